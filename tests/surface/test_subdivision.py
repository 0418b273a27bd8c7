"""Subdivision against bodies whose surface and normals are known in closed form."""

from dataclasses import replace

import numpy as np
import pytest
import torch
import trimesh

from blender_nep.presets import SurfacePreset
from blender_nep.support.plane import Support
from blender_nep.surface.extraction import extract_surface
from support.analytic_field import AnalyticField, ball

CENTER, RADIUS = np.array([0.1, 0.0, -0.05]), 0.6
COARSE = SurfacePreset(grid=72, unwrapped_faces=1000, faces=1000, atlas_texels=256)
BALL = AnalyticField(ball(CENTER.tolist(), RADIUS))


def welded(surface):
    """The mesh without its UV seams."""
    mesh = trimesh.Trimesh(surface.vertices, surface.faces, process=False)
    mesh.merge_vertices(digits_vertex=12)
    return mesh


def angles_to_ball(surface):
    """Angles [F] in degrees between the faces' normals and those of the ball at the faces' centers."""
    mesh = trimesh.Trimesh(surface.vertices, surface.faces, process=False)
    true = mesh.triangles_center - CENTER
    cosine = (true * mesh.face_normals).sum(1) / np.linalg.norm(true, axis=1)
    return np.degrees(np.arccos(cosine.clip(-1, 1)))


def uv_areas(surface):
    a, b, c = (surface.uv[surface.faces[:, k]] for k in range(3))
    return 0.5 * ((b - a)[:, 0] * (c - a)[:, 1] - (b - a)[:, 1] * (c - a)[:, 0])


def test_edges_of_a_ball_are_halved_until_chords_are_good_enough():
    tolerance = 1e-3
    surface, report, *_ = extract_surface(BALL, replace(COARSE, faces=100_000, chord_error=tolerance))
    distance = np.linalg.norm(surface.vertices - CENTER, axis=1)
    assert np.abs(distance - RADIUS).max() < 1e-5
    a, b = (welded(surface).vertices[welded(surface).edges_unique[:, k]] for k in range(2))
    length = np.linalg.norm(a - b, axis=1)
    height = RADIUS - np.sqrt(RADIUS**2 - length**2 / 4)  # of an arc over its chord, in closed form
    assert height.max() < tolerance * 1.05
    assert height.max() > tolerance / 8  # halving an edge divides its height by four: no edge is halved twice for nothing
    assert report["faces"] == len(surface.faces) > report["faces_unwrapped"]


def test_face_normals_become_better_as_edges_become_shorter():
    coarse, *_ = extract_surface(BALL, COARSE)
    fine, *_ = extract_surface(BALL, replace(COARSE, faces=16_000, chord_error=0.0))
    assert 12_000 < len(fine.faces) <= 16_000
    # sixteen times as many faces have a quarter of the edge length, and the angle within a face is proportional to it
    assert angles_to_ball(fine).mean() < 0.4 * angles_to_ball(coarse).mean()
    assert angles_to_ball(fine).max() < 15


def test_no_cracks_open_and_the_uv_map_stays_the_same_map():
    coarse, *_ = extract_surface(BALL, COARSE)
    fine, *_ = extract_surface(BALL, replace(COARSE, faces=7001, chord_error=0.0))
    assert welded(coarse).is_watertight and welded(fine).is_watertight
    assert len(fine.vertices) > len(welded(fine).vertices)  # there are seams at which a crack could open
    assert np.array_equal(fine.uv[: len(coarse.uv)], coarse.uv)
    for sign in (1, -1):  # xatlas mirrors some charts
        assert (sign * uv_areas(fine)).clip(0).sum() == pytest.approx((sign * uv_areas(coarse)).clip(0).sum(), rel=1e-9)
    assert np.abs(uv_areas(fine)).min() > 1e-3 * np.abs(uv_areas(coarse)).min()  # no face vanishes in the map
    assert np.linalg.norm(fine.normals, axis=1) == pytest.approx(1)


def cylinder(p):
    """The SDF of a cylinder with flat ends. Only its side bends, and only around the axis."""
    return torch.maximum(torch.hypot(p[:, 0], p[:, 1]) - 0.5, p[:, 2].abs() - 0.4)


def test_relief_may_have_more_faces():
    limits = replace(COARSE, faces=2000, relief_faces=6000, chord_error=0.0)
    plain, fine = (extract_surface(AnalyticField(BALL.function, fine=level), limits)[0] for level in (None, "a level"))
    assert 1900 < len(plain.faces) <= 2000 and 5900 < len(fine.faces) <= 6000


def test_faces_become_no_thinner_on_a_surface_bent_in_one_way():
    """Halving longest edges, too, keeps every angle above half of the least one (Rivara 1984)."""

    def least_angles(**changes):
        mesh = welded(extract_surface(AnalyticField(cylinder), replace(COARSE, **changes))[0])
        on_side = (np.abs(mesh.face_normals[:, 2]) < 0.1) & (np.abs(mesh.triangles_center[:, 2]) < 0.35)
        return np.quantile(mesh.face_angles[on_side].min(1), 0.01)

    assert least_angles(faces=60_000, chord_error=1e-4) > 0.9 * least_angles()


def test_flat_sides_get_no_more_faces_than_their_rims_need():
    surface, *_ = extract_surface(AnalyticField(cylinder), replace(COARSE, faces=20_000, chord_error=3e-4))
    mesh = welded(surface)
    flat = np.abs(mesh.face_normals[:, 2]) > 0.99
    inside = np.linalg.norm(mesh.triangles_center[:, :2], axis=1) < 0.4
    assert mesh.area_faces[flat & inside].mean() > 4 * mesh.area_faces[~flat].mean()


def test_cuts_stay_where_they_are():
    """The cap at the sphere's border, and the foot on the support plane, are not zero levels of the SDF."""
    plane = Support(np.array([0.0, 0.0, 1.0]), -0.3)
    field = AnalyticField(ball([0.6, 0.0, 0.0], 0.7))
    surface, report, *_ = extract_surface(field, replace(COARSE, faces=8000, chord_error=1e-4), plane)
    assert report["faces"] > 4000 and welded(surface).is_watertight
    assert np.linalg.norm(surface.vertices, axis=1).max() < 1
    assert surface.vertices[:, 2].min() > -0.32
    mesh = welded(surface)
    foot = (mesh.face_normals[:, 2] < -0.99) & (mesh.triangles_center[:, 2] < -0.28)
    # a disc of radius sqrt(0.49 - 0.09) around (0.6, 0), cut by the sphere of radius sqrt(1 - 0.09)
    grid = np.stack(np.meshgrid(np.linspace(-1, 2, 1501), np.linspace(-1.5, 1.5, 1501)), -1)
    disc = (np.linalg.norm(grid - [0.6, 0], axis=-1) < np.sqrt(0.4)) & (np.linalg.norm(grid, axis=-1) < np.sqrt(0.91))
    assert mesh.area_faces[foot].sum() == pytest.approx(disc.sum() * (3 / 1500) ** 2, rel=0.05)


def test_a_field_that_is_not_finite_leaves_the_mesh_as_it_is():
    class Broken(AnalyticField):
        def sdf_and_gradient(self, points):
            return torch.full_like(points[:, 0], float("nan")), torch.full_like(points, float("nan"))

    surface, report, *_ = extract_surface(Broken(BALL.function), replace(COARSE, faces=20_000))
    assert report["faces"] == report["faces_unwrapped"] and np.isfinite(surface.vertices).all()
