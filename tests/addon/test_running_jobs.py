"""The add-on and its jobs, in Blender without a screen: its timer's rounds are made by hand. Each check is a process."""

import os
import shutil
import signal
import sys
from pathlib import Path

import pytest

from support import ball_engine, correcting_engine, scripted_engine
from support.blender_checks import drawn_by, fails, register, rounds
from support.own_process import run_file

LIMIT_S = 180


@pytest.fixture
def folders(package, make_capture, monkeypatch):
    """A folder with `capture`, an engine, and the package."""
    make_capture(masks=True)
    monkeypatch.setenv("NEP_ENGINE_PYTHON", ball_engine.make(package))
    return package


@pytest.fixture
def played(package, make_capture, monkeypatch):
    """The same with an engine that only copies an asset: enough for what becomes of a result in the artist's scenes."""
    make_capture(masks=True)
    asset = correcting_engine.make_asset(package / "asset")
    engine = {"SCRIPTED_ENGINE": "asset", "SCRIPTED_ASSET": str(asset), "NEP_ENGINE_PYTHON": scripted_engine.make(package)}
    for name, value in engine.items():
        monkeypatch.setenv(name, value)
    return package


def in_blender(function, folder: Path, *, code=0, **variables) -> str:
    """Run a function of this file in a Blender of its own."""
    done = run_file(__file__, function.__name__, folder, timeout=LIMIT_S, **variables)
    assert done.returncode == code, done.stdout[-2000:] + done.stderr[-4000:]
    assert "Traceback" not in done.stderr, done.stderr
    return done.stdout + done.stderr


SLOW = {"BALL_STEPS": "4000", "BALL_DELAY": "0.02"}
BRISK = {"BALL_STEPS": "60", "BALL_DELAY": "0.03"}


def set_up(folder: Path):
    """A new file whose scene names the capture and an output folder; (bpy, the add-on's modules, settings)."""
    import bpy

    addon = register()
    bpy.ops.wm.read_factory_settings(use_empty=True)
    settings = bpy.context.scene.nep
    settings.capture, settings.output, settings.preset = str(folder / "capture"), str(folder / "out"), "preview"
    return bpy, addon, settings


def start(bpy, addon, scene=None):
    """Press the button; returns the job."""
    assert bpy.ops.nep.reconstruct(wait=False) == {"FINISHED"}
    return addon.tasks.running_jobs.job_of(scene or bpy.context.scene)


def meshes(bpy) -> list[str]:
    return sorted(item.name for item in bpy.data.objects if item.type == "MESH")


def drawn(bpy, addon) -> list[str]:
    """The texts and operators of the main panel, in their order."""
    return drawn_by(bpy, addon.panels.reconstruct.NEP_PT_reconstruct)


@pytest.mark.slow
def test_what_photos_show_is_below_the_buttons_also_after_a_stop(folders):
    in_blender(check_box_of_the_photos, folders, **SLOW)


def check_box_of_the_photos(folder):
    bpy, addon, _settings = set_up(folder)
    job = start(bpy, addon)
    rounds(addon, lambda: job.scene_analysis)
    running = drawn(bpy, addon)
    box = running.index("What the Photos Show")
    assert running.index("nep.cancel") < box and "Masks are there and are used." in running[box:]
    assert bpy.ops.nep.cancel() == {"FINISHED"}
    rounds(addon, lambda: job.ended)
    stopped = drawn(bpy, addon)
    assert job.was_stopped and stopped.index("Resume") < stopped.index("What the Photos Show")


def test_a_job_runs_beside_blender_and_brings_its_object(folders):
    in_blender(check_life_of_a_job, folders, **BRISK)


