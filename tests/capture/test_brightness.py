"""How bright a capture's photos are does not matter."""

from dataclasses import replace

import pytest
import torch

from blender_nep.capture import PixelRays, load_capture
from blender_nep.capture.brightness import MOST_EXPOSURE, to_brightness, typical_radiance
from blender_nep.fields.training import FieldsLearning
from blender_nep.scene.scene import Scene
from support.brief_preset import brief_preset
from support.paths import SUZANNE_SMALL


@pytest.fixture(scope="module")
def rays():
    return PixelRays.from_capture(load_capture(SUZANNE_SMALL), 2_000, False)


def darker(rays, factor):
    """The same photos with a shorter exposure."""
    return replace(rays, radiance=rays.radiance / factor)


def test_typical_radiance_is_a_geometric_mean_over_the_sphere(rays):
    index = rays.sphere.tensor()
    half = replace(rays, radiance=torch.full_like(rays.radiance, 0.5).index_fill(0, index[::2], 0.125))
    assert typical_radiance(half, pixels=len(index)) == pytest.approx(0.25, rel=1e-2)


@pytest.mark.parametrize("factor", [1.0, 7.0, 0.01])
def test_photos_of_any_exposure_become_equally_bright(rays, factor):
    bright = to_brightness(darker(rays, factor), 0.18)
    assert typical_radiance(bright) == pytest.approx(0.18, rel=1e-4)
    index = torch.arange(0, rays.count, 17)
    torch.testing.assert_close(bright.photo(index), to_brightness(rays, 0.18).photo(index), rtol=1e-4, atol=1e-6)
    assert torch.equal(bright.radiance, darker(rays, factor).radiance), "what the files hold is still known"
    again = to_brightness(bright, 0.18)
    assert again.exposure == pytest.approx(bright.exposure, rel=1e-4)


def test_black_photos_are_not_made_bright_without_end(rays):
    assert to_brightness(darker(rays, 1e12), 0.18).exposure == MOST_EXPOSURE
    assert to_brightness(replace(rays, radiance=0 * rays.radiance), 0.18).exposure == pytest.approx(0.18)


def test_gains_and_exposure_work_together(rays):
    gain = torch.linspace(0.5, 2, rays.views)[:, None].expand(rays.views, 3)
    taken = replace(rays, radiance=rays.radiance * gain[rays.view_of(torch.arange(rays.count))])
    index = torch.arange(0, rays.count, 17)
    found = to_brightness(taken.with_gain(gain), 0.18)
    torch.testing.assert_close(found.photo(index), to_brightness(rays, 0.18).photo(index), rtol=1e-4, atol=1e-6)


@pytest.mark.slow
def test_dark_photos_give_the_same_object_as_bright_ones(rays):
    """Before, a loss on dark photos was small beside the priors."""

    def learned(photos):
        learning = FieldsLearning(Scene.of(photos), brief_preset(coarsest_cells=16), 0)
        for _ in range(25):
            learning.learn_step()
        return learning.object_field.coefficients().detach()

    one, dark = learned(to_brightness(rays, 0.18)), learned(to_brightness(darker(rays, 20), 0.18))
    as_taken = learned(darker(rays, 20))
    assert (one - dark).abs().max() < 1e-4 < 1e-3 < (one - as_taken).abs().max()
