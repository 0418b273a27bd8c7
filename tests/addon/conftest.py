"""The fixture of the tests that use the add-on without installing it."""

import pytest

from support.paths import ROOT


@pytest.fixture
def package(tmp_path, monkeypatch):
    """A folder with the extension as the importable package `nep_addon`; Blender's user files go there too."""
    (tmp_path / "package").mkdir()
    (tmp_path / "package" / "nep_addon").symlink_to(ROOT)
    monkeypatch.setenv("BLENDER_USER_RESOURCES", str(tmp_path))
    return tmp_path
