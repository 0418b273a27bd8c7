"""Fine paint is told from reflections, from shading, from plain paint, and from too few photos."""

import numpy as np
import pytest
import torch

from blender_nep.capture import PixelRays, load_capture
from blender_nep.fields.refinements.fine_paint import fine_paint
from blender_nep.presets import FieldsPreset
from support.pot_scene import block, everywhere, in_cells, write_pot_scene

SHAPE = in_cells(block)
ENOUGH = FieldsPreset.least_fine_paint


def spots(points: np.ndarray) -> np.ndarray:
    """Linear radiance [n, 3] of points [n, 3]: light spots on dark paint, a tenth of a radius wide."""
    return np.where(np.prod(np.sin(25 * points), 1) > 0, 0.6, 0.15)[:, None] * [1.0, 0.8, 0.5]


def bumpy(points: np.ndarray) -> np.ndarray:
    """Signed distance [...] of points [..., 3] from a ball with bumps 0.2 radii wide, nearly."""
    return np.linalg.norm(points, axis=-1) - 0.6 - 0.02 * np.prod(np.sin(12 * points + 0.5), -1)


def shaded(points: np.ndarray) -> np.ndarray:
    """Linear radiance [n, 3] of points [n, 3] of a dull bumpy ball that the sky lights from one side."""
    steps = 1e-3 * np.eye(3)
    normals = np.stack([bumpy(points + step) - bumpy(points - step) for step in steps], 1) / 2e-3
    return (0.4 + 0.35 * normals @ [0.6, 0.0, 0.8])[:, None].clip(0, 1) * [1.0, 0.8, 0.5]


def horizon(directions: np.ndarray) -> np.ndarray:
    """Linear radiance [n, 3] of directions [n, 3]: a bright sky over dark ground, the same on all sides."""
    return np.where(directions[:, 2:] > 0, 0.7, 0.1) * [1.0, 0.8, 0.5]


def rays_of(folder) -> PixelRays:
    return PixelRays.from_capture(load_capture(folder), 10_000, False, torch.device("cpu"))


def test_painted_spots_are_found_although_the_surface_is_inexact(tmp_path):
    rays = rays_of(write_pot_scene(tmp_path / "spots", block, painted=spots))
    assert fine_paint(rays, SHAPE) > 2 * ENOUGH
    assert fine_paint(rays, SHAPE + 0.02) > ENOUGH


@pytest.mark.parametrize("noise", [0.0, 0.05])
def test_a_mirror_and_plain_paint_have_none(tmp_path, noise):
    random = torch.Generator().manual_seed(0)
    bodies = {"mirror": {"mirror": everywhere}, "plain": {"painted": lambda points: np.full_like(points, 0.4)}}
    for name, kwargs in bodies.items():
        rays = rays_of(write_pot_scene(tmp_path / name, block, **kwargs))
        rays.radiance.add_(noise * torch.rand(rays.radiance.shape, generator=random))
        assert abs(fine_paint(rays, SHAPE)) < ENOUGH


@pytest.mark.parametrize(
    "body",
    [{"mirror": everywhere}, {"mirror": everywhere, "mirrored": horizon}, {"painted": shaded}],
    ids=["mirror", "mirrored horizon", "shading"],
)
def test_what_bumps_do_to_reflections_and_shading_is_no_paint(tmp_path, body):
    rays = rays_of(write_pot_scene(tmp_path / "ball", bumpy, **body))
    assert abs(fine_paint(rays, in_cells(bumpy))) < ENOUGH / 2


def test_spots_are_found_on_bumps(tmp_path):
    rays = rays_of(write_pot_scene(tmp_path / "ball", bumpy, painted=lambda points: spots(points) * shaded(points)))
    assert fine_paint(rays, in_cells(bumpy)) > 2 * ENOUGH


@pytest.mark.parametrize("sdf", [1.0, -1.0])
def test_nothing_is_said_where_no_surface_is_shown(tmp_path, sdf):
    rays = rays_of(write_pot_scene(tmp_path / "block", block))
    assert fine_paint(rays, np.full(SHAPE.shape, sdf, np.float32)) == 0
