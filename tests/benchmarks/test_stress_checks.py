"""The checks of the stress tests fail for meshes that are wrong, and for wrong turns of a turntable."""

import json

import numpy as np
import pytest
import trimesh

from benchmarks.stress.checks import check_mesh, check_turntable
from benchmarks.stress.scenes import Case
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


def motion(degrees: float) -> dict:
    """A frame of cameras.json whose object was turned about the upright axis."""
    c, s = np.cos(np.radians(degrees)), np.sin(np.radians(degrees))
    return {"object_to_room": [[c, -s, 0, 0.1], [s, c, 0, 0], [0, 0, 1, 0], [0, 0, 0, 1]]}


@pytest.mark.parametrize(
    ("frames", "said", "turntable", "failure"),
    [
        ([motion(0), motion(90), motion(180), motion(270)], True, "told", None),
        ([motion(0), motion(90), motion(181), motion(270)], True, "told", "wrong turns: by 0.01"),
        ([motion(0), motion(-90), motion(180), motion(-270)], True, "untold", "wrong turns: by 2"),
        ([motion(0), motion(90), {}, motion(270)], True, "told", "turntable forgotten: True in the report, 3 of 4"),
        ([{}, {}, {}, {}], False, "told", "turntable forgotten: False in the report, 0 of 4"),
        ([{}, {}, {}, {}], False, "untold", None),
        ([{}, {}, {}, {}], False, "none", None),
        ([{}, {}, {}, {}], False, "walk", "false turntable"),
    ],
)
def test_wrong_and_forgotten_turns_fail(frames, said, turntable, failure, tmp_path):
    frames = [{"file_path": f"../capture/images/{i:03d}.exr"} | frame for i, frame in enumerate(frames)]
    (tmp_path / "cameras.json").write_text(json.dumps({"frames": frames}))
    report = {"scene": {"photos": {"turntable": said}}}
    found = check_turntable(Case(turntable=turntable, views=8), tmp_path, report)
    assert [one.startswith(failure) for one in found] == ([True] if failure else [])