def check_life_of_a_job(folder):
    bpy, addon, _settings = set_up(folder)

    from nep_addon.backend.engine.words import EngineMessage

    def says(words: str) -> bool:
        return words in " ".join(drawn(bpy, addon))

    assert says("a guess until the first job") and not says("these photos")
    job = start(bpy, addon)
    assert not bpy.ops.nep.reconstruct.poll() and bpy.ops.nep.cancel.poll()
    assert not bpy.ops.nep.find_cameras.poll(), "other cameras would keep the job from being resumed"
    assert addon.operators.engine.engine_at_work(), "it is not installed anew meanwhile"
    rounds(addon, lambda: "NeP preview" in bpy.data.objects)
    preview = bpy.data.objects["NeP preview"]
    assert len(preview.data.polygons) == 320 and preview.hide_render
    assert len(addon.halved_pictures.picture_halves(job.key)) == 2, "photo and what was learned"
    texts = drawn(bpy, addon)
    assert texts.index("nep.cancel") < texts.index("Photo"), "what changes its height stands below Cancel"
    bpy.data.objects.remove(preview)  # as undo does
    rounds(addon, lambda: job.progress.stage == "Learning the materials")
    bpy.ops.wm.read_factory_settings(use_empty=True)  # File > New, in the middle
    assert addon.tasks.running_jobs.job_of(bpy.context.scene) is None
    bpy.context.scene.nep.capture, bpy.context.scene.nep.output = str(folder / "capture"), str(folder / "out")
    assert addon.tasks.running_jobs.job_of(bpy.context.scene) is job and not job.ended
    rounds(addon, lambda: job.ended and not job.import_when_ended)
    assert (
        job.failed is None and meshes(bpy) == ["out"] and not addon.scene.imported_result.has_new_result(bpy.context.scene)
    )
    assert addon.tasks.clock.tick() is None and not addon.operators.engine.engine_at_work(), "the timer rests"
    assert EngineMessage("scene.masks_used", {}, "Masks are there and are used.") in job.scene_analysis
    assert job.scene_analysis[-1].code == "scene.left_out" and "Left out: " in job.scene_analysis[-1].words()
    assert "stage fields_learning" in log(bpy)
    bpy.context.scene.nep.preset = "preview"
    assert says("as measured with these photos") and not says("a guess")
    fails(bpy.ops.nep.reconstruct, "already holds an asset")
    assert bpy.ops.nep.reconstruct(overwrite=True) == {"FINISHED"} and len(meshes(bpy)) == 2


def log(bpy) -> str:
    assert bpy.ops.nep.open_log() == {"FINISHED"}
    return bpy.data.texts["NeP log"].as_string()


@pytest.mark.parametrize("closing", ["KEEP", pytest.param("STOP", marks=pytest.mark.slow)])
def test_blender_closes_in_the_middle(folders, closing):
    in_blender(check_close, folders, CLOSING=closing, **(BRISK if closing == "KEEP" else SLOW))
    in_blender(check_kept if closing == "KEEP" else check_stopped, folders)


def check_close(folder):
    bpy, addon, settings = set_up(folder)
    settings.closing = os.environ["CLOSING"]
    job = start(bpy, addon)
    if settings.closing == "KEEP":
        rounds(addon, lambda: "NeP preview" in bpy.data.objects)  # it is in the file, then
    bpy.ops.wm.save_as_mainfile(filepath=str(folder / "scene.blend"))
    rounds(addon, (folder / "out" / "checkpoints" / "fields_learning.pt").exists)
    assert not job.ended


def check_kept(folder):
    """A job that is still at work brings its object. That of one that has ended meanwhile waits for the artist."""
    import bpy

    addon = register()
    bpy.ops.wm.open_mainfile(filepath=str(folder / "scene.blend"))
    scene = bpy.context.scene
    job = addon.tasks.running_jobs.job_of(scene)
    assert job is not None and job.progress.fraction > 0
    brought = [] if job.ended else ["out"]
    rounds(addon, lambda: job.ended and not job.import_when_ended)
    assert job.failed is None and meshes(bpy) == brought
    # the file was not saved with the object: the result waits again, and is not forced upon anybody
    bpy.ops.wm.open_mainfile(filepath=str(folder / "scene.blend"))
    addon.tasks.clock.tick()
    assert meshes(bpy) == [] and addon.scene.imported_result.has_new_result(bpy.context.scene)
    assert bpy.ops.nep.import_result() == {"FINISHED"} and meshes(bpy) == ["out"]
    assert not addon.scene.imported_result.has_new_result(bpy.context.scene)
    # a new file that names the folder finds the ended job, and its result waits for the artist
    bpy.ops.wm.read_factory_settings(use_empty=True)
    assert addon.tasks.running_jobs.job_of(bpy.context.scene) is None
    bpy.context.scene.nep.output = str(folder / "out")
    again = addon.tasks.running_jobs.job_of(bpy.context.scene)
    assert again is not None and again.ended and again.failed is None
    addon.tasks.clock.tick()
    assert meshes(bpy) == [] and addon.scene.imported_result.has_new_result(bpy.context.scene)
    # an undo step may hold a preview
    preview = bpy.data.objects.new("NeP preview", bpy.data.meshes.new("NeP preview"))
    preview[addon.scene.live_preview.JOB_PROPERTY] = again.key
    bpy.context.scene.collection.objects.link(preview)
    for handler in bpy.app.handlers.undo_post:
        handler(bpy.context.scene, None)
    addon.tasks.clock.tick()
    assert meshes(bpy) == []


