"""Names of objects: the names of their captures' folders, made safe for file systems, and unique."""

from __future__ import annotations

import re
from pathlib import Path

_LONGEST = 80
_TAKEN = {"gallery", "log", "con", "prn", "aux", "nul", *(f"{port}{n}" for port in ("com", "lpt") for n in range(1, 10))}
"""Names that mean something else: the gallery's own folder, and the devices of Windows"""


def object_name(capture: Path, taken: set[str]) -> str:
    """A name for the object of `capture`: `vase`, or if that is taken `vase-2`, `vase-3` and so on. Adds it to `taken`.

    `taken` has names in small letters, because to some file systems names that differ only in capitals are equal.
    """
    base = re.sub(r"[^\w.-]+", "_", capture.name)[:_LONGEST].strip("._-") or "object"
    if Path(base).stem.lower() in _TAKEN:
        base = f"object_{base}"
    name, number = base, 1
    while name.lower() in taken:
        number += 1
        name = f"{base}-{number}"
    taken.add(name.lower())
    return name
