"""Writes the asset folder: mesh, textures, light, preview picture and report, in the capture's own coordinates.

An asset is complete when `report.json` is there. That file is removed first and written last.
"""

from __future__ import annotations

import contextlib
import json
import math
import os
import shutil
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import OpenEXR
import trimesh
from PIL import Image

from blender_nep.asset.cameras_file import CAMERAS
from blender_nep.color import linear_to_srgb, to_bytes
from blender_nep.files import jsonable, output_errors, refuse_links
from blender_nep.geometry.mesh import Surface

TEXTURES = ("albedo", "roughness", "metallic", "confidence")
"""Every texture of an asset. `TEXTURE_NAMES` in backend/engine/results/job_files.py repeats them for Blender's Python."""
NORMAL_MAP = "normal"
"""The texture that only some assets have: a tangent-space normal map (`surface.normal_map`)."""
SRGB_TEXTURES = ("albedo",)
"""Textures that are colors. Their 8-bit files are sRGB-encoded: `is_color` in backend/scene_io/asset_import.py."""
REPORT, TEXTURES_FOLDER = "report.json", "textures"
FILES = (
    *("mesh.obj", "mesh.mtl", "asset.glb", "environment.exr", "preview.png", CAMERAS),
    *(f"{TEXTURES_FOLDER}/{name}{ending}" for name in (*TEXTURES, NORMAL_MAP) for ending in (".exr", ".png")),
    REPORT,
)
"""Every file of an asset, in the order in which they are moved into its folder. No other file is replaced or removed."""
PARTIAL = ".partial"
"""The folder in which the files of an asset are made."""
WRITTEN = (*(name for name in FILES if "/" not in name), TEXTURES_FOLDER, PARTIAL)
"""The files and folders in the folder of an asset that `write_asset` writes"""

_HALF_MAX = 65504.0
_HALF_LOSS = 1e-3
"""Share of the sum of all values that half floats may lose"""


@dataclass
class TexturedMesh:
    """A mesh in the capture's frame, and its textures."""

    vertices: np.ndarray
    """[V, 3]"""
    faces: np.ndarray
    """[F, 3] int"""
    normals: np.ndarray
    """[V, 3] unit vectors"""
    uv: np.ndarray
    """[V, 2] in 0..1"""
    textures: dict[str, np.ndarray]
    """{name: texture [H, W] or [H, W, 3] float32, row 0 at v = 1}"""


@dataclass
class Placement:
    """Where the unit frame lies in the capture's frame."""

    center: np.ndarray
    """[3] the object's center"""
    radius: float

    def mesh(self, surface: Surface, textures: dict[str, np.ndarray]) -> TexturedMesh:
        """The surface in the capture's frame, with its textures."""
        return TexturedMesh(
            vertices=np.asarray(surface.vertices) * self.radius + self.center,
            faces=np.asarray(surface.faces),
            normals=np.asarray(surface.normals),
            uv=surface.atlas,
            textures=textures,
        )


def write_asset(
    folder: Path,
    mesh: TexturedMesh,
    picture: np.ndarray | None,
    light: np.ndarray | None,
    cameras: dict | None,
    report: Callable[[], dict],
) -> None:
    """Write an asset into `folder`. Raises OutputError; where one of its files or folders is a link, nothing is written.

    `picture` [h, w, 3] uint8 is the preview picture, `light` [H, 2H, 3] the environment as bright as the photos, and
    `cameras` the content of cameras.json; where one is None, the file that is there stays. `report` gives the content of
    report.json; it is called last, when everything else is on the disk.
    """
    with output_errors(folder):
        refuse_links(folder, (*WRITTEN, f"{PARTIAL}/{TEXTURES_FOLDER}"))
        partial = folder / PARTIAL
        _remove(partial)
        (partial / TEXTURES_FOLDER).mkdir(parents=True, exist_ok=True)
        try:
            write_obj(partial / "mesh.obj", mesh)
            for name, texture in mesh.textures.items():
                write_exr(partial / TEXTURES_FOLDER / f"{name}.exr", texture)
                write_png(partial / TEXTURES_FOLDER / f"{name}.png", texture, srgb=name in SRGB_TEXTURES)
            write_glb(partial / "asset.glb", mesh)
            if light is not None:
                write_exr(partial / "environment.exr", light)
            if cameras is not None:
                (partial / CAMERAS).write_text(json.dumps(cameras, indent=1), encoding="utf-8")
            if picture is not None:
                Image.fromarray(picture).save(partial / "preview.png")
            (partial / REPORT).write_text(json.dumps(jsonable(report()), indent=1), encoding="utf-8")
            _move(partial, folder)
        finally:
            with contextlib.suppress(OSError):
                _remove(partial)


def _remove(partial: Path) -> None:
    """Remove what was made in the folder `partial`, and the folder, unless somebody else has put files there."""
    for name in FILES:
        (partial / name).unlink(missing_ok=True)
    for folder in (partial / TEXTURES_FOLDER, partial):
        with contextlib.suppress(OSError):  # not empty, or not there
            folder.rmdir()


def _move(partial: Path, folder: Path) -> None:
    """Flush the files to the disk and move them into the folder. report.json is removed first and moved last.

    The normal map of an earlier asset is removed, too: it does not fit this mesh.
    """
    (folder / REPORT).unlink(missing_ok=True)
    (folder / TEXTURES_FOLDER).mkdir(exist_ok=True)
    for suffix in (".exr", ".png"):
        (folder / TEXTURES_FOLDER / f"{NORMAL_MAP}{suffix}").unlink(missing_ok=True)
    for name in FILES:
        if (partial / name).is_file():
            with open(partial / name, "rb+") as opened:
                os.fsync(opened.fileno())
            os.replace(partial / name, folder / name)


