"""How this package starts another Python: so that nothing in the user's current folder is run.

The current folder may hold files of strangers, such as a capture or a shelf. `python -m` imports modules from there, and
libraries look there for their settings.
"""

from __future__ import annotations

import site
import sys
from pathlib import Path

NEUTRAL_FOLDER = Path(sys.prefix).anchor
"""The current folder of every program that is started: the top of the disk that this Python is on. It is always there, and
only an administrator puts files there."""


def isolated_python() -> tuple[str, ...]:
    """The command that starts this Python; a program and its arguments follow.

    It imports nothing from the current folder or the program's folder, and reads no PYTHON* variables. -I also leaves out
    the packages that a user has installed for that user alone (`pip install --user`). A Python that has found such packages
    finds them again: the user has put them there, and no stranger.
    """
    with_user_packages = site.getusersitepackages() in sys.path
    return sys.executable, *(("-E", "-P") if with_user_packages else ("-I",))
