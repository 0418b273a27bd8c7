"""Asks a Python program which parts of the engine it has, without blocking Blender. No bpy in this file."""

import json
import subprocess
import time

from .command import engine_environment
from .install import NEUTRAL_FOLDER, whole_path

LIMIT_S = 180.0  # the first import of torch from a cold disk is slow

# the modules named here import everything that the engine needs
SCRIPT = """
import importlib, json, platform, sys
found = {"python": platform.python_version(), "missing": []}
for name in ("torch", "blender_nep", "blender_nep.job.runner", "blender_nep.fields.training",
             "blender_nep.materials.training", "blender_nep.surface.extraction", "blender_nep.asset.export"):
    try:
        module = importlib.import_module(name)
        found[name] = str(getattr(module, "__version__", ""))
    except ImportError as error:
        found["missing"].append(error.name or str(error))
if "torch" in found:
    torch = sys.modules["torch"]
    found["cuda"] = torch.version.cuda or ""
    found["gpu"] = torch.cuda.get_device_name(0) if torch.cuda.is_available() else ""
print(json.dumps(found))
"""


class EngineCheck:
    """Asks one Python whether it can run the engine. The answer is there when `poll` returns True.

    `works`: whether this Python can run the engine. `lines`: the answer in words, one line each. `versions`: the versions of
    python, blender_nep and torch that were found.
    """

    def __init__(self, python: str):
        self.python = python
        self.works = False
        self.versions: dict[str, str] = {}
        self.lines: list[str] = []
        self._start = time.monotonic()
        self._process: subprocess.Popen[bytes] | None = None
        try:
            # The answer is one line, which fits into the pipe. So it can be read after the process has ended.
            self._process = subprocess.Popen(
                [whole_path(python), "-I", "-c", SCRIPT],
                cwd=NEUTRAL_FOLDER,
                env=engine_environment(),
                stdin=subprocess.DEVNULL,
                stdout=subprocess.PIPE,
                stderr=subprocess.DEVNULL,
                creationflags=getattr(subprocess, "CREATE_NO_WINDOW", 0),
            )
        except OSError as error:
            self.lines = [f"{python} cannot be started: {error.strerror or error}.", "Choose another Python."]

    def poll(self) -> bool:
        """Return True when the answer is there."""
        if self._process is None:
            return True
        if self._process.poll() is None:
            if time.monotonic() - self._start < LIMIT_S:
                return False
            self.close()
            self.lines = [f"It did not answer within {LIMIT_S:.0f} s.", "If the computer is busy, press Check again later."]
            return True
        code = self._process.returncode
        output, _ = self._process.communicate()
        self._process = None
        try:
            self._read_answer(json.loads(output.splitlines()[-1]))
        except (IndexError, ValueError, KeyError, TypeError):
            self.lines = [f"{self.python} is no Python that can run the engine (it ended with code {code})."]
        return True

    def _read_answer(self, found: dict) -> None:
        missing = sorted({name.partition(".")[0] for name in found["missing"]})
        self.lines = [f"Python {found['python']}"]
        for name, title in (("blender_nep", "blender-nep"), ("torch", "torch")):
            if name in found:
                self.lines.append(f"{title} {found[name]}")
        if "torch" in found:
            self.lines.append(
                f"CUDA on {found['gpu']}"
                if found["gpu"]
                else "CPU (a CUDA build, but no usable graphics card)"
                if found["cuda"]
                else "CPU"
            )
        if missing:
            self.lines.append(f"Missing: {', '.join(missing)}. Install the engine, or choose another Python.")
        self.works = not missing
        self.versions = {name: found[name] for name in ("python", "blender_nep", "torch") if name in found}

    def close(self) -> None:
        """Stop waiting for the answer, and kill the process that would give it."""
        if self._process is not None:
            self._process.kill()
            self._process.communicate()
            self._process = None
