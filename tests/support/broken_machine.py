"""What goes wrong around sound photos of the printed room: output folders, disks, and pycolmap's process."""

from __future__ import annotations

import os
import shutil
from pathlib import Path
from types import SimpleNamespace

from PIL import Image

from support.broken_photos import Shoot

# where the cameras are written


def cameras_there(shoot: Shoot) -> None:
    (shoot.folder / "transforms.json").write_text("mine")


def out_among_the_photos(shoot: Shoot) -> None:
    shoot.out = shoot.folder / "cameras" / "new"


def out_is_a_file(shoot: Shoot) -> None:
    shoot.out = shoot.spare / "file"
    shoot.out.write_text("mine")


def out_below_a_file(shoot: Shoot) -> None:
    (shoot.spare / "file").write_text("mine")
    shoot.out = shoot.spare / "file" / "capture"


def read_only(shoot: Shoot) -> None:
    """Root may write everywhere, so the operating system's refusal is played."""
    real = os.open

    def refusing(path: object, flags: int, *rest: object, **more: object) -> int:
        if flags & (os.O_WRONLY | os.O_RDWR) and Path(os.fsdecode(path)).is_relative_to(shoot.folder):
            raise PermissionError(13, "Permission denied", path)
        return real(path, flags, *rest, **more)

    shoot.patch.setattr(os, "open", refusing)


def disk_full_at_the_end(shoot: Shoot) -> None:
    """The capture's own disk, when transforms.json is written."""

    def full(_: int) -> None:
        raise OSError(28, "No space left on device")

    shoot.patch.setattr(os, "fsync", full)


# the machine


REAL = """
import os, sys
sys.path.remove(os.path.dirname(__file__))
del sys.modules["pycolmap"]
import pycolmap
"""
"""Makes a fake the real pycolmap, of which the next lines change something"""


def no_pycolmap(shoot: Shoot) -> None:
    shoot.fake_pycolmap("raise ModuleNotFoundError(\"No module named 'pycolmap'\", name='pycolmap')")


def crash(shoot: Shoot) -> None:
    shoot.fake_pycolmap("import os, signal\nos.kill(os.getpid(), signal.SIGSEGV)")


def killed_by_the_system(shoot: Shoot) -> None:
    """As Linux does to a process where memory is short."""
    shoot.fake_pycolmap("import os, signal\nos.kill(os.getpid(), signal.SIGKILL)")


def disk_full_while_matching(shoot: Shoot) -> None:
    shoot.fake_pycolmap(
        REAL
        + """
def match(*_):
    raise RuntimeError("[database_sqlite.cc:2376] SQLite error: database or disk is full")
pycolmap.match_image_pairs = match
"""
    )


def no_space_for_a_log(shoot: Shoot) -> None:
    """pycolmap says nothing and ends by SIGABRT, as on a disk that is so full that not even its log can be written."""
    shoot.fake_pycolmap("import os, signal\nos.kill(os.getpid(), signal.SIGABRT)")
    shoot.patch.setattr(shutil, "disk_usage", lambda _: SimpleNamespace(total=10**9, used=10**9, free=0))


def disk_full_before(shoot: Shoot) -> None:
    def full(*_: object, **__: object) -> None:
        raise OSError(28, "No space left on device")

    shoot.patch.setattr(Image.Image, "save", full)


def talking_pycolmap(shoot: Shoot) -> None:
    """It writes to standard output, where the process says how far it is."""
    shoot.fake_pycolmap(REAL + "\nprint('==== Bundle adjustment ====')\nprint('{}')\nprint(3)")


def stop_while_matching(shoot: Shoot) -> None:
    shoot.stop_at = "cameras.matches"
