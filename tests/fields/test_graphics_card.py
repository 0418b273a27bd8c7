"""Stage 1 on a graphics card that is pretended: no tensor lies on the wrong device, and the results are those of the CPU."""

import math

import pytest
import torch

from benchmarks.suite.harness import with_changes
from blender_nep.capture import PixelRays, load_capture
from blender_nep.fields.training import FieldsLearning
from blender_nep.scene.scene import Scene
from support.brief_preset import brief_preset
from support.pretended_gpu import pretended_gpu

CPU = torch.device("cpu")
BRIEF = with_changes(
    brief_preset(background_steps=4, steps=8, first_levels=2, last_levels=3, validation_pixels=256, sdf_rate=0.003),
    {"environment": {"initial_raw_density": -9.0}},  # so F_e is clear, and not rendered in front of most of the rays
)


def learn(capture, use_masks, device, preset=BRIEF):
    """Learn the fields; returns the learning and the loss of each step."""
    learning = FieldsLearning(Scene.of(PixelRays.from_capture(capture, 2_000, use_masks, device)), preset, 0)
    losses = []
    while learning.fraction < 1:
        losses.append(learning.learn_step())
    return learning, losses


@pytest.mark.parametrize(
    "use_masks", [pytest.param(True, id="with masks"), pytest.param(False, id="without", marks=pytest.mark.slow)]
)
def test_fields_are_those_of_the_cpu(monkeypatch, make_capture, use_masks):
    capture = load_capture(make_capture(views=8, size=32, masks=True).folder, use_masks=use_masks)
    expected, losses = learn(capture, use_masks, CPU)
    with pretended_gpu(monkeypatch) as device:
        learning, found = learn(capture, use_masks, device)
        assert math.isfinite(learning.explanation_ratio(256)) and len(learning.object_pixels.clear)
        resumed = FieldsLearning(learning.scene, BRIEF, 0)
        resumed.load(learning.state())
        sdf = resumed.object_field.sdf_in_cells(32)
    assert found[:4] == pytest.approx(losses[:4], rel=1e-5)  # of F_e alone
    assert found == pytest.approx(losses, rel=0.02)  # spans that begin elsewhere put the samples elsewhere
    assert abs(sdf - expected.object_field.sdf_in_cells(32)).mean() < 5e-5
