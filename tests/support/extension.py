"""The extension's zip, built as its manifest says, and a process that uses it in a Blender of its own."""

import fnmatch
import os
import subprocess
import tomllib
import zipfile
from pathlib import Path

ROOT = Path(__file__).resolve().parents[2]


def build(archive: Path) -> Path:
    """Zip this checkout but for what the manifest leaves out."""
    excluded = tomllib.loads((ROOT / "blender_manifest.toml").read_text())["build"]["paths_exclude_pattern"]
    with zipfile.ZipFile(archive, "w") as packed:
        for file in sorted(path for path in ROOT.rglob("*") if path.is_file() and not _left_out(path, excluded)):
            packed.write(file, file.relative_to(ROOT))
    return archive


def _left_out(path: Path, patterns: list[str]) -> bool:
    """The rules of .gitignore, as far as the manifest uses them."""
    parts = path.relative_to(ROOT).parts
    for pattern in patterns:
        names = parts[:1] if pattern.startswith("/") else parts
        if pattern.endswith("/"):
            names = names[:-1] if len(names) == len(parts) else names
        if any(fnmatch.fnmatch(name, pattern.strip("/")) for name in names):
            return True
    return False


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