def check_stopped(folder):
    import bpy

    addon = register()
    bpy.ops.wm.open_mainfile(filepath=str(folder / "scene.blend"))
    job = addon.tasks.running_jobs.job_of(bpy.context.scene)
    rounds(addon, lambda: job.ended)
    assert job.was_stopped and not addon.scene.imported_result.has_new_result(bpy.context.scene)
    assert bpy.ops.nep.reconstruct(resume=True) == {"FINISHED"} and meshes(bpy) == ["out"]


@pytest.mark.slow
def test_cancel_crash_and_resume(folders):
    in_blender(check_cancel_and_crash, folders, **SLOW)


def check_cancel_and_crash(folder):
    bpy, addon, settings = set_up(folder)
    sign = folder / "out" / "checkpoints" / "fields_learning.pt"
    job = start(bpy, addon)
    rounds(addon, sign.exists)
    assert bpy.ops.nep.cancel() == {"FINISHED"} and not bpy.ops.nep.cancel.poll()
    rounds(addon, lambda: job.ended)
    assert job.was_stopped and meshes(bpy) == []
    sign.unlink()
    assert bpy.ops.nep.reconstruct(resume=True, wait=False) == {"FINISHED"}
    job = addon.tasks.running_jobs.job_of(bpy.context.scene)
    rounds(addon, sign.exists)
    from nep_addon.backend.engine.results.job_files import read_job

    os.kill(read_job(folder / "out")["pid"], signal.SIGKILL)
    rounds(addon, lambda: job.ended)
    assert "killed" in job.failed.message and not job.was_stopped and addon.tasks.clock.tick() is None
    # no engine, no capture: said where the artist looks
    os.environ["NEP_ENGINE_PYTHON"] = str(folder / "no-python")
    fails(lambda: bpy.ops.nep.reconstruct(resume=True), "cannot be started")
    assert "cannot be started" in addon.tasks.running_jobs.job_of(bpy.context.scene).failed.message
    settings.output = "//beside"
    fails(bpy.ops.nep.reconstruct, "Save the file first")


def test_a_button_does_not_begin_with_what_another_has_set(played):
    in_blender(check_forgotten_options, played)


def check_forgotten_options(folder):
    bpy, addon, _settings = set_up(folder)
    begun = []
    operators = addon.operators.reconstruct
    whole = operators.reconstruct_arguments
    operators.reconstruct_arguments = lambda *a, **k: begun.append(whole(*a, **k)) or begun[-1]

    bpy.context.scene.nep.turntable = "no"

    def press(**options):
        """As a button does: Blender then remembers the options of an operator."""
        assert bpy.ops.nep.reconstruct("EXEC_DEFAULT", True, **options) == {"FINISHED"}
        return {"--resume", "--overwrite"} & set(begun[-1])

    assert press() == set()
    assert press(overwrite=True) == {"--overwrite"}
    assert press(resume=True) == {"--resume"}
    assert press(overwrite=True) == {"--overwrite"}
    bpy.context.scene.nep.output = str(folder / "another")
    assert press() == set()
    assert begun[-1][begun[-1].index("--turntable") + 1] == "no", "a setting of the scene is handed on"
    check_double_click(addon)


def check_double_click(addon):
    """The second half of a double click is no answer to the question that the first half has asked."""
    from types import SimpleNamespace

    asks = addon.operators.confirmation.Asks()
    manager = SimpleNamespace(invoke_confirm=lambda operator, event, **texts: {"RUNNING_MODAL"})
    asks.options = SimpleNamespace(is_invoke=True)
    assert asks._ask(SimpleNamespace(window_manager=manager), None, title="", message="") == {"RUNNING_MODAL"}
    assert asks._is_double_click()
    asks._asked_at -= addon.operators.confirmation.LEAST_S
    assert not asks._is_double_click()
    asks._asked_at, asks.options.is_invoke = asks._asked_at + 9, False
    assert not asks._is_double_click(), "a script asks nobody"


def test_the_artists_world_outlives_a_second_result(played):
    in_blender(check_own_world, played)


def check_own_world(folder):
    bpy, _addon, settings = set_up(folder)
    own = bpy.data.worlds.new("the artist's")
    bpy.context.scene.world = own
    assert bpy.ops.nep.reconstruct() == {"FINISHED"}
    assert bpy.ops.nep.use_recovered_light() == {"FINISHED"}
    first = bpy.context.scene.world
    assert first is settings.recovered_world and settings.own_world is own
    assert bpy.ops.nep.import_result() == {"FINISHED"}
    assert bpy.context.scene.world is settings.recovered_world is first, "a second import needs no second World"
    settings.output, second = str(folder / "second"), settings.recovered_world
    assert bpy.ops.nep.reconstruct() == {"FINISHED"} and settings.recovered_world is not second
    assert bpy.context.scene.world is settings.recovered_world
    assert bpy.ops.nep.use_recovered_light() == {"FINISHED"} and bpy.context.scene.world is own


