"""The jobs that this Blender follows, at most one for each output folder.

A job's state lies in the files of its output folder (backend/engine/engine.py). So the job of an earlier session, or of
another .blend file, is found again when a scene names its output folder.
"""

from pathlib import Path

import bpy
from bpy.app.handlers import persistent
from bpy.app.translations import pgettext_iface

from ...backend.engine import timings
from ...backend.engine.command import EngineError
from ...backend.engine.engine import STOPPED, Engine
from ...backend.engine.progress import Progress
from ...backend.engine.words import EngineMessage
from .. import engine_paths, halved_pictures
from ..folders import resolve_folder
from ..scene import live_preview
from . import clock, registry
from .registry import Task

DONE = "{name}: the object is done"


class Job(Task):
    """A job in its output folder. When it has ended, there is an asset, or `failed` says why not."""

    one_per_folder = True

    def __init__(
        self, output: Path, scene: bpy.types.Scene, engine: Engine | None, failed: EngineError | None = None
    ) -> None:
        """A job that `scene` has started or found. `engine` is None for a job that could not be started."""
        super().__init__(output)
        self.engine, self.failed, self.ended = engine, failed, engine is None
        self.scene_name = scene.name
        self.progress = Progress()
        self.warnings: list[EngineMessage] = []
        # sentences: what the photos show, what the engine has left out, and what has improved the shape
        self.scene_analysis: list[EngineMessage] = []
        self.stopping = False
        self.import_when_ended = True  # False once the result is imported, or where somebody else decides about it
        self._events_read = 0
        self._previews: dict[str, Path] = {}  # file ending -> the newest preview file that is not shown yet

    def poll(self) -> bool:
        events, ended = self.engine.poll()
        self._events_read += len(events)
        for event in events:
            if event["event"] == "progress":
                self.progress = Progress.of(event)
            elif event["event"] == "warning":
                self.warnings.append(EngineMessage.of(event))
            elif event["event"] == "scene":
                self.scene_analysis = [EngineMessage.of(line) for line in event.get("lines") or ()]
            elif event["event"] == "preview":
                path = Path(str(event.get("path", "")))
                self._previews[path.suffix] = path
        if ended:
            self.failed = self.engine.outcome()
            self.engine.close()
        elif self.import_when_ended:  # a script that waits for the job needs no previews
            self._show_previews()
        return ended

    def _show_previews(self) -> None:
        picture, mesh = self._previews.pop(".png", None), self._previews.pop(".npz", None)
        if picture is not None:
            halved_pictures.load_picture(self.key, picture)
        scene = None if mesh is None else scene_of(self)
        if scene is not None:
            live_preview.show_mesh(scene, self.key, mesh)

    def displayed_state(self) -> object:
        return self._events_read

    def finish(self) -> None:
        """Remove the live preview, remember how long a successful job took, and import the result as soon as possible."""
        if remove_old_previews():
            clock.call_until_false(remove_old_previews)
        halved_pictures.remove_picture(self.key)
        if self.failed is None:
            timings.remember(engine_paths.timings_file(), self.folder)
        if self._waits_for_import():
            clock.call_until_false(self._waits_for_import)

    def _waits_for_import(self) -> bool:
        self.import_when_ended = self.import_when_ended and not _import_if_possible(self)
        return self.import_when_ended

    def close(self) -> None:
        """A job that was not started to keep going writes its checkpoint and ends."""
        if self.engine is not None:
            self.engine.close()

    def stop(self) -> None:
        """Ask the engine to write its checkpoint and to end."""
        self.stopping = True
        self.engine.request_stop()

    @property
    def done_fraction(self) -> float:
        return self.progress.fraction

    @property
    def has_failed(self) -> bool:
        return self.failed is not None

    def status_name(self) -> str:
        return self.folder.name

    def end_status(self) -> str:
        if self.failed is not None:
            return f"{self.folder.name}: {self.failed.words(pgettext_iface)[0]}"
        return pgettext_iface(DONE).format(name=self.folder.name)

    @property
    def was_stopped(self) -> bool:
        """Whether the job ended because somebody stopped it."""
        return self.failed is not None and self.failed.code == STOPPED


def job_of(scene: bpy.types.Scene) -> Job | None:
    """The job in the scene's output folder; None where this Blender knows of no job there."""
    output = resolve_folder(scene.nep.output)
    return None if output is None else registry.find(Job, output)


def scene_of(job: Job) -> bpy.types.Scene | None:
    """The scene of this file whose output folder is the job's; None where another file is open.

    Of several such scenes it is the one that has started the job.
    """
    scenes = [scene for scene in bpy.data.scenes if job_of(scene) is job]
    return next((scene for scene in scenes if scene.name == job.scene_name), scenes[0] if scenes else None)


def attach_job(scene: bpy.types.Scene) -> None:
    """Find the job that runs, or has ended, in the scene's output folder, and follow it where it runs."""
    output = resolve_folder(scene.nep.output)
    if output is None or registry.find(Job, output) is not None:
        return
    engine = Engine.attach(output)
    if engine is None:
        return
    job = Job(output, scene, engine)
    job.import_when_ended = False  # where it ended unseen: the artist decides about its result
    job.ended = job.poll()
    if job.ended:
        registry.keep(job)
    else:
        job.import_when_ended = True
        registry.start(job)


def attach_jobs_of_all_scenes() -> None:
    """Find the jobs of all scenes in the open file."""
    for scene in bpy.data.scenes:
        attach_job(scene)


@persistent
def on_file_loaded(*_: object) -> None:
    """Blender's handler after another file was opened, and the ended jobs were forgotten: find those that the file names.

    What became of an ended job is read again from its files where this file names its folder.
    """
    attach_jobs_of_all_scenes()
    remove_old_previews()


def remove_old_previews() -> bool:
    """Remove the preview meshes of jobs that do not run. Returns whether another call is needed: one is being edited."""
    return live_preview.remove_meshes_except([job.key for job in registry.tasks_of(Job) if not job.ended])


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
        bpy.ops.nep.import_result("EXEC_DEFAULT", True, folder=str(job.folder))
    except RuntimeError as error:  # this is how an operator's error report arrives
        job.failed = EngineError(1, str(error).removeprefix("Error: ").strip(), "Press Import Result to try again.")
