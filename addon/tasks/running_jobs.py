"""The jobs that this Blender follows, at most one for each output folder.

A job's state lies in the files of its output folder (backend/engine/engine.py). So the job of an earlier session, or of
another .blend file, is found again when a scene names its output folder. No reference to Blender's data is kept: undo
and File > New may end the life of such data at any moment.
"""

from pathlib import Path

import bpy
from bpy.app.handlers import persistent

from ...backend.engine import timings
from ...backend.engine.command import EngineError
from ...backend.engine.engine import STOPPED, Engine
from ...backend.engine.progress import Progress
from ...backend.engine.words import Said
from .. import engine_paths, halved_pictures
from ..folders import folder_key, resolve_folder
from ..scene import live_preview
from . import clock


class Job:
    """A job in the folder `output`. It runs, or has `ended`: with an asset, or with `failed`, which says why."""

    def __init__(
        self, output: Path, scene: bpy.types.Scene, engine: Engine | None, failed: EngineError | None = None
    ) -> None:
        """A job that `scene` has started or found. `engine` is None for a job that could not be started."""
        self.output, self.engine, self.failed = output, engine, failed
        self.scene_name = scene.name
        self.key = folder_key(output)
        self.progress = Progress()
        self.warnings: list[Said] = []
        self.scene_analysis: list[Said] = []  # sentences: what the photos show, and what the engine leaves out for it
        self.stopping = False
        self.ended = engine is None
        self.import_when_ended = True  # False once the result is imported, or where the artist is to decide about it
        self.previews: dict[str, Path] = {}  # file ending -> the newest preview file that is not shown yet

    def advance(self) -> bool:
        """Read what the engine has said since the last call; returns whether anything has changed. Sets `ended`."""
        if self.ended:
            return False
        events, ended = self.engine.poll()
        for event in events:
            if event["event"] == "progress":
                self.progress = Progress.of(event)
            elif event["event"] == "warning":
                self.warnings.append(Said.of(event))
            elif event["event"] == "scene":
                self.scene_analysis = [Said.of(line) for line in event.get("lines") or ()]
            elif event["event"] == "preview":
                path = Path(str(event.get("path", "")))
                self.previews[path.suffix] = path
        if ended:
            self.ended = True
            self.failed = self.engine.outcome()
            self.engine.close()
        return bool(events) or ended

    def stop(self) -> None:
        """Ask the engine to write its checkpoint and to end."""
        self.stopping = True
        self.engine.request_stop()

    @property
    def was_stopped(self) -> bool:
        """Whether the job ended because somebody stopped it."""
        return self.failed is not None and self.failed.code == STOPPED


_jobs: dict[str, Job] = {}  # by the key of the output folder


def job_of(scene: bpy.types.Scene) -> Job | None:
    """The job in the scene's output folder; None where this Blender knows of no job there."""
    output = resolve_folder(scene.nep.output)
    return _jobs.get(folder_key(output)) if output is not None else None


def any_at_work() -> bool:
    """Whether a job of this Blender has not ended."""
    return any(not job.ended for job in _jobs.values())


def scene_of(job: Job) -> bpy.types.Scene | None:
    """The scene of this file whose output folder is the job's; None where another file is open.

    Of several such scenes it is the one that has started the job.
    """
    scenes = [scene for scene in bpy.data.scenes if job_of(scene) is job]
    return next((scene for scene in scenes if scene.name == job.scene_name), scenes[0] if scenes else None)


def follow_job(job: Job) -> None:
    """Follow a running job to its end, in place of an earlier job in the same folder."""
    _jobs[job.key] = job
    clock.call_until_false(advance_jobs)


def keep_failed_start(output: Path, scene: bpy.types.Scene, error: EngineError) -> None:
    """Keep, for the panel, why a job in this folder could not be started."""
    job = Job(output, scene, None, error)
    _jobs[job.key] = job


