"""The support under an object is cut off where it touches, and the foot is closed flat. Objects without one stay whole."""

import numpy as np
import pytest
import torch
import trimesh

from blender_nep.presets import SurfacePreset
from blender_nep.support.plane import Support
from blender_nep.surface.extraction import extract_surface

N = 64
CELL = 2 / (N - 1)
AXIS = np.linspace(-1, 1, N)
GRID = np.stack(np.meshgrid(AXIS, AXIS, AXIS, indexing="ij"), -1)
BALL = np.linalg.norm(GRID - [0, 0, 0.05], axis=-1) - 0.5
UP = np.array([0.0, 0.0, 1.0])
PRESET = SurfacePreset(grid=N, unwrapped_faces=100_000)


def table(normal, height):
    return GRID @ np.asarray(normal) - height


def cylinder(radius, low, high):
    return np.maximum(np.hypot(GRID[..., 0], GRID[..., 1]) - radius, np.maximum(low - GRID[..., 2], GRID[..., 2] - high))


def box(half, low, high):
    sides = np.maximum(np.abs(GRID[..., 0]), np.abs(GRID[..., 1])) - half
    return np.maximum(sides, np.maximum(low - GRID[..., 2], GRID[..., 2] - high))


class Analytic:
    """Stands for an object field whose SDF is known."""

    def __init__(self, sdf):
        self.values, self.fine = sdf.astype(np.float32), None

    def sdf_grid(self, n):
        return self.values

    def parameters(self):
        yield torch.zeros(1)

    def normal(self, points):
        return torch.full_like(points, float("nan"))

    def sdf_and_gradient(self, points):
        return torch.full_like(points[:, 0], float("nan")), torch.full_like(points, float("nan"))


def extracted(sdf, support=None):
    surface, report, *_ = extract_surface(Analytic(sdf), PRESET, support)
    assert report["watertight"]
    mesh = trimesh.Trimesh(surface.vertices, surface.faces, process=False)
    mesh.merge_vertices()  # the unwrapping cut it along its seams
    return mesh, report


def check_foot(mesh, height, area):
    """The mesh ends at the plane with a flat foot of this area."""
    assert mesh.vertices[:, 2].min() == pytest.approx(height, abs=0.5 * CELL)
    flat = np.abs(mesh.triangles_center[:, 2] - height) < 0.1 * CELL
    found = mesh.area_faces[flat & (mesh.face_normals[:, 2] < -0.99)].sum()
    bevelled = np.pi * (np.sqrt(area / np.pi) - 1.5 * CELL) ** 2  # marching cubes bevels the rim of the foot
    assert bevelled < found < 1.02 * area


@pytest.mark.parametrize("tilt", [0.0, 0.2])
def test_a_table_is_found_in_the_mesh_and_cut_off(tilt):
    normal = np.array([np.sin(tilt), 0, np.cos(tilt)])
    mesh, report = extracted(np.minimum(BALL, table(normal, -0.4)))
    assert (mesh.vertices @ normal).min() == pytest.approx(-0.4, abs=0.5 * CELL)
    radius = np.linalg.norm(mesh.vertices - [0, 0, 0.05], axis=1)
    assert radius.max() < 0.53, "nothing of the table is left"
    cut = report["cut_support_plane"]
    assert cut["normal"] @ normal > 0.999 and cut["height"] == pytest.approx(-0.4, abs=0.01)


@pytest.mark.parametrize("known", [True, False], ids=["plane known", "plane found in the mesh"])
def test_a_box_on_a_table_keeps_its_volume_and_gets_a_flat_foot(known):
    sdf = np.minimum(box(0.4, -0.6, 0.3), table(UP, -0.503))
    mesh, _ = extracted(sdf, Support(UP, -0.503) if known else None)
    check_foot(mesh, -0.503, 0.64)
    assert mesh.volume == pytest.approx(0.64 * 0.803, rel=0.02)


def test_a_ball_on_a_table_is_closed_where_it_touches():
    """The ball dips a twentieth into the table, as a ball that was found does."""
    sdf = np.minimum(BALL, table(UP, -0.4))
    mesh, _ = extracted(sdf, Support(UP, -0.4))
    cap = 0.05**2 * np.pi * (3 * 0.5 - 0.05) / 3
    assert mesh.volume == pytest.approx(4 / 3 * np.pi * 0.5**3 - cap, rel=0.02)
    check_foot(mesh, -0.4, np.pi * (0.5**2 - 0.45**2))


def test_a_cup_is_cut_off_a_plate_smaller_than_the_sphere():
    cup = cylinder(0.25, -0.35, 0.3)
    plate = cylinder(0.7, -0.45, -0.35)
    mesh, _ = extracted(np.minimum(cup, plate), Support(UP, -0.35))
    check_foot(mesh, -0.35, np.pi * 0.25**2)
    assert mesh.volume == pytest.approx(np.pi * 0.25**2 * 0.65, rel=0.03)
    assert np.hypot(*mesh.vertices[:, :2].T).max() < 0.27


@pytest.mark.parametrize(
    ("body", "lowest"),
    [
        (BALL, -0.45),
        (cylinder(0.8, -0.3, 0.2), -0.3),
        (np.minimum(BALL, cylinder(0.2, -2, 0)), -0.995),
        (np.minimum(BALL, cylinder(0.5, -2, 0)), -0.995),
    ],
    ids=["a ball in the air", "a flat underside", "a stand that leaves the sphere", "a wide stand"],
)
def test_an_object_without_a_support_is_left_alone(body, lowest):
    mesh, report = extracted(body)
    assert "cut_support_plane" not in report
    assert mesh.vertices[:, 2].min() == pytest.approx(lowest, abs=0.01)
