"""A shelf from a stranger may hold links to files of the user: a batch and a gallery write nothing through them."""

from __future__ import annotations

import os

import pytest

from blender_nep.errors import OutputError
from blender_nep.gallery import write_gallery

FILES = ("log.txt", "batch.json", "batch.lock", "batch.stop")


def refused(batch, link: str, target, **options) -> None:
    """The batch refuses the link and changes nothing at its target."""
    before = {path: path.read_text() for path in target.rglob("*")} if target.is_dir() else target.read_text()
    place = batch.out / link
    place.parent.mkdir(parents=True, exist_ok=True)
    place.symlink_to(target)
    code, events = batch.run(**options)
    assert code == 5 and events[-1]["name"] == "output.is_a_link" and events[-1]["values"]["path"] == str(place)
    after = {path: path.read_text() for path in target.rglob("*")} if target.is_dir() else target.read_text()
    assert after == before and place.is_symlink()


@pytest.mark.parametrize("name", FILES)
def test_a_link_in_the_folder_of_a_batch_is_refused(name, batch, tmp_path):
    batch.add("a")
    (tmp_path / "profile").write_text("mine")
    refused(batch, name, tmp_path / "profile", overwrite=True)


@pytest.mark.parametrize("name", ["a", "a/capture", "a/checkpoints", "a/textures"])
def test_a_link_for_an_object_is_refused(name, batch, tmp_path):
    batch.add("a")
    (tmp_path / "victim").mkdir()
    for mine in ("transforms.json", "run.json", "surface.done.pt"):
        (tmp_path / "victim" / mine).write_text("mine")
    if name != "a":  # the mark of an asset, as a stranger may have put it there
        (batch.out / "a").mkdir(parents=True)
        (batch.out / "a" / "report.json").write_text('{"fingerprint": {"format": 15}}')
    refused(batch, name, tmp_path / "victim", overwrite=True)


@pytest.mark.parametrize("name", ["index.html", "gallery"])
def test_the_gallery_is_not_written_through_links(name, batch, tmp_path):
    batch.add("a")
    assert batch.run()[0] == 0
    (tmp_path / "victim").mkdir()
    for path in sorted((batch.out / "gallery").iterdir()):
        path.unlink()
    (batch.out / "gallery").rmdir()
    (batch.out / "index.html").unlink()
    (batch.out / name).symlink_to(tmp_path / "victim")
    with pytest.raises(OutputError) as error:
        write_gallery(batch.out)
    assert error.value.name == "output.is_a_link" and not os.listdir(tmp_path / "victim")


def test_an_object_whose_folder_is_a_link_gets_no_page(batch, tmp_path):
    batch.add("a")
    assert batch.run()[0] == 0
    (batch.out / "a" / "asset.glb").write_text("model")
    (batch.out / "a").rename(tmp_path / "victim")
    (batch.out / "a").symlink_to(tmp_path / "victim")
    write_gallery(batch.out)
    assert not (tmp_path / "victim" / "view.html").exists()
    (batch.out / "a").unlink()
    (tmp_path / "victim").rename(batch.out / "a")
    write_gallery(batch.out)
    assert (batch.out / "a" / "view.html").is_file()
