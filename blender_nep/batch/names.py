"""Names of objects: the names of their captures' folders, made safe for file systems, and unique."""

from __future__ import annotations

import re
from collections.abc import Iterable
from pathlib import Path

_LONGEST = 80
_TAKEN = {"gallery", "log", "con", "prn", "aux", "nul", *(f"{port}{n}" for port in ("com", "lpt") for n in range(1, 10))}
"""Names that mean something else: the gallery's own folder, and the devices of Windows"""


def object_name(capture: Path, taken: Iterable[str]) -> str:
    """A name for the object of `capture` that is none of `taken`: `vase`, or else `vase-2`, `vase-3` and so on.

    Names that differ only in capitals count as equal, because they are on some file systems.
    """
    used = {name.lower() for name in taken}
    base = re.sub(r"[^\w.-]+", "_", capture.name)[:_LONGEST].strip("._-") or "object"
    if Path(base).stem.lower() in _TAKEN:
        base = f"object_{base}"
    name, number = base, 1
    while name.lower() in used:
        number += 1
        name = f"{base}-{number}"
    return name
