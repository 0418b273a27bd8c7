"""The five stages in order: capture, fields learning, surface, material learning, asset.

Each stage's result is written before the next begins, so that a killed run goes on from there.
"""

from __future__ import annotations

import json
import os
import random
import time
import traceback
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numba
import numpy as np
import torch

from blender_nep.capture import Capture, PixelRays, load_capture
from blender_nep.capture.exposure import find_exposures
from blender_nep.capture.pixel_store import PixelMemory
from blender_nep.errors import NepError, OutputError, Stopped, UsageError
from blender_nep.files import output_errors
from blender_nep.job.device import choose_device, peak_memory, usable_cores, versions
from blender_nep.job.events import Events, Timeline
from blender_nep.job.job_folder import JobFolder
from blender_nep.job.run_folder import RunFolder, fingerprint, refuse_other_run
from blender_nep.job.scene_analysis import SceneAnalysis, SurfaceAnalysis, seconds_of_cones
from blender_nep.job.scene_report import SceneReport
from blender_nep.job.stages import Stages
from blender_nep.presets import Preset
from blender_nep.profiling import Profile, profiled, section
from blender_nep.stop_request import StopRequest

STAGES = ("capture", "fields_learning", "surface", "material_learning", "asset")
_DOUBT = 0.03
"""Share of the error by which metal and not metal must differ; under it the photos do not tell."""


@dataclass(frozen=True)
class Settings:
    """What the user asked for."""

    capture: Path
    out: Path
    preset: Preset
    device: str = "auto"
    seed: int = 0
    use_masks: bool = True
    mesh: Path | None = None
    sphere: tuple[tuple[float, float, float], float] | None = None
    """Centre and radius of the object's sphere, capture coordinates; None: the capture's own, or estimated."""
    resume: bool = False
    overwrite: bool = False
    clean: bool = False
    threads: int | None = None
    job_files: bool = False
    preview: bool = False
    profile: bool = False


def run(settings: Settings, events: Events, stop: StopRequest, stages: Stages | None = None) -> int:
    """Run a job to its end; returns the exit code. An error is one `error` event, its traceback goes to the log."""
    try:
        # An SDF in bfloat16 has steps of 1/256 object radii: where a caller has lowered the precision, a job does not.
        with torch.autocast("cpu", enabled=False), torch.autocast("cuda", enabled=False):
            Job(settings, events, stop, stages or Stages()).run()
        return 0
    except NepError as error:
        events.log("".join(traceback.format_exception(error)))
        events.error(error.code, error.message, error.hint)
        return error.code
    except KeyboardInterrupt:
        events.error(7, "interrupted", "Work since the last checkpoint is lost; --resume goes on from there.")
        return 7
    except Exception as error:  # the last resort: a bug, or no memory; the log has it all
        events.log("".join(traceback.format_exception(error)))
        where = f"The details are in {settings.out / 'log.txt'}."
        if not events.has_log:
            where = "".join(traceback.format_exception(error))
        events.error(1, *_unexpected(error, where))
        return 1
    finally:
        events.close()


def _unexpected(error: Exception, where: str) -> tuple[str, str]:
    if isinstance(error, MemoryError | torch.OutOfMemoryError) or "allocate memory" in str(error):
        return "out of memory", f"Try --preset preview, or smaller photos. {where}"
    text = " ".join(str(error).split())
    return f"unexpected {type(error).__name__}: {text[:200]}", where


