"""Files that are packed on one machine and unpacked on another one."""

from __future__ import annotations

import io
import tarfile
from pathlib import Path

import pytest

from blender_nep.batch.workers.shipping import pack, unpack


@pytest.fixture
def store(tmp_path) -> Path:
    """A folder with a photo, outside of all captures."""
    (tmp_path / "store").mkdir()
    (tmp_path / "store/aa11.jpg").write_bytes(b"photo")
    return tmp_path / "store"


@pytest.fixture
def node(tmp_path) -> Path:
    (tmp_path / "node").mkdir()
    return tmp_path / "node"


def files_of(folder: Path) -> dict[str, bytes]:
    return {path.relative_to(folder).as_posix(): path.read_bytes() for path in folder.rglob("*") if path.is_file()}


def test_files_and_folders_keep_their_paths(tmp_path, node):
    (tmp_path / "asset/checkpoints").mkdir(parents=True)
    (tmp_path / "asset/checkpoints/step").write_bytes(b"3")
    (tmp_path / "meta.json").write_bytes(b"{}")
    (tmp_path / "asset/notes.txt").write_bytes(b"mine")
    unpack(pack([tmp_path / "meta.json", tmp_path / "missing"], tmp_path, tmp_path / "asset"), node)
    assert files_of(node) == {"meta.json": b"{}", "asset/checkpoints/step": b"3"}, "notes of the user stay at home"


def test_photos_that_are_symbolic_links_arrive_at_the_job(tmp_path, store, node):
    images = tmp_path / "vase/images"
    images.mkdir(parents=True)
    for name in ("0.jpg", "1.jpg"):
        (images / name).symlink_to(store / "aa11.jpg")
    unpack(pack([images / "0.jpg", images / "../images/1.jpg"], tmp_path), node)
    assert files_of(node) == {"vase/images/0.jpg": b"photo", "vase/images/1.jpg": b"photo"}
    assert not any(path.is_symlink() for path in node.rglob("*"))


def test_a_folder_of_photos_that_is_a_symbolic_link(tmp_path, store, node):
    (tmp_path / "vase").mkdir()
    (tmp_path / "vase/images").symlink_to(store)
    unpack(pack([tmp_path / "vase/images/aa11.jpg"], Path(tmp_path.anchor)), node)
    assert files_of(node / tmp_path.relative_to(tmp_path.anchor)) == {"vase/images/aa11.jpg": b"photo"}


def test_a_link_in_a_capture_is_packed_as_what_it_leads_to(tmp_path, store, node):
    (tmp_path / "vase").mkdir()
    (tmp_path / "vase/photo.jpg").symlink_to(store / "aa11.jpg")
    unpack(pack([tmp_path / "vase"], tmp_path), node)
    assert files_of(node) == {"vase/photo.jpg": b"photo"}


def test_links_in_the_folder_of_a_run_are_left_out(tmp_path, store, node):
    (tmp_path / "asset/checkpoints").mkdir(parents=True)
    (tmp_path / "asset/checkpoints/surface.done.pt").symlink_to(store / "aa11.jpg")
    (tmp_path / "asset/log.txt").symlink_to(store / "aa11.jpg")
    unpack(pack([], tmp_path, tmp_path / "asset"), node)
    assert not files_of(node)


def test_nothing_is_unpacked_through_a_link(tmp_path, store, node):
    (tmp_path / "asset").mkdir()
    (tmp_path / "asset/report.json").write_bytes(b"{}")
    packed = pack([], tmp_path, tmp_path / "asset")
    (node / "asset").mkdir()
    (node / "asset/report.json").symlink_to(store / "aa11.jpg")
    unpack(packed, node)
    assert (store / "aa11.jpg").read_bytes() == b"photo" and files_of(node) == {"asset/report.json": b"{}"}


def test_a_root_that_is_not_absolute(tmp_path, node, monkeypatch):
    monkeypatch.chdir(tmp_path)
    (tmp_path / "meta.json").write_bytes(b"{}")
    unpack(pack([Path("meta.json")], Path(".")), node)
    assert files_of(node) == {"meta.json": b"{}"}


@pytest.mark.parametrize("name", ["../outside.json", "/outside.json", "a/../../outside.json"])
def test_a_path_that_leaves_the_root_is_refused(node, name):
    packed = io.BytesIO()
    with tarfile.open(fileobj=packed, mode="w") as archive:
        member = tarfile.TarInfo(name)
        member.size = 2
        archive.addfile(member, io.BytesIO(b"{}"))
    with pytest.raises(ValueError, match="leads out of the folder"):
        unpack(packed.getvalue(), node)
    assert not files_of(node) and not (node.parent / "outside.json").exists()


def test_a_folder_that_is_a_link_is_not_followed(tmp_path, store, node):
    (tmp_path / "asset").mkdir()
    (tmp_path / "asset/report.json").write_bytes(b"{}")
    packed = pack([], tmp_path, tmp_path / "asset")
    (node / "asset").symlink_to(store)
    with pytest.raises(ValueError, match="leads out of the folder"):
        unpack(packed, node)
    assert not (store / "report.json").exists()
