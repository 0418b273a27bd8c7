"""A Python that the user or the package starts runs nothing from the current folder, which may hold files of strangers."""

from __future__ import annotations

import os
import site
import subprocess
import sys

import pytest

from blender_nep.safety.isolated_python import NEUTRAL_FOLDER, isolated_python
from support.traps import set_traps

LIMIT_S = 120


@pytest.mark.parametrize("own", [(), ("-I",)], ids=["plain", "isolated"])
def test_python_m_leaves_the_current_folder_out(own, make_capture, tmp_path):
    sprung = set_traps(tmp_path / "stranger")
    command = [sys.executable, *own, "-m", "blender_nep", "info", make_capture().folder]
    ended = subprocess.run(command, cwd=sprung.parent, capture_output=True, text=True, timeout=LIMIT_S)
    assert ended.returncode == 0 and "6 photos" in ended.stdout, ended.stderr
    assert not sprung.exists()


def test_the_neutral_folder_is_the_top_of_a_disk():
    assert os.path.isabs(NEUTRAL_FOLDER) and os.path.dirname(NEUTRAL_FOLDER) == NEUTRAL_FOLDER


@pytest.mark.parametrize("with_user_packages", [False, True])
def test_packages_of_the_user_alone_are_found_again(with_user_packages, tmp_path, monkeypatch):
    """Neither way, the current folder or PYTHONPATH say what is imported."""
    sprung = set_traps(tmp_path / "stranger")
    monkeypatch.setattr(site, "getusersitepackages", lambda: str(tmp_path / "user"))
    monkeypatch.setattr(sys, "path", [*sys.path, str(tmp_path / "user")] if with_user_packages else sys.path)
    script = "import sys, tqdm; print(sys.flags.safe_path, sys.flags.ignore_environment, sys.flags.no_user_site)"
    ended = subprocess.run(
        [*isolated_python(), "-c", script],
        cwd=sprung.parent,
        env=os.environ | {"PYTHONPATH": str(sprung.parent)},
        capture_output=True,
        text=True,
        timeout=LIMIT_S,
    )
    assert ended.stdout.split() == ["True", "1", "0" if with_user_packages else "1"], ended.stderr
    assert not sprung.exists()


def test_numba_takes_no_settings_from_the_current_folder(tmp_path):
    """They may name a folder of compiled kernels. PyYAML, without which Numba reads none, is played here."""
    (tmp_path / ".numba_config.yaml").write_text("cache_dir: kernels")
    code = (
        "import sys, types; yaml = sys.modules['yaml'] = types.ModuleType('yaml')\n"
        "yaml.safe_load = lambda _: {'cache_dir': 'kernels'}\n"
        "import %s; import numba; print(repr(numba.config.CACHE_DIR))"
    )

    def cache_with(first: str) -> str:
        command = [sys.executable, "-I", "-c", code % first]
        return subprocess.run(command, cwd=tmp_path, capture_output=True, text=True, check=True).stdout.strip()

    assert "kernels" in cache_with("numba"), "Numba reads the file"
    assert "kernels" not in cache_with("blender_nep.ops.compilation")
