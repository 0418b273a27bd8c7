"""Things before the object: masks of two photos lack a part of the object, which the masks of the others show."""

from dataclasses import replace

import numpy as np
import pytest
import torch

from blender_nep.capture import PixelRays, load_capture
from blender_nep.fields.losses import FieldsLosses
from blender_nep.fields.refinements.hidden_pixels import UNEXPLAINED, hidden_pixels
from blender_nep.fields.training import FieldsLearning
from blender_nep.fields.visual_hull import carve, mask_silhouettes, score_cells
from blender_nep.scene.scene import Scene
from support.brief_preset import brief_preset
from support.paths import SUZANNE_SMALL

CPU = torch.device("cpu")
COVERED = (3, 11)


@pytest.fixture(scope="module")
def rays():
    return PixelRays.from_capture(load_capture(SUZANNE_SMALL), 10_000, True, CPU)


def covered(rays, views=COVERED):
    """The rays with a disc of the object missing in the masks of some views, and the indices of the missing pixels."""
    mask, missing = rays.mask.clone(), []
    for view in views:
        height, width = rays.size[view]
        here = rays.mask[rays.offset[view] : rays.offset[view + 1]].reshape(height, width)
        row, column = (axis.float().mean() for axis in torch.nonzero(here > 127, as_tuple=True))
        y, x = torch.meshgrid(torch.arange(height), torch.arange(width), indexing="ij")
        disc = ((y - row) ** 2 + (x - column) ** 2 < (0.12 * height) ** 2) & (here > 127)
        missing.append(torch.nonzero(disc.flatten())[:, 0] + rays.offset[view])
    mask[torch.cat(missing)] = 0
    return replace(rays, mask=mask), torch.cat(missing)


def found(rays, error=10.0):
    hull = carve(score_cells(rays, mask_silhouettes(rays), 64))
    return hidden_pixels(rays, hull.sdf, lambda index: torch.full((len(index),), error))


def test_what_the_other_masks_outvote_is_hidden(rays):
    """Gaps through which few photos see are outvoted, too; here F_e is said to explain nothing."""
    masked, missing = covered(rays)
    hidden = np.setdiff1d(found(masked), found(rays))
    both = np.intersect1d(hidden, missing)
    assert len(both) > 0.9 * len(missing) and len(both) > 0.9 * len(hidden)
    assert (found(masked).diff() > 0).all()


def test_a_hole_that_f_e_explains_is_not_hidden(rays):
    masked, _ = covered(rays)
    assert len(found(masked, error=0.9 * UNEXPLAINED)) == 0


def test_a_hole_that_all_masks_show_is_no_contradiction(rays):
    masked, _ = covered(rays, range(rays.views))
    hull = carve(score_cells(masked, mask_silhouettes(masked), 64))
    outvoted = found(masked)
    assert hull.sdf[32, 32, 32] > 0, "the hull has the hole"
    assert len(outvoted) < 0.1 * int((rays.mask > 127).sum())


def test_learning_does_not_hold_the_object_back_there(rays, monkeypatch):
    """The mask loss of hidden pixels is left out, and a resumed run still leaves it out."""
    masked, missing = covered(rays)
    # the brief preset's F_e explains nothing, neither behind nor beside the object
    nothing = lambda self: lambda index: torch.full((len(index),), 10.0)  # noqa: E731
    monkeypatch.setattr(FieldsLearning, "unexplained_by_environment", nothing)
    learning = FieldsLearning(Scene.of(masked), brief_preset(), 0)
    while not learning.hidden_pixels.numel() and learning.fraction < 0.3:
        learning.learn_step()
    hidden = learning.hidden_pixels
    assert len(np.intersect1d(hidden, missing)) > 0.9 * len(missing)
    resumed = FieldsLearning(Scene.of(masked), brief_preset(), 0)
    resumed.load(learning.state())
    assert torch.equal(resumed.hidden_pixels, hidden)
    assert learning.refinements.report()["hidden_pixels"]["pixels"] == pytest.approx(len(hidden), rel=1e-3)
    batch = torch.cat([hidden[:200], masked.outside[:200], masked.sphere[::37]])
    handed, total = {}, FieldsLosses.total

    def spy(losses, photometric, out, curvature_weight, distortion_weight, mask, says):
        loss = total(losses, photometric, out, curvature_weight, distortion_weight, mask, says)
        handed["says"] = says
        handed["gradient"] = torch.autograd.grad(loss - photometric, out.opacity, retain_graph=True)[0]
        return loss

    monkeypatch.setattr(FieldsLosses, "total", spy)
    monkeypatch.setattr(resumed, "_draw_batch", lambda: (batch, 0))
    resumed.learn_step()
    is_hidden = np.isin(batch, hidden)
    np.testing.assert_array_equal(handed["says"] == 0, is_hidden)
    assert (handed["gradient"][is_hidden] == 0).all() and (handed["gradient"][~is_hidden] != 0).any()


def test_the_error_of_f_e_is_measured_against_that_beside_it(rays):
    """A short F_e alone: about 1 beside the sphere, and larger where the object stands."""
    learning = FieldsLearning(Scene.of(rays), brief_preset(background_steps=60), 0)
    while learning.schedule.learns_background:
        learning.learn_step()
    error = learning.unexplained_by_environment()
    beside, on_object = error(rays.outside[::7]), error(torch.nonzero(rays.mask > 250)[::7, 0])
    assert torch.isfinite(beside).all() and beside.mean() == pytest.approx(1, rel=0.1)
    assert on_object.mean() > 1.3
