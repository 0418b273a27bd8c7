"""Functions of a test file in a process of their own: no state of Blender leaks, and a hang has a limit."""

import os
import subprocess
import sys

from support.paths import ROOT, TESTS


def run_file(file: str, *arguments: object, timeout: float, **variables: str) -> subprocess.CompletedProcess:
    """Run a test file as a script, with `variables` in its environment."""
    path = os.pathsep.join(map(str, (ROOT, TESTS)))
    return subprocess.run(
        [sys.executable, file, *map(str, arguments)],
        capture_output=True,
        text=True,
        timeout=timeout,
        env=os.environ | {"PYTHONPATH": path} | variables,
    )
