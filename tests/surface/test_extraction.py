"""Surface extraction against spheres whose SDF, area and normals are known in closed form."""

import numpy as np
import pytest
import torch
import trimesh

from blender_nep.errors import LearningError
from blender_nep.geometry.uv_raster import nearest_known, rasterize
from blender_nep.presets import SurfacePreset
from blender_nep.surface.extraction import extract_surface
from support.analytic_field import AnalyticField, ball, union

PRESET = SurfacePreset(grid=72, unwrapped_faces=1500, faces=1500, atlas_texels=256)


def as_mesh(surface):
    return trimesh.Trimesh(surface.vertices, surface.faces, process=False)


def test_sphere_position_normals_orientation():
    surface, report, *_ = extract_surface(AnalyticField(ball([0.1, 0.0, -0.05], 0.6)), PRESET)
    offset = surface.vertices - [0.1, 0.0, -0.05]
    assert np.abs(np.linalg.norm(offset, axis=1) - 0.6).max() < 0.01
    cosine = (offset / 0.6 * surface.normals).sum(1)
    assert cosine.min() > 0.99
    assert as_mesh(surface).volume == pytest.approx(4 / 3 * np.pi * 0.6**3, rel=0.03)
    assert report["faces"] <= PRESET.faces * 1.02 and report["watertight"]


def test_floaters_and_inner_shells_are_dropped_and_counted():
    solid = union(ball([0, 0, 0], 0.5), ball([0.8, 0, 0], 0.1))
    hollow = AnalyticField(lambda p: torch.maximum(solid(p), -ball([0, 0, 0], 0.3)(p)))
    surface, report, *_ = extract_surface(hollow, PRESET)
    assert report["components"] == 3
    assert report["dropped_inner_shells"] == 1 and report["dropped_floaters"] == 1
    assert np.linalg.norm(surface.vertices, axis=1).min() > 0.48


def test_a_cup_and_its_saucer_are_both_kept():
    two = union(ball([0.45, 0, 0], 0.4), ball([-0.5, 0, 0], 0.2))
    surface, report, *_ = extract_surface(AnalyticField(union(two, ball([0, 0.9, 0], 0.04))), PRESET)
    assert report["components"] == 3 and report["parts"] == 2 and report["dropped_floaters"] == 1
    volume = 4 / 3 * np.pi * (0.4**3 + 0.2**3)
    assert as_mesh(surface).volume == pytest.approx(volume, rel=0.05)


def test_object_cut_by_the_sphere_is_capped():
    surface, report, *_ = extract_surface(AnalyticField(ball([0.6, 0, 0], 0.7)), PRESET)
    assert report["watertight"]
    assert np.linalg.norm(surface.vertices, axis=1).max() < 1.0
    # both spheres meet in a circle at x = 0.717, and a spherical cap has the area 2 pi * radius * height
    circle = (0.6**2 + 0.995**2 - 0.7**2) / (2 * 0.6)
    cap, ball_left = 0.995 * (0.995 - circle), 0.7 * (0.7 + circle - 0.6)
    assert report["cut_by_sphere"] == pytest.approx(cap / (cap + ball_left), rel=0.1)
    whole = extract_surface(AnalyticField(ball([0.3, 0, 0], 0.69)), PRESET)
    assert whole.report["cut_by_sphere"] == 0


def test_decimation_leaves_no_vertex_outside_of_the_sphere():
    few = SurfacePreset(grid=40, unwrapped_faces=300, faces=300, atlas_texels=128)
    surface, *_ = extract_surface(AnalyticField(ball([0.5, 0.0, 0.0], 0.8)), few)
    assert 0.98 < np.linalg.norm(surface.vertices, axis=1).max() < 0.995 + 1e-6


def test_uv_atlas_covers_every_face_without_overlap():
    surface, *_ = extract_surface(AnalyticField(ball([0, 0, 0], 0.6)), PRESET)
    assert surface.uv.min() >= 0 and surface.uv.max() <= 1
    a, b, c = (surface.uv[surface.faces[:, k]] for k in range(3))
    area = 0.5 * np.abs((b - a)[:, 0] * (c - a)[:, 1] - (b - a)[:, 1] * (c - a)[:, 0])
    face, _ = rasterize(surface.uv, surface.faces, 512)
    # Overlapping charts would leave fewer texels than the faces' areas add up to.
    assert (face >= 0).sum() == pytest.approx(area.sum() * 512**2, rel=0.02)
    assert np.isin(np.flatnonzero(area * 512**2 > 4), face).all()


@pytest.mark.parametrize(
    ("function", "message", "hint"),
    [
        (lambda p: p.norm(dim=-1) + 1, "is empty inside the sphere", "object_radius"),
        (lambda p: p.norm(dim=-1) - 5, "fills the whole sphere", "object_radius"),
        (lambda p: p[:, 0] * float("nan"), "SDF is not finite", "--seed"),
    ],
    ids=["empty", "full", "not finite"],
)
def test_a_field_without_a_surface_is_an_error_that_says_why(function, message, hint):
    with pytest.raises(LearningError, match=message) as error:
        extract_surface(AnalyticField(function), PRESET)
    assert error.value.code == 6 and hint in error.value.hint


def test_rasterized_texels_lie_at_their_own_uv():
    rng = np.random.default_rng(0)
    uv = rng.random((3, 2))
    face, barycentric = rasterize(uv, np.array([[0, 1, 2]]), 64)
    i, j = np.nonzero(face == 0)
    centers = np.stack([(j + 0.5) / 64, 1 - (i + 0.5) / 64], 1)
    assert np.abs(barycentric[i, j] @ uv - centers).max() < 1e-5
    # Brute force: the number of centers inside, by the sign of the three edge functions.
    grid = np.stack(np.meshgrid((np.arange(64) + 0.5) / 64, (np.arange(64) + 0.5) / 64), -1).reshape(-1, 2)
    edges = [np.cross(uv[(k + 1) % 3] - uv[k], grid - uv[k]) for k in range(3)]
    inside = (np.min(edges, 0) >= 0) | (np.max(edges, 0) <= 0)
    assert inside.sum() == len(i)


def test_dilation_takes_the_nearest_known_texel():
    known = np.zeros((9, 9), bool)
    known[4, 1] = known[4, 7] = True
    texture = np.full((9, 9, 3), np.nan)
    texture[4, 1], texture[4, 7] = 1, 2
    filled = texture[nearest_known(known)]
    assert (filled[:, :4] == 1).all() and (filled[:, 5:] == 2).all()
    nothing = np.zeros((3, 4), bool)
    assert np.array_equal(nearest_known(nothing), np.indices((3, 4)))
