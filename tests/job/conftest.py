"""A job on a tiny capture, with stages that know the answer (support.ball_stages)."""

from __future__ import annotations

import io
import json

import pytest

from blender_nep.job import runner as job
from blender_nep.job.reporting.events import Events
from blender_nep.presets import preset
from blender_nep.stop_request import StopRequest


@pytest.fixture
def start(make_capture, tmp_path):
    """start(stages, stop=..., **settings) runs a job; returns exit code and events. start.out is the asset."""
    folder = make_capture(masks=True).folder

    def run(stages, stop=None, **keywords):
        protocol = io.StringIO()
        settings = job.Settings(**({"capture": folder, "out": run.out, "preset": preset("preview")} | keywords))
        code = job.run(settings, Events(protocol, io.StringIO()), stop or StopRequest(), stages)
        return code, [json.loads(line) for line in protocol.getvalue().splitlines()]

    run.out = tmp_path / "asset"
    run.folder = folder
    return run