def attach_job(scene: bpy.types.Scene) -> None:
    """Find the job that runs, or has ended, in the scene's output folder, and follow it where it runs."""
    output = resolve_folder(scene.nep.output)
    if output is None or folder_key(output) in _jobs:
        return
    engine = Engine.attach(output)
    if engine is None:
        return
    job = Job(output, scene, engine)
    job.advance()
    if job.ended:
        job.import_when_ended = False  # it ended unseen: the artist decides about its result
        _jobs[job.key] = job
    else:
        follow_job(job)


def attach_jobs_of_all_scenes() -> None:
    """Find the jobs of all scenes in the open file."""
    for scene in bpy.data.scenes:
        attach_job(scene)


@persistent
def on_file_loaded(*_: object) -> None:
    """Blender's handler after another file was opened: forget the ended jobs, and find those that the file names.

    What became of an ended job is read again from its files where this file names its folder.
    """
    for ended in [job for job in _jobs.values() if job.ended]:
        del _jobs[ended.key]
    attach_jobs_of_all_scenes()
    remove_old_previews()


def advance_jobs() -> bool:
    """Advance all jobs, once every clock period; returns whether one of them needs another call."""
    changed = False
    for job in list(_jobs.values()):
        was_running = not job.ended
        changed |= job.advance()
        _show_previews(job)
        if job.ended and was_running:
            on_job_ended(job)
        if job.ended and job.import_when_ended:
            job.import_when_ended = not _import_if_possible(job)
    if changed:
        clock.redraw_sidebars_soon()
    return any(not job.ended or job.import_when_ended for job in _jobs.values())


def _show_previews(job: Job) -> None:
    if job.ended or not job.previews:
        return
    picture, mesh = job.previews.pop(".png", None), job.previews.pop(".npz", None)
    if picture is not None:
        halved_pictures.load_picture(job.key, picture)
    scene = scene_of(job)
    if mesh is not None and scene is not None:
        live_preview.show_mesh(scene, job.key, mesh)


def on_job_ended(job: Job) -> None:
    """Remove the job's live preview, and remember how long a successful job took."""
    if remove_old_previews():
        clock.call_until_false(remove_old_previews)
    halved_pictures.remove_picture(job.key)
    if job.failed is None:
        timings.remember(engine_paths.timings_file(), job.output)


def remove_old_previews() -> bool:
    """Remove the preview meshes of jobs that do not run. Returns whether another call is needed: one is being edited."""
    return live_preview.remove_meshes_except([job.key for job in _jobs.values() if not job.ended])


@persistent
def on_undone(*_: object) -> None:
    """Blender's handler after undo and redo, which may bring an old preview back. It is removed a little later."""
    clock.call_until_false(remove_old_previews)


def _import_if_possible(job: Job) -> bool:
    """Import the result of an ended job. False: not possible now, try again; True: done, or nothing to import."""
    scene = scene_of(job)
    if job.failed is not None or scene is None:
        return True
    window = next((window for window in bpy.context.window_manager.windows if window.scene == scene), None)
    if window is None:  # no window shows the scene, and an operator works on a scene that is shown
        return False
    with bpy.context.temp_override(window=window):
        if bpy.context.mode != "OBJECT":  # nobody is thrown out of Edit Mode
            return False
        import_job_result(job)
    return True


def import_job_result(job: Job) -> None:
    """Import the job's result into the context's scene, as one undo step. A failure becomes the job's failure.

    The operator is called by its name, as a script would call it: so Blender makes the undo step.
    """
    try:
        bpy.ops.nep.import_result("EXEC_DEFAULT", True, folder=str(job.output))
    except RuntimeError as error:  # this is how an operator's error report arrives
        job.failed = EngineError(1, str(error).removeprefix("Error: ").strip(), "Press Import Result to try again.")


def close_all() -> None:
    """Blender or the add-on ends: jobs that were not started to keep going write their checkpoint and end."""
    for job in _jobs.values():
        if job.engine is not None:
            job.engine.close()
    _jobs.clear()
