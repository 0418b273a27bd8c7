"""`make extension`: what is in the zip, that Blender accepts it, and what is said where it does not."""

import re
import subprocess
import sys
import tomllib
import zipfile

import pytest

from release import extension
from support.paths import ROOT

NEEDED = {
    "blender_manifest.toml",
    "__init__.py",
    "addon/__init__.py",
    "backend/run.py",
    "backend/render_comparison.py",
    "blender_nep/__main__.py",
    "blender_nep/gallery/templates/index.html",
    "blender_nep/gallery/vendor/LICENSES.txt",
    "LICENSE",
    "README.md",
    "THIRD_PARTY.md",
    "constraints.txt",
    "pyproject.toml",
}
"""What Blender, `Install Engine` and the licenses ask for"""
FOLDERS = {"addon", "backend", "blender_nep"}


@pytest.fixture(scope="module")
def archive(tmp_path_factory):
    return extension.build(tmp_path_factory.mktemp("extension") / "blender_nep.zip")


def test_zip_has_what_is_needed_and_no_more(archive):
    with zipfile.ZipFile(archive) as packed:
        names = set(packed.namelist())
        assert packed.read("README.md") == (ROOT / "README.md").read_bytes()
    tracked = subprocess.run(["git", "ls-files", *FOLDERS], cwd=ROOT, capture_output=True, text=True, check=False)
    assert names >= NEEDED | set(tracked.stdout.split())
    assert {name.partition("/")[0] for name in names if "/" in name} == FOLDERS
    assert not [name for name in names if "__pycache__" in name or name.startswith(".") or name.endswith(".pyc")]


def test_same_files_give_the_same_bytes(archive, tmp_path):
    assert extension.build(tmp_path / "again.zip").read_bytes() == archive.read_bytes()


def test_make_extension_names_it_by_its_version(tmp_path):
    done = run(tmp_path / "dist")
    version = tomllib.loads((ROOT / "blender_manifest.toml").read_text())["version"]
    assert done.returncode == 0, done.stderr
    assert [path.name for path in (tmp_path / "dist").iterdir()] == [f"blender_nep-{version}.zip"]
    assert "Install from Disk" in done.stdout and "Blender has checked it" in done.stdout
    assert re.search(r"^extension:.*\n\t.* release/extension\.py$", (ROOT / "Makefile").read_text(), re.MULTILINE)


def test_a_folder_that_is_a_file_is_one_message(tmp_path):
    (tmp_path / "dist").touch()
    done = run(tmp_path / "dist")
    assert done.returncode == 1 and done.stderr.startswith("error: ") and "Choose another --out" in done.stderr


def test_what_blender_refuses_takes_no_zips_place(archive, tmp_path, monkeypatch, capsys):
    def spoilt(path):
        with zipfile.ZipFile(archive) as good, zipfile.ZipFile(path, "w") as bad:
            for name in good.namelist():
                bad.writestr(name, good.read(name).replace(b'schema_version = "1.0.0"', b'schema_version = "x"'))
        return path

    assert extension.main(["--out", str(tmp_path)]) == 0
    before = {path.name: path.read_bytes() for path in tmp_path.iterdir()}
    monkeypatch.setattr(extension, "build", spoilt)
    assert extension.main(["--out", str(tmp_path)]) == 1
    assert "schema_version" in capsys.readouterr().err
    assert {path.name: path.read_bytes() for path in tmp_path.iterdir()} == before


def test_without_a_blender_it_is_said(tmp_path, monkeypatch, capsys):
    monkeypatch.setattr(extension.shutil, "which", lambda name: None)
    monkeypatch.setattr(extension.importlib.util, "find_spec", lambda name: None)
    assert extension.main(["--out", str(tmp_path)]) == 0
    assert "No Blender was found" in capsys.readouterr().out


def run(out) -> subprocess.CompletedProcess:
    """The program itself, with nothing but the standard library but for Blender's own check."""
    command = [sys.executable, ROOT / "release" / "extension.py", "--out", out]
    return subprocess.run(command, capture_output=True, text=True, timeout=120)
