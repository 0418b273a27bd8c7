"""The pages that `write_gallery` writes: what is on them, what is escaped, and what happens when files are missing."""

from __future__ import annotations

import errno
import json
import os
import shutil
import zlib
from html.parser import HTMLParser
from pathlib import Path
from urllib.parse import unquote

import imagecodecs
import numpy as np
import pytest

from backend.engine import progress
from blender_nep.asset.export import write_exr
from blender_nep.batch.progress import STAGE as BATCH
from blender_nep.cli import main
from blender_nep.errors import OutputError, UsageError
from blender_nep.gallery import pages, pictures, write_gallery
from blender_nep.job.stage_names import CAMERA_SEARCH, StageName
from support.batch_folder import picture, spotted_light, write_batch, write_mirror_ball

EVIL = '<script>alert(1)</script> <img src="http://x/y" onerror=alert(2)> & "quotes\''


class Page(HTMLParser):
    """The links, the ids, the tags and the visible text of a page."""

    def __init__(self, path: Path):
        super().__init__()
        self.path, self.links, self.ids, self.tags = path, [], set(), []
        self.words, self._hidden = "", False
        self.feed(path.read_text(encoding="utf-8"))
        self.text = " ".join(self.words.split())

    def handle_starttag(self, tag, attributes):
        found = dict(attributes)
        self.tags.append((tag, found))
        self.ids.add(found.get("id"))
        self.links += [found[key] for key in ("href", "src", "environment-image") if found.get(key)]
        self._hidden = tag in ("script", "style")

    def handle_endtag(self, tag):
        self._hidden = False

    def handle_data(self, data):
        self.words += "" if self._hidden else data

    def all(self, name):
        return [attributes for tag, attributes in self.tags if tag == name]


def assert_links_hold(page: Page) -> None:
    for link in page.links:
        if link.startswith("data:"):
            continue
        path, _, fragment = link.partition("#")
        assert ":" not in path, f"{link} leads out of the folder"
        target = (page.path.parent / unquote(path)) if path else page.path
        assert target.is_file(), link
        if fragment:
            assert fragment in Page(target).ids, link


@pytest.fixture(scope="module")
def finished_ball(tmp_path_factory):
    return write_mirror_ball(tmp_path_factory.mktemp("asset") / "ball")


@pytest.fixture
def batch(tmp_path, finished_ball):
    """A folder for a batch, and a function that puts a finished object into it."""
    folder = tmp_path / "museum & co"
    folder.mkdir()

    def finished(name: str) -> dict:
        shutil.copytree(finished_ball, folder / name)
        return {"name": name, "seconds": 312.5, "peak_memory_mb": 1530.0}

    return folder, finished


def index_of(folder: Path) -> Page:
    write_gallery(folder)
    return Page(folder / "index.html")


def test_a_finished_object(batch):
    folder, finished = batch
    page = index_of(write_batch(folder, [finished("vase 100% #2 é")]))
    assert (
        "museum & co" in page.text and "1 done 0 failed 0 not finished" in page.text and "2026-11-23 09:30 UTC" in page.text
    )
    for words in ("Metal, 75 %", "#ffbc00, roughness 0.05", "Not metal, 25 %", "#7c00ff, roughness 0.30"):
        assert words in page.text
    assert page.text.index("75 %") < page.text.index("25 %"), "the largest share comes first"
    for words in ("23,998", "5 min 12 s", "1.5 GB", "0.038", "0.043", "View in 3D"):
        assert words in page.text
    assert_links_hold(page)
    view = Page(folder / "vase 100% #2 é" / "view.html")
    assert_links_hold(view)
    assert "../index.html#object-vase%20100%25%20%232%20%C3%A9" in view.links
    assert {"asset.glb", "report.json", "log.txt", "../gallery/model-viewer-umd.min.js"} < set(view.links)
    assert all(image["alt"] for shown in (page, view) for image in shown.all("img"))
    assert (folder / "gallery" / "LICENSES.txt").is_file()


def test_objects_that_are_not_finished(batch):
    folder, finished = batch
    lost = {"name": "capture.few_photos", "values": {}, "code": 3, "message": "2 photos are too few", "hint": "Take more."}
    objects = [
        {"name": "wait", "state": "waiting", "fraction": 0.0},
        {"name": "run", "state": "running", "stage": "fields_learning", "fraction": 0.31, "eta_s": 94},
        {"name": "lost", "state": "failed", "error": lost},
        {"name": "new", "state": "running", "fraction": 0.0},
        {"name": "halt", "state": "stopped", "stage": "material_learning", "fraction": 0.74},
        finished("good"),
    ]
    (folder / "lost").mkdir()
    (folder / "lost" / "log.txt").write_text("so it was", encoding="utf-8")
    page = index_of(write_batch(folder, objects))
    assert "1 done 1 failed 4 not finished" in page.text
    assert "Learning shape and light (1 min 34 s left)" in page.text and "31 %" in page.text
    assert "new running 0 % Starting" in page.text
    assert "2 photos are too few What to do: Take more." in page.text and "lost/log.txt" in page.links
    assert "Learning the materials · Start blender-nep batch again to go on." in page.text
    assert [bar["value"] for bar in page.all("progress")] == ["0.310", "0.000", "0.740"]
    groups = {card["data-name"]: card["data-group"] for card in page.all("article")}
    assert groups == {"good": "done", "lost": "failed", "wait": "left", "run": "left", "new": "left", "halt": "left"}
    assert next(iter(groups)) == "good", "pictures come first"
    assert_links_hold(page)


