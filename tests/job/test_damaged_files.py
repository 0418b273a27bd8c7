"""Damaged photos, masks and camera files end in words (benchmarks/stress/damaged_files.py has the campaign)."""

from __future__ import annotations

import json
import random

import pytest

pytest.importorskip("hypothesis")
from hypothesis import HealthCheck, Phase, given, settings

from benchmarks.stress import damaged_files
from benchmarks.stress.checks import strict_json
from benchmarks.stress.damaged_files import ENDINGS, FORMS, DamagedFile, run_damaged, write_damaged
from benchmarks.stress.file_changes import CHANGES, changed
from blender_nep import cli
from blender_nep.capture.doctor.summary import summarize
from blender_nep.errors import BoundsError, CaptureError


@settings(
    max_examples=25,
    derandomize=True,
    database=None,
    deadline=None,
    phases=[Phase.generate],
    suppress_health_check=list(HealthCheck),
)
@given(case=damaged_files.damaged_files())
def test_a_damaged_file_is_read_or_refused(tmp_path_factory, case):
    if case.form.startswith("colmap"):
        pytest.importorskip("pycolmap")
    folder = tmp_path_factory.mktemp("damaged")
    write_damaged(case, folder)
    try:
        json.dumps(summarize(folder), allow_nan=False)
    except (CaptureError, BoundsError) as error:
        assert error.message and "\n" not in error.message


def test_a_photo_without_pixels_is_refused(tmp_path):
    """A TIFF file may say that it has no rows."""
    case = DamagedFile(form="record3d", target="photo", change="length", ending=".tif", times=3, number=83047)
    write_damaged(case, tmp_path)
    with pytest.raises(CaptureError, match=r"2\.tif cannot be read as an image \(it has no pixels\)"):
        summarize(tmp_path)


@pytest.mark.parametrize("form", FORMS)
def test_every_form_is_read_where_nothing_is_damaged(tmp_path, monkeypatch, form):
    """Otherwise all cases of a form would be refused for the same reason."""
    if form.startswith("colmap"):
        pytest.importorskip("pycolmap")
    monkeypatch.setattr(damaged_files, "changed", lambda content, change, draw: content)
    write_damaged(DamagedFile(form=form, target="photo", ending=ENDINGS[FORMS.index(form) % len(ENDINGS)]), tmp_path)
    assert summarize(tmp_path)["photos"] >= 3


@pytest.mark.parametrize("change", CHANGES)
def test_each_change_changes_and_can_be_repeated(change):
    for content in (b'{"a": [1, 2, {"b": 3.5}]}' * (change not in ("value", "missing")), b'{"a": [1, 2]}', b"1 2.5\n3 4\n"):
        if content:
            results = {changed(content, change, random.Random(seed)) for seed in range(8)}
            assert results - {content} and changed(content, change, random.Random(3)) in results


def test_a_case_is_read_in_a_process_of_its_own(tmp_path):
    row = run_damaged(DamagedFile(target="photo", ending=".exr", change="zeros", number=4), tmp_path)
    assert not row["failures"] and row["code"] in (0, 3)


def test_what_libraries_print_does_not_spoil_the_json(tmp_path, capfd):
    """OpenEXR tells of damaged pixels on standard output."""
    path = write_damaged(DamagedFile(target="photo", ending=".exr", change="cut", number=21), tmp_path)
    assert cli.main(["info", str(tmp_path), "--json"]) == 3
    out, told = capfd.readouterr()
    error = strict_json(out)["error"]
    assert f"error: {error['message']}" in told
    assert error["message"] == f"{path.name} cannot be read as an image (its pixels are damaged)"
