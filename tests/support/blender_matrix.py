"""Tests the extension in every version of Blender that it supports: `make test-blender`, or with chosen versions:

    python tests/support/blender_matrix.py [4.2 4.5 5.0 5.2]

Each version is a bpy wheel in its own environment, .venv-blender/VERSION (1 GB each, made once). The engine runs in the
Python that runs this file. It makes an asset of the bundled capture, and makes it again only if that asset is of another
preset or version. All versions use it.
"""

import os
import shutil
import subprocess
import sys
import tempfile
from pathlib import Path

sys.path.insert(0, str(Path(__file__).resolve().parents[1]))  # for support
sys.path.insert(0, str(Path(__file__).resolve().parents[2]))  # for release

from blender_nep.errors import UsageError
from release.extension import build
from support.extension import session
from support.paths import ROOT

PYTHON_OF = {"4.2": "3.11", "4.5": "3.11", "5.0": "3.11", "5.2": "3.13"}  # the one Python that each wheel is built for
ENVIRONMENTS = ROOT / ".venv-blender"
CAPTURE = ROOT / "data" / "suzanne_small"
ASSET = ROOT / "out" / "blender_matrix"
INSTALL_LIMIT_S, ENGINE_LIMIT_S, SESSION_LIMIT_S = 1800, 1800, 600


def find_python(version: str) -> str:
    """A Python of that version with its venv module, from the path or from pyenv. SystemExit where there is none."""
    pyenv = Path(os.environ.get("PYENV_ROOT", Path.home() / ".pyenv"), "versions")
    candidates = [f"python{version}", *map(str, sorted(pyenv.glob(f"{version}.*/bin/python{version}")))]
    for candidate in candidates:
        if shutil.which(candidate) and not subprocess.run([candidate, "-c", "import venv"], capture_output=True).returncode:
            return candidate
    sys.exit(f"Python {version} was not found: put python{version} on the PATH")


def environment(version: str) -> str:
    """The Python of the environment with that Blender. The environment is made where it is not there yet."""
    python = ENVIRONMENTS / version / "bin" / "python"
    if subprocess.run([python, "-c", "import bpy"], capture_output=True).returncode if python.exists() else True:
        print(f"Blender {version}: installing", flush=True)
        subprocess.run([find_python(PYTHON_OF[version]), "-m", "venv", "--clear", ENVIRONMENTS / version], check=True)
        subprocess.run([python, "-m", "pip", "install", "--quiet", f"bpy=={version}.*"], check=True, timeout=INSTALL_LIMIT_S)
    return str(python)


def main(versions: list[str]) -> int:
    command = [sys.executable, "-m", "blender_nep", "reconstruct", CAPTURE, "--out", ASSET, "--preset", "preview"]
    ended = subprocess.run([*command, "--resume"], timeout=ENGINE_LIMIT_S, cwd=ROOT)
    if ended.returncode == UsageError.code:  # the asset there is of another preset or version
        ended = subprocess.run([*command, "--overwrite"], timeout=ENGINE_LIMIT_S, cwd=ROOT)
    ended.check_returncode()
    failed = []
    for version in versions:
        python = environment(version)
        with tempfile.TemporaryDirectory() as folder:
            archive = build(Path(folder) / "blender_nep.zip")
            try:
                ended = session(python, sys.executable, archive, CAPTURE, ASSET, Path(folder) / "session", SESSION_LIMIT_S)
                told, code = ended.stdout, ended.returncode
            except subprocess.TimeoutExpired as error:
                told, code = (error.stdout or b"").decode(errors="replace"), f"none after {SESSION_LIMIT_S} s"
        print(f"Blender {version}: " + ("passed" if code == 0 else f"FAILED, exit code {code}\n{told[-4000:]}"), flush=True)
        failed += [version] if code != 0 else []
    return 1 if failed else 0


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:] or list(PYTHON_OF)))
