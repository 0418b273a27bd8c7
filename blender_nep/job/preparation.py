"""The capture stage of a job: checks the settings, reads and analyzes the capture, and makes the output folder."""

from __future__ import annotations

import random
from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np
import torch

from blender_nep.capture import Capture, PixelRays, load_capture
from blender_nep.capture.brightness import to_brightness
from blender_nep.capture.camera_settings import expected_response
from blender_nep.capture.capture import View
from blender_nep.capture.doctor.turntable import MOST_STILL, still_share
from blender_nep.capture.exposure.curve_of_files import curve_of_files
from blender_nep.capture.exposure.from_exif import exif_gains, exposures_by
from blender_nep.capture.exposure.other_light import other_light
from blender_nep.capture.exposure.sessions import sessions, times_of
from blender_nep.capture.exposure.surroundings import Comparison, compare_exposures
from blender_nep.capture.held_out import split
from blender_nep.capture.rays.pixel_store import PixelMemory
from blender_nep.capture.turntable.motions import in_unit_frame, on_turntable
from blender_nep.errors import OutputError, Stopped, UsageError
from blender_nep.files import output_errors, refuse_links
from blender_nep.job.device import usable_cores
from blender_nep.job.folders.own_files import (
    CHECKPOINTS,
    ENTRIES,
    LOG,
    refuse_captures_folder,
    refuse_folder_of_photos,
    refuse_foreign_files,
)
from blender_nep.job.folders.run_folder import RunFolder, fingerprint, refuse_other_run
from blender_nep.job.reporting.events import Events
from blender_nep.job.reporting.tracker import Tracker
from blender_nep.job.settings import Settings
from blender_nep.job.stage_names import StageName
from blender_nep.messages import Message
from blender_nep.ops import numba
from blender_nep.profiling import profiled, section
from blender_nep.safety.plain_files import read_json
from blender_nep.scene.analysis import Plan
from blender_nep.scene.scene import Scene
from blender_nep.stop_request import StopRequest
from blender_nep.surface.mesh_file import read_mesh


@dataclass(frozen=True)
class Prepared:
    """The result of the capture stage. All later stages work with it."""

    capture: Capture
    scene: Scene
    held_out: PixelRays | None
    """The pixels of the photos that were held out from learning, as bright as the scene's. None: no photo was"""
    plan: Plan
    """The preset without the parts that this scene does not need"""
    device: torch.device
    fingerprint: dict[str, object]
    """All inputs that decide the result of the run (`run_folder.fingerprint`)"""
    folder: RunFolder
    left_out: tuple[int, ...] = ()
    """Which photos were left out, counted from 0: those in another light than most; on a turntable, those whose camera did
    not stand still. `capture` and `rays` lack them."""


@dataclass(frozen=True)
class _Photos:
    """The photos to learn from."""

    capture: Capture
    """Only with these photos"""
    rays: PixelRays
    compared: Comparison | None
    """Their exposures; None: they share too little"""
    left_out: tuple[int, ...]
    """`Prepared.left_out`"""
    held_out: Capture | None
    """The capture with the photos that are held out; None: no photo is"""


def refuse_to_overwrite(settings: Settings) -> None:
    """Raises UsageError when the output folder is the capture's, or holds what a job would replace and may not replace.

    That is an asset or a run, where neither --resume nor --overwrite is given, and always files that are not ours. Raises
    OutputError when the output path is not a folder, and when something there that a run writes is a link.
    """
    out = settings.out
    if out.exists() and not out.is_dir():
        raise OutputError(f"{out} is a file, not a folder", "Choose another --out.", "output.is_a_file", path=out)
    refuse_links(out, ENTRIES)
    refuse_captures_folder(out, settings.capture)
    refuse_foreign_files(out)
    if settings.resume or settings.overwrite or not out.exists():
        return
    with output_errors(out):
        if (out / "report.json").exists() or (out / "mesh.obj").exists():
            hint = "Choose another --out, or give --overwrite."
            raise UsageError(f"{out} already holds an asset", hint, "usage.asset_exists", folder=out)
        if (out / CHECKPOINTS).exists():
            hint = "Go on with --resume, or start again with --overwrite."
            raise UsageError(f"{out} holds a run that did not end", hint, "usage.run_exists", folder=out)


def refuse_missing_mesh(settings: Settings) -> None:
    """Raises UsageError when --mesh names no file."""
    if settings.mesh is not None and not settings.mesh.is_file():
        mesh = settings.mesh
        raise UsageError(f"there is no mesh {mesh}", "Check the path of --mesh.", "usage.no_mesh", path=mesh)


