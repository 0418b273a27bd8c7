"""The extension: its manifest keeps Blender's rules, and it installs, works and goes away again."""

import importlib
import os
import re
import subprocess
import sys
import tomllib
from pathlib import Path

import numpy as np

from release.extension import build
from support.blender_checks import drawn_by, fails, rounds
from support.executable import write_executable
from support.own_process import run_file
from support.paths import ROOT
from support.played_python import played_python

LIMIT_S = 120
NEEDED = {"schema_version", "id", "name", "tagline", "version", "type", "maintainer", "license", "blender_version_min"}
ADDON_TAGS = {"3D View", "Bake", "Import-Export", "Material", "Render"}  # those of Blender's list that could apply here
PERMISSIONS = {"files", "network", "clipboard", "camera", "microphone"}
FAKE_ENGINE = """
import json, os, pathlib, shutil, sys
if sys.argv[2] == "-c":
    sys.exit(0)
out = pathlib.Path(sys.argv[sys.argv.index("--out") + 1])
print(json.dumps({"event": "progress", "stage": "surface", "step": 1, "steps": 1, "fraction": 1.0}), flush=True)
if "missing" in sys.argv[5]:
    print(json.dumps({"event": "error", "code": 3, "message": "there is no capture", "hint": "Look."}), flush=True)
    sys.exit(3)
(out / "textures").mkdir(parents=True)
(out / "mesh.obj").write_text("v 0 0 1\\nv 1 0 1\\nv 0 1 2\\nvt 0 0\\nvt 1 0\\nvt 0 1\\nf 1/1 2/2 3/3\\n")
for name in ("albedo", "roughness", "metallic", "confidence"):
    shutil.copy(os.environ["FAKE_IMAGE"], out / "textures" / (name + ".png"))
shutil.copy(os.environ["FAKE_IMAGE"], out / "environment.exr")
print(json.dumps({"event": "done", "asset": str(out)}), flush=True)
"""


def manifest() -> dict:
    return tomllib.loads((ROOT / "blender_manifest.toml").read_text())


def test_manifest_keeps_blenders_rules():
    found = manifest()
    assert NEEDED <= set(found) and found["schema_version"] == "1.0.0" and found["type"] == "add-on"
    assert found["id"] == "blender_nep" and found["blender_version_min"] == "4.2.0"
    assert found["license"] == ["SPDX:GPL-3.0-or-later"]
    assert re.fullmatch(r"\d+\.\d+\.\d+", found["version"])
    assert set(found["tags"]) <= ADDON_TAGS
    assert set(found["permissions"]) == {"files", "network"} <= PERMISSIONS
    for text in (found["tagline"], *found["permissions"].values()):
        assert 0 < len(text) <= 64 and not text.endswith(".")


def test_version_is_the_librarys():
    library = (ROOT / "blender_nep" / "__init__.py").read_text()
    assert re.search(r'__version__ = "(.+?)"', library)[1] == manifest()["version"]


def test_nothing_of_blender_is_imported_by_the_root_module():
    done = subprocess.run(
        [sys.executable, "-c", "import runpy, sys; runpy.run_path('__init__.py'); sys.exit('bpy' in sys.modules)"],
        cwd=ROOT,
        timeout=LIMIT_S,
    )
    assert done.returncode == 0


def test_backend_and_addon_import_no_engine():
    allowed = {*sys.stdlib_module_names, "bpy", "blf", "bmesh", "mathutils", "numpy", "backend", "_cycles"}
    for path in [*(ROOT / "backend").rglob("*.py"), *(ROOT / "addon").rglob("*.py"), ROOT / "__init__.py"]:
        for module in re.findall(r"^\s*(?:from|import)\s+([A-Za-z_]\w*)", path.read_text(), re.MULTILINE):
            assert module in allowed, path


def test_extension_installs_reconstructs_and_goes(tmp_path):
    archive = build(tmp_path / "blender_nep.zip")
    fake = write_executable(tmp_path / "fake-python", FAKE_ENGINE)
    played_python(tmp_path)
    user = tmp_path / "user"
    user.mkdir()
    variables = {
        "BLENDER_USER_RESOURCES": str(user),
        "FAKE_IMAGE": str(tmp_path / "image.exr"),
        "NEP_ENGINE_PYTHON": fake,
    }
    done = run_file(__file__, archive, tmp_path, timeout=LIMIT_S, **variables)
    assert done.returncode == 0, done.stdout[-2000:] + done.stderr[-4000:]


