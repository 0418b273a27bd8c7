"""Writes asset catalogs: the file that names the groups in which Blender's Asset Browser shows assets.

The file lies at the top of an asset library. Blender reads UUID:PATH:SIMPLE_NAME lines from it. An asset names its catalog
by the UUID.
"""

import re
import uuid
from dataclasses import dataclass
from pathlib import Path

from ..engine.results.batch_file import BatchFile
from ..scene_io.image_files import write_whole

FILE = "blender_assets.cats.txt"
VERSION = "VERSION 1"
HEADER = f"""\
# This is an Asset Catalog Definition file for Blender.
#
# Empty lines and lines starting with `#` will be ignored.
# The first non-ignored line should be the version indicator.
# Other lines are of the format "UUID:catalog/path/for/assets:simple catalog name"

{VERSION}

"""
NAMESPACE = uuid.UUID("0f9b6a8e-5b0c-4c59-9a53-6f0c2d1d7a41")
"""Of the UUIDs of batches; drawn once"""


@dataclass(frozen=True)
class Catalog:
    """A catalog. `identifier`: its UUID. `path`: its name, or its place in the tree of catalogs."""

    identifier: str
    path: str

    @property
    def line(self) -> str:
        """The line of the file."""
        return f"{self.identifier}:{self.path}:{self.path.replace('/', '-')}"


def catalog_of(batch: BatchFile) -> Catalog:
    """The catalog of a batch's objects: the same one for the same batch, and another one for another batch.

    A batch is known by its folder's name and by the time when it was started first. If the catalog file in its folder
    already has a catalog of this path, it is that one.
    """
    path = re.sub(r"[\s/:\\]+", " ", batch.folder.resolve().name).strip() or "objects"
    for found in _read(batch.folder / FILE):
        if found.path == path:
            return found
    return Catalog(str(uuid.uuid5(NAMESPACE, f"{batch.started} {path}")), path)


def add_catalogs(folder: Path, catalogs: list[Catalog]) -> None:
    """Add catalogs to the catalog file at the top of the asset library `folder`, which keeps all that is in it.

    The file is replaced as a whole, and only if a catalog is new. Raises OSError where it cannot be written, and ValueError
    where its version is not known.
    """
    path = folder / FILE
    text = path.read_text(encoding="utf-8") if path.is_file() else HEADER
    if VERSION not in text.splitlines():
        raise ValueError(f"{path} is of a version that is not known: move it away")
    known = {found.identifier for found in _read(path)}
    new = [catalog.line for catalog in catalogs if catalog.identifier not in known]
    if new:
        write_whole(path, (text.rstrip("\n") + "\n" + "\n" * (text is HEADER) + "\n".join(new) + "\n").encode())


def _read(path: Path) -> list[Catalog]:
    """The catalogs in a file; an empty list where it cannot be read."""
    try:
        lines = path.read_text(encoding="utf-8").splitlines()
    except (OSError, ValueError):
        return []
    parts = [line.split(":") for line in lines if line.count(":") == 2 and not line.startswith("#")]
    return [Catalog(identifier.strip(), place.strip()) for identifier, place, _ in parts]
