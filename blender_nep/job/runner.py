"""Runs a job: the five stages capture, fields learning, surface, material learning and asset, in this order.

The result of each long stage is written before the next stage begins, so that a killed run can go on from there.
"""

from __future__ import annotations

import time
from collections.abc import Callable
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any, TypeVar

import torch

from blender_nep.asset.export import Placement
from blender_nep.asset.preview import PreviewView
from blender_nep.checkpoints import DAMAGED, Checkpoint
from blender_nep.job.device import choose_device, usable_cores
from blender_nep.job.exit_code import exit_code
from blender_nep.job.explained import ExplainedReport, explained
from blender_nep.job.folders.job_folder import JobFolder
from blender_nep.job.folders.own_files import PREVIEW, PROFILE
from blender_nep.job.folders.run_folder import RunFolder
from blender_nep.job.heap import keep_freed_memory
from blender_nep.job.kernels import compiled_beside
from blender_nep.job.preparation import (
    Preparation,
    Prepared,
    refuse_missing_mesh,
    refuse_to_overwrite,
    set_seed_and_threads,
)
from blender_nep.job.report import JobReport
from blender_nep.job.reporting.events import Events
from blender_nep.job.reporting.tracker import Tracker
from blender_nep.job.scene_report import SceneReport
from blender_nep.job.settings import Settings
from blender_nep.job.stage_names import StageName
from blender_nep.job.stage_reports import FieldsReportView, MaterialsReportView, StageReportView, SurfaceReportView
from blender_nep.job.stages import (
    AssetInput,
    FieldsInput,
    MaterialsInput,
    Progress,
    Stage,
    Stages,
    SurfaceInput,
    SurfaceResult,
)
from blender_nep.messages import Message
from blender_nep.profiling import Profile, section
from blender_nep.scene.analysis import Plan, seconds_of_cones
from blender_nep.scene.surface_analysis import SurfaceAnalysis
from blender_nep.stop_request import StopRequest

if TYPE_CHECKING:
    from blender_nep.fields.fields import Fields
    from blender_nep.materials.training import Materials
    from blender_nep.scene.scene import Scene
    from blender_nep.shading.environment import Environment

_DOUBT = 0.03
"""If the validation errors of metal and dielectric differ by less than this share, the photos do not decide between them."""

_CUT = 0.01
"""The artist hears of a cut at the object's sphere if it is more than this share of the surface."""

Given = TypeVar("Given")
Result = TypeVar("Result")


def run(settings: Settings, events: Events, stop: StopRequest, stages: Stages | None = None) -> int:
    """Run a job to its end and return the exit code. An error becomes one `error` event; its traceback goes to the log."""

    job = Job(settings, events, stop, stages or Stages())

    def work() -> None:
        # An SDF in bfloat16 has steps of 1/256 object radii. So a job uses full precision, even if its caller does not.
        with (
            torch.autocast("cpu", enabled=False),
            torch.autocast("cuda", enabled=False),
            compiled_beside(settings.threads or usable_cores()),
        ):
            job.run()

    try:
        return exit_code(work, events, settings.out)
    finally:
        job.close()


@dataclass(frozen=True)
class Learned:
    """The results of the three long stages, and what is known about the scene after them."""

    scene: Scene
    fields: Fields
    surface: SurfaceResult
    materials: Materials

    def light(self) -> Environment:
        """F_e as light, without the camera's response curve."""
        from blender_nep.shading.light_of_photos import LightOfPhotos

        environment, curve = self.fields.environment, self.materials.response
        return environment if curve is None else LightOfPhotos(environment, curve)

    def reports(self) -> dict[StageName, StageReportView]:
        """{stage: its report} of the three long stages."""
        return {
            StageName.FIELDS_LEARNING: FieldsReportView.of(self.fields.report),
            StageName.SURFACE: SurfaceReportView.of(self.surface.report),
            StageName.MATERIAL_LEARNING: MaterialsReportView.of(self.materials.report),
        }


