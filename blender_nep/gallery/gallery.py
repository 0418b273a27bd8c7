"""Writes the gallery of a batch: index.html, a page for each asset, and the viewer that these pages share."""

from __future__ import annotations

import hashlib
import shutil
from dataclasses import dataclass
from functools import partial
from pathlib import Path

from blender_nep.files import output_errors, write_atomically, write_text
from blender_nep.gallery.asset_summary import AssetSummary, read_summary
from blender_nep.gallery.batch_file import Batch, BatchObject, State, read_batch
from blender_nep.gallery.pages import GROUP_WORDS, render, templates_digest
from blender_nep.gallery.pictures import Thumbnail, data_uri, thumbnail, viewer_light

VENDOR = Path(__file__).with_name("vendor")
"""The viewer script and its licenses (THIRD_PARTY.md)."""
SHARED = "gallery"
"""The folder in the batch's folder that has a copy of them."""
PICTURE_WIDTH = 480
"""Pixels of a card's picture. Browsers show it at most 400 wide."""
STRIP_WIDTH = 768
"""Pixels of a turntable strip of 8 frames."""
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

    Raises UsageError if there is no batch or its batch.json is damaged, OutputError if the pages cannot be written. Missing
    or damaged files of an object leave gaps on its card, and raise nothing.
    """
    batch = read_batch(folder)
    _share_viewer(folder / SHARED)
    cards = [_card(folder, found) for found in batch.objects]
    write_text(folder / "index.html", _index(folder, batch, cards))


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
    finished = found.state is State.DONE
    summary = (read_summary(asset) if finished else None) or AssetSummary()
    warnings = (*found.warnings, *summary.warnings)
    if finished and summary == AssetSummary():
        warnings = (*warnings, "report.json is missing or damaged, so the card shows no figures and no materials")
    return Card(
        object=found,
        summary=summary,
        warnings=tuple(dict.fromkeys(warnings)),
        picture=_picture(asset) if finished else None,
        strip=thumbnail(asset / "turntable.png", STRIP_WIDTH) if finished else None,
        view=finished and _write_view(asset, found, summary),
        files=tuple(name for name in FILES if (asset / name).is_file()),
    )


def _picture(asset: Path) -> Thumbnail | None:
    return thumbnail(asset / "preview.png", PICTURE_WIDTH) or thumbnail(asset / "comparison.png", PICTURE_WIDTH)


def _write_view(asset: Path, found: BatchObject, summary: AssetSummary) -> bool:
    """Write the object's own page, if it has a model. A page that was made from the same files stays."""
    if not (asset / "asset.glb").is_file():
        return False
    target, made_from = asset / "view.html", _made_from(asset, found)
    if _stamp(target, len(made_from)) == made_from:
        return True
    try:
        model = data_uri((asset / "asset.glb").read_bytes(), "model/gltf-binary")
    except OSError:
        return False
    page = render(
        "view.html",
        made_from=made_from,
        object=found,
        summary=summary,
        shared=f"../{SHARED}",
        model=model,
        light=viewer_light(asset / "environment.exr"),
        preview=(asset / "preview.png").is_file(),
        files=[name for name in FILES if (asset / name).is_file()],
    )
    write_text(target, page)
    return True


def _made_from(asset: Path, found: BatchObject) -> str:
    """A hash of everything that the object's page is made from. Of large files, the time and the size count."""
    parts = [templates_digest(), repr(found)]
    for name in ("preview.png", "environment.exr", *FILES):
        path = asset / name
        state = path.stat() if path.is_file() else None
        parts.append(f"{name} {(state.st_mtime_ns, state.st_size) if state else None}")
    return hashlib.sha256("\n".join(parts).encode()).hexdigest()


STAMP = b'<meta name="made-from" content="'


def _stamp(page: Path, length: int) -> str:
    """The hash that stands in the first lines of an object's page, or nothing."""
    try:
        with open(page, "rb") as file:
            start = file.read(500)
    except OSError:
        return ""
    return start.partition(STAMP)[2][:length].decode(errors="replace")