@pytest.mark.slow
def test_two_scenes_have_two_jobs(folders):
    shutil.copytree(folders / "capture", folders / "second capture")
    in_blender(check_two_jobs, folders, **BRISK)


def check_two_jobs(folder):
    bpy, addon, _settings = set_up(folder)
    one = start(bpy, addon)
    scene = bpy.data.scenes.new("second")
    scene.nep.capture, scene.nep.output, scene.nep.preset = str(folder / "second capture"), str(folder / "two"), "preview"
    with bpy.context.temp_override(scene=scene):
        two = start(bpy, addon, scene)
    assert (
        one is not two
        and addon.tasks.running_jobs.job_of(bpy.context.scene) is one
        and addon.tasks.running_jobs.job_of(scene) is two
    )
    rounds(addon, lambda: all(job.ended for job in (one, two)) and not one.import_when_ended)
    assert meshes(bpy) == ["out"], "what belongs to a scene that is not shown waits"
    bpy.context.window.scene = scene
    rounds(addon, lambda: not two.import_when_ended)
    assert one.failed is None and two.failed is None
    assert [item.name for item in scene.objects if item.type == "MESH"] == ["two"]
    assert "out" not in scene.objects and "two" not in bpy.data.scenes[0].objects


def test_of_scenes_with_one_folder_the_starter_gets_the_result(played):
    in_blender(check_shared_folder, played)


def check_shared_folder(folder):
    bpy, addon, _settings = set_up(folder)
    scene = bpy.data.scenes.new("a scene with an earlier name")
    scene.nep.capture, scene.nep.output, scene.nep.preset = str(folder / "capture"), str(folder / "out"), "preview"
    bpy.context.window.scene = bpy.data.scenes["Scene"]
    job = start(bpy, addon)
    rounds(addon, lambda: job.ended and not job.import_when_ended)
    assert job.failed is None and not [item for item in scene.objects if item.type == "MESH"]
    assert [item.name for item in bpy.data.scenes["Scene"].objects if item.type == "MESH"] == ["out"]


@pytest.mark.slow
def test_save_as_into_another_folder_keeps_the_job_and_all_paths(folders):
    in_blender(check_save_as, folders, **BRISK)


def check_save_as(folder):
    bpy, addon, settings = set_up(folder)
    for name in ("one", "two/deep", "copies"):
        (folder / name).mkdir(parents=True)
    save = bpy.ops.wm.save_as_mainfile
    save(filepath=str(folder / "one/scene.blend"))
    settings.capture, settings.output, settings.comparison_light_file = "//../capture", "//out", "//light.exr"
    settings.asset = str(folder / "an absolute path stays")
    settings.shelf_captures.add().path = "//"
    named = {"capture": folder / "capture", "output": folder / "one/out", "comparison_light_file": folder / "one/light.exr"}

    def right() -> bool:
        same = all(Path(bpy.path.abspath(getattr(settings, name))).resolve() == path for name, path in named.items())
        shelf = Path(bpy.path.abspath(settings.shelf_captures[0].path)).resolve()
        relative = all(getattr(settings, name).startswith("//") for name in named)
        return same and relative and shelf == folder / "one" and settings.asset == str(folder / "an absolute path stays")

    job = start(bpy, addon)
    assert bpy.ops.nep.check_photos() == {"FINISHED"} and addon.tasks.photo_check.last_check(folder / "capture") is not None
    save(filepath=str(folder / "two/deep/scene.blend"))
    assert right() and addon.tasks.running_jobs.job_of(bpy.context.scene) is job
    assert addon.tasks.photo_check.last_check(folder / "capture") is not None, "it is the same capture"
    save(filepath=str(folder / "copies/scene.blend"), copy=True)
    fails(lambda: save(filepath=str(folder / "not there/scene.blend")), "Cannot open file")
    assert right(), "the open file is where it was"
    rounds(addon, lambda: job.ended and not job.import_when_ended)
    assert meshes(bpy) == ["out"]
    for file in ("copies/scene.blend", "two/deep/scene.blend"):
        bpy.ops.wm.open_mainfile(filepath=str(folder / file))
        settings = bpy.context.scene.nep
        assert right(), file


if __name__ == "__main__":
    sys.path.insert(0, str(Path(sys.argv[2]) / "package"))
    globals()[sys.argv[1]](Path(sys.argv[2]))
