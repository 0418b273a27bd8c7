"""The table that an object stands on is cut off. Feet and stands that leave the sphere are not cut off."""

import numpy as np
import pytest

from blender_nep.presets import SurfacePreset
from blender_nep.surface.extraction import extract_surface

N = 96
AXIS = np.linspace(-1, 1, N)
GRID = np.stack(np.meshgrid(AXIS, AXIS, AXIS, indexing="ij"), -1)
BALL = np.linalg.norm(GRID - [0, 0, 0.05], axis=-1) - 0.5


def table(normal, height):
    return GRID @ np.asarray(normal) - height


class Analytic:
    """Stands for an object field whose SDF is known."""

    def __init__(self, sdf):
        self.sdf = sdf.astype(np.float32)

    def sdf_grid(self, n):
        return self.sdf

    def parameters(self):
        import torch

        yield torch.zeros(1)

    def normal(self, points):
        import torch

        return torch.full_like(points, float("nan"))


@pytest.mark.parametrize("tilt", [0.0, 0.2])
def test_a_table_is_found_and_cut_off(tilt):
    normal = np.array([np.sin(tilt), 0, np.cos(tilt)])
    sdf = np.minimum(BALL, table(normal, -0.4))
    surface, report = extract_surface(Analytic(sdf), SurfacePreset(grid=N, faces=100_000))
    assert (surface.vertices @ normal).min() > -0.4 and report["watertight"]
    radius = np.linalg.norm(surface.vertices - [0, 0, 0.05], axis=1)
    assert radius.max() < 0.53, "nothing of the table is left"
    cut = report["cut_support_plane"]
    assert cut["normal"] @ normal > 0.999 and cut["height"] == pytest.approx(-0.4, abs=0.01)


def test_a_ball_in_the_air_and_a_stand_that_leaves_the_sphere_are_left_alone():
    stand = np.maximum(np.linalg.norm(GRID[..., :2], axis=-1) - 0.2, GRID[..., 2])
    wide = np.maximum(np.linalg.norm(GRID[..., :2], axis=-1) - 0.5, GRID[..., 2])
    for sdf, lowest in ((BALL, -0.45), (np.minimum(BALL, stand), -0.995), (np.minimum(BALL, wide), -0.995)):
        surface, report = extract_surface(Analytic(sdf), SurfacePreset(grid=N, faces=100_000))
        assert "cut_support_plane" not in report
        assert surface.vertices[:, 2].min() == pytest.approx(lowest, abs=0.01)
