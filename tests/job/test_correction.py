"""`blender-nep materials`: a finished asset is corrected, or refused and left as it is."""

import io
import json
from dataclasses import replace

import numpy as np
import OpenEXR
import pytest
import torch
import trimesh

from blender_nep.cli import main
from blender_nep.job.commands import correction
from blender_nep.job.folders.job_folder import JobFolder
from blender_nep.job.reporting.events import Events
from blender_nep.job.stages import SurfaceResult
from blender_nep.materials.corrections import Correction
from blender_nep.surface.normal_map import LeanMesh
from support.ball_stages import BallSurface, ball_surface
from support.two_materials import KeepingStages, two_materials

SHARE = round(float((ball_surface().normals[:, 2] <= 0).mean()), 4)
"""Share of the points that show the metal of `two_materials`"""
FILES = ("mesh.obj", "asset.glb", "preview.png", "environment.exr", "report.json", "textures/roughness.exr")


@pytest.fixture
def asset(start):
    assert start(KeepingStages())[0] == 0
    return start.out


def contents(asset) -> dict[str, bytes]:
    return {name: (asset / name).read_bytes() for name in FILES}


def correct(asset, corrections):
    protocol = io.StringIO()
    code = correction.run(asset, corrections, Events(protocol, io.StringIO()))
    return code, [json.loads(line) for line in protocol.getvalue().splitlines()]


def report_of(asset) -> dict:
    return json.loads((asset / "report.json").read_text())


def roughness_of(asset) -> np.ndarray:
    return OpenEXR.File(str(asset / "textures/roughness.exr")).channels()["V"].pixels.astype(float)


def test_the_report_of_a_job_lists_the_materials(asset):
    listed = report_of(asset)["materials"]
    assert [entry["metallic"] for entry in listed] == [1, 0] and report_of(asset)["corrections"] == {}
    assert listed[0] == {
        "share": SHARE,
        "albedo": [0.9, 0.7, 0.3],
        "roughness": 0.2,
        "metallic": 1,
        "learned": {"roughness": 0.2, "metallic": 1},
    }


def test_taking_a_correction_back_restores_every_byte(asset):
    before = contents(asset)
    code, events = correct(asset, {1: Correction(metallic=1.0, roughness=0.3)})
    assert code == 0 and events[-1] == {"event": "done", "asset": str(asset)}
    assert [event["fraction"] for event in events if event["event"] == "progress"][-1] == 1
    report = report_of(asset)
    assert report["corrections"] == {"1": {"metallic": 1, "roughness": 0.3}}
    assert report["materials"][1]["metallic"] == 1 and report["materials"][1]["learned"] == {"roughness": 0.5, "metallic": 0}
    values = roughness_of(asset)  # a texel is a mean of several points
    assert 0.28 < values.max() < 0.301, "0.5 is gone"
    assert values.min() < 0.22, "the other material is still there"
    now = contents(asset)
    changed = {name for name in FILES if now[name] != before[name]}
    assert changed == {"asset.glb", "preview.png", "report.json", "textures/roughness.exr"}
    assert correct(asset, {})[0] == 0
    assert contents(asset) == before


def test_a_correction_keeps_a_lean_mesh_and_its_normal_map(start):
    """The textures change; the mesh of few faces and its map stay."""

    class Lean(BallSurface):
        def run(self, given, progress, checkpoint):
            few = LeanMesh(ball_surface(0), np.full((8, 8, 3), (0.75, 0.25, 0.9), np.float32))
            return SurfaceResult(ball_surface(), {"faces": 20}, few)

    stages = KeepingStages()
    stages.surface = Lean(stages)
    assert start(stages)[0] == 0
    kept = ("mesh.obj", "mesh.mtl", "textures/normal.exr", "textures/normal.png")
    before = {name: (start.out / name).read_bytes() for name in kept}
    assert correct(start.out, {1: Correction(roughness=0.3)})[0] == 0
    assert {name: (start.out / name).read_bytes() for name in kept} == before
    shown = next(iter(trimesh.load(start.out / "asset.glb").geometry.values()))
    assert len(shown.faces) == 20 and shown.visual.material.normalTexture is not None


def test_each_correction_begins_with_what_was_learned(asset):
    assert correct(asset, {0: Correction(roughness=0.9)})[0] == 0
    assert correct(asset, {1: Correction(roughness=0.8)})[0] == 0
    assert report_of(asset)["corrections"] == {"1": {"roughness": 0.8}}
    assert report_of(asset)["materials"][0]["roughness"] == 0.2


def without_surface(asset):
    (asset / "checkpoints" / "surface.done.pt").unlink()


def without_checkpoints(asset):
    for file in (asset / "checkpoints").iterdir():
        file.unlink()


def with_damaged_materials(asset):
    (asset / "checkpoints" / "material_learning.done.pt").write_bytes(b"no archive")


