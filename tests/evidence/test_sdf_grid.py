"""An SDF in cells: planes and balls, for which distances, normals and surfaces have closed forms."""

import numpy as np
import pytest
import torch

from blender_nep.evidence.sdf_grid import SdfGrid, cell_centers, distances_to, sampled, signed_distances

N, RADIUS, CENTER = 48, 0.6, np.array([0.1, -0.05, 0.2])


def ball(n=N) -> SdfGrid:
    """The exact SDF of a ball."""
    centers = SdfGrid(np.empty((n, n, n))).centers()
    return SdfGrid((np.linalg.norm(centers - CENTER, axis=-1) - RADIUS).astype(np.float32))


def test_centers_are_those_of_equal_cells():
    assert cell_centers(4).tolist() == [-0.75, -0.25, 0.25, 0.75]
    grid = ball(4)
    assert grid.cell == 0.5
    assert grid.centers()[3, 0, 1].tolist() == [0.75, -0.75, -0.25], "the axes are x, y, z"
    mask = np.zeros((4, 4, 4), bool)
    mask[3, 0, 1] = mask[0, 2, 2] = True
    assert grid.centers_of(mask).tolist() == [[-0.75, 0.25, 0.25], [0.75, -0.75, -0.25]]


@pytest.mark.parametrize("axis", [0, 1, 2])
def test_the_border_of_solid_cells_lies_between_their_centers(axis):
    """Cells below the middle are solid: the border is the plane through the middle, and the distance is the coordinate."""
    height = np.moveaxis(np.broadcast_to(cell_centers(8), (8, 8, 8)), 2, axis)
    np.testing.assert_allclose(SdfGrid.of_solid(height < 0).values, height, atol=1e-12)
    to_solid = distances_to(height < 0, 2 / 8)
    np.testing.assert_allclose(to_solid[height > 0], height[height > 0], atol=1e-12)
    assert (to_solid[height < 0] < 0).all()


def test_distances_from_a_solid_ball_are_those_of_the_ball():
    true = ball()
    found = SdfGrid.of_solid(true.solid)
    assert np.array_equal(found.solid, true.solid)
    off = found.values - true.values
    assert np.abs(off).max() < 0.6 * true.cell


def test_where_nothing_is_solid_the_object_is_far_away():
    assert (SdfGrid.of_solid(np.zeros((4, 4, 4), bool)).values == 1).all()
    assert (signed_distances(np.zeros((4, 4), bool), 0.5) == 1).all()


def test_normals_of_a_ball_point_outwards():
    grid = ball()
    place = np.stack(np.nonzero(np.abs(grid.values) < 0.1), -1)
    normals = grid.normals(place)
    true = cell_centers(N)[place] - CENTER
    true /= np.linalg.norm(true, axis=1, keepdims=True)
    assert (normals * true).sum(1).min() > 0.999
    np.testing.assert_allclose(np.linalg.norm(normals, axis=1), 1, atol=1e-6)


def test_the_surface_of_a_ball_is_that_of_its_outer_cells():
    grid = ball()
    surface = grid.surface()
    assert np.array_equal(np.stack(np.nonzero(surface.mask), -1), surface.place)
    assert (grid.values[surface.mask] < 0).all() and (grid.values[surface.mask] > -1.75 * grid.cell).all()
    assert np.abs(np.linalg.norm(surface.points - CENTER, axis=1) - RADIUS).max() < 0.1 * grid.cell
    through = np.abs(grid.values) < 0.3 * grid.cell  # these cells are cut by the surface
    assert surface.mask[through & grid.solid].all()


@pytest.mark.parametrize("n", [24, 48, 128])
def test_the_traced_mesh_of_a_ball_lies_on_the_ball(n):
    """Finer grids are traced at 64 cells."""
    mesh = ball(n).traced_mesh()
    radius = np.linalg.norm(mesh.vertices - CENTER, axis=1)
    assert np.abs(radius - RADIUS).max() < 0.2 * 2 / min(n, 64)
    area = np.linalg.norm(np.cross(*np.diff(mesh.vertices[mesh.faces], axis=1).transpose(1, 0, 2)), axis=1).sum() / 2
    assert area == pytest.approx(4 * np.pi * RADIUS**2, rel=0.02)


def test_the_mesh_of_what_reaches_the_border_is_closed_there():
    mesh = SdfGrid(np.full((8, 8, 8), -0.5, np.float32)).traced_mesh()
    inside = np.zeros((6, 3), np.float32)
    ways = np.concatenate([np.eye(3), -np.eye(3)]).astype(np.float32)
    assert mesh.occluded(inside, ways).all()


def test_nothing_has_no_mesh():
    assert SdfGrid(np.ones((8, 8, 8), np.float32)).traced_mesh() is None


@pytest.mark.parametrize("d", [2, 3])
def test_sampling_a_linear_function_gives_it(d):
    axes = np.meshgrid(*[cell_centers(10)] * d, indexing="ij")
    slope = np.array([0.3, -0.7, 0.2])[:d]
    values = torch.from_numpy(sum(a * axis for a, axis in zip(slope, axes, strict=True)))
    points = 3 * torch.rand(5, 40, d, generator=torch.Generator().manual_seed(0), dtype=torch.float64) - 1.5
    found = sampled(values, points)
    assert found.shape == (5, 40) and (points.abs() > 1).any()
    np.testing.assert_allclose(found, points.clamp(-0.9, 0.9).numpy() @ slope, atol=1e-12)


def test_a_grid_is_sampled_where_it_was_made():
    grid = ball()
    points = torch.from_numpy(grid.centers().reshape(-1, 3)[::97])
    np.testing.assert_allclose(grid.sample(points), grid.values.reshape(-1)[::97], atol=1e-6)
