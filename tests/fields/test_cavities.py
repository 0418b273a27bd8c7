"""A pot whose opening is closed by a lid is opened, and nothing else is."""

from types import SimpleNamespace

import numpy as np
import pytest
import torch
from scipy import ndimage

from blender_nep.capture import PixelRays, load_capture
from blender_nep.capture.rays.rigid_motions import RigidMotions
from blender_nep.evidence.lids import Lid, ShownSurface, _without_holes
from blender_nep.evidence.small_photos import SmallPhotos
from blender_nep.fields.object.field import ObjectField
from blender_nep.fields.refinements import cavities as cavity_search
from blender_nep.fields.refinements.cavities import CavityOpening, find_cavities
from support.pot_scene import BOTTOM, RADIUS, TOP, block, everywhere, in_cells, nowhere, pipe, pot, sky, write_pot_scene

CLOSED = in_cells(block)


def pixels(folder) -> PixelRays:
    return PixelRays.from_capture(load_capture(folder), 10_000, False, torch.device("cpu"))


def known_sky(rays):
    return sky(rays.directions)


def difference_for(rays: PixelRays, sdf: np.ndarray, background=known_sky) -> np.ndarray:
    return find_cavities(rays, sdf, background).difference


def of_thickness(wall: float):
    return lambda points: pot(points, wall)


@pytest.mark.parametrize("wall", [0.06, *(pytest.param(wall, marks=pytest.mark.slow) for wall in (0.1, 0.18))])
def test_a_painted_pot_is_opened_down_to_its_wall(tmp_path, wall):
    true = in_cells(of_thickness(wall))
    opened = CLOSED + difference_for(pixels(write_pot_scene(tmp_path / "pot", of_thickness(wall))), CLOSED)
    cavity, body = (CLOSED < 0) & (true > 0), true < 0
    found = (CLOSED < 0) & (opened > 0)
    assert (found & cavity).sum() / (found | cavity).sum() > 0.85
    assert (opened[body & (true < -0.02)] < 0).mean() > 0.98
    assert np.abs(opened - true)[np.abs(true) < 0.05].mean() < 0.02
    assert (opened[CLOSED > 0.1] == CLOSED[CLOSED > 0.1]).mean() > 0.8


def test_a_pot_that_ends_at_the_border_of_the_grid_is_opened(tmp_path):
    def raised(distance):
        return lambda points: distance(points - np.array([0.0, 0.0, 0.38]))

    whole, true = in_cells(raised(block)), in_cells(raised(of_thickness(0.1)))
    opened = whole + difference_for(pixels(write_pot_scene(tmp_path / "pot", raised(of_thickness(0.1)))), whole)
    cavity, found = (whole < 0) & (true > 0), (whole < 0) & (opened > 0)
    assert (found & cavity).sum() / (found | cavity).sum() > 0.8


def test_a_pot_with_gold_leaf_below_its_rim_is_opened(tmp_path):
    """The photos disagree on the gold, too. It is not taken for a part of the lid."""

    def gold(points):
        x, y, z = points.T
        return (np.hypot(x, y) > RADIUS - 0.02) & (z > 0.1) & (y > 0)

    folder = write_pot_scene(tmp_path / "pot", of_thickness(0.1), mirror=gold)
    cavity = (CLOSED < 0) & (in_cells(of_thickness(0.1)) > 0)
    found = (CLOSED < 0) & (CLOSED + difference_for(pixels(folder), CLOSED) > 0)
    assert (found & cavity).sum() / (found | cavity).sum() > 0.8


def test_a_pipe_is_opened_at_both_ends(tmp_path):
    true = in_cells(lambda points: pipe(points, 0.1))
    photos = pixels(write_pot_scene(tmp_path / "pipe", lambda points: pipe(points, 0.1)))
    opened = CLOSED + difference_for(photos, CLOSED)
    inside, body = (CLOSED < 0) & (true > 0), true < 0
    found = (CLOSED < 0) & (opened > 0)
    assert (found & inside).sum() / (found | inside).sum() > 0.85
    assert (opened[body & (true < -0.02)] < 0).mean() > 0.98
    field = ObjectField(64, 0.6)
    field.start_from(torch.from_numpy(opened))
    assert (field.sdf(torch.tensor([[0.0, 0.0, z] for z in (BOTTOM, -0.3, 0.0, 0.3, TOP)])) > 0.05).all()


@pytest.mark.slow
def test_a_short_ring_is_opened(tmp_path):
    """Most pixels of its lid see through it, and few see its wall."""

    def raised(distance):
        return lambda points: np.maximum(distance(points), np.abs(points[..., 2]) - 0.2)

    whole, true = in_cells(raised(block)), in_cells(raised(lambda points: pipe(points, 0.1)))
    photos = pixels(write_pot_scene(tmp_path / "ring", raised(lambda points: pipe(points, 0.1))))
    opened = whole + difference_for(photos, whole)
    inside, found = (whole < 0) & (true > 0), (whole < 0) & (opened > 0)
    assert (found & inside).sum() / (found | inside).sum() > 0.8


@pytest.mark.slow
def test_nothing_is_a_tube_without_a_known_background(tmp_path):
    photos = pixels(write_pot_scene(tmp_path / "pipe", lambda points: pipe(points, 0.1)))
    opened = CLOSED + difference_for(photos, CLOSED, None)
    floor = (CLOSED < 0) & (in_cells(lambda points: points[..., 2]) < BOTTOM + 0.03)
    assert (opened[floor] < 0).all()