class Job:
    """One run, from the capture to the asset."""

    def __init__(self, settings: Settings, events: Events, stop: StopRequest, stages: Stages) -> None:
        self.settings, self.events, self.stop, self.stages = settings, events, stop, stages
        preset = settings.preset
        self.timeline = Timeline(
            {
                "capture": 5.0,
                "fields_learning": preset.fields_seconds,
                "surface": preset.surface_seconds,
                "material_learning": preset.material_seconds,
                "asset": 10.0,
            }
        )
        self.seconds: dict[str, float] = {}
        self.resumed: list[str] = []
        self.losses: dict[str, float] = {}
        self.profile: Profile | None = None

    def run(self) -> None:
        """All stages. Raises NepError and its kinds."""
        if not self.settings.profile:
            return self._run()
        self.profile = Profile(torch.cuda.synchronize if choose_device(self.settings.device).type == "cuda" else None)
        with self.profile.recording():
            self._run()
        self.profile.write(self.settings.out / "profile.json")
        self.events.say(self.profile.table())

    def _run(self) -> None:
        s = self.settings
        self._refuse_to_overwrite()
        if s.job_files:
            self._open_job_folder()
        if s.mesh is not None and not s.mesh.is_file():
            raise UsageError(f"there is no mesh {s.mesh}", "Check the path of --mesh.")
        self.device = choose_device(s.device)
        self._seed_and_threads()
        self.timeline.enter("capture")
        start = time.monotonic()
        self._progress("capture", 0, 1, None)
        capture = self._load_capture()
        what = fingerprint(capture, s.preset, s.seed, s.use_masks, s.mesh, s.sphere)
        self.folder = RunFolder(s.out, self.stop, self.events.warning)
        if s.resume and (s.out / "report.json").is_file():
            self._finish_complete(what)
            return
        rays = self._read_photos(capture)
        with section("scene analysis"):
            if s.preset.even_exposure:
                rays = self._even_out(rays)
            photos = SceneAnalysis.of(rays)
        self.timeline.leave()
        self.seconds["capture"] = time.monotonic() - start
        plan = photos.plan(s.preset)
        preset = plan.preset
        self._make_output()
        if self.folder.begin(what, resume=s.resume):
            self.events.say(f"resuming the run in {s.out}")
        elif s.resume:
            self.events.say(f"{s.out} holds no checkpoint yet: starting from the beginning")
        self.scene = SceneReport(self.events)
        self.scene.left_out(rays, masks_ignored=not s.use_masks, mesh_given=s.mesh is not None)
        self.scene.add("photos", photos, plan)

        given = None
        if s.mesh is not None:
            given = self._stage(
                "surface",
                lambda *_: (self.stages.load_surface(s.mesh, capture, preset.surface), {}),
                self.stages.pack_surface,
                self.stages.unpack_surface,
            )
        fields = self._stage(
            "fields_learning",
            lambda progress, checkpoint: self.stages.learn_fields(
                rays,
                preset,
                seed=s.seed,
                device=self.device,
                progress=progress,
                checkpoint=checkpoint,
                surface=given and given[0],
                **self._watching(capture, rays),
            ),
            self.stages.pack_fields,
            lambda state: self.stages.unpack_fields(state, preset, self.device),
        )
        learned = fields.report
        if "of_steps" in learned:
            self.scene.stopped_early(learned["steps"], learned["of_steps"], self.seconds["fields_learning"])
        surface, surface_report = given or self._stage(
            "surface",
            lambda *_: self.stages.extract_surface(fields.object_field, preset.surface),
            self.stages.pack_surface,
            self.stages.unpack_surface,
        )
        with section("scene analysis"):
            shape = SurfaceAnalysis.of(surface, rays, s.seed)
        plan = shape.plan(preset)
        self.scene.add("surface", shape, plan)
        materials = self._stage(
            "material_learning",
            lambda progress, checkpoint: self.stages.learn_materials(
                surface,
                fields.environment,
                rays,
                plan.preset.material,
                seed=s.seed,
                device=self.device,
                progress=progress,
                checkpoint=checkpoint,
            ),
            self.stages.pack_materials,
            self.stages.unpack_materials,
        )
        left_out = fields.report.get("steps_not_finite")
        if left_out:
            self.events.warning(f"{left_out} steps of fields learning were left out: their loss or gradient was not finite")
        gathering = materials.report.get("seconds", {}).get("light", 0.0)
        if gathering > 0.5:  # not so where it came from a checkpoint
            self.scene.skip({}, seconds_of_cones(s.preset.material, plan.preset.material, gathering))
        margin = materials.report.get("metal_or_not_margin")
        if margin is not None and margin < _DOUBT:
            self.events.warning(
                "the photos hardly tell whether the object is metal: where the result is wrong, say so "
                "by --metal yes or --metal no"
            )
        parts = {"fields_learning": fields.report, "surface": surface_report, "material_learning": materials.report}
        self._write_asset(capture, rays, surface, materials, fields.environment, parts, what)

    def _finish_complete(self, what: dict[str, object]) -> None:
        """A resume of an asset that is complete: nothing to do, if it is what was asked for."""
        s = self.settings
        try:
            before = json.loads((s.out / "report.json").read_text(encoding="utf-8")).get("fingerprint", {})
        except (OSError, ValueError, AttributeError) as error:
            raise UsageError(f"{s.out / 'report.json'} is damaged", "Start again with --overwrite.") from error
        refuse_other_run(s.out, before, what)
        if s.clean and self.folder.path.exists():
            self.folder.remove()
        self.events.say("the asset is complete: there is nothing to resume")
        self.events.done(s.out)

    def _refuse_to_overwrite(self) -> None:
        s = self.settings
        if s.out.exists() and not s.out.is_dir():
            raise OutputError(f"{s.out} is a file, not a folder", "Choose another --out.")
        if s.resume or s.overwrite or not s.out.exists():
            return
        with output_errors(s.out):
            if (s.out / "report.json").exists() or (s.out / "mesh.obj").exists():
                raise UsageError(f"{s.out} already holds an asset", "Choose another --out, or give --overwrite.")
            if (s.out / "checkpoints").exists():
                raise UsageError(
                    f"{s.out} holds a run that did not end", "Go on with --resume, or start again with --overwrite."
                )

    def _open_job_folder(self) -> None:
        """From here on the run is followed by its files. Before, the folder may have been somebody else's."""
        s = self.settings
        self.job_folder = JobFolder(s.out)
        self.job_folder.take_stderr()
        self.stop.watch_file(self.job_folder.stop_file)
        self.job_folder.describe(capture=str(s.capture), out=str(s.out), preset=s.preset.name)
        self.events.move_to(self.job_folder.path, self.job_folder.journal)

    def _watching(self, capture: Capture, rays: PixelRays) -> dict[str, Any]:
        if not self.settings.preview or self.settings.mesh is not None:
            return {}
        from blender_nep.job.live_preview import LivePreview

        return {"watch": LivePreview(self.settings.out, rays, capture.from_unit, self.events)}

    def _seed_and_threads(self) -> None:
        threads = self.settings.threads or usable_cores()
        torch.set_num_threads(threads)
        numba.set_num_threads(min(threads, numba.config.NUMBA_NUM_THREADS))
        random.seed(self.settings.seed)
        np.random.seed(self.settings.seed % 2**32)
        torch.manual_seed(self.settings.seed)

    def _make_output(self) -> None:
        out = self.settings.out
        with output_errors(out):
            out.mkdir(parents=True, exist_ok=True)
            if self.settings.overwrite and not self.settings.resume:
                (out / "report.json").unlink(missing_ok=True)  # from here on the folder is no valid asset
                (out / "profile.json").unlink(missing_ok=True)
            self.events.open_log(out / "log.txt")

    @profiled("capture")
    def _load_capture(self) -> Capture:
        s = self.settings
        capture = load_capture(s.capture, use_masks=s.use_masks, sphere=s.sphere)
        for warning in capture.warnings:
            self.events.warning(warning)
        return capture

    @profiled("capture")
    def _read_photos(self, capture: Capture) -> PixelRays:
        s = self.settings
        memory = PixelMemory(s.preset.max_pixels, s.preset.pixels_in_memory, s.out)
        rays = PixelRays.from_capture(
            capture, s.preset.max_pixels_per_photo, s.use_masks, self.device, memory=memory, progress=self._photo_read
        )
        for warning in rays.warnings:
            self.events.warning(warning)
        self._progress("capture", 1, 1, None)
        return rays

    def _even_out(self, rays: PixelRays) -> PixelRays:
        """The photos as of one exposure, where theirs differ."""
        found = find_exposures(rays)
        if found.warning:
            self.events.warning(found.warning)
        return rays if found.gain is None else rays.with_gain(found.gain)

    def _photo_read(self, done: int, photos: int) -> None:
        self._progress("capture", done, photos, None)
        if self.stop.requested:
            raise Stopped(f"stopped ({self.stop.reason}) while the photos were read", "Start it again with --resume.")

    def _progress(self, stage: str, step: int, steps: int, loss: float | None, **extra: Any) -> None:
        fraction, eta = self.timeline.at(step / max(steps, 1))
        preview = extra.pop("preview", None)
        self.events.progress(stage, step, steps, fraction, eta, loss, **extra)
        if preview is not None:
            self.events.preview(Path(preview))

    def _stage(self, stage: str, work: Callable, pack: Callable[[Any], dict], unpack: Callable[[dict], Any]) -> Any:
        """Enter a stage: take its result from the disk, or work and write it. Raises Stopped between stages, too."""
        self.timeline.enter(stage)
        saved = self.folder.load_result(stage)
        if saved is not None:
            self.seconds[stage] = saved[1]
            self.resumed.append(stage)
            self.timeline.leave(skipped=True)
            self.events.log(f"stage {stage}: taken from the disk")
            return unpack(saved[0])
        self.events.log(f"stage {stage}")
        checkpoint = self.folder.checkpoint(stage)
        checkpoint.raise_if_stopped(saves=False)

        begun = False

        def progress(step: int, steps: int, loss: float | None = None, **extra: Any) -> None:
            nonlocal begun
            if checkpoint.loaded and not begun:
                self.timeline.begin_at(max(step - 1, 0) / max(steps, 1))
            begun = True
            if loss is not None:
                self.losses[stage] = float(loss)
            self._progress(stage, step, steps, None if loss is None else float(loss), **extra)
            checkpoint.raise_if_stopped(saves=True)

        # a stage's kernels are compiled at its first step, on each machine once; later runs take them from the cache
        self._progress(stage, 0, 1, None, note="warming up")
        with section(stage):
            result = work(progress, checkpoint)
        self.seconds[stage] = checkpoint.seconds()
        self.folder.save_result(stage, pack(result), self.seconds[stage])
        checkpoint.remove()
        self._progress(stage, 1, 1, self.losses.get(stage))
        self.timeline.leave()
        return result

    def _write_asset(
        self,
        capture: Capture,
        rays: PixelRays,
        surface: Any,
        materials: Any,
        environment: Any,
        parts: dict[str, dict],
        what: dict[str, object],
    ) -> None:
        s = self.settings
        self.timeline.enter("asset")
        self._progress("asset", 0, 1, None)
        start = time.monotonic()
        light, coverage = environment.equirect(s.preset.environment_height)
        if materials.unseen is not None:
            more = materials.unseen.equirect(s.preset.environment_height).to(light.device)
            light = light + more * (1 - coverage)[..., None]
        for part in parts.values():
            self.scene.skip(part.get("skipped", {}), part.get("seconds_saved", {}))

        def report() -> dict:
            self.seconds["asset"] = time.monotonic() - start
            return {
                "preset": s.preset.name,
                "seed": s.seed,
                "device": str(self.device),
                "threads": torch.get_num_threads(),
                "versions": versions(),
                "capture": {
                    "folder": os.path.abspath(capture.folder),
                    "views": len(capture.views),
                    "pixels": rays.count,
                    "color_space": capture.color_space,
                    "object_center": capture.object_center.tolist(),
                    "object_radius": capture.object_radius,
                    "bounds_source": capture.bounds_source,
                    "masks": rays.mask is not None,
                    **({} if rays.gain is None else {"photo_gains": np.round(rays.gain.tolist(), 4).tolist()}),
                },
                "seconds": {stage: round(self.seconds[stage], 2) for stage in STAGES},
                "seconds_total": round(sum(self.seconds.values()), 2),
                "peak_memory_mb": None if peak_memory() is None else round(peak_memory(), 1),
                "resumed_stages": self.resumed,
                **self.scene.report(),
                "losses": self.losses,
                **({} if self.profile is None else {"profile": self.profile.report()}),
                "stages": {
                    stage: {k: v for k, v in part.items() if k not in ("skipped", "seconds_saved")}
                    for stage, part in parts.items()
                },
                "warnings": self.events.warnings,
                "fingerprint": what,
            }

        with section("asset"):
            self.stages.write_asset(s.out, capture, rays, surface, materials, (light, coverage), report)
        if s.clean:
            self.folder.remove()
        self._progress("asset", 1, 1, None)
        self.timeline.leave()
        self.events.preview(s.out / "preview.png")
        self.events.done(s.out)
