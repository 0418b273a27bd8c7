"""The add-on in Blender: a whole session in the wheel at hand, and the arithmetic of its cameras."""

from __future__ import annotations

import io
import sys

import pytest

from blender_nep.job import runner as job
from blender_nep.job.reporting.events import Events
from blender_nep.presets import preset
from blender_nep.stop_request import StopRequest
from release.extension import build
from support.ball_stages import BallStages
from support.extension import session

LIMIT_S = 300


@pytest.fixture(scope="module")
def archive(tmp_path_factory):
    return build(tmp_path_factory.mktemp("extension") / "blender_nep.zip")


@pytest.mark.slow
def test_an_artists_session(make_capture, tmp_path, archive):
    """See blender_session.py. Asset and engine are real but for what was learned, which BallStages knows."""
    capture, asset = make_capture(masks=True).folder, tmp_path / "ball"
    settings = job.Settings(capture, asset, preset("preview"))
    assert job.run(settings, Events(None, io.StringIO()), StopRequest(), BallStages()) == 0
    ended = session(sys.executable, sys.executable, archive, capture, asset, tmp_path / "session", LIMIT_S)
    assert ended.returncode == 0, ended.stdout[-5000:]
    assert "all of it works" in ended.stdout
