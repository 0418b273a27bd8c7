"""A mesh file in place of the learned shape: where it is, which way its faces look, its normals and its UV map."""

import re
from dataclasses import dataclass, field
from types import SimpleNamespace

import numpy as np
import pytest
import trimesh

from blender_nep.asset.export import TexturedMesh, write_glb
from blender_nep.errors import CaptureError
from blender_nep.geometry.mesh import angle_normals
from blender_nep.presets import SurfacePreset
from blender_nep.surface.mesh_file import load_surface, read_mesh

PRESET = SurfacePreset(atlas_texels=256)
CORNERS = [(x, y, z) for x in (-0.5, 0.5) for y in (-0.5, 0.5) for z in (-0.5, 0.5)]
SIDES = {  # normal: corners, counter-clockwise seen from outside
    (-1, 0, 0): (0, 1, 3, 2),
    (1, 0, 0): (4, 6, 7, 5),
    (0, -1, 0): (0, 4, 5, 1),
    (0, 1, 0): (2, 3, 7, 6),
    (0, 0, -1): (0, 2, 6, 4),
    (0, 0, 1): (1, 5, 7, 3),
}


def cameras() -> list:
    """Around the object, at 3 radii."""
    directions = np.random.default_rng(0).normal(size=(30, 3))
    away = 3 * directions / np.linalg.norm(directions, axis=1, keepdims=True)
    return [SimpleNamespace(camera=SimpleNamespace(position=position)) for position in away]


@dataclass
class UnitCapture:
    to_unit: np.ndarray = field(default_factory=lambda: np.eye(4))
    views: list = field(default_factory=cameras)


def write_cube(path, *, uv=None, normals=False, inside_out=False) -> None:
    """An OBJ as Blender writes it: eight vertices, and other UVs and normals on each side. uv(side, corner) is in 0..1."""
    lines = [f"v {x} {y} {z}" for x, y, z in CORNERS]
    lines += [f"vt {u} {v}" for side in range(6) for u, v in (uv(side, corner) for corner in range(4))] if uv else []
    lines += [f"vn {x} {y} {z}" for x, y, z in SIDES] if normals else []
    for side, corners in enumerate(SIDES.values()):
        names = [
            f"{corner + 1}/{4 * side + k + 1 if uv else ''}/{side + 1 if normals else ''}".rstrip("/")
            for k, corner in enumerate(corners)
        ]
        lines.append("f " + " ".join(names[::-1] if inside_out else names))
    path.write_text("\n".join(lines) + "\n")


