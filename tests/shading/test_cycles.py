"""Cycles is the reference: our shading of a sphere and of Suzanne under a known light against its Principled BSDF."""

import json
import math
import subprocess
import sys

import numpy as np
import OpenEXR
import pytest
import torch
import trimesh

pytest.importorskip("bpy")
from blender_nep.asset.preview import Pyramid
from blender_nep.geometry.ray_tracing import RayTracer
from blender_nep.shading.plenoptic import Material, PlenopticFunction, PlenopticSettings, TerminalRadiance
from support.paths import SUZANNE_SMALL, TESTS

SIZE, WIDTH = 64, 2.0
MATERIALS = [
    {"albedo": (0.9, 0.6, 0.3), "roughness": 0.15, "metallic": 1.0},
    {"albedo": (0.9, 0.6, 0.3), "roughness": 0.5, "metallic": 1.0},
    {"albedo": (0.7, 0.2, 0.1), "roughness": 0.2, "metallic": 0.0},
    {"albedo": (0.1, 0.4, 0.8), "roughness": 0.8, "metallic": 0.0},
    {"albedo": (0.5, 0.5, 0.5), "roughness": 0.3, "metallic": 0.5},
    {"albedo": (1.0, 1.0, 1.0), "roughness": 1.0, "metallic": 1.0},
]


def sky(height: int = 128) -> np.ndarray:
    """Soft lamps on a gradient [height, 2 height, 3], Blender's orientation."""
    polar = (np.arange(height) + 0.5) * math.pi / height
    around = (0.5 - (np.arange(2 * height) + 0.5) / (2 * height)) * 2 * math.pi
    d = np.stack(
        [
            np.outer(np.sin(polar), np.cos(around)),
            np.outer(np.sin(polar), np.sin(around)),
            np.outer(np.cos(polar), np.ones_like(around)),
        ],
        -1,
    )
    out = 0.4 + 0.2 * d
    for axis, color, sharpness in (
        ((0.6, 0.3, 0.74), (6, 5, 4), 30),
        ((0.2, -0.9, 0.39), (1, 2, 4), 12),
        ((0.9, 0.1, -0.42), (2, 1, 1), 60),
    ):
        axis = np.array(axis) / np.linalg.norm(axis)
        out = out + np.exp(sharpness * (d @ axis - 1))[..., None] * np.array(color)
    return out.astype(np.float32)


class Sky:
    """The sky as F_e: rays only, so that nothing but the shading is compared."""

    def __init__(self, radiance: np.ndarray) -> None:
        self.pyramid = Pyramid([radiance])

    def query_cone(self, origins, directions, half_angle):
        found = self.pyramid.lookup(directions.numpy(), np.zeros(len(directions)))
        return torch.from_numpy(found), torch.ones(len(directions))


def suzanne() -> trimesh.Trimesh:
    mesh = trimesh.load(SUZANNE_SMALL / "gt_mesh.ply", process=False, force="mesh")
    mesh.vertices -= mesh.bounds.mean(0)
    mesh.vertices *= 0.9 / np.linalg.norm(mesh.vertices, axis=1).max()
    return mesh


BODIES = {"sphere": lambda: trimesh.creation.icosphere(subdivisions=5, radius=0.9), "suzanne": suzanne}


RENDERED = [("sphere", (0, 2)), ("sphere", (1, 3, 4, 5)), ("suzanne", tuple(range(len(MATERIALS))))]
"""Bodies, and numbers of the materials that one Blender renders them in. The first is quick: a metal and a paint."""


