"""Modules of a stranger in the current folder: each leaves a file when a Python imports it."""

from __future__ import annotations

from pathlib import Path

NAMES = ("json", "numpy", "torch", "tqdm")


def set_traps(folder: Path, *more: str) -> Path:
    """Write the modules, and those named `more`, into the new folder `folder`.

    Returns the file to which they write their names.
    """
    folder.mkdir()
    sprung = folder / "sprung.txt"
    for name in (*NAMES, *more):
        (folder / f"{name}.py").write_text(
            f"with open({str(sprung)!r}, 'a') as file:\n    file.write('{name}\\n')\nraise ImportError('a trap')\n"
        )
    return sprung
