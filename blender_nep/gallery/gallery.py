"""Writes the gallery of a batch: index.html, a page for each asset, and the viewer that these pages share."""

from __future__ import annotations

import hashlib
import os
import shutil
import sys
from dataclasses import dataclass
from functools import partial
from pathlib import Path

from blender_nep.errors import UsageError
from blender_nep.files import is_link, output_errors, refuse_links, write_atomically, write_text
from blender_nep.gallery.asset_summary import AssetSummary, read_summary
from blender_nep.gallery.batch_file import Batch, BatchObject, State, read_batch
from blender_nep.gallery.pages import GROUP_WORDS, render, templates_digest
from blender_nep.gallery.pictures import Thumbnail, data_uri, thumbnail, viewer_light
from blender_nep.safety.plain_files import MEGABYTE, open_plain, read_bytes

VENDOR = Path(__file__).with_name("vendor")
"""The viewer script and its licenses (THIRD_PARTY.md)."""
SHARED = "gallery"
"""The folder in the batch's folder that has a copy of them."""
PICTURE_WIDTH = 480
"""Pixels of a card's picture. Browsers show it at most 400 wide."""
STRIP_WIDTH = 768
"""Pixels of a turntable strip of 8 frames."""
INDEX = "index.html"
GENERATOR = b'<meta name="generator" content="blender-nep '
"""In the beginning of each page of ours. No other page is replaced."""
STAMP = b'<meta name="made-from" content="'
"""Before the hash of what an object's page is made from"""
_BEGIN_BYTES = 1500
_MOST_MODEL = 256 * MEGABYTE
"""Of asset.glb. Browsers open no page that is much larger."""
FILES = ("comparison.png", "asset.glb", "report.json", "log.txt")
"""The files that a card links to, where they are there."""


@dataclass(frozen=True)
class Card:
    """What index.html shows of one object."""

    object: BatchObject
    summary: AssetSummary
    warnings: tuple[str, ...]
    picture: Thumbnail | None
    strip: Thumbnail | None
    view: bool
    """The object has a page of its own"""
    files: tuple[str, ...]

    @property
    def group(self) -> str:
        """The part of the page where it stands: `done`, `failed`, or `left` for what is not finished."""
        return str(self.object.state) if self.object.state in (State.DONE, State.FAILED) else "left"


def write_gallery(folder: Path) -> None:
    """Write FOLDER/index.html, a view.html for each finished object, and FOLDER/gallery/.

    `folder` is the folder of a batch. Its state may be any: call this again when it has changed. Pages of objects that have
    not changed stay. Each file is replaced as a whole.

    Raises UsageError if there is no batch, its batch.json is damaged or index.html is not ours, OutputError if the pages
    cannot be written or one is a link. Missing or damaged files of an object leave gaps on its card, and raise nothing, and
    so do links: they may lead to private files, which would be copied into the page. An object whose folder is a link gets
    no page.
    """
    batch = read_batch(folder)
    refuse_links(folder, (SHARED, INDEX))
    index = folder / INDEX
    if os.path.lexists(index) and GENERATOR not in _begin(index):
        hint = "Move that file away."
        raise UsageError(f"{index} was not written by blender-nep", hint, "usage.not_ours", folder=folder, files=INDEX)
    _share_viewer(folder / SHARED)
    cards = [_card(folder, found) for found in batch.objects]
    write_text(index, _index(folder, batch, cards))


def _share_viewer(shared: Path) -> None:
    with output_errors(shared):
        shared.mkdir(exist_ok=True)
        for source in VENDOR.iterdir():
            target = shared / source.name
            if not target.is_file() or target.read_bytes() != source.read_bytes():
                write_atomically(target, partial(shutil.copyfile, source))


def _index(folder: Path, batch: Batch, cards: list[Card]) -> str:
    groups = {group: [card for card in cards if card.group == group] for group in GROUP_WORDS}
    return render(
        "index.html",
        title=folder.resolve().name,
        batch=batch,
        groups=[(group, members) for group, members in groups.items() if members],
        totals={group: len(members) for group, members in groups.items()},
        seconds=sum(found.seconds or 0 for found in batch.objects),
    )


def _card(folder: Path, found: BatchObject) -> Card:
    asset = folder / found.name
    finished = found.state is State.DONE and not is_link(asset)
    summary = (read_summary(asset) if finished and _is_own(asset / "report.json") else None) or AssetSummary()
    warnings = (*found.warnings, *summary.warnings)
    if finished and summary == AssetSummary():
        warnings = (*warnings, "report.json is missing or damaged, so the card shows no figures and no materials")
    return Card(
        object=found,
        summary=summary,
        warnings=tuple(dict.fromkeys(warnings)),
        picture=_picture(asset) if finished else None,
        strip=_thumbnail(asset / "turntable.png", STRIP_WIDTH) if finished else None,
        view=finished and _write_view(asset, found, summary),
        files=tuple(name for name in FILES if not is_link(asset) and _is_own(asset / name)),
    )


def _picture(asset: Path) -> Thumbnail | None:
    return _thumbnail(asset / "preview.png", PICTURE_WIDTH) or _thumbnail(asset / "comparison.png", PICTURE_WIDTH)


def _thumbnail(path: Path, width: int) -> Thumbnail | None:
    return thumbnail(path, width) if _is_own(path) else None


def _is_own(path: Path) -> bool:
    """Whether the path is a file, and no link to one."""
    return path.is_file() and not is_link(path)


def _write_view(asset: Path, found: BatchObject, summary: AssetSummary) -> bool:
    """Write the object's own page, if it has a model. A page that was made from the same files stays."""
    target, made_from = asset / "view.html", _made_from(asset, found)
    begin = _begin(target)
    if not _is_own(asset / "asset.glb") or (os.path.lexists(target) and GENERATOR not in begin):
        return False
    if begin.partition(STAMP)[2][: len(made_from)].decode(errors="replace") == made_from:
        return True
    try:
        model = data_uri(read_bytes(asset / "asset.glb", _MOST_MODEL), "model/gltf-binary")
    except OSError:
        return False
    page = render(
        "view.html",
        made_from=made_from,
        object=found,
        summary=summary,
        shared=f"../{SHARED}",
        model=model,
        light=viewer_light(asset / "environment.exr") if _is_own(asset / "environment.exr") else None,
        preview=_is_own(asset / "preview.png"),
        files=[name for name in FILES if _is_own(asset / name)],
    )
    write_text(target, page)
    return True


def _made_from(asset: Path, found: BatchObject) -> str:
    """A hash of everything that the object's page is made from. Of large files, the time and the size count."""
    parts = [templates_digest(), repr(found)]
    for name in ("preview.png", "environment.exr", *FILES):
        path = asset / name
        state = path.stat() if _is_own(path) else None
        parts.append(f"{name} {(state.st_mtime_ns, state.st_size) if state else None}")
    return hashlib.sha256("\n".join(parts).encode()).hexdigest()


def _begin(page: Path) -> bytes:
    """The first bytes of a page, in which its marks stand; nothing if it cannot be read."""
    try:
        with open_plain(page, sys.maxsize) as file:
            return file.read(_BEGIN_BYTES)
    except OSError:
        return b""
