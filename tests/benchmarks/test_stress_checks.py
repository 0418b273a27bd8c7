"""The checks of the stress tests fail for meshes that are wrong."""

import numpy as np
import pytest
import trimesh

from benchmarks.stress.checks import check_mesh
from blender_nep.asset.export import TexturedMesh, write_obj

CENTER, RADIUS = np.array([0.3, -0.2, 0.5]), 2.0
Y_UP = np.array([[1, 0, 0], [0, 0, -1], [0, 1, 0]])


def failures_of(mesh: trimesh.Trimesh, faces: np.ndarray, folder) -> list[str]:
    """Write the mesh with these faces as an asset whose vertices are split at every face, and check it."""
    vertices = np.asarray(mesh.vertices)[faces].reshape(-1, 3) * RADIUS + CENTER
    split = np.arange(len(vertices)).reshape(-1, 3)
    normals = np.repeat(trimesh.Trimesh(vertices, split, process=False).face_normals, 3, axis=0)
    write_obj(folder / "mesh.obj", TexturedMesh(vertices, split, normals, np.zeros((len(vertices), 2)), {}))
    trimesh.Trimesh(vertices @ Y_UP, split, process=False).export(folder / "asset.glb")
    return check_mesh(folder, CENTER, RADIUS, {"skipped": {}})


@pytest.mark.parametrize(
    "mesh",
    [trimesh.creation.icosphere(subdivisions=2, radius=0.6), trimesh.creation.torus(0.5, 0.16)],
    ids=["sphere", "ring"],
)
def test_a_closed_mesh_inside_out_fails_and_an_open_one_does_not(mesh, tmp_path):
    faces = np.asarray(mesh.faces)
    assert failures_of(mesh, faces, tmp_path) == []
    (failure,) = failures_of(mesh, faces[:, ::-1], tmp_path)
    assert failure.startswith("bad mesh: inside out, its volume is -")
    assert failures_of(mesh, faces[1:, ::-1], tmp_path) == [], "nobody can tell the inside of an open mesh"
