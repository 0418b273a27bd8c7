"""Runs functions of a test file in a separate process, so that no state of Blender leaks and a hang has a limit."""

import inspect
import os
import subprocess
import sys
from collections.abc import Callable

from support.paths import ROOT, TESTS

LIMIT_S = 120


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


def in_blender(function: Callable[..., None], *arguments: object, limit_s: float = LIMIT_S) -> str:
    """Call a function of a test file, with strings for arguments, in a process that may import bpy; what it printed.

    An error that Blender only prints, as that of a handler or a timer, fails the test, too.
    The file ends with: if __name__ == "__main__": globals()[sys.argv[1]](*sys.argv[2:]). Without that end nothing would be
    called, and the test could not fail.
    """
    assert 'if __name__ == "__main__":' in inspect.getsource(inspect.getmodule(function)), (
        "the file does not call its functions"
    )
    done = run_file(inspect.getfile(function), function.__name__, *arguments, timeout=limit_s)
    assert done.returncode == 0, done.stdout[-2000:] + done.stderr[-4000:]
    assert "Traceback" not in done.stderr, done.stderr
    return done.stdout + done.stderr
