"""The extension's zip, built as its manifest says, and a process that uses it in a Blender of its own."""

import fnmatch
import os
import subprocess
import tomllib
import zipfile
from collections.abc import Iterator
from pathlib import Path

ROOT = Path(__file__).resolve().parents[2]


def build(archive: Path) -> Path:
    """Zip this checkout but for what the manifest leaves out."""
    excluded = tomllib.loads((ROOT / "blender_manifest.toml").read_text())["build"]["paths_exclude_pattern"]
    with zipfile.ZipFile(archive, "w") as packed:
        for file in sorted(_files(excluded)):
            packed.write(file, file.relative_to(ROOT))
    return archive


def _files(excluded: list[str]) -> Iterator[Path]:
    """The files of this checkout that are packed. Folders that are left out, as .venv, are not looked into."""
    for folder, folders, files in os.walk(ROOT):
        at = Path(folder)
        folders[:] = [name for name in folders if not _left_out(at / name, excluded, is_folder=True)]
        yield from (at / name for name in files if not _left_out(at / name, excluded, is_folder=False))


def _left_out(path: Path, patterns: list[str], is_folder: bool) -> bool:
    """The rules of .gitignore, as far as the manifest uses them. The folders above `path` are not left out."""
    for pattern in patterns:
        elsewhere = pattern.startswith("/") and path.parent != ROOT
        if elsewhere or (pattern.endswith("/") and not is_folder):
            continue
        if fnmatch.fnmatch(path.name, pattern.strip("/")):
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