def set_seed_and_threads(settings: Settings) -> None:
    """Set the seed of every random generator that a library may use, and the number of threads."""
    threads = settings.threads or usable_cores()
    torch.set_num_threads(threads)
    numba.set_num_threads(min(threads, numba.config.NUMBA_NUM_THREADS))  # type: ignore[attr-defined]  # made at import
    random.seed(settings.seed)
    np.random.seed(settings.seed % 2**32)
    torch.manual_seed(settings.seed)


class Preparation:
    """Runs the capture stage."""

    def __init__(
        self,
        settings: Settings,
        device: torch.device,
        tracker: Tracker,
        events: Events,
        stop: StopRequest,
        take_folder: Callable[[], object],
    ) -> None:
        """`take_folder` makes the output folder this run's own. It raises UsageError while another run has it."""
        self._settings, self._device, self._take_folder = settings, device, take_folder
        self._tracker, self._events, self._stop = tracker, events, stop
        self._folder = RunFolder(settings.out, stop, events.warning)

    def run(self) -> Prepared | None:
        """Do the work of the stage. Returns None on a resume if the asset that was asked for is complete already.

        Raises CaptureError, BoundsError, UsageError, OutputError and Stopped.
        """
        s = self._settings
        capture = self._load_capture()
        what = fingerprint(
            capture, s.preset, s.seed, s.use_masks, s.mesh, s.sphere, s.all_photos, s.hold_out, s.mask_meaning, s.turntable
        )
        refuse_folder_of_photos(s.out, capture, s.mesh)
        if s.hold_out is not None:
            split(capture, s.hold_out)  # to refuse too small a number before the photos are read
        if s.mesh is not None:
            read_mesh(s.mesh, capture)  # to refuse one that is not usable before the light is learned
        if s.resume and (s.out / "report.json").is_file():
            self._finish_complete(what)
            return None
        if s.resume:
            self._folder.can_be_resumed(what)  # to refuse another run before the photos are read
        photos = self._choose_photos(capture)
        scene = self._look(photos)
        first = photos.capture.views[0]
        scored = None if photos.held_out is None else self._read_held_out(photos.held_out, scene.rays, first)
        self._make_output()
        if s.resume and self._folder.can_be_resumed(what):
            self._events.say(f"resuming the run in {s.out}")
        else:
            self._folder.begin(what)
            if s.resume:
                self._events.say(f"{s.out} holds no checkpoint yet: starting from the beginning")
        plan = scene.photos.plan(s.preset)
        return Prepared(photos.capture, scene, scored, plan, self._device, what, self._folder, photos.left_out)

    def _choose_photos(self, capture: Capture) -> _Photos:
        """Read the photos, but for those in another light than most and those that are held out. Raises CaptureError.

        If the object turned, the rays know how it stood. A photo whose camera did not stand still is left out then.
        """
        rays, held_out = self._read_photos(capture), None
        views = len(capture.views)
        kept = list(range(views))
        if self._is_turntable(capture, rays):
            capture, moved = self._with_motions(capture)
            kept = [i for i in kept if i not in moved]
            if moved:
                del rays  # before the others are in memory, too
                rays = self._read_photos(capture)
            else:
                rays = self._moved(rays, capture, capture.views[0])
        with section("scene analysis"):
            compared = compare_exposures(rays)
            other = () if compared is None else self._in_other_light(capture, compared)
        left_out = tuple(i for i in range(views) if i not in kept or kept.index(i) in other)
        if other:
            capture = replace(capture, views=[view for i, view in enumerate(capture.views) if i not in other])
        if self._settings.hold_out is not None:
            capture, held_out = split(capture, self._settings.hold_out)
        if other or held_out is not None:
            del rays  # before the others are in memory, too
            rays = self._read_photos(capture)
            with section("scene analysis"):
                compared = compare_exposures(rays)
        for warning in rays.warnings:
            self._events.warning(warning)
        return _Photos(capture, rays, compared, left_out, held_out)

    def _is_turntable(self, capture: Capture, rays: PixelRays) -> bool:
        """Whether the object turned while camera and light stood still: as was asked for, as told, or as it looks."""
        wanted = capture.turntable if self._settings.turntable is None else self._settings.turntable
        if not self._settings.preset.turntable or wanted is not None:
            return bool(wanted) and self._settings.preset.turntable
        with section("scene analysis"):
            share = still_share(rays)
        if share is None or share <= MOST_STILL:
            return False
        self._events.warning(Message("capture.on_turntable", {"percent": 100 * share}))
        return True

    def _with_motions(self, capture: Capture) -> tuple[Capture, tuple[int, ...]]:
        """The capture whose views know how the object stood on the turntable, and the photos that it lacks.

        The user is told what is not known.
        """
        found = on_turntable(capture)
        if found.left_out:
            names = [capture.views[i].name for i in found.left_out]
            self._events.warning(Message("capture.turntable_left_out", {"count": len(names), "names": names}))
        if not found.angles_known:
            self._events.warning(Message("capture.turntable_side", {"rows": found.rows}))
        return found.capture, found.left_out

    @staticmethod
    def _moved(rays: PixelRays, capture: Capture, first: View) -> PixelRays:
        """The pixels of the capture's photos with the motions of the object, if it turned. In `first`, it had not moved."""
        if first.in_room is None:
            return rays
        return rays.with_turntable(in_unit_frame(capture, first, rays.radiance.device))

    @profiled("scene analysis")
    def _look(self, photos: _Photos) -> Scene:
        """The photos as bright as they are learned from, and what they show."""
        preset, rays = self._settings.preset, photos.rays
        response = expected_response(photos.capture)
        if preset.even_exposure:
            rays = self._even_out(rays, photos, response)
        if preset.brightness > 0:
            rays = to_brightness(rays, preset.brightness)
        return Scene.of(rays, response)

    def _finish_complete(self, what: dict[str, object]) -> None:
        """End a resume of an asset that is complete. Raises UsageError if it is not the asset that was asked for."""
        s = self._settings
        try:
            before = dict(read_json(s.out / "report.json").get("fingerprint", {}))
        except (OSError, TypeError, ValueError, AttributeError) as error:
            report = s.out / "report.json"
            hint = "Start again with --overwrite."
            raise UsageError(f"{report} is damaged", hint, "usage.report_damaged", path=report) from error
        refuse_other_run(s.out, before, what)
        if s.clean and self._folder.path.exists():
            self._folder.remove()
        self._events.say("the asset is complete: there is nothing to resume")
        self._events.done(s.out)

    @profiled("capture")
    def _load_capture(self) -> Capture:
        s = self._settings
        capture = load_capture(s.capture, use_masks=s.use_masks, mask_meaning=s.mask_meaning, sphere=s.sphere)
        for warning in capture.warnings:
            self._events.warning(warning)
        return capture

    @profiled("capture")
    def _read_photos(self, capture: Capture) -> PixelRays:
        s = self._settings
        memory = PixelMemory(s.preset.max_pixels, s.preset.pixels_in_memory, s.out)
        rays = PixelRays.from_capture(
            capture, s.preset.max_pixels_per_photo, s.use_masks, self._device, memory=memory, progress=self._photo_read
        )
        self._tracker.report(StageName.CAPTURE, 1, 1)
        return self._moved(rays, capture, capture.views[0])

    @profiled("capture")
    def _read_held_out(self, held_out: Capture, learned: PixelRays, first: View) -> PixelRays:
        """The pixels of the photos that are held out, with the vignetting and the exposure of those that are not.

        `first` is the first photo that is learned from. A turntable's object stands in its room as it stood there.
        """
        s = self._settings
        rays = PixelRays.from_capture(held_out, s.preset.max_pixels_per_photo, s.use_masks, self._device)
        rays = self._moved(rays, held_out, first).with_curve_of_files(learned.curve_of_files)
        return rays.with_gain(None, learned.vignetting).with_exposure(learned.exposure)

    def _photo_read(self, done: int, photos: int) -> None:
        self._tracker.report(StageName.CAPTURE, done, photos)
        if self._stop.requested:
            message = f"stopped ({self._stop.reason}) while the photos were read"
            raise Stopped(message, "Start it again with --resume.", "stopped.reading_photos", reason=self._stop.reason)

    def _in_other_light(self, capture: Capture, compared: Comparison) -> tuple[int, ...]:
        """The photos that are left out, because they were taken in another light than most. The user is told."""
        found = () if self._settings.all_photos else other_light(compared, times_of(capture))
        if found:
            names = [capture.views[i].name for i in found]
            self._events.warning(Message("capture.other_light", {"count": len(found), "names": names}))
        return found

    def _even_out(self, rays: PixelRays, photos: _Photos, expected: float | None) -> PixelRays:
        """The same pixels with the gains of the photos, if the photos' exposures differ, and without vignetting.

        `expected` is the likely strength of the camera's response curve. If EXIF's exposures tell the curve, it is undone
        before they are evened out.
        """
        compared, material = photos.compared, self._settings.preset.material
        exif = exif_gains(photos.capture), sessions(times_of(photos.capture))
        if compared is not None and material.camera_response:
            curve = curve_of_files(rays, compared, *exif, expected, material.response_prior)
            if curve is not None:
                rays = rays.with_curve_of_files(curve)
                compared = compare_exposures(rays)
        exposures = exposures_by(*exif, compared, rays.radiance.device)
        if exposures.warning:
            self._events.warning(exposures.warning)
        return rays.with_gain(exposures.gain, exposures.vignetting)

    def _make_output(self) -> None:
        out = self._settings.out
        with output_errors(out):
            out.mkdir(parents=True, exist_ok=True)
            self._take_folder()
            refuse_to_overwrite(self._settings)  # another run may have come while the photos were read
            self._events.open_log(out / LOG)
