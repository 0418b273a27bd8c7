"""The live preview shows what is being learned, where it is, and changes nothing of it."""

import io
import json
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest
import torch
from PIL import Image

from blender_nep.capture import PixelRays, load_capture
from blender_nep.checkpoints import NoCheckpoint
from blender_nep.errors import LearningError
from blender_nep.fields.training import learn_fields
from blender_nep.job.reporting import live_preview
from blender_nep.job.reporting.events import Events
from blender_nep.job.reporting.live_preview import LivePreview
from blender_nep.scene.scene import Scene
from support.brief_preset import brief_preset
from support.paths import SUZANNE_SMALL

CPU = torch.device("cpu")


@pytest.fixture(scope="module")
def capture():
    return load_capture(SUZANNE_SMALL)


@pytest.fixture(scope="module")
def rays(capture):
    return PixelRays.from_capture(capture, 10_000, True, CPU)


class EveryStep(LivePreview):
    """A preview after every step."""

    interval, share = 0.0, float("inf")


def flat(value) -> dict:
    """A nested state as {path: tensor or number}."""
    if isinstance(value, dict):
        return {f"{k}.{path}": leaf for k, v in value.items() for path, leaf in flat(v).items()}
    return {"": value}


@pytest.mark.slow
def test_learning_is_the_same_with_and_without(rays, capture, tmp_path, monkeypatch):
    monkeypatch.setattr(live_preview, "GRID", 24)
    protocol = io.StringIO()
    watch = EveryStep(tmp_path, rays, capture.from_unit, Events(protocol))
    preset = brief_preset(steps=12, least_explanation_ratio=0.0)
    fields = [
        learn_fields(Scene.of(rays), preset, seed=3, progress=lambda *_: None, checkpoint=NoCheckpoint(), **keywords)
        for keywords in ({}, {"watch": watch})
    ]
    without, with_preview = (flat(each.state()) for each in fields)
    assert without.keys() == with_preview.keys()
    for name, value in without.items():
        same = torch.equal(value, with_preview[name]) if isinstance(value, torch.Tensor) else value == with_preview[name]
        assert same, name
    shown = [json.loads(line) for line in protocol.getvalue().splitlines()]
    assert [Path(event["path"]).name for event in shown] == ["preview.npz", "preview.png"] * (len(shown) // 2)
    assert len(shown) >= 12 and all(event["event"] == "preview" for event in shown)

    arrays = np.load(tmp_path / "job" / "preview.npz")
    distance = np.linalg.norm(arrays["vertices"] - capture.object_center, axis=1)
    assert 0.2 * capture.object_radius < distance.mean() and distance.max() <= 1.01 * capture.object_radius
    assert arrays["faces"].max() < len(arrays["vertices"])
    picture = np.asarray(Image.open(tmp_path / "job" / "preview.png"))
    height, width = picture.shape[:2]
    assert width == 2 * height <= 2 * live_preview.WIDTH and picture[:, :height].std() > 10
    assert sorted(path.name for path in (tmp_path / "job").iterdir()) == ["preview.npz", "preview.png"]


def test_previews_keep_to_their_share_of_the_time(rays, capture, tmp_path, monkeypatch):
    now, written = [0.0], []
    watch = LivePreview(tmp_path, rays, capture.from_unit, Events(), clock=lambda: now[0])

    def slowly_find_nothing(_sdf):
        written.append(now[0])
        now[0] += 1.5
        raise LearningError("no surface yet")

    monkeypatch.setattr(live_preview, "zero_level", slowly_find_nothing)
    learning = SimpleNamespace(fraction=0.0, object_field=SimpleNamespace(sdf_grid=lambda _samples: None))
    for _ in range(300):
        watch(learning)
        learning.fraction = 0.1
        now[0] += 1
    assert written[0] == 10 and np.diff(written).min() >= 1.5 / 0.03


def test_a_preview_that_fails_is_one_warning(rays, capture, tmp_path):
    (tmp_path / "job").write_text("a file where the folder should be")
    events = Events()
    watch = EveryStep(tmp_path, rays, capture.from_unit, events)
    preset = brief_preset(steps=4, background_steps=0, least_explanation_ratio=0.0)
    fields = learn_fields(Scene.of(rays), preset, seed=3, progress=lambda *_: None, checkpoint=NoCheckpoint(), watch=watch)
    assert fields.object_field is not None
    assert len(events.warnings) == 1 and events.warnings[0].code == "job.preview_ended"