def use_extension(archive: str, folder: str) -> None:
    """In a process of its own, with preferences of its own."""
    import bpy

    bpy.ops.extensions.package_install_files(filepath=archive, repo="user_default", enable_on_install=True)
    name = "bl_ext.user_default.blender_nep"
    assert name in bpy.context.preferences.addons, "installed, but not enabled"
    channels = __import__(f"{name}.backend.synthetic_capture.files.exr_channels", fromlist=["write_channels"])
    channels.write_channels(Path(folder) / "image.exr", {c: np.full((2, 4), 0.5, np.float16) for c in "RGB"})
    for operator in (bpy.ops.nep.reconstruct, bpy.ops.nep.cancel):
        assert operator.get_rna_type().description
    assert not bpy.ops.nep.cancel.poll() and bpy.ops.nep.reconstruct.poll()

    set_engine_up(bpy, __import__(f"{name}.addon", fromlist=["clock"]), Path(folder))
    fails(lambda: bpy.ops.nep.reconstruct(), "Choose a capture folder")
    fails(lambda: bpy.ops.nep.reconstruct(capture="missing", output=folder + "/none"), "there is no capture")
    settings = bpy.context.scene.nep
    (Path(folder) / "transforms.json").touch()  # the played engine does not read the cameras
    settings.capture, settings.output, settings.preset = folder, folder + "/out", "preview"
    assert bpy.ops.nep.reconstruct() == {"FINISHED"}
    item = bpy.data.objects["out"]
    assert len(item.data.polygons) == 1 and item.data.materials[0].node_tree and "out light" in bpy.data.worlds

    bpy.ops.preferences.addon_disable(module=name)
    assert not hasattr(bpy.types.Scene, "nep") and not hasattr(bpy.types, "NEP_PT_reconstruct")
    bpy.ops.preferences.addon_enable(module=name)
    assert hasattr(bpy.types, "NEP_PT_reconstruct")


def set_engine_up(bpy, addon, folder: Path) -> None:
    """Press Install Engine and Check in the preferences, with a Python that plays venv and pip."""
    paths, install = addon.engine_paths, bpy.ops.nep.install_engine
    chosen = paths.addon_preferences(bpy.context)

    def drawn() -> list[str]:
        """What the preferences show."""
        return drawn_by(bpy, addon.preferences.NepPreferences, base_python=chosen.base_python)

    default = paths.engine_folder(bpy.context)
    assert default.name == "blender_nep" and default.is_relative_to(folder / "user"), "the extension's own folder"
    assert not paths.engine_python(bpy.context)
    assert "No engine yet: install it below, or choose a Python that has it" in drawn()
    chosen.base_python, chosen.engine_folder = str(folder / "base-python"), str(folder / "engines")
    bpy.context.preferences.system.use_online_access = False
    assert not install.poll()
    bpy.context.preferences.system.use_online_access = True
    (folder / "mode").write_text("slow")
    assert install() == {"FINISHED"} and not install.poll() and "nep.cancel_install" in drawn()
    rounds(addon, lambda: (folder / "slow").exists())
    assert bpy.ops.nep.cancel_install() == {"FINISHED"} and not bpy.ops.nep.cancel_install.poll()
    rounds(addon, install.poll)
    assert "The installation was cancelled." in drawn() and not paths.engine_python(bpy.context)
    (folder / "mode").write_text("full")
    assert install() == {"FINISHED"}
    rounds(addon, install.poll)
    log = folder / "engines" / "nep-engine.log"
    assert "The disk is full." in drawn() and "No space left on device" in log.read_text(), "the log is kept"
    assert str(log) in "".join(drawn())
    chosen.base_python = ""
    assert "The disk is full." not in drawn(), "another Base Python is chosen"
    chosen.base_python = str(folder / "base-python")
    (folder / "mode").write_text("well")
    chosen.engine_python = "/an/older/python"
    assert install() == {"FINISHED"} and chosen.engine_python == "/an/older/python"
    rounds(addon, install.poll)
    assert not chosen.engine_python and "Engine Python was /an/older/python. It is empty now" in " ".join(drawn())
    installed = paths.engine_python(bpy.context)
    assert Path(installed).is_relative_to(folder / "engines" / "nep-engine")
    assert (folder / "engines" / "nep-engine" / "engine.json").is_file()
    headless = importlib.import_module(f"{paths.EXTENSION_PACKAGE}.backend.headless.configured_python")
    assert headless.configured_python() == installed, "backend/run.py finds the installed engine"
    rounds(addon, bpy.ops.nep.check_engine.poll)
    assert installed in "".join(drawn()), "what was installed is checked"
    chosen.engine_python = "/no/python"
    assert paths.engine_python(bpy.context) == headless.configured_python() == "/no/python"
    engine = os.environ.pop("NEP_ENGINE_PYTHON")  # it would go before the preferences
    assert bpy.ops.nep.check_engine() == {"FINISHED"}
    os.environ["NEP_ENGINE_PYTHON"] = engine
    rounds(addon, bpy.ops.nep.check_engine.poll)
    assert "/no/python cannot be started" in " ".join(drawn())


if __name__ == "__main__":
    use_extension(*sys.argv[1:])
