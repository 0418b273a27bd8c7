"""Writes Python scripts as executables. They stand for a Python, or for the engine."""

import stat
import sys
from pathlib import Path

HEAD = """#!/bin/sh
'''exec' "{python}" "$0" "$@"
' '''
"""
"""The first lines of pip's scripts. To sh, they start Python with this file; to Python, they are a string.

The line `#!/path/to/python` would do, but not where the path has a space or is longer than 127 characters.
"""


def write_executable(path: Path, script: str, python: str = sys.executable) -> str:
    """Write a script that `python` runs; returns its path."""
    path.write_text(HEAD.format(python=python) + script)
    path.chmod(path.stat().st_mode | stat.S_IXUSR)
    return str(path)
