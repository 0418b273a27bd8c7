"""Tests of the normals of a mesh."""

from __future__ import annotations

import numpy as np
import pytest
import trimesh

from blender_nep.geometry.mesh import angle_normals


@pytest.mark.parametrize("scale", [1e-9, 1.0])
def test_normals_of_a_long_box_point_along_its_diagonals(scale):
    """Three right angles meet at each corner, however large the faces are and wherever their diagonals lie."""
    box = trimesh.creation.box(extents=(1, 2, 5))
    normals = angle_normals(np.asarray(box.vertices) * scale, np.asarray(box.faces))
    np.testing.assert_allclose(normals, np.sign(box.vertices) / np.sqrt(3), atol=1e-9)


def test_vertices_that_a_seam_has_split_share_a_normal():
    ball = trimesh.creation.icosphere(subdivisions=2)
    split = np.asarray(ball.vertices)[ball.faces].reshape(-1, 3)
    normals = angle_normals(split, np.arange(len(split)).reshape(-1, 3))
    whole = angle_normals(np.asarray(ball.vertices), np.asarray(ball.faces))
    np.testing.assert_allclose(normals, whole[ball.faces].reshape(-1, 3), atol=1e-9)


def test_a_face_without_area_changes_no_normal():
    box = trimesh.creation.box()
    vertices, faces = np.asarray(box.vertices), np.asarray(box.faces)
    more = np.concatenate([faces, [[0, 0, 1], [2, 2, 2]]])
    np.testing.assert_allclose(angle_normals(vertices, more), angle_normals(vertices, faces), atol=1e-12)


@pytest.mark.parametrize("scale", [1e-3, 1.0, 1e3])
def test_normals_are_those_with_which_blender_shades(scale):
    """A mesh of very unequal triangles, in bpy."""
    import bpy

    rng = np.random.default_rng(5)
    direction = rng.normal(size=(200, 3)) ** 3  # clusters of small faces beside large ones
    hull = trimesh.convex.convex_hull(direction / np.linalg.norm(direction, axis=1, keepdims=True))
    vertices, faces = np.asarray(hull.vertices) * scale, np.asarray(hull.faces)
    mesh = bpy.data.meshes.new("unequal")
    try:
        mesh.from_pydata(vertices.tolist(), [], faces.tolist())
        theirs = np.array([normal.vector[:] for normal in mesh.vertex_normals])
    finally:
        bpy.data.meshes.remove(mesh)
    np.testing.assert_allclose(angle_normals(vertices, faces), theirs, atol=1e-4)