def of_another_version(asset):
    report = report_of(asset)
    report["fingerprint"]["format"] -= 1
    (asset / "report.json").write_text(json.dumps(report))


def with_a_damaged_report(asset):
    (asset / "report.json").write_text("{")


@pytest.mark.parametrize(
    ("spoil", "name"),
    [
        (without_surface, "usage.not_correctable"),
        (without_checkpoints, "usage.not_correctable"),
        (with_damaged_materials, "usage.not_correctable"),
        (of_another_version, "usage.asset_of_other_version"),
        (with_a_damaged_report, "usage.no_asset"),
    ],
)
def test_what_cannot_be_corrected_is_refused_and_left_as_it_is(asset, spoil, name):
    spoil(asset)
    before = contents(asset)
    code, events = correct(asset, {0: Correction(roughness=0.9)})
    assert code == 2 and events[-1]["name"] == name and events[-1]["hint"]
    assert contents(asset) == before and not (asset / ".partial").exists()


def test_an_unknown_material_is_refused(asset):
    code, events = correct(asset, {2: Correction(roughness=0.9)})
    assert code == 2 and events[-1]["name"] == "usage.no_such_material"
    assert events[-1]["values"] == {"number": 2, "count": 2}


def test_paint_is_refused_where_its_light_was_not_gathered(start, monkeypatch):
    kept = two_materials()
    light = kept.materials.light
    kept.materials.light = replace(light, diffuse=torch.zeros_like(light.diffuse))  # as after --metal yes
    monkeypatch.setattr("support.two_materials.two_materials", lambda: kept)
    assert start(KeepingStages())[0] == 0
    before = contents(start.out)
    code, events = correct(start.out, {0: Correction(metallic=0.0)})
    assert code == 2 and events[-1]["name"] == "usage.told_to_be_metal" and contents(start.out) == before
    assert correct(start.out, {0: Correction(roughness=0.4)})[0] == 0


def test_an_interrupted_correction_says_what_to_do(asset, monkeypatch):
    def interrupted(*_):
        raise KeyboardInterrupt

    monkeypatch.setattr(correction, "_correct", interrupted)
    code, events = correct(asset, {})
    assert code == 7 and events[-1]["hint"].startswith("Correct it again")


def test_a_folder_without_an_asset_is_refused(tmp_path):
    code, events = correct(tmp_path / "nothing", {})
    assert code == 2 and events[-1]["name"] == "usage.no_asset"
    assert not (tmp_path / "nothing").exists()


def test_an_asset_at_which_a_job_works_is_refused(asset):
    run = JobFolder(asset, followed=True)  # it holds the lock as long as this process lives
    before = contents(asset)
    code, events = correct(asset, {0: Correction(roughness=0.9)})
    assert code == 2 and events[-1]["name"] == "usage.folder_in_use"
    assert "--out" not in events[-1]["hint"] and "correct the materials again" in events[-1]["hint"]
    assert contents(asset) == before and run.path.is_dir()


def test_a_correction_leaves_the_job_folder_free_and_as_it_was(start):
    assert start(KeepingStages())[0] == 0
    (start.out / "job" / "events.jsonl").write_text("as it was")
    assert correct(start.out, {0: Correction(roughness=0.9)})[0] == 0
    assert (start.out / "job" / "events.jsonl").read_text() == "as it was"
    JobFolder(start.out, followed=True)  # raises UsageError if the lock is still held


def test_an_asset_that_was_cleaned_is_refused(start):
    assert start(KeepingStages(), clean=True)[0] == 0
    code, events = correct(start.out, {0: Correction(roughness=0.9)})
    assert code == 2 and events[-1]["name"] == "usage.not_correctable"


def test_an_asset_with_materials_from_the_disk_can_be_corrected(start):
    """A resumed job takes the materials from the disk, with what a correction needs."""
    assert start(KeepingStages())[0] == 0
    (start.out / "report.json").unlink()
    assert start(KeepingStages(), resume=True)[0] == 0
    assert correct(start.out, {0: Correction(roughness=0.9)})[0] == 0


def test_the_command_lists_the_materials(asset, capsys):
    assert main(["materials", str(asset)]) == 0
    lines = capsys.readouterr().out.splitlines()
    assert len(lines) == 3 and lines[1].split() == ["0", f"{SHARE:.1%}", "0.200", "yes", "0.900", "0.700", "0.300"]


@pytest.mark.parametrize(
    "what", ["1", "1:metallic=0.5", "1:roughness=2", "1:roughness=nan", "x:metallic=1", "1:albedo=0", "1:roughness=a"]
)
def test_a_wrong_correction_is_a_wrong_argument(asset, what):
    with pytest.raises(SystemExit) as ended:
        main(["materials", str(asset), "--set", what])
    assert ended.value.code == 2