def test_pages_of_somebody_else_are_not_replaced(batch):
    folder, finished = batch
    write_batch(folder, [finished("ball")])
    view, index = folder / "ball" / "view.html", folder / "index.html"
    view.write_text("<p>mine</p>")
    page = index_of(folder)
    assert view.read_text() == "<p>mine</p>" and "ball/view.html" not in page.links
    index.write_text("<p>my site</p>")
    with pytest.raises(UsageError, match=r"index\.html was not written by blender-nep"):
        write_gallery(folder)
    assert index.read_text() == "<p>my site</p>"
    view.unlink()
    index.unlink()
    for _ in range(2):  # those of ours are
        assert "ball/view.html" in index_of(folder).links


def test_an_old_picture_is_not_shown_while_the_job_runs(batch):
    folder, finished = batch
    page = index_of(write_batch(folder, [finished("ball") | {"state": "running", "stage": "capture", "fraction": 0.01}]))
    assert not page.all("img") and not (folder / "ball" / "view.html").exists()


def test_names_and_messages_are_escaped(batch):
    folder, finished = batch
    error = {"name": "x", "values": {}, "code": 1, "message": EVIL, "hint": EVIL}
    warnings = [{"code": "x", "values": {}, "message": EVIL}]
    name = "&lt;b& 'quotes' #%41"
    objects = [{"name": name, "state": "failed", "error": error}, finished("ball") | {"warnings": warnings}]
    objects.append({"name": "run", "state": "running", "stage": EVIL})
    (folder / "ball" / "report.json").write_text(json.dumps({"warnings": [{"message": EVIL + "2"}]}), encoding="utf-8")
    page = index_of(write_batch(folder, objects, preset=EVIL, started=EVIL))
    assert len(page.all("script")) == 1 and not [a for _, a in page.tags if "onerror" in a]
    assert page.text.count(EVIL) == 7 and "2 warnings" in page.text
    assert page.all("article")[1]["data-name"] == name
    view = Page(folder / "ball" / "view.html")
    assert len(view.all("script")) == 2


@pytest.mark.parametrize("kept", [(), ("asset.glb",), ("report.json",), ("asset.glb", "preview.png")])
def test_missing_files_leave_gaps(batch, kept):
    folder, finished = batch
    entry = finished("ball")
    for path in (folder / "ball").iterdir():
        if path.name not in kept:
            path.unlink()
    page = index_of(write_batch(folder, [entry]))
    assert ("No picture" in page.text) == ("preview.png" not in kept)
    assert ("report.json is missing or damaged" in page.text) == ("report.json" not in kept)
    assert ("View in 3D" in page.text) == ("asset.glb" in kept)
    assert_links_hold(page)
    if "asset.glb" in kept:
        view = Page(folder / "ball" / "view.html")
        assert "The recovered light is missing or damaged" in view.text
        assert_links_hold(view)


def test_damaged_files_leave_gaps(batch):
    folder, finished = batch
    entry = finished("ball")
    for name in ("preview.png", "report.json", "environment.exr"):
        (folder / "ball" / name).write_bytes(b"\x89PNG half a file")
    page = index_of(write_batch(folder, [entry]))
    assert "No picture" in page.text and "report.json is missing or damaged" in page.text
    assert "The recovered light is missing or damaged" in Page(folder / "ball" / "view.html").text


def half_a_png(whole: bytes) -> bytes:
    """A PNG file whose pixels are in two chunks, of which the second one is damaged."""
    place = whole.index(b"IDAT")
    size = int.from_bytes(whole[place - 4 : place], "big") // 2
    first = whole[place : place + 4 + size]
    damaged = size.to_bytes(4, "big") + bytes(8) + whole[place + 4 + size :]
    return whole[: place - 4] + size.to_bytes(4, "big") + first + zlib.crc32(first).to_bytes(4, "big") + damaged


@pytest.mark.parametrize(
    ("name", "spoil", "said"),
    [
        ("environment.exr", lambda whole: whole[:400], "The recovered light is missing or damaged"),
        ("preview.png", half_a_png, "No picture"),
        ("report.json", lambda whole: b'{"stages": {"surface": {"faces": "many"}}}', "report.json is missing or damaged"),
    ],
)
def test_files_that_are_damaged_behind_their_header_leave_gaps(batch, name, spoil, said):
    folder, finished = batch
    entry = finished("ball")
    path = folder / "ball" / name
    path.write_bytes(spoil(path.read_bytes()))
    page = index_of(write_batch(folder, [entry]))
    assert said in page.text + Page(folder / "ball" / "view.html").text


