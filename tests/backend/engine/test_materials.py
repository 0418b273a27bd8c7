"""The materials of an asset as its report names them, and the engine process that corrects them."""

import json
from pathlib import Path

import pytest

from backend.engine import words
from backend.engine.command import NoEngineError, materials_arguments
from backend.engine.commands.correction_process import CorrectionProcess
from backend.engine.results.asset_materials import AssetMaterial, read_materials
from blender_nep import command_line
from blender_nep.materials.corrections import ListedMaterial
from support import correcting_engine
from support.played_python import bare_python
from support.waiting import wait_until


@pytest.fixture
def asset(tmp_path) -> Path:
    return correcting_engine.make_asset(tmp_path / "asset")


def corrected(python: str, asset: Path, corrections: dict) -> CorrectionProcess:
    """The process after its end."""
    process = CorrectionProcess(python, asset, corrections)
    wait_until(process.poll)
    return process


def test_the_report_names_the_materials_and_their_corrections(asset):
    correcting_engine.write_report(asset, correcting_engine.MATERIALS, {"1": {"metallic": 0}, "2": {"roughness": 0.25}})
    first, second, third = read_materials(asset)
    assert first == AssetMaterial(0.62, (0.8, 0.2, 0.1), 0.5, False, 0.5, False)
    assert second.is_metal and second.learned_is_metal and second.correction == {"metallic": 0.0}
    assert third.correction == {"roughness": 0.25}


@pytest.mark.parametrize(
    "report",
    [
        "torn",
        "[]",
        "{}",
        '{"materials": null}',
        '{"materials": [{"share": 1}]}',
        '{"materials": [{"share": 1, "albedo": [0, 0], "roughness": 1, "metallic": 0, "learned": {}}]}',
        None,
    ],
)
def test_a_report_that_does_not_name_the_materials_gives_none(tmp_path, report):
    if report is not None:
        (tmp_path / "report.json").write_text(report)
    assert read_materials(tmp_path) == []


def test_a_report_of_the_library_is_understood(tmp_path):
    learned = ListedMaterial(0.25, (0.8, 0.2, 0.1), 0.5, 0.0)
    told = ListedMaterial(0.25, (0.9, 0.7, 0.3), 0.1, 1.0).to_dict(learned)
    (tmp_path / "report.json").write_text(json.dumps({"materials": [told], "corrections": {}}))
    expected = AssetMaterial(0.25, (0.9, 0.7, 0.3), 0.1, True, 0.5, False)
    assert read_materials(tmp_path) == [expected]


def test_the_library_understands_the_arguments():
    found = command_line.parser().parse_args(materials_arguments("asset", {1: {"metallic": 1.0}, 11: {"roughness": 1e-5}}))
    assert found.set == [(1, "metallic", 1.0), (11, "roughness", 1e-5)] and not found.reset
    assert command_line.parser().parse_args(materials_arguments("asset", {})).reset


def test_the_arguments_name_all_corrections_or_take_all_back():
    given = materials_arguments("/asset", {0: {"roughness": 0.2}, 11: {"metallic": 1.0, "roughness": 0.0}})
    assert given == ["materials", "/asset", "--set", "0:roughness=0.2", "--set", "11:metallic=1", "--set", "11:roughness=0"]
    assert materials_arguments("/asset", {}) == ["materials", "/asset", "--reset"]


def test_the_engine_corrects_the_asset(asset, tmp_path):
    process = corrected(correcting_engine.make(tmp_path), asset, {2: {"metallic": 1.0, "roughness": 0.25}})
    assert process.failed is None and [said.words() for said in process.warnings] == ["The light is weak"]
    assert process.progress.stage == "Learning the materials" and process.progress.fraction == 0.5
    assert json.loads((tmp_path / "arguments.json").read_text()) == ["--set", "2:metallic=1", "--set", "2:roughness=0.25"]
    third = read_materials(asset)[2]
    assert third.is_metal and not third.learned_is_metal and third.roughness == 0.25 and third.learned_roughness == 0.3


@pytest.mark.parametrize(
    ("mode", "message", "hint"),
    [
        ("refuse", "The light was not kept", "Reconstruct again."),
        ("full", "The disk is full: /a cannot be written", "Free some space, then press Apply again."),
        ("crash", "The engine was killed", "Press Apply again."),
        ("old", "The installed engine is older than this add-on", "Install the engine"),
    ],
)
def test_a_failure_is_told_with_what_to_do_about_the_correction(asset, tmp_path, mode, message, hint):
    before = {path: path.read_bytes() for path in asset.rglob("*") if path.is_file()}
    (tmp_path / "mode").write_text(mode)
    failed = corrected(correcting_engine.make(tmp_path), asset, {}).failed
    said, advice = failed.words()
    assert said.startswith(message) and advice.startswith(hint) and "Resume" not in advice
    assert {path: path.read_bytes() for path in asset.rglob("*") if path.is_file()} == before


def test_a_python_without_the_engine_is_told_as_in_a_job(asset, tmp_path):
    failed = corrected(bare_python(tmp_path), asset, {}).failed
    assert failed.name == "engine.missing" and "lacks blender_nep" in failed.words()[0] and "Install" in failed.words()[1]
    with pytest.raises(NoEngineError, match="cannot be started"):
        CorrectionProcess(str(tmp_path / "no-python"), asset, {})


def test_hints_of_a_correction_have_errors_and_are_translated():
    assert set(words.CORRECTION_HINTS) <= set(words.ERRORS)
    assert set(words.CORRECTION_HINTS.values()) <= set(words.texts())
