"""Links in a batch of a stranger: the gallery copies nothing that they lead to."""

from __future__ import annotations

import base64
import shutil

import pytest
from PIL import Image

from blender_nep.gallery import write_gallery
from support.batch_folder import write_batch, write_mirror_ball

SECRET = b"-----BEGIN PRIVATE KEY-----"


@pytest.fixture
def shelf(tmp_path):
    write_mirror_ball(tmp_path / "shelf" / "ball")
    return write_batch(tmp_path / "shelf", [{"name": "ball"}])


def pages(shelf) -> str:
    write_gallery(shelf)
    return "".join(path.read_text(encoding="utf-8") for path in sorted(shelf.rglob("*.html")))


def test_a_model_that_is_a_link_is_not_copied(shelf, tmp_path):
    (tmp_path / "key").write_bytes(SECRET)
    (shelf / "ball" / "asset.glb").unlink()
    (shelf / "ball" / "asset.glb").symlink_to(tmp_path / "key")
    page = pages(shelf)
    assert base64.b64encode(SECRET).decode()[:20] not in page and "View in 3D" not in page and "asset.glb" not in page


@pytest.mark.parametrize("name", ["preview.png", "comparison.png", "turntable.png"])
def test_a_picture_that_is_a_link_is_not_copied(name, shelf, tmp_path):
    Image.new("RGB", (40, 30), (1, 2, 3)).save(tmp_path / "private.png")
    for picture in ("preview.png", "comparison.png", "turntable.png"):
        (shelf / "ball" / picture).unlink(missing_ok=True)
    assert "data:image/webp" not in pages(shelf)
    shutil.copy(tmp_path / "private.png", shelf / "ball" / name)
    assert "data:image/webp" in pages(shelf), "as a file it is shown"
    (shelf / "ball" / name).unlink()
    (shelf / "ball" / name).symlink_to(tmp_path / "private.png")
    assert "data:image/webp" not in pages(shelf)


def test_a_light_and_a_report_that_are_links_are_not_copied(shelf, tmp_path):
    whole = pages(shelf)
    assert "data:image/vnd.radiance" in whole and "roughness" in whole.lower()
    for name in ("environment.exr", "report.json"):
        shutil.move(shelf / "ball" / name, tmp_path / name)
        (shelf / "ball" / name).symlink_to(tmp_path / name)
    page = pages(shelf)
    assert "data:image/vnd.radiance" not in page and "report.json is missing or damaged" in page


def test_nothing_is_copied_out_of_a_folder_that_is_a_link(shelf, tmp_path):
    shutil.move(shelf / "ball", tmp_path / "private")
    (shelf / "ball").symlink_to(tmp_path / "private")
    page = pages(shelf)
    assert "data:image/webp" not in page and "asset.glb" not in page and not (tmp_path / "private" / "view.html").exists()