def write_exr(path: Path, pixels: np.ndarray) -> None:
    """Write linear values [H, W, 3] (channels R, G, B) or [H, W] (channel V) as OpenEXR. Raises OSError.

    The values are half floats. They are 32-bit floats where half floats would lose a thousandth of their sum, as with light
    in large or in tiny units.
    """
    whole = np.nan_to_num(pixels, posinf=_HALF_MAX, neginf=-_HALF_MAX).astype(np.float32)
    half = np.clip(whole, -_HALF_MAX, _HALF_MAX).astype(np.float16)
    lost = np.abs(whole - half, dtype=np.float64).sum() > _HALF_LOSS * np.abs(whole, dtype=np.float64).sum()
    stored = whole if lost else half
    channels = {"RGB": stored} if stored.ndim == 3 else {"V": stored}
    header = {"compression": OpenEXR.ZIP_COMPRESSION, "type": OpenEXR.scanlineimage}
    path.touch()  # raises a clear OSError for a folder that may not be written; OpenEXR raises RuntimeError without errno
    try:
        OpenEXR.File(header, channels).write(str(path))
    except RuntimeError as error:
        free = shutil.disk_usage(path.parent).free
        raise OSError(28 if free < stored.nbytes else 5, f"OpenEXR: {error}") from error


def write_png(path: Path, pixels: np.ndarray, *, srgb: bool) -> None:
    """Write linear values in [0, 1] as 8-bit PNG. With `srgb`, the values are sRGB-encoded; otherwise they stay linear."""
    values = linear_to_srgb(pixels) if srgb else np.clip(pixels, 0, 1)
    Image.fromarray(to_bytes(values)).save(path)


def write_obj(path: Path, mesh: TexturedMesh) -> None:
    """Write a Wavefront OBJ with normals and UVs, and its MTL with a material of the PBR extension (Pm, Pr, norm).

    Position, normal and UV of a corner have the same index.
    """
    material = [
        "newmtl nep",
        "Kd 1 1 1",
        "Pr 1",
        "Pm 1",
        "map_Kd textures/albedo.png",
        "map_Pr textures/roughness.png",
        "map_Pm textures/metallic.png",
    ]
    if NORMAL_MAP in mesh.textures:
        material.append(f"norm textures/{NORMAL_MAP}.png")
    path.with_suffix(".mtl").write_text("\n".join(material) + "\n", encoding="utf-8")
    with open(path, "w", encoding="utf-8") as file:
        file.write(f"mtllib {path.stem}.mtl\no nep\nusemtl nep\n")
        np.savetxt(file, mesh.vertices, "v" + f" %.{_digits(mesh.vertices)}g" * 3)
        np.savetxt(file, mesh.uv, "vt %.6f %.6f")
        np.savetxt(file, mesh.normals, "vn %.4f %.4f %.4f")
        np.savetxt(file, np.repeat(mesh.faces + 1, 3, axis=1), "f %d/%d/%d %d/%d/%d %d/%d/%d")


def _digits(vertices: np.ndarray) -> int:
    """Decimal digits that keep vertices [V, 3] exact to a ten-millionth of the mesh's size, however far from the origin."""
    size, farthest = np.ptp(vertices, axis=0).max(), np.abs(vertices).max()
    return 7 if farthest <= size else min(17, 7 + math.ceil(math.log10(farthest / max(size, 1e-10 * farthest))))


def write_glb(path: Path, mesh: TexturedMesh) -> None:
    """Write a glTF 2.0 binary: Y up, base color sRGB-encoded, roughness in G and metallic in B of one linear texture.

    Vertices are relative to the middle of the mesh; the translation of the node holds the middle. The reason: glTF stores
    vertices in single precision, which is too coarse far from the origin.
    """
    y_up = np.array([[1, 0, 0], [0, 0, 1], [0, -1, 0]], np.float64)
    rough, metal = to_bytes(mesh.textures["roughness"]), to_bytes(mesh.textures["metallic"])
    normal_map = mesh.textures.get(NORMAL_MAP)
    material = trimesh.visual.material.PBRMaterial(
        name="nep",
        baseColorTexture=Image.fromarray(to_bytes(linear_to_srgb(mesh.textures["albedo"]))),
        metallicRoughnessTexture=Image.fromarray(np.stack([np.zeros_like(rough), rough, metal], -1)),
        normalTexture=None if normal_map is None else Image.fromarray(to_bytes(normal_map)),
        metallicFactor=1.0,
        roughnessFactor=1.0,
    )
    middle = 0.5 * (mesh.vertices.min(0) + mesh.vertices.max(0))
    place = np.eye(4)
    place[:3, 3] = y_up @ middle
    whole = trimesh.Trimesh(
        (mesh.vertices - middle) @ y_up.T,
        mesh.faces,
        vertex_normals=mesh.normals @ y_up.T,
        visual=trimesh.visual.TextureVisuals(uv=mesh.uv, material=material),
        process=False,
    )
    scene = trimesh.Scene()
    scene.add_geometry(whole, node_name="nep", geom_name="nep", transform=place)
    path.write_bytes(scene.export(file_type="glb", include_normals=True))
