"""Names of objects: the names of their captures' folders, made safe for file systems, and unique."""

from __future__ import annotations

import re
from pathlib import Path

from blender_nep.safety.folder_names import is_folder_name

_LONGEST, _LONGEST_BYTES = 80, 180
"""Of the part that is taken from the capture's name, in letters and in UTF-8"""
_TAKEN = {"gallery", "log"}
"""Names that mean something else in the folder of a batch"""


def object_name(capture: Path, taken: set[str]) -> str:
    """A name for the object of `capture`: `vase`, or if that is taken `vase-2`, `vase-3` and so on. Adds it to `taken`.

    `taken` has names in small letters, because to some file systems names that differ only in capitals are equal.
    """
    base = re.sub(r"[^\w.-]+", "_", capture.name)[:_LONGEST].encode()[:_LONGEST_BYTES].decode(errors="ignore")
    base = base.strip("._-") or "object"
    if Path(base).stem.lower() in _TAKEN or not is_folder_name(base):
        base = f"object_{base}"
    name, number = base, 1
    while name.lower() in taken:
        number += 1
        name = f"{base}-{number}"
    taken.add(name.lower())
    return name
