"""Keeps the .blend file that is about to be replaced: somebody may have worked in it."""

import os
from pathlib import Path


def put_in_place(partial: Path, path: Path) -> None:
    """Rename the finished .blend file `partial` to `path`. A file that was there becomes .blend1, as with Blender itself.

    A link that was there is replaced, and what it names stays.
    """
    if path.is_file() and not path.is_symlink():
        os.replace(path, path.with_name(path.name + "1"))
    os.replace(partial, path)
