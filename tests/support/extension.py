"""A process that uses the extension's zip in a Blender of its own."""

import os
import subprocess
from pathlib import Path


def session(python: str, engine: str, archive: Path, capture: Path, asset: Path, folder: Path, limit: float):
    """Run blender_session.py with `python` (which has bpy); returns the ended process, output in `stdout`."""
    (folder / "user").mkdir(parents=True)
    (folder / "work").mkdir()
    variables = os.environ | {"BLENDER_USER_RESOURCES": str(folder / "user"), "NEP_ENGINE_PYTHON": engine}
    return subprocess.run(
        [
            python,
            str(Path(__file__).with_name("blender_session.py")),
            *map(str, (archive, capture, asset)),
            str(folder / "work"),
        ],
        env=variables,
        stdout=subprocess.PIPE,
        stderr=subprocess.STDOUT,
        text=True,
        timeout=limit,
    )