def six_squares(side: int, corner: int) -> tuple[float, float]:
    u, v = ((0, 0), (1, 0), (1, 1), (0, 1))[corner]
    return (side % 3 + 0.05 + 0.9 * u) / 3, (side // 3 + 0.05 + 0.9 * v) / 2


def flat_normals(surface) -> np.ndarray:
    """[F, 3] unit normals of the faces."""
    corner = surface.vertices[surface.faces]
    normal = np.cross(corner[:, 1] - corner[:, 0], corner[:, 2] - corner[:, 0])
    return normal / np.linalg.norm(normal, axis=1, keepdims=True)


def uv_areas(surface) -> np.ndarray:
    flat = surface.uv[surface.faces]
    side, up = flat[:, 1] - flat[:, 0], flat[:, 2] - flat[:, 0]
    return 0.5 * np.abs(side[:, 0] * up[:, 1] - side[:, 1] * up[:, 0])


def test_loaded_mesh_comes_to_the_unit_frame(tmp_path):
    mesh = trimesh.creation.icosphere(subdivisions=2, radius=3)
    mesh.apply_translation([5, 0, 0])
    mesh.export(tmp_path / "ball.ply")
    to_unit = np.diag([0.25, 0.25, 0.25, 1.0])
    to_unit[0, 3] = -1.25
    surface, report = load_surface(tmp_path / "ball.ply", UnitCapture(to_unit), PRESET)
    assert np.abs(np.linalg.norm(surface.vertices, axis=1) - 0.75).max() < 1e-6
    assert (surface.normals * surface.vertices).sum(1).min() > 0.74
    assert surface.uv is not None and report == {"turned_fraction": 0.0, "own_normals": False, "own_uv_map": False}


def test_a_uv_map_with_seams_at_shared_vertices_is_kept(tmp_path):
    write_cube(tmp_path / "cube.obj", uv=six_squares)
    surface, report = load_surface(tmp_path / "cube.obj", UnitCapture(), PRESET)
    assert report["own_uv_map"] and len(surface.faces) == 12
    np.testing.assert_allclose(uv_areas(surface), 0.5 * 0.81 / 6, rtol=1e-6)
    for point, (u, v) in zip(surface.vertices, surface.uv, strict=True):
        expected = [
            six_squares(s, k) for s, of in enumerate(SIDES.values()) for k in range(4) if CORNERS[of[k]] == tuple(point)
        ]
        assert min(np.hypot(u - a, v - b) for a, b in expected) < 1e-6


@pytest.mark.parametrize(
    "uv",
    [
        lambda side, corner: six_squares(side % 3, corner),
        lambda side, corner: six_squares(side, corner) if side else (0.0, 0.0),
        lambda side, corner: (2 * six_squares(side, corner)[0], six_squares(side, corner)[1]),
    ],
    ids=["mirrored", "one side without a chart", "tiled"],
)
def test_a_uv_map_of_shared_texels_is_replaced(tmp_path, uv):
    write_cube(tmp_path / "cube.obj", uv=uv)
    surface, report = load_surface(tmp_path / "cube.obj", UnitCapture(), PRESET)
    assert not report["own_uv_map"]
    assert uv_areas(surface).min() > 0.01 and 0 <= surface.uv.min() <= surface.uv.max() <= 1


@pytest.mark.parametrize("uv", [six_squares, None], ids=["with UVs", "unwrapped here"])
@pytest.mark.parametrize("inside_out", [False, True])
def test_hard_edges_of_the_file_stay_hard(tmp_path, uv, inside_out):
    write_cube(tmp_path / "cube.obj", uv=uv, normals=True, inside_out=inside_out)
    surface, report = load_surface(tmp_path / "cube.obj", UnitCapture(), PRESET)
    assert report["own_normals"] and report["turned_fraction"] == float(inside_out)
    flat = flat_normals(surface)
    assert (flat * surface.vertices[surface.faces].mean(1)).sum(1).min() > 0, "outward"
    np.testing.assert_allclose(surface.normals[surface.faces], np.repeat(flat[:, None], 3, 1), atol=1e-6)


def test_no_normal_is_turned_at_a_saddle_of_hard_edges(tmp_path):
    """Four cubes in an S. At one corner, a face's normal is opposite to the mean of all normals there."""
    cells, points, normals = {(0, 0, 0), (0, 0, 1), (1, 0, 1), (1, 1, 1)}, [], []
    for cell in cells:
        for normal, corners in SIDES.items():
            if tuple(np.add(cell, normal)) not in cells:
                points += [np.add(cell, CORNERS[corner]) for corner in corners]
                normals += 4 * [normal]
    turn = trimesh.transformations.random_rotation_matrix(np.random.default_rng(3).uniform(size=3))[:3, :3]
    first = 4 * np.arange(len(points) // 4)[:, None]
    faces = np.concatenate([first + np.array(triangle) for triangle in ((0, 1, 2), (0, 2, 3))])
    vertices, normals = (np.array(points) - 0.5) / 3 @ turn.T, np.array(normals, float) @ turn.T
    mesh = trimesh.Trimesh(vertices, faces, vertex_normals=normals, process=False)
    mesh.export(tmp_path / "s.ply", vertex_normal=True)
    surface, report = load_surface(tmp_path / "s.ply", UnitCapture(), PRESET)
    assert report["own_normals"] and report["turned_fraction"] == 0
    flat = np.repeat(flat_normals(surface)[:, None], 3, 1)
    np.testing.assert_allclose(surface.normals[surface.faces], flat, atol=1e-5)


def test_without_normals_in_the_file_edges_are_smooth(tmp_path):
    write_cube(tmp_path / "cube.obj", uv=six_squares)
    surface, report = load_surface(tmp_path / "cube.obj", UnitCapture(), PRESET)
    assert not report["own_normals"]
    np.testing.assert_allclose(surface.normals, surface.vertices / np.sqrt(0.75), atol=1e-6)


def test_our_own_gltf_comes_back_as_it_was(tmp_path):
    """glTF has Y up. The box has three different sides, so that a turned one would be noticed."""
    write_cube(tmp_path / "cube.obj", uv=six_squares, normals=True)
    whole, _ = load_surface(tmp_path / "cube.obj", UnitCapture(np.diag([1.0, 0.8, 0.2, 1.0])), PRESET)
    textures = {name: np.full((4, 4, *more), 0.5, np.float32) for name, more in (("albedo", (3,)), ("roughness", ()))}
    textures["metallic"] = textures["roughness"]
    write_glb(tmp_path / "box.glb", TexturedMesh(whole.vertices, whole.faces, whole.normals, whole.uv, textures))
    surface, report = load_surface(tmp_path / "box.glb", UnitCapture(), PRESET)
    assert report == {"turned_fraction": 0.0, "own_normals": True, "own_uv_map": True}
    order, again = (np.lexsort(np.round(np.c_[s.vertices, s.uv], 4).T) for s in (whole, surface))
    np.testing.assert_allclose(surface.vertices[again], whole.vertices[order], atol=1e-6)
    np.testing.assert_allclose(surface.uv[again], whole.uv[order], atol=1e-6)


@pytest.mark.parametrize("shape", ["ball", "bowl", "half of the faces", "hollow ball"])
def test_faces_look_outward(tmp_path, shape):
    ball = trimesh.creation.icosphere(subdivisions=3, radius=0.8)
    if shape == "bowl":  # an open mesh has no volume whose sign could tell
        ball.update_faces(ball.triangles_center[:, 2] < 0.3)
    faces = ball.faces[:, ::-1].copy()
    if shape == "half of the faces":
        faces[::2] = faces[::2, ::-1]
    mesh = trimesh.Trimesh(ball.vertices, faces, process=False)
    if shape == "hollow ball":  # a wall: what no camera sees looks inward
        inner = trimesh.creation.icosphere(subdivisions=2, radius=0.4)
        mesh = trimesh.util.concatenate([mesh, inner])
    mesh.export(tmp_path / "mesh.ply")
    surface, report = load_surface(tmp_path / "mesh.ply", UnitCapture(), PRESET)
    center = surface.vertices[surface.faces].mean(1)
    outward = (flat_normals(surface) * center).sum(1) > 0
    outer = np.linalg.norm(center, axis=1) > 0.6
    if shape == "bowl":  # from above, cameras see its inner side; more of them see its outer side
        assert outward.all() and report["turned_fraction"] == 1
    else:
        assert outward[outer].all() and report["turned_fraction"] > 0.4
        assert (surface.normals * surface.vertices).sum(1)[np.linalg.norm(surface.vertices, axis=1) > 0.6].min() > 0


def test_a_box_in_its_own_bounding_sphere_is_no_mesh_outside(tmp_path):
    rng = np.random.default_rng(0)
    for _ in range(20):
        sides = rng.uniform(0.2, 1, 3)
        trimesh.creation.box(2 * sides / np.linalg.norm(sides) * (1 + 1e-9)).export(tmp_path / "box.ply")
        assert len(read_mesh(tmp_path / "box.ply", UnitCapture()).faces) == 12


def test_the_two_sides_of_a_sheet_have_normals_of_their_own():
    corners = np.array([[0, -0.5, -0.5], [0, 0.5, -0.5], [0, 0.5, 0.5], [0, -0.5, 0.5]], float)
    faces = np.array([[0, 1, 2], [0, 2, 3], [4, 6, 5], [4, 7, 6]])
    normals = angle_normals(np.concatenate([corners, corners]), faces)
    np.testing.assert_allclose(normals, np.repeat([[1, 0, 0], [-1, 0, 0]], 4, 0), atol=1e-9)


@pytest.mark.parametrize(
    ("name", "message", "hint"),
    [
        ("missing.ply", "there is no mesh file .*missing.ply", "--mesh"),
        ("bad.ply", "the mesh bad.ply cannot be read", "OBJ, PLY, STL or glTF"),
        ("points.ply", "points.ply holds no usable triangle", "a triangle mesh"),
        ("far.ply", "far.ply lies outside the object's bounding sphere", "coordinates"),
        ("beyond.obj", "the mesh beyond.obj (holds no usable triangle|cannot be read)", "triangle|OBJ"),
        ("flat.obj", "flat.obj holds no usable triangle", "a triangle mesh"),
        ("other.dae", "the mesh other.dae cannot be read", "OBJ, PLY, STL or glTF"),
    ],
)
def test_an_unusable_mesh_file_is_refused_with_its_reason(tmp_path, name, message, hint):
    (tmp_path / "bad.ply").write_text("no mesh")
    (tmp_path / "beyond.obj").write_text("v 0 0 0\nv 1 0 0\nv 0 1 0\nf 1 2 9\n")
    (tmp_path / "flat.obj").write_text("v 0 0 0\nv 0.5 0 0\nv 0.2 0 0\nf 1 2 3\n")
    (tmp_path / "other.dae").write_text("<COLLADA/>")
    trimesh.PointCloud(np.eye(3)).export(tmp_path / "points.ply")
    trimesh.creation.icosphere(radius=0.1).apply_translation([9, 0, 0]).export(tmp_path / "far.ply")
    with pytest.raises(CaptureError, match=message) as error:
        load_surface(tmp_path / name, UnitCapture(), PRESET)
    assert re.search(hint, error.value.hint)