def test_comparison_and_turntable(batch):
    folder, finished = batch
    entry = finished("ball")
    (folder / "ball" / "preview.png").rename(folder / "ball" / "comparison.png")
    pictures.Image.fromarray(picture(1024, 128)).save(folder / "ball" / "turntable.png")
    page = index_of(write_batch(folder, [entry]))
    assert [(image["width"], image["height"]) for image in page.all("img")] == [("480", "240"), ("768", "96")]
    assert "ball/comparison.png" in page.links


def test_the_page_of_200_objects_is_small(batch):
    folder, finished = batch
    entries = [finished(f"ball {number}") for number in range(4)]
    sizes = []
    for count in (1, 4):
        write_gallery(write_batch(folder, entries[:count]))
        sizes.append((folder / "index.html").stat().st_size)
    assert (sizes[1] - sizes[0]) / 3 < 60_000


def test_a_page_is_made_again_only_when_its_files_have_changed(batch):
    folder, finished = batch
    write_batch(folder, [finished("ball")])
    write_gallery(folder)
    view = folder / "ball" / "view.html"
    first = view.stat().st_mtime_ns, view.stat().st_ino
    write_gallery(folder)
    assert (view.stat().st_mtime_ns, view.stat().st_ino) == first
    write_exr(folder / "ball" / "environment.exr", 2 * spotted_light(32))
    write_gallery(folder)
    assert (view.stat().st_mtime_ns, view.stat().st_ino) != first


def test_the_old_page_stays_if_the_new_one_cannot_be_written(batch, monkeypatch):
    folder, finished = batch
    write_batch(folder, [])
    write_gallery(folder)
    before = (folder / "index.html").read_bytes()
    write_batch(folder, [finished("ball")])

    def full(_file):
        raise OSError(errno.ENOSPC, "No space left on device")

    monkeypatch.setattr(os, "fsync", full)
    with pytest.raises(OutputError) as caught:
        write_gallery(folder)
    assert caught.value.name == "output.disk_full"
    assert (folder / "index.html").read_bytes() == before and not list(folder.rglob("*.tmp"))


@pytest.mark.parametrize(
    ("content", "name"),
    [
        (None, "usage.no_batch"),
        ("{", "usage.batch_damaged"),
        ("[]", "usage.batch_damaged"),
        ('{"format": 2}', "usage.batch_format"),
        ('{"format": 1, "preset": "", "started": "", "updated": "", "objects": [{}]}', "usage.batch_damaged"),
    ],
)
def test_a_folder_without_a_good_batch(tmp_path, capsys, content, name):
    if content is not None:
        (tmp_path / "batch.json").write_text(content, encoding="utf-8")
    with pytest.raises(UsageError) as caught:
        write_gallery(tmp_path)
    assert caught.value.name == name and caught.value.hint
    assert main(["gallery", str(tmp_path)]) == 2
    said = capsys.readouterr().err
    assert said.startswith("error: ") and caught.value.hint in said
    assert not (tmp_path / "index.html").exists()


@pytest.mark.parametrize("name", ["", ".", "..", "../elsewhere", "a/b", "a\\b", "\0", 3])
def test_a_name_cannot_lead_out_of_the_folder(tmp_path, name):
    with pytest.raises(UsageError):
        write_gallery(write_batch(tmp_path / "batch", [{"name": name}]))


def test_the_command_writes_the_pages(batch, capsys):
    folder, finished = batch
    write_batch(folder, [finished("ball")])
    assert main(["gallery", str(folder)]) == 0
    assert capsys.readouterr().out.strip() == str(folder / "index.html")
    assert (folder / "index.html").is_file() and (folder / "ball" / "view.html").is_file()


def test_the_light_of_the_viewer_is_exact(tmp_path):
    light = np.random.default_rng(0).uniform(0, 1, (32, 64, 3)) * 10.0 ** np.random.default_rng(1).uniform(
        -2, 3, (32, 64, 1)
    )
    write_exr(tmp_path / "light.exr", light)
    found = pictures.viewer_light(tmp_path / "light.exr")
    packed = pictures.base64.b64decode(found.uri.partition(",")[2].partition("#")[0])
    assert packed.startswith(b"#?RADIANCE") and found.uri.endswith("#.hdr")
    largest = light.max(-1, keepdims=True)
    assert (abs(imagecodecs.rgbe_decode(packed) - light) <= largest / 100).all(), "RGBE has 8 bits a channel"
    # the mean over the sphere of a light of 2 everywhere is 2, so a white ball has radiance 2
    write_exr(tmp_path / "even.exr", np.full((16, 32, 3), 2.0))
    assert pictures.viewer_light(tmp_path / "even.exr").exposure == pytest.approx(0.4)


def test_all_stages_have_the_words_of_the_sidebar():
    assert set(pages.STAGE_WORDS) == {*StageName, CAMERA_SEARCH}
    assert pages.STAGE_WORDS == {stage: words for stage, words in progress.STAGES.items() if stage != BATCH}


@pytest.mark.parametrize(
    ("seconds", "words"), [(0.4, "0 s"), (59.6, "1 min 0 s"), (312.5, "5 min 12 s"), (7500, "2 h 5 min")]
)
def test_times_in_words(seconds, words):
    assert pages.duration(seconds) == words
