"""The jobs that this Blender looks after, one for each output folder.

A job lives in its files (backend/engine/engine.py): those of an earlier session, or of another .blend file, are found
again when a scene names their folder. No reference to Blender's data is kept: undo and File > New end its life at any
moment.
"""

import os
from pathlib import Path

import bpy
from bpy.app.handlers import persistent

from ..backend.engine import timings
from ..backend.engine.command import EngineError
from ..backend.engine.engine import STOPPED, Engine
from ..backend.engine.job_files import is_asset, read_job
from ..backend.engine.progress import Progress
from ..backend.engine.words import Said
from . import clock, live_preview, preferences, settings


class Job:
    """A job in `output`: running, or `ended` with an asset or with `failed` (which says why)."""

    def __init__(self, output: Path, engine: Engine | None, failed: EngineError | None = None, here: bool = True):
        self.output, self.engine, self.failed = output, engine, failed
        self.key = key(output)
        self.progress = Progress()
        self.warnings: list[Said] = []
        self.scene: list[Said] = []  # what the photos show and what is left out because of it, in sentences
        self.stopping = False
        self.ended = engine is None
        self.watched = here  # whether it ran while this Blender looked on: then its result is imported by itself
        self.previews: dict[str, Path] = {}  # by ending, not shown yet

    def advance(self) -> bool:
        """Take in what the engine has said; whether there was anything. Afterwards `ended` holds."""
        if self.ended:
            return False
        events, ended = self.engine.poll()
        for event in events:
            if event["event"] == "progress":
                self.progress = Progress.of(event)
            elif event["event"] == "warning":
                self.warnings.append(Said.of(event))
            elif event["event"] == "scene":
                self.scene = [Said.of(line) for line in event.get("lines") or ()]
            elif event["event"] == "preview":
                path = Path(str(event.get("path", "")))
                self.previews[path.suffix] = path
        if ended:
            self.ended = True
            self.failed = self.engine.outcome()
            self.engine.close()
        return bool(events) or ended

    def stop(self) -> None:
        """Ask the engine for its checkpoint and its end."""
        self.stopping = True
        self.engine.request_stop()

    @property
    def was_stopped(self) -> bool:
        """Whether it ended because somebody wanted it."""
        return self.failed is not None and self.failed.code == STOPPED


jobs: dict[str, Job] = {}


def key(output: Path) -> str:
    """The same for all ways to write a folder's path."""
    return os.path.normcase(os.path.abspath(output))


def of(scene) -> Job | None:
    """The job of the scene's output folder."""
    output = settings.folder(scene.nep.output)
    return jobs.get(key(output)) if output is not None else None


def add(job: Job) -> None:
    """Look after a job from now on."""
    jobs[job.key] = job
    clock.watch(advance_all)


def look(scene) -> None:
    """Take up the job that runs, or ended, in the scene's output folder."""
    output = settings.folder(scene.nep.output)
    if output is None or key(output) in jobs:
        return
    engine = Engine.attach(output)
    if engine is None:
        return
    job = Job(output, engine, here=False)
    job.advance()
    if job.ended:
        jobs[job.key] = job
    else:
        job.watched = True
        add(job)


def look_everywhere() -> None:
    """In all scenes of the file."""
    for scene in bpy.data.scenes:
        look(scene)


@persistent
def on_load(*_):
    """Another file is open."""
    for found in [job for job in jobs.values() if job.ended]:
        del jobs[found.key]  # what became of it is read again from its files, as far as this file's scenes ask
    look_everywhere()


def advance_all() -> bool:
    """Once every clock period; whether there is more to do."""
    changed = False
    for job in list(jobs.values()):
        was_running = not job.ended
        changed |= job.advance()
        _show_previews(job)
        if job.ended and was_running:
            clean_up(job)
        if job.ended and job.watched:
            job.watched = not _import_when_possible(job)
    if changed:
        clock.redraw_soon()
    return any(not job.ended or job.watched for job in jobs.values())


def _show_previews(job: Job) -> None:
    if job.ended or not job.previews:
        return
    picture, mesh = job.previews.pop(".png", None), job.previews.pop(".npz", None)
    if picture is not None:
        live_preview.load_picture(job.key, picture)
    scene = scene_of(job)
    if mesh is not None and scene is not None:
        live_preview.show_mesh(scene, job.key, mesh)


def clean_up(job: Job) -> None:
    """After the end of a job: its preview goes, its time is remembered."""
    live_preview.remove_meshes(job.key)
    live_preview.forget_picture(job.key)
    if job.failed is None:
        timings.remember(preferences.timings_file(), job.output)


def scene_of(job: Job):
    """A scene of this file whose output folder is the job's; None where another file is open."""
    return next((scene for scene in bpy.data.scenes if of(scene) is job), None)


def result_waits(scene) -> bool:
    """Whether the output folder holds an asset that is not in the scene yet."""
    output = settings.folder(scene.nep.output)
    if output is None or not is_asset(output):
        return False
    return _run_in(output) != scene.nep.imported_job


def note_import(scene, output: Path) -> None:
    """The asset of this folder is in the scene now."""
    scene.nep.imported_job = _run_in(output)


def _run_in(output: Path) -> str:
    """Tells the last run in a folder from others; where nobody follows runs, the folder stands for it."""
    return str((read_job(output) or {}).get("id") or key(output))


def _import_when_possible(job: Job) -> bool:
    """Import the result of a job that ended while we looked on; False: not yet, ask again."""
    scene = scene_of(job)
    if job.failed is not None or scene is None:
        return True
    window = next((window for window in bpy.context.window_manager.windows if window.scene == scene), None)
    if window is None:  # another scene is shown: an import works on what is
        return False
    with bpy.context.temp_override(window=window):
        if bpy.context.mode != "OBJECT":  # nobody is thrown out of Edit Mode
            return False
        import_result(job)
    return True


def import_result(job: Job) -> None:
    """Into the context's scene, as one undo step. A failure becomes the job's."""
    try:
        bpy.ops.nep.import_result("EXEC_DEFAULT", True, folder=str(job.output))
    except RuntimeError as error:  # how an operator's error report arrives
        job.failed = EngineError(1, str(error).removeprefix("Error: ").strip(), "Press Import Result to try again.")


def let_go() -> None:
    """Blender or the add-on ends: jobs that were not started to keep going write their checkpoint and leave."""
    for job in jobs.values():
        if job.engine is not None:
            job.engine.close()
    jobs.clear()
