"""The study of skipping: variants of captures have the properties of their names, and the table shows only differences."""

import shutil
from types import SimpleNamespace

import pytest
import torch

pytest.importorskip("igl")
from benchmarks.studies.skipping import FieldsOnce, Scene, found_scenes, line, main, without_skipping
from benchmarks.suite.derived_captures import derive
from benchmarks.suite.fewer_views import with_fewer_views
from blender_nep.capture import PixelRays, load_capture
from blender_nep.job.stages import FieldsStage
from blender_nep.presets import preset
from blender_nep.scene.photo_analysis import PhotoAnalysis
from support.paths import SUZANNE_SMALL


def analyze(scene: Scene) -> PhotoAnalysis:
    return PhotoAnalysis.of(PixelRays.from_capture(load_capture(scene.folder), 40_000, scene.masks, torch.device("cpu")))


def test_a_variant_of_a_capture_has_the_properties_of_its_name(tmp_path):
    few = with_fewer_views(SUZANNE_SMALL, 8, tmp_path / "few")
    plain = analyze(Scene.parse(f"{few}:masks", tmp_path))
    cut, white, far = (analyze(Scene.parse(f"{few}:{word}", tmp_path)) for word in ("cut-out", "clipped", "distant"))
    assert plain.backdrop and white.backdrop and far.backdrop and not cut.backdrop
    assert plain.clipped < 0.001 and 0.01 < white.clipped < 0.05 and white.brightest <= 1
    assert far.pixels_across == pytest.approx(plain.pixels_across / 4, rel=0.02)
    for made in (cut, white, far):
        assert made.object_share == pytest.approx(plain.object_share, rel=0.05)


@pytest.mark.slow
def test_a_variant_follows_a_source_that_was_rendered_again(tmp_path):
    source, made = tmp_path / "source", tmp_path / "made"
    shutil.copytree(SUZANNE_SMALL, source)
    before = {file.name: file.read_bytes() for file in (derive(source, "clipped", made) / "images").iterdir()}
    stamp = (made / "transforms.json").stat().st_mtime_ns
    assert (derive(source, "clipped", made) / "transforms.json").stat().st_mtime_ns == stamp, "it is not made twice"
    first, second, *_ = sorted((source / "images").iterdir())
    shutil.copy(second, first)  # the same cameras, another photo
    photo = first.with_suffix(".png").name
    assert (derive(source, "clipped", made) / "images" / photo).read_bytes() != before[photo]


def test_a_scene_is_parsed_and_an_unknown_word_is_refused(tmp_path):
    told = Scene.parse(f"{SUZANNE_SMALL}:metal", tmp_path)
    assert told == Scene(SUZANNE_SMALL, "suzanne_small-metal", masks=False, metal=True)
    with pytest.raises(SystemExit, match="unknown: glas"):
        Scene.parse(f"{SUZANNE_SMALL}:glas", tmp_path)


def test_a_missing_capture_is_told_and_the_others_are_studied(tmp_path, monkeypatch, capsys):
    gone = tmp_path / "gone"
    for word in ("", ":masks", ":clipped"):
        assert found_scenes([f"{gone}{word}", f"{SUZANNE_SMALL}"], tmp_path) == [
            Scene(SUZANNE_SMALL, "suzanne_small", masks=False, metal=False)
        ]
        assert f"{gone}{word} is left out: {gone} is no capture" in capsys.readouterr().err
    monkeypatch.setattr("sys.argv", ["skipping", str(gone), "--out", str(tmp_path)])
    with pytest.raises(SystemExit) as ended:
        main()
    assert ended.value.code == 2 and "no capture can be studied" in capsys.readouterr().err


def test_the_table_names_only_what_the_run_without_skipping_did():
    scores = {"cd_visible": 0.5, "normal_deg": 1.0, "mse_roughness": 0.0, "mse_metallic": 0.0, "mse_albedo": 0.0}
    rows = {
        True: [
            scores | {"seed": k, "seconds": s, "skipped": {"mask term": "", "indirect light": ""}}
            for k, s in enumerate((1.0, 3.0))
        ],
        False: [scores | {"seed": k, "seconds": 4.0, "skipped": {"mask term": ""}} for k in (0, 1)],
    }
    name, seeds, left_out, seconds, saved, *_ = line("ball", rows)
    assert (name, seeds, left_out, seconds, saved) == ("ball", "2", "indirect light", "2 ± 1 / 4 ± 0", "50 %")
    none = {True: rows[True], False: [{"seed": k, "error": "no surface"} for k in (0, 1)]}
    assert line("ball", none) == ["ball", "0 of 2", "no surface"]


def test_a_seed_that_failed_on_one_side_counts_on_neither():
    """Seed 1 takes ten times as long as the others. It must not make skipping look slow where it failed without."""
    scores = {"cd_visible": 0.5, "normal_deg": 1.0, "mse_roughness": 0.0, "mse_metallic": 0.0, "mse_albedo": 0.0}
    rows = {
        skip: [scores | {"seed": k, "seconds": s * slow, "skipped": {}} for k, slow in enumerate((1, 10, 1))]
        for skip, s in ((True, 3.0), (False, 4.0))
    }
    rows[False][1] = {"seed": 1, "error": "no surface"}
    assert line("ball", rows)[:5] == ["ball", "2 of 3", "nothing", "3 ± 0 / 4 ± 0", "25 %"]


@pytest.mark.parametrize(("commit", "learned"), [("aaaaaaaa", 1), ("aaaaaaaa-dirty", 2), ("", 2)])
def test_a_stage_1_is_learned_once_where_a_commit_holds_the_code(commit, learned, tmp_path, monkeypatch):
    done = []
    monkeypatch.setattr(FieldsStage, "run", lambda *_: done.append("learned"))
    monkeypatch.setattr(FieldsOnce, "pack", lambda *_: {"steps": 7})
    monkeypatch.setattr(FieldsOnce, "unpack", lambda *_: done.append("taken"))
    given = SimpleNamespace(preset=preset("preview"), seed=0)
    for _ in range(2):
        scene = Scene(SUZANNE_SMALL, "small", masks=False, metal=False)
        FieldsOnce(scene, tmp_path, "photos", commit).run(given, None, None)
    assert done == ["learned"] * learned + ["taken"] * (2 - learned)


def test_without_skipping_turns_every_way_of_skipping_off():
    whole = without_skipping(preset("preview"))
    assert not whole.skip_needless and whole.material.uniform_texels == whole.material.most_texels
    assert whole.material.sure_margin == float("inf") and whole.fields == preset("preview").fields
