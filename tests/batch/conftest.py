"""A batch of captures whose jobs are played by support.batch_engine."""

from __future__ import annotations

import io
import json
from pathlib import Path

import pytest

from blender_nep.batch import runner
from blender_nep.batch.settings import BatchSettings
from blender_nep.batch.workers.scheduler import Scheduler
from blender_nep.job.reporting.events import Events
from blender_nep.stop_request import StopRequest
from support import batch_engine


class PlayedBatch:
    """The folders of a batch, and a way to run it in this process."""

    def __init__(self, folder: Path, make_capture) -> None:
        self.out, self.captures = folder / "shelf", folder / "captures"
        self.captures.mkdir()
        self.engine = batch_engine.make(folder)
        self._make_capture, self.said = make_capture, ""

    def add(self, name: str, plays: str = "", views: int = 6) -> Path:
        """Make a capture whose job plays `plays`."""
        folder = self._make_capture(name=f"captures/{name}", views=views, size=8, suffix=".png").folder
        if plays:
            (folder / "plays").write_text(plays)
        return folder

    def run(self, stop: StopRequest | None = None, captures=None, **options) -> tuple[int, list[dict]]:
        """Run the batch; returns the exit code and the events."""
        protocol, human = io.StringIO(), io.StringIO()
        named = (self.captures,) if captures is None else tuple(captures)
        wanted = {"preset": "preview", "workers": 2, "threads": 1, "memory_mb": 20000.0, "engine": self.engine} | options
        code = runner.run(BatchSettings(named, self.out, **wanted), Events(protocol, human), stop or StopRequest())
        self.said = human.getvalue()
        return code, [json.loads(line) for line in protocol.getvalue().splitlines()]

    def objects(self) -> dict[str, dict]:
        """{name: object} of batch.json."""
        return {one["name"]: one for one in self.content()["objects"]}

    def content(self) -> dict:
        """What is in batch.json."""
        return json.loads((self.out / "batch.json").read_text(encoding="utf-8"))

    def steps(self, name: str) -> list[str]:
        """The steps that were done for an object, in order."""
        return (self.out / name / "steps.txt").read_text().split()


@pytest.fixture
def batch(tmp_path, make_capture, monkeypatch):
    monkeypatch.setattr(Scheduler, "poll_s", 0.01)
    return PlayedBatch(tmp_path, make_capture)
