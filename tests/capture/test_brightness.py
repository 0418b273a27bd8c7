"""How bright a capture's photos are does not matter."""

from dataclasses import replace

import pytest
import torch

from blender_nep.capture import PixelRays, load_capture
from blender_nep.capture.brightness import (
    DARKEST_OBJECT,
    MOST_BRIGHTENED,
    MOST_EXPOSURE,
    radiance_of_object,
    to_brightness,
    typical_radiance,
)
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


def near_center(rays, width=0.25):
    """Which pixels see within `width` of the sphere's center: the nearest of many points of each ray decides."""
    bundle = rays.rays(torch.arange(rays.count))
    nearest = torch.full((rays.count,), torch.inf)
    for t in torch.linspace(0, 10, 2001):
        nearest = torch.minimum(nearest, (bundle.origins + t * bundle.directions).norm(dim=-1))
    return nearest < width


def with_object(rays, own, radiance):
    """The same photos, where the pixels `own` have this radiance and all others have a radiance of 0.5."""
    pixels = torch.where(own, radiance, 0.5)[:, None].expand(-1, 3)
    return replace(rays, radiance=pixels.to(rays.radiance.dtype).contiguous())


def test_a_dark_object_is_found_near_the_center(rays):
    dark = with_object(rays, near_center(rays), 0.01)
    assert radiance_of_object(dark, pixels=rays.count) == pytest.approx(0.01, rel=0.05)
    assert typical_radiance(dark, pixels=rays.count) > 0.1


def test_masks_say_what_the_object_is():
    rays = PixelRays.from_capture(load_capture(SUZANNE_SMALL), 2_000, True)
    dark = with_object(rays, rays.mask > 127, 0.02)
    assert radiance_of_object(dark, pixels=rays.count) == pytest.approx(0.02, rel=1e-3)


def test_a_dark_object_becomes_bright_enough(rays):
    """Bronze before a white wall was too dark for the losses, though the photos were bright."""
    dark, even = (to_brightness(with_object(rays, near_center(rays), of), 0.18) for of in (0.08, 0.4))
    assert radiance_of_object(dark) == pytest.approx(DARKEST_OBJECT * 0.18, rel=0.05)
    assert typical_radiance(even) == pytest.approx(0.18, rel=1e-4), "an object that is not dark changes nothing"


def test_an_object_without_light_changes_nothing(rays):
    """A silhouette says nothing of its brightness. A very dark object does not make its surroundings bright without end."""
    black, dark, even = (to_brightness(with_object(rays, near_center(rays), of), 0.18) for of in (0.0, 1e-5, 0.5))
    assert typical_radiance(black) == pytest.approx(0.18, rel=1e-4)
    assert dark.exposure < 1.01 * MOST_BRIGHTENED * even.exposure


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
