"""Which pixels stage 1 learns from, and which it is tested on."""

from dataclasses import replace
from types import SimpleNamespace

import pytest
import torch

from blender_nep.capture import PixelRays, load_capture
from blender_nep.capture.rays.pixel_set import PixelSet
from blender_nep.fields.object.field import ObjectField
from blender_nep.fields.object_pixels import (
    ObjectPixels,
    draw_pixels,
    find_object_pixels,
    fitted_to_widths,
    held_out_pixels,
)
from blender_nep.fields.training import FieldsLearning
from blender_nep.presets import preset
from blender_nep.scene.scene import Scene
from support.paths import SUZANNE_SMALL


@pytest.fixture(scope="module")
def rays():
    return PixelRays.from_capture(load_capture(SUZANNE_SMALL), 10_000, False)


def clear_above(rays):
    """Transmittances of a veil that hides the object from all cameras below its center."""
    return torch.where(rays.origins[:, 2] > 0, 1.0, 0.5)


def test_the_object_is_found_in_the_pixels_that_show_it(rays):
    radius, band = 0.6, 0.06
    pixels = find_object_pixels(rays, ObjectField(64, radius).shape(), band, None)
    shown = torch.cat([rays.sphere.tensor(), rays.outside.tensor()])
    origins, directions, _ = rays.rays(shown)
    off_axis = torch.linalg.cross(origins, directions).norm(dim=-1)
    found = torch.zeros(rays.count, dtype=torch.bool)
    found[pixels.joined().tensor()] = True
    found = found[shown]
    assert found[off_axis < radius + band].all() and not found[off_axis > radius + 0.25].any()
    assert not len(pixels.clear), "without an F_e that could tell, no pixel is clear"


def test_pixels_behind_a_veil_are_told_from_clear_ones(rays):
    pixels = find_object_pixels(rays, ObjectField(64, 0.6).shape(), 0.06, clear_above)
    for part, clear in ((pixels.clear, True), (pixels.veiled, False)):
        origins, _, _ = rays.rays(part.tensor())
        assert len(part) > 100 and ((origins[:, 2] > 0) == clear).all()


def test_pixels_beside_a_veil_are_veiled_too(rays):
    """One ray in 16 is asked, so the border of what stands before the object lies somewhere between two rays."""
    band = 0.02
    whole = find_object_pixels(rays, ObjectField(64, 0.6).shape(), band, lambda r: torch.ones(len(r)))
    half = find_object_pixels(rays, ObjectField(64, 0.6).shape(), band, lambda r: (r.directions[:, 2] < 0).float())
    assert len(whole.veiled) == 0 and len(half) == len(whole)
    _, directions, _ = rays.rays(half.clear.tensor())
    assert (directions[:, 2] < 0).all(), "no pixel of a clear block looks through the veil"


def test_an_object_that_is_nowhere_may_be_anywhere_in_its_sphere(rays):
    class Nothing:
        def near(self, origins, directions, band):
            return torch.zeros(len(origins), dtype=torch.bool)

    pixels = find_object_pixels(rays, Nothing(), 0.06, clear_above)
    assert pixels.veiled is rays.sphere and not len(pixels.clear)


def test_clear_and_veiled_pixels_are_drawn_and_held_out_ones_not():
    flags = torch.ones(500, dtype=torch.bool)
    pixels = ObjectPixels(PixelSet.where(flags), PixelSet.where(flags[:101], 500))
    clear, veiled = pixels.draw(30_000, 101, torch.Generator().manual_seed(0))
    assert set(clear.tolist()) == {k for k in range(500) if k % 101}
    assert set(veiled.tolist()) == {k for k in range(500, 601) if k % 101}
    assert (clear.diff() >= 0).all() and (veiled.diff() >= 0).all(), "neighbors follow each other"
    assert len(veiled) / len(clear) == pytest.approx(100 / 495, rel=0.05)
    clear, veiled = ObjectPixels(pixels.clear.empty(), pixels.veiled).draw(7, 1 << 40, torch.Generator().manual_seed(0))
    assert (len(clear), len(veiled)) == (0, 7)
    again = ObjectPixels.from_state(pixels.state(), torch.device("cpu"))
    assert torch.equal(again.joined().tensor(), pixels.joined().tensor()) and len(again.clear) == 500


def test_held_out_pixels_are_thinned_evenly():
    pixels = PixelSet.where(torch.ones(10_000, dtype=torch.bool))
    assert torch.equal(held_out_pixels(pixels, 101, 1000), torch.arange(0, 10_000, 101))
    thinned = held_out_pixels(pixels, 101, 10)
    assert len(thinned) == 10 and (thinned.diff() == 10 * 101).all()


@pytest.mark.parametrize(
    ("widths", "every"),
    [((640, 480), 101), ((101,), 102), ((1010,), 103), ((640, 808), 103), ((102, 202), 103), ((101 * 103, 404), 105)],
)
def test_held_out_pixels_are_no_columns_of_any_photo(widths, every):
    rays = SimpleNamespace(size=[(2000, width) for width in widths])
    chosen = preset("preview").fields
    fitted = fitted_to_widths(chosen, rays)
    assert fitted == replace(chosen, held_out_every=every) and (every == 101) == (fitted == chosen)
    start = 0
    for width in widths:
        pixels = PixelSet.where(torch.ones(2000 * width, dtype=torch.bool), start)
        start += len(pixels)
        column = (held_out_pixels(pixels, fitted.held_out_every, len(pixels)) - start) % width
        assert len(column.unique()) == width, "each column has pixels that are held out, and others"


def test_learning_holds_out_pixels_of_all_columns(make_capture):
    """Photos of 202 x 202 pixels."""
    rays = PixelRays.from_capture(load_capture(make_capture(views=4, size=202).folder), 1 << 20, False)
    learning = FieldsLearning(Scene.of(rays), preset("preview"), 0)
    every = learning.preset.held_out_every
    assert len((held_out_pixels(rays.sphere, every, 1 << 20) % 202).unique()) > 100
    drawn = learning.draw(rays.sphere, 1 << 16)
    assert (drawn % every).all() and not (drawn % 101).all()


def test_held_out_pixels_are_drawn_only_if_there_are_no_others():
    generator = torch.Generator().manual_seed(0)
    drawn = draw_pixels(PixelSet.where(torch.ones(500, dtype=torch.bool)), 4000, 101, generator)
    assert sorted(set(range(500)) - set(drawn.tolist())) == [0, 101, 202, 303, 404]
    assert (drawn.diff() >= 0).all(), "neighbors follow each other"
    assert draw_pixels(torch.tensor([101]), 4, 101, generator).tolist() == [101] * 4, "a batch is never empty"
    assert set(draw_pixels(torch.tensor([1, 101]), 64, 101, generator).tolist()) == {1}
