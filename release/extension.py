"""Builds the extension that Blender installs: `make extension` writes dist/blender_nep-VERSION.zip.

The zip has all files of this checkout, but for those that `paths_exclude_pattern` of blender_manifest.toml leaves out, as
`blender --command extension build` would make it. No Blender is needed: only the standard library is used. If there is one
(the program `blender`, or the bpy wheel of this Python), Blender's own check looks at the zip before the zip gets its name.
"""

import argparse
import fnmatch
import importlib.util
import os
import shutil
import subprocess
import sys
import tempfile
import tomllib
import zipfile
from collections.abc import Iterator
from pathlib import Path
from typing import Any

ROOT = Path(__file__).resolve().parents[1]
_BLENDERS_CHECK = "*/scripts/addons_core/bl_pkg/cli/blender_ext.py"
"""In the bpy wheel: the program behind `blender --command extension`, which needs no bpy itself"""
_CHECK_LIMIT_S = 120.0
_FIRST_DAY = (1980, 1, 1, 0, 0, 0)
"""The time of every file in the zip, so that the same files always give the same zip. It is the earliest that a zip knows"""


class InvalidExtensionError(Exception):
    """Blender refuses the zip, or gives no answer. The message has Blender's own words."""


def build(archive: Path) -> Path:
    """Write the zip to the path `archive`, and return `archive`.

    The same files give the same bytes. Raises OSError where the zip cannot be written.
    """
    excluded = _manifest()["build"]["paths_exclude_pattern"]
    with zipfile.ZipFile(archive, "w") as packed:
        for file in sorted(_files(excluded)):
            entry = zipfile.ZipInfo(file.relative_to(ROOT).as_posix(), _FIRST_DAY)
            entry.external_attr = 0o644 << 16
            packed.writestr(entry, file.read_bytes(), zipfile.ZIP_DEFLATED)
    return archive


def validate(archive: Path) -> str:
    """Let Blender check the zip. Returns what has checked it; empty where there is no Blender, and nothing was checked.

    Raises InvalidExtensionError where Blender refuses the zip, or gives no answer.
    """
    checker = _checker()
    if checker is None:
        return ""
    name, command = checker
    try:
        done = subprocess.run([*command, "validate", str(archive)], capture_output=True, text=True, timeout=_CHECK_LIMIT_S)
    except subprocess.TimeoutExpired as error:
        raise InvalidExtensionError(f"{name} has given no answer in {error.timeout:.0f} s") from error
    if done.returncode != 0:
        raise InvalidExtensionError((done.stdout + done.stderr).strip())
    return name


def _manifest() -> dict[str, Any]:
    return tomllib.loads((ROOT / "blender_manifest.toml").read_text(encoding="utf-8"))


def _checker() -> tuple[str, list[str]] | None:
    """The name and the command of Blender's own check, or None where there is no Blender."""
    program = shutil.which("blender")
    if program is not None:
        return program, [program, "--command", "extension"]
    wheel = importlib.util.find_spec("bpy")  # does not import it
    folders = wheel.submodule_search_locations or [] if wheel is not None else []
    scripts = [script for folder in folders for script in Path(folder).glob(_BLENDERS_CHECK)]
    return ("the bpy wheel", [sys.executable, str(scripts[0])]) if scripts else None


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


def main(arguments: list[str] | None = None) -> int:
    """Build and check the zip. Returns the exit code: 0, or 1 where the zip cannot be written or Blender refuses it."""
    parser = argparse.ArgumentParser(prog="extension.py", description=(__doc__ or "").partition("\n")[0])
    parser.add_argument("--out", type=Path, default=ROOT / "dist", help="folder of the zip (dist)")
    options = parser.parse_args(arguments)
    about = _manifest()
    archive = options.out / f"{about['id']}-{about['version']}.zip"
    try:
        options.out.mkdir(parents=True, exist_ok=True)
        with tempfile.TemporaryDirectory(dir=options.out) as folder:
            unchecked = build(Path(folder) / archive.name)
            checked = validate(unchecked)
            os.replace(unchecked, archive)
    except OSError as error:
        print(f"error: {archive} cannot be written ({error.strerror or error})", file=sys.stderr)
        print("       Choose another --out.", file=sys.stderr)
        return 1
    except InvalidExtensionError as error:
        print(f"error: Blender refuses the zip\n{error}", file=sys.stderr)
        return 1
    checks = f"Blender has checked it ({checked})." if checked else "No Blender was found to check it."
    print(f"{archive} is built. {checks}")
    print("In Blender: Edit > Preferences > Get Extensions > Install from Disk, and choose this file.")
    return 0


if __name__ == "__main__":
    sys.exit(main())