@pytest.fixture(scope="module")
def reference(request, tmp_path_factory):
    """A body, the sky, Cycles' images {number of a material: image}, and the number of bounces."""
    body, numbers = request.param
    folder = tmp_path_factory.mktemp(body)
    mesh, bounces = BODIES[body](), 0 if body == "sphere" else 1
    np.savez(folder / "mesh.npz", vertices=mesh.vertices, faces=mesh.faces, bounces=bounces)
    light = sky()
    OpenEXR.File({"compression": OpenEXR.ZIP_COMPRESSION, "type": OpenEXR.scanlineimage}, {"RGB": light}).write(
        str(folder / "light.exr")
    )
    script = TESTS / "support" / "cycles_reference.py"
    files = [folder / name for name in ("mesh.npz", "light.exr", "out.npz")]
    materials = json.dumps([MATERIALS[number] for number in numbers])
    subprocess.run([sys.executable, script, *files, materials], check=True, timeout=300, capture_output=True)
    return mesh, light, dict(zip(numbers, np.load(folder / "out.npz")["images"], strict=True)), bounces


def case(rendered, number):
    """Parameters of the test for one material of a body."""
    values = MATERIALS[number]
    name = f"{rendered[0]}-r {values['roughness']} m {values['metallic']}"
    return pytest.param(rendered, number, id=name, marks=[pytest.mark.slow] * (rendered is not RENDERED[0]))


@pytest.mark.parametrize(
    ("reference", "index"),
    [case(rendered, number) for rendered in RENDERED for number in rendered[1]],
    indirect=["reference"],
    scope="module",
)
def test_our_shading_is_that_of_cycles(reference, index):
    """Mean relative error over the pixels that see the body away from its edge: under 3 %."""
    mesh, light, images, bounces = reference
    image = images[index]
    tracer = RayTracer(np.asarray(mesh.vertices), np.asarray(mesh.faces))
    rays = 96 if bounces else 256
    f_p = PlenopticFunction(
        tracer,
        np.asarray(mesh.vertex_normals),
        Sky(light),
        TerminalRadiance(),
        PlenopticSettings(levels=1 + bounces, diffuse=rays, specular=rays, use_cones=False),
        "cpu",
    )
    at = ((np.arange(SIZE) + 0.5) / SIZE - 0.5) * WIDTH
    y, z = np.meshgrid(at, -at)
    origins = np.stack([np.full_like(y, 5), y, z], -1).reshape(-1, 3).astype(np.float32)
    directions = np.tile(np.array([[-1, 0, 0]], np.float32), (len(origins), 1))
    distance, face, barycentric = tracer.intersect(origins, directions)
    facing = np.abs(tracer.face_normals[np.maximum(face, 0)] @ directions[0])
    seen = np.flatnonzero(np.isfinite(distance) & (facing > 0.35) & (image[..., 3].ravel() > 0.999))
    if bounces:  # pixels in which the depth is not smooth see more than their center's surface
        depth = np.where(np.isfinite(distance), distance, 9).reshape(SIZE, SIZE)
        jump = np.max([np.abs(depth - np.roll(depth, s, a)) for s in (1, -1) for a in (0, 1)], axis=0).ravel()
        seen = seen[jump[seen] < 0.08]
    points = f_p.points(face[seen], barycentric[seen], -torch.from_numpy(directions[seen]))
    values = MATERIALS[index]

    def material(points):
        n = len(points)
        return Material(
            torch.tensor(values["albedo"]).expand(n, 3),
            torch.full((n,), values["roughness"]),
            torch.full((n,), values["metallic"]),
        )

    # what a second bounce meets is black in Cycles: with N interactions nothing is asked of the terminal MLP
    f_p.terminal.forward = lambda points: torch.zeros(len(points), 3)
    ours = f_p.outgoing(points, material, 1, torch.Generator().manual_seed(0)).numpy()
    theirs = image[..., :3].reshape(-1, 3)[seen]
    relative = np.abs(ours - theirs).mean() / theirs.mean()
    bias = ours.mean() / theirs.mean() - 1
    print(f"mean relative error {relative:.4f}, bias {bias:+.4f}, {len(seen)} pixels")
    assert relative < 0.03 and abs(bias) < 0.02