def test_a_lid_grows_over_the_rest_of_the_opening(tmp_path):
    photos = pixels(write_pot_scene(tmp_path / "pipe", lambda points: pipe(points, 0.1)))
    surface = ShownSurface.of(SmallPhotos(photos), CLOSED, known_sky)
    x, y, z = (in_cells(lambda points, k=k: points[..., k]) for k in range(3))
    mask, beside = surface.surface.mask, np.hypot(x, y)
    top, floor = (mask & (z * side > TOP - 0.05) & (beside < RADIUS - 0.1) for side in (1, -1))
    half = top & (x > 0)
    lid = surface.lid(half, surface.volume_of(half), surface.volume_of(floor))
    open_to, cells = cavity_search._grown(lid, surface, CLOSED, lid.above | lid.beyond, 0.1)
    wall = mask & (beside > RADIUS - 0.05) & (np.abs(z) < TOP - 0.15)
    assert (cells & top).sum() > 0.8 * top.sum() and (cells & wall).sum() < 0.01 * wall.sum()
    assert (open_to & wall).sum() < 0.01 * wall.sum()


def test_a_pipe_is_no_pipe_if_something_else_is_behind_it(tmp_path):
    photos = pixels(write_pot_scene(tmp_path / "pipe", lambda points: pipe(points, 0.1)))
    opened = CLOSED + difference_for(photos, CLOSED, lambda rays: torch.zeros_like(rays.directions))
    floor = (CLOSED < 0) & (in_cells(lambda points: points[..., 2]) < BOTTOM + 0.03)
    assert (opened[floor] < 0).all()


@pytest.mark.parametrize("mirror", [nowhere, everywhere])
def test_a_solid_body_stays_as_it_is(tmp_path, mirror):
    assert not difference_for(pixels(write_pot_scene(tmp_path / "block", block, mirror=mirror)), CLOSED).any()


def test_a_mirroring_pot_stays_closed(tmp_path):
    """Photos do not agree on the inside of a mirror."""
    assert not difference_for(pixels(write_pot_scene(tmp_path / "pot", of_thickness(0.1), mirror=everywhere)), CLOSED).any()


def test_the_object_field_is_opened(tmp_path):
    rays = pixels(write_pot_scene(tmp_path / "pot", of_thickness(0.1)))
    field = ObjectField(64, 0.6)
    field.start_from(torch.from_numpy(CLOSED))
    change = CavityOpening(0.5).apply(
        SimpleNamespace(
            object_field=field,
            rays=rays,
            on_device=torch.from_numpy,
            renderer=SimpleNamespace(background=known_sky),
        )
    )
    assert change.acted and change.found["parts_tried"] >= 1 and 0.2 < change.found["share"] < 0.9
    axis = torch.tensor([[0.0, 0.0, z] for z in (-0.3, 0.0, 0.3, 0.6)])
    assert (field.sdf(axis) > 0.05).all()
    assert (field.sdf(torch.tensor([[0.5, 0.0, 0.0], [0.0, -0.5, 0.3], [0.0, 0.0, -0.55]])) < 0).all()


def test_nothing_is_opened_on_a_turntable(tmp_path):
    """There the photos disagree on every surface, because the object turns in its light."""
    rays = pixels(write_pot_scene(tmp_path / "pot", of_thickness(0.1)))
    still = RigidMotions(torch.eye(3).repeat(rays.views, 1, 1), torch.zeros(rays.views, 3))
    opening = CavityOpening(0.5)
    assert opening.skipped(SimpleNamespace(rays=rays)) is None
    assert opening.skipped(SimpleNamespace(rays=rays.with_turntable(still))).code == "reason.turntable"


@pytest.mark.parametrize("sdf", [1.0, -1.0])
def test_nothing_and_everything_have_no_cavity(tmp_path, sdf):
    rays = pixels(write_pot_scene(tmp_path / "block", block))
    assert not difference_for(rays, np.full(CLOSED.shape, sdf, np.float32)).any()


@pytest.mark.parametrize("on_the_lid, opens", [(0.6, True), (0.2, False)])
def test_lid_and_inside_are_compared_in_the_same_photos(on_the_lid, opens):
    """Four of eight photos show the inside and agree on it. It is a cavity only if these four disagree on the lid."""
    shown = torch.full((8, 20, 3), torch.nan)
    shown[:4], shown[4:] = torch.tensor([0.2, on_the_lid, on_the_lid, on_the_lid])[:, None, None], 0.6
    inside = shown.clone()
    inside[:4], inside[4:] = 0.2, torch.nan

    class Photos:
        def surface_colors(self, points, normals, surface, inexact):
            return inside[:, : len(points)]

    down = torch.tensor([[0.0, 0.0, -1.0]]).expand(20, 3)
    lid = Lid(
        cells=CLOSED < 0,
        above=CLOSED > 0,
        beyond=CLOSED > 2,
        origins=torch.stack([torch.linspace(-0.3, 0.3, 20), torch.zeros(20), torch.full((20,), 2.0)], 1),
        directions=down,
        distance=torch.full((20,), 2.0 - TOP),
        colors=torch.full((20, 3), 0.2),
        shown=shown,
        difference=torch.full((20,), 0.4),
        behind=torch.full((20,), 0.4),
    )
    assert cavity_search._trial(lid, Photos(), in_cells(of_thickness(0.1))).agrees == opens


def test_a_point_of_the_lid_on_which_photos_agree_is_the_lids():
    surface = (CLOSED < 0) & ndimage.binary_dilation(CLOSED >= 0)
    x, y, z = (in_cells(lambda points, k=k: points[..., k]) for k in range(3))
    top = surface & (z > TOP - 0.05) & (np.hypot(x, y) < 0.45)
    ring = top & (np.hypot(x - 0.1, y) > 0.2)
    np.testing.assert_array_equal(_without_holes(ring, surface), top)
    beside = top & (x > -0.2)  # not enclosed by the lid
    np.testing.assert_array_equal(_without_holes(beside, surface), beside)
