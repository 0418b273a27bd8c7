"""Executables that stand for a Python: one that only plays venv and pip, and one without any packages."""

import os
import stat
import sys
from pathlib import Path

from support.executable import write_executable

PLAYED = """
import os, pathlib, shutil, sys, time
mode = pathlib.Path({folder!r}, "mode").read_text()
what = sys.argv[2:]
if what[0] == "-c" and "version_info" in what[1]:
    name, *version = mode.split()
    print("version", *version if name in ("old", "new") else (3, 12))
    sys.exit("No module named 'ensurepip'" if mode == "no venv" or name == "new" else 0)
if what[0] == "-c":
    print("versions 2.9.9 0.1.0")
elif what[:2] == ["-m", "venv"]:
    place = pathlib.Path(what[2], *{place!r})
    place.parent.mkdir(parents=True)
    shutil.copy(__file__, place)
elif what == ["-m", "blender_nep.ops.rehearsal"]:
    pathlib.Path({folder!r}, "compiled").touch()
    sys.exit(mode == "no compiler")
elif what[:3] == ["-m", "pip", "install"]:
    with open({folder!r} + "/pip.txt", "a") as told:
        print(*what[3:], file=told)
        print(*sorted(name for name in os.environ if name.startswith("PIP_")), file=told)
    print("Collecting something", flush=True)
    if mode == "slow":
        pathlib.Path({folder!r}, "slow").touch()
        time.sleep(600)
    if mode == "no build" and "torch" in what:
        sys.exit("ERROR: No matching distribution found for torch")
    if mode == "no network":
        print("WARNING: Retrying after connection broken by 'NewConnectionError': /simple/torch/", file=sys.stderr)
        print("ERROR: Could not find a version that satisfies torch (from versions: none)", file=sys.stderr)
        sys.exit("ERROR: No matching distribution found for torch")
    if mode == "full":
        sys.exit("ERROR: Could not install packages due to an OSError: [Errno 28] No space left on device")
    sources = [item for item in what if "nep_source_" in item]
    assert not sources or pathlib.Path(sources[0], "blender_nep", "cli.py").is_file()
"""


def played_python(folder: Path) -> str:
    """Make a Python that only plays venv and pip. The file `mode` beside it says how it behaves. Returns its path."""
    place = ("Scripts", "python.exe") if os.name == "nt" else ("bin", "python")
    (folder / "mode").write_text("well")
    return write_executable(folder / "base-python", PLAYED.format(folder=str(folder), place=place))


def bare_python(folder: Path) -> str:
    """Make a Python that has no installed packages, so that the engine is missing. Returns its path."""
    path = folder / "bare-python"
    path.write_text(f'#!/bin/sh\nexec "{sys.executable}" -S "$@"\n')
    path.chmod(path.stat().st_mode | stat.S_IXUSR)
    return str(path)
