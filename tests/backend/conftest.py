"""Fixtures: a small asset that is written by hand, and a scripted engine that learns nothing."""

from pathlib import Path

import numpy as np
import pytest
from PIL import Image

from support import scripted_engine
from support.captures import write_exr

VERTICES = [(0.5, 0.25, 0.75), (-0.5, 0.3, 0.6), (0.1, -0.6, 0.2), (0.05, 0.1, -0.7)]


@pytest.fixture
def engine_python(tmp_path) -> str:
    """The path of the executable that scripted_engine.py describes."""
    return scripted_engine.make(tmp_path)


@pytest.fixture
def asset(tmp_path) -> Path:
    """A tetrahedron with the corners VERTICES, textures of one color each, a gray light."""
    folder = tmp_path / "asset"
    (folder / "textures").mkdir(parents=True)
    lines = [
        "mtllib mesh.mtl",
        *(f"v {x} {y} {z}" for x, y, z in VERTICES),
        "vt 0 0",
        "vt 1 0",
        "vt 0 1",
        "vt 1 1",
        "usemtl m",
        "f 1/1 2/2 3/3",
        "f 1/1 4/4 2/2",
        "f 2/2 4/4 3/3",
        "f 1/1 3/3 4/4",
    ]
    (folder / "mesh.obj").write_text("\n".join(lines) + "\n")
    (folder / "mesh.mtl").write_text("newmtl m\nmap_Kd textures/albedo.png\n")
    for name, color in (("albedo", (200, 120, 40)), ("roughness", 60), ("metallic", 255), ("confidence", 128)):
        pixels = np.broadcast_to(np.array(color, np.uint8), (8, 8, 3) if name == "albedo" else (8, 8))
        Image.fromarray(np.ascontiguousarray(pixels)).save(folder / "textures" / f"{name}.png")
        write_exr(folder / "textures" / f"{name}.exr", np.full((8, 8, 3), 0.5))
    write_exr(folder / "environment.exr", np.full((16, 32, 3), 0.5))
    (folder / "report.json").write_text("{}")
    return folder
