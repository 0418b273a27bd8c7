"""A whole job on a graphics card that is pretended: no tensor lies on the wrong device, from the photos to the asset."""

import io
import json
from dataclasses import replace

import pytest

from blender_nep.job import runner as job
from blender_nep.job.reporting.events import Events
from blender_nep.presets import Preset
from blender_nep.stop_request import StopRequest
from support.brief_preset import brief_preset
from support.lit_ball import PRESET
from support.pretended_gpu import DEVICE, pretended_gpu


def brief() -> Preset:
    """A preset for seconds instead of minutes: an operation on the pretended card takes a hundred times as long."""
    p = brief_preset(background_steps=4, steps=8, first_levels=2, last_levels=3, least_explanation_ratio=0.0)
    surface = replace(p.surface, grid=64, unwrapped_faces=500, faces=1000)
    material = replace(PRESET, samples=300, most_texels=64, unseen_steps=4, rounds=1)
    return replace(p, surface=surface, material=material)


@pytest.mark.slow
def test_a_job_ends_with_an_asset(make_capture, tmp_path, monkeypatch):
    capture, asset = make_capture(masks=True), tmp_path / "asset"
    settings = job.Settings(capture=capture.folder, out=asset, preset=brief(), preview=True)
    monkeypatch.setattr(job, "choose_device", lambda name: DEVICE)
    told = io.StringIO()
    with pretended_gpu(monkeypatch):
        assert job.run(settings, Events(io.StringIO(), told), StopRequest()) == 0, told.getvalue()
    assert (asset / "textures/albedo.exr").is_file()
    assert json.loads((asset / "report.json").read_text())["device"] == str(DEVICE)
