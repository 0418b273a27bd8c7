"""Pictures are opened only in the formats that are promised: Pillow would give others to programs such as Ghostscript."""

from __future__ import annotations

import io
import json
import re
import sys

import numpy as np
import pytest
import tifffile
import trimesh
from PIL import EpsImagePlugin, Image

from blender_nep.asset.export import TexturedMesh, write_glb
from blender_nep.cameras.photo_folder import Photo, gray_copy
from blender_nep.cameras.reduction import Reduction
from blender_nep.capture.photos.photo_files import exif, image_size, open_image
from blender_nep.cli import main
from blender_nep.errors import CaptureError
from blender_nep.gallery import write_gallery
from blender_nep.safety.pictures import open_picture
from blender_nep.surface.mesh_file import read_mesh
from support.batch_folder import write_batch, write_mirror_ball
from support.paths import ROOT

EPS = b"%!PS-Adobe-3.0 EPSF-3.0\n%%BoundingBox: 0 0 24 24\n%%EndComments\n(ran) print\nshowpage\n%%EOF\n"


@pytest.fixture
def ghostscript(tmp_path, monkeypatch):
    """A program in the place of Ghostscript, and the file that it leaves behind."""
    left = tmp_path / "started"
    program = tmp_path / "gs"
    program.write_text(f"#!{sys.executable}\nopen({str(left)!r}, 'w').close()\n")
    program.chmod(0o755)
    monkeypatch.setenv("PATH", str(tmp_path))
    monkeypatch.setattr(EpsImagePlugin, "gs_binary", str(program))
    return left


@pytest.mark.skipif(sys.platform == "win32", reason="the played program is a script")
def test_pillow_alone_would_start_ghostscript(ghostscript):
    with pytest.raises(OSError):
        Image.open(io.BytesIO(EPS)).load()
    assert ghostscript.exists()


def test_a_photo_that_is_a_program_is_refused(ghostscript, make_capture, capsys):
    capture = make_capture(views=6, suffix=".png")
    photo = capture.folder / capture.meta["frames"][0]["file_path"]
    photo.write_bytes(EPS)
    assert main(["info", str(capture.folder)]) == 3 and photo.name in capsys.readouterr().err
    for read in (image_size, exif, lambda path: open_image(path, "srgb")):
        with pytest.raises(CaptureError, match=photo.name):
            read(photo)
    with pytest.raises(CaptureError, match=photo.name):
        gray_copy(Photo(photo, 24, 24, None, ()), Reduction.of(24, 24, 12))
    assert not ghostscript.exists()


def test_a_preview_that_is_a_program_leaves_a_gap(ghostscript, tmp_path):
    write_mirror_ball(tmp_path / "shelf" / "ball")
    (tmp_path / "shelf" / "ball" / "preview.png").write_bytes(EPS)
    write_gallery(write_batch(tmp_path / "shelf", [{"name": "ball"}]))
    assert "data:image/webp" not in (tmp_path / "shelf" / "index.html").read_text() and not ghostscript.exists()


class Unit:
    to_unit = np.eye(4)


def test_the_textures_of_a_mesh_start_nothing(ghostscript, tmp_path):
    """An OBJ's textures are not opened at all. trimesh mixes those of a glTF file with this extension, and keeps UVs."""
    ball = trimesh.creation.icosphere(1, radius=0.5)
    uv = np.random.default_rng(0).random((len(ball.vertices), 2))
    lines = [f"v {x} {y} {z}" for x, y, z in ball.vertices] + [f"vt {u} {v}" for u, v in uv]
    lines += ["mtllib a.mtl", "usemtl m", *("f " + " ".join(f"{i + 1}/{i + 1}" for i in face) for face in ball.faces)]
    (tmp_path / "a.obj").write_text("\n".join(lines))
    (tmp_path / "a.mtl").write_text("newmtl m\nmap_Kd a.png\n")
    (tmp_path / "a.png").write_bytes(EPS)
    small = np.ones((4, 4), np.float32)
    textures = {"albedo": np.ones((4, 4, 3), np.float32), "roughness": small, "metallic": small}
    write_glb(tmp_path / "a.glb", TexturedMesh(ball.vertices, ball.faces, ball.vertices, uv, textures))
    (tmp_path / "a.gltf").write_text(json.dumps(with_program(tmp_path / "a.glb")))
    for name in ("a.obj", "a.gltf"):
        assert read_mesh(tmp_path / name, Unit).uv is not None, name
    assert not ghostscript.exists()


def with_program(glb) -> dict:
    """The content of a .glb file as a .gltf file whose texture is an EPS file."""
    data = glb.read_bytes()
    size = int.from_bytes(data[12:16], "little")
    told = json.loads(data[20 : 20 + size])
    (glb.parent / "buffer.bin").write_bytes(data[28 + size :])
    (glb.parent / "texture.eps").write_bytes(EPS)
    told["buffers"] = [{"uri": "buffer.bin", "byteLength": len(data) - 28 - size}]
    told["images"] = [{"uri": "texture.eps"} for _ in told["images"]]
    glossy = {"diffuseTexture": {"index": 0}, "specularGlossinessTexture": {"index": 0}}
    told["materials"] = [{"extensions": {"KHR_materials_pbrSpecularGlossiness": glossy}}]
    return told


@pytest.mark.parametrize("name", ["a.zip", "a.bz2", "a"])
def test_a_mesh_in_an_archive_is_refused(name, tmp_path):
    (tmp_path / name).write_bytes(b"PK")
    with pytest.raises(CaptureError, match="its ending is"):
        read_mesh(tmp_path / name, Unit)


def test_a_compression_that_no_photo_has_is_refused(tmp_path):
    pixels = np.zeros((16, 16, 3), np.uint8)
    tifffile.imwrite(tmp_path / "a.tif", pixels, photometric="rgb", compression="png")
    with pytest.raises(CaptureError, match=r"compression PNG .*LZW"):
        open_image(tmp_path / "a.tif", "srgb")
    for usual in ("zstd", "lzma", "packbits", "deflate"):
        tifffile.imwrite(tmp_path / "a.tif", pixels, photometric="rgb", compression=usual)
        assert open_image(tmp_path / "a.tif", "srgb").size == (16, 16)


def test_several_jpeg_pictures_in_a_file_are_a_photo(tmp_path):
    """Phones write such files: the photo, and a smaller one or a map of depths."""
    photo, second = Image.new("RGB", (32, 24), (200, 10, 10)), Image.new("RGB", (16, 12))
    photo.save(tmp_path / "a.jpg", "MPO", save_all=True, append_images=[second])
    with open_picture(tmp_path / "a.jpg") as opened:
        assert opened.format == "MPO"
    assert image_size(tmp_path / "a.jpg") == (32, 24)


def test_nothing_else_opens_pictures():
    files = [path for folder in ("blender_nep", "backend", "addon", "benchmarks") for path in (ROOT / folder).rglob("*.py")]
    found = [path.name for path in files if re.search(r"\bImage\.open\(", path.read_text(encoding="utf-8"))]
    assert found == ["pictures.py"]