class Job:
    """One run, from the capture to the asset."""

    def __init__(self, settings: Settings, events: Events, stop: StopRequest, stages: Stages) -> None:
        self._settings, self._events, self._stop, self._stages = settings, events, stop, stages
        self._tracker = Tracker(stages.expected_seconds(settings.preset), events)
        self._scene = SceneReport(events)
        self._folder: JobFolder | None = None

    def run(self) -> None:
        """Run all stages. Raises NepError and its subclasses."""
        if not self._settings.profile:
            return self._run(None)
        profile = Profile(torch.cuda.synchronize if choose_device(self._settings.device).type == "cuda" else None)
        with profile.recording():
            self._run(profile)
        profile.write(self._settings.out / PROFILE)
        self._events.say(*profile.table().split("\n"))

    def close(self) -> None:
        """Let another run have the output folder. Before this, all events must be written."""
        if self._folder is not None:
            self._folder.close()

    def _take_folder(self) -> JobFolder:
        """The output folder's job folder, which belongs to this run from now on. Raises UsageError, OutputError."""
        if self._folder is None:
            self._folder = JobFolder(self._settings.out, followed=self._settings.job_files)
        return self._folder

    def _run(self, profile: Profile | None) -> None:
        prepared = self._prepare()
        if prepared is not None:
            learned = self._learn(prepared)
            self._write_asset(prepared, learned, profile)

    def _prepare(self) -> Prepared | None:
        """Check the settings and run the capture stage. None if the asset is complete already."""
        s = self._settings
        refuse_to_overwrite(s)
        if s.job_files:
            self._follow_by_files()
        refuse_missing_mesh(s)
        device = choose_device(s.device)
        keep_freed_memory()
        set_seed_and_threads(s)
        self._tracker.enter(StageName.CAPTURE)
        start = time.monotonic()
        self._tracker.report(StageName.CAPTURE, 0, 1)
        prepared = Preparation(s, device, self._tracker, self._events, self._stop, self._take_folder).run()
        if prepared is None:
            return None
        self._tracker.leave(StageName.CAPTURE, time.monotonic() - start)
        self._scene.left_out(prepared.scene, masks_ignored=not s.use_masks, mesh_given=s.mesh is not None)
        self._scene.add("photos", prepared.scene.photos, prepared.plan)
        return prepared

    def _follow_by_files(self) -> None:
        """Take the job folder and send events there. Before this call, the folder may have belonged to another run."""
        s = self._settings
        folder = self._take_folder()
        folder.take_stderr()
        self._stop.watch_file(folder.stop_file)
        folder.describe(capture=str(s.capture), out=str(s.out), preset=s.preset.name)
        self._events.move_to(folder.path, folder.journal())

    def _learn(self, prepared: Prepared) -> Learned:
        """Run the three long stages."""
        s, capture, preset, folder = self._settings, prepared.capture, prepared.plan.preset, prepared.folder
        scene, given = prepared.scene, None
        if s.mesh is not None:
            given = self._enter(self._stages.surface, SurfaceInput(scene, capture, preset.surface, s.mesh), folder)
        mesh = None if given is None else given.surface
        fields = self._enter(
            self._stages.fields, FieldsInput(scene, preset, s.seed, mesh, self._live_preview(prepared)), folder
        )
        scene = scene.with_support(fields.support)
        self._report_fields(FieldsReportView.of(fields.report))
        surface = given or self._enter(
            self._stages.surface,
            SurfaceInput(scene, capture, preset.surface, object_field=fields.object_field),
            folder,
        )
        scene = scene.with_support(surface.support)
        self._report_surface(SurfaceReportView.of(surface.report))
        with section("scene analysis"):
            shape = SurfaceAnalysis.of(surface.surface, scene.rays, s.seed)
        plan = shape.plan(preset)
        self._scene.add("surface", shape, plan)
        materials_input = MaterialsInput(surface.surface, fields.environment, scene, plan.preset.material, s.seed)
        materials = self._enter(self._stages.materials, materials_input, folder)
        self._report_materials(MaterialsReportView.of(materials.report), plan)
        return Learned(scene, fields, surface, materials)

    def _live_preview(self, prepared: Prepared) -> Callable | None:
        if not self._settings.preview or self._settings.mesh is not None:
            return None
        from blender_nep.job.reporting.live_preview import LivePreview

        return LivePreview(self._settings.out, prepared.scene.rays, prepared.capture.from_unit, self._events)

    def _report_fields(self, report: FieldsReportView) -> None:
        self._scene.act(report.acted)
        self._scene.stopped_early(report.steps_saved, self._tracker.seconds[StageName.FIELDS_LEARNING])
        left_out = report.steps_not_finite
        if left_out:
            self._events.warning(Message("job.steps_left_out", {"count": left_out}))

    def _report_surface(self, report: SurfaceReportView) -> None:
        if report.cut_by_sphere > _CUT:
            self._events.warning(Message("job.cut_by_sphere", {"percent": 100 * report.cut_by_sphere}))

    def _report_materials(self, report: MaterialsReportView, plan: Plan) -> None:
        self._scene.act(report.acted)
        if report.light_seconds > 0.5:  # about 0 where the light came from a checkpoint
            whole, less = self._settings.preset.material, plan.preset.material
            self._scene.skip({}, seconds_of_cones(whole, less, report.light_seconds))
        margin = report.metal_or_not_margin
        if margin is not None and margin < _DOUBT:
            self._events.warning(Message("job.metal_unclear"))

    def _enter(self, stage: Stage[Given, Result], given: Given, folder: RunFolder) -> Result:
        """The result of a stage: read from the disk if it is there, else computed and written.

        Raises NepError and its subclasses; Stopped also before the stage has begun to work.
        """
        name = stage.name
        self._tracker.enter(name)
        saved = folder.load_result(name)
        if saved is not None:
            try:
                result = stage.unpack(saved[0], given)
            except DAMAGED as error:
                values = {"file": f"{name}.done.pt", "reason": f"{type(error).__name__}: {error}"}
                self._events.warning(Message("job.result_damaged", values))
            else:
                self._tracker.take_over(name, saved[1])
                self._events.log(f"stage {name}: taken from the disk")
                return result
        self._events.log(f"stage {name}")
        checkpoint = folder.checkpoint(name)
        checkpoint.raise_if_stopped(saves=False)
        # A stage's kernels are compiled at its first step, once on each machine. Later runs take them from the cache.
        self._tracker.report(name, 0, 1, note=Message("progress.warming_up"))
        with section(name):
            result = stage.run(given, self._progress(name, checkpoint), checkpoint)
        seconds = checkpoint.seconds()
        folder.save_result(name, stage.pack(result), seconds)
        checkpoint.remove()
        self._tracker.report(name, 1, 1, self._tracker.losses.get(name))
        self._tracker.leave(name, seconds)
        return result

    def _progress(self, name: StageName, checkpoint: Checkpoint) -> Progress:
        """The function that the stage calls after every step. It raises Stopped if a stop was asked for."""
        begun = False

        def progress(step: int, steps: int, loss: float | None = None, **extra: Any) -> None:
            nonlocal begun
            if checkpoint.loaded and not begun:
                self._tracker.begin_at(max(step - 1, 0) / max(steps, 1))
            begun = True
            self._tracker.report(name, step, steps, loss, **extra)
            checkpoint.raise_if_stopped(saves=True)

        return progress

    def _explained(self, prepared: Prepared, learned: Learned) -> ExplainedReport:
        """Say how well the asset explains the photos."""
        s = self._settings
        score = explained(
            prepared.scene.rays,
            prepared.held_out,
            s.hold_out,
            learned.fields,
            learned.surface,
            learned.materials,
            s.preset,
            s.seed,
        )
        self._scene.explain(score.sentences())
        for warning in score.warnings():
            self._events.warning(warning)
        return score

    def _write_asset(self, prepared: Prepared, learned: Learned, profile: Profile | None) -> None:
        s, name = self._settings, StageName.ASSET
        self._tracker.enter(name)
        self._tracker.report(name, 0, 1)
        start = time.monotonic()
        light, coverage = learned.light().equirect(s.preset.environment_height)
        if learned.materials.unseen is not None:
            light = learned.materials.unseen.completed(light, coverage)
        with section(name):
            score = self._explained(prepared, learned)
        reports = learned.reports()
        for part in reports.values():
            self._scene.skip(part.skipped, part.seconds_saved)
        kept = learned.materials.kept
        materials = [] if kept is None else kept.listed()
        job_report = JobReport(
            s, prepared, reports, materials, self._scene, score, self._tracker, self._events.warnings, profile
        )

        def report() -> dict:
            self._tracker.seconds[name] = time.monotonic() - start
            return job_report.content()

        capture, scene = prepared.capture, learned.scene
        with section(name), section("preview picture"):
            view = PreviewView.best(scene.rays, learned.surface.surface, learned.materials.response)
        radiance = light.detach().float().cpu().numpy()
        if not s.clean:
            prepared.folder.save_result(PREVIEW, {"view": vars(view), "light": radiance}, 0.0)
        place = Placement(capture.object_center, capture.object_radius)
        given = AssetInput(s.out, scene, capture, place, learned.surface, learned.materials, radiance, view, report)
        with section(name):
            self._stages.asset.run(given)
        if s.clean:
            prepared.folder.remove()
        self._tracker.report(name, 1, 1)
        self._tracker.leave(name, time.monotonic() - start)
        self._events.preview(s.out / "preview.png")
        self._events.done(s.out)
