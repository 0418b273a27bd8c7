"""The normal map of a lean, bumpy ball, whose normals are known; Blender's tangents and Cycles are the references."""

from dataclasses import replace

import numpy as np
import pytest
import torch

from blender_nep.asset.export import NORMAL_MAP, TEXTURES, TexturedMesh, write_exr, write_obj, write_png
from blender_nep.geometry.uv_raster import look_up
from blender_nep.presets import SurfacePreset
from blender_nep.surface.extraction import extract_surface
from blender_nep.surface.normal_map import tangent_frames
from support.analytic_field import AnalyticField
from support.normal_map_checks import SIZE, angles, check_cycles, check_tangents
from support.own_process import in_blender

RADIUS, BUMPS = 0.6, 14.0
PRESET = SurfacePreset(
    grid=96, unwrapped_faces=4000, faces=30_000, chord_error=1e-4, asset_faces=1000, normal_texels=512, atlas_texels=256
)


def bumpy(p):
    return p.norm(dim=-1) - RADIUS - 0.03 * torch.sin(BUMPS * p).prod(-1)


FIELD = AnalyticField(bumpy)


@pytest.fixture(scope="module")
def extracted():
    return extract_surface(FIELD, PRESET)


def true_normals(points):
    """The normals [n, 3] of the bumpy ball where the rays from its center through points [n, 3] leave it."""
    direction = torch.nn.functional.normalize(torch.as_tensor(points, dtype=torch.float32), dim=-1)
    reach = torch.full((len(points), 1), RADIUS)
    for _ in range(20):
        reach -= FIELD.sdf_and_gradient(reach * direction)[0][:, None]
    return FIELD.normal(reach * direction).numpy()


def seen_from_x(size):
    """What an orthographic camera of width 2 at +x sees: normals [m, 3], and which pixels [size, size] see them."""
    at = torch.linspace(-1, 1, size + 1)[:-1] + 1 / size
    z, y = torch.meshgrid(-at, at, indexing="ij")
    inside = y**2 + z**2 < (0.8 * RADIUS) ** 2
    place = torch.stack([torch.ones(int(inside.sum())), y[inside], z[inside]], 1)
    for _ in range(200):
        place[:, 0] -= 0.5 * FIELD.sdf_and_gradient(place)[0]
    return FIELD.normal(place).numpy(), inside.numpy()


def test_a_lean_mesh_has_few_faces_and_the_fine_ones_uv_map(extracted):
    surface, report, lean, _ = extracted
    assert len(lean.surface.faces) == report["faces"] <= 1000 < len(surface.faces) == report["faces_learned_on"]
    np.testing.assert_array_equal(surface.uv[: len(lean.surface.uv)], lean.surface.uv)
    assert lean.normal_map.shape == (512, 512, 3) and 0 <= lean.normal_map.min() <= lean.normal_map.max() <= 1
    assert extract_surface(FIELD, replace(PRESET, asset_faces=0)).lean is None
    assert extract_surface(FIELD, replace(PRESET, asset_faces=10**6)).lean is None


def test_the_map_turns_the_lean_normals_into_those_of_the_ball(extracted):
    lean, corners = extracted.lean.surface, extracted.lean.surface.faces
    weight = np.random.default_rng(0).dirichlet((2, 2, 2), len(corners))
    point, uv, normal = ((values[corners] * weight[..., None]).sum(1) for values in (lean.vertices, lean.uv, lean.normals))
    frames, handedness = tangent_frames(lean)
    tangent = (frames[corners] * weight[..., None]).sum(1)
    bitangent = handedness[corners[:, :1]] * np.cross(normal, tangent)
    red, green, blue = 2 * look_up(extracted.lean.normal_map, uv).T[..., None] - 1
    true = true_normals(point)
    mapped = red * tangent + green * bitangent + blue * normal
    assert angles(normal, true).mean() > 2 and angles(mapped, true).mean() < 0.25 * angles(normal, true).mean()


def test_the_report_says_how_wrong_normals_are_without_the_map(extracted):
    said = extracted.report["normals_without_map_deg"]
    lean = extracted.lean.surface
    middle = lean.vertices[lean.faces].mean(1)
    assert said == pytest.approx(angles(lean.normals[lean.faces].sum(1), true_normals(middle)).mean(), rel=0.4)
    more = extract_surface(FIELD, replace(PRESET, asset_faces=4000)).report["normals_without_map_deg"]
    assert more < 0.5 * said


def test_the_tangents_are_those_of_blender(extracted, tmp_path):
    pytest.importorskip("bpy")
    lean = extracted.lean.surface
    tangents, handedness = tangent_frames(lean)
    arrays = {"vertices": lean.vertices, "faces": lean.faces, "normals": lean.normals, "uv": lean.uv}
    np.savez(tmp_path / "mesh.npz", **arrays, tangents=tangents, handedness=handedness)
    in_blender(check_tangents, tmp_path / "mesh.npz")


def test_cycles_shades_an_imported_lean_ball_as_a_ball(extracted, tmp_path):
    pytest.importorskip("bpy")
    lean = extracted.lean
    textures = {name: np.full((8, 8, 3) if name == "albedo" else (8, 8), 0.5, np.float32) for name in TEXTURES}
    textures[NORMAL_MAP] = lean.normal_map
    (tmp_path / "textures").mkdir()
    for name, texture in textures.items():
        write_exr(tmp_path / "textures" / f"{name}.exr", texture)
        write_png(tmp_path / "textures" / f"{name}.png", texture, srgb=name == "albedo")
    mesh = lean.surface
    write_obj(tmp_path / "mesh.obj", TexturedMesh(mesh.vertices, mesh.faces, mesh.normals, mesh.uv, textures))
    normals, inside = seen_from_x(SIZE)
    np.savez(tmp_path / "truth.npz", normals=normals, inside=inside)
    in_blender(check_cycles, tmp_path)
