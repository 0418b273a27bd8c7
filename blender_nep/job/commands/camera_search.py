"""The command that finds the cameras of photos or of a video's frames, or improves given ones, and writes a capture."""

from __future__ import annotations

import os
import shutil
from collections.abc import Mapping
from dataclasses import dataclass, replace
from functools import partial
from importlib.util import find_spec
from pathlib import Path
from types import MappingProxyType

import numpy as np

from blender_nep.cameras.found_cameras import FoundCameras, choose, messages
from blender_nep.cameras.improved_cameras import take_over
from blender_nep.cameras.object_sphere import ObjectSphere, find_object_sphere
from blender_nep.cameras.photo_folder import Photo, find_photos, photos_of
from blender_nep.cameras.still_surroundings import StillSurroundings, look_for_still_surroundings
from blender_nep.cameras.structure_from_motion import Group, PlacedPhoto, find_groups, stop_if_asked, working_folder
from blender_nep.cameras.video.kept_frames import FOLDER as FRAMES
from blender_nep.cameras.video.kept_frames import keep_frames
from blender_nep.cameras.video.named_video import video_of
from blender_nep.cameras.written_capture import check_writable, keep_present_file, without_resume, write_capture
from blender_nep.capture.brackets import bracket_warnings
from blender_nep.capture.capture import Capture, View
from blender_nep.capture.formats import transforms
from blender_nep.capture.formats.mask_search import photo_mask_messages
from blender_nep.capture.loading import load_capture
from blender_nep.capture.mask_meaning import read_photo_masks
from blender_nep.capture.turntable.motions import on_turntable
from blender_nep.errors import BoundsError, CaptureError, NepError, OutputError, UsageError
from blender_nep.job.exit_code import exit_code
from blender_nep.job.reporting.events import Events
from blender_nep.job.reporting.timeline import Timeline
from blender_nep.job.stage_names import CAMERA_SEARCH
from blender_nep.messages import Message
from blender_nep.stop_request import StopRequest

_SECONDS = {"photos": 0.1, "features": 2.0, "matches": 4.0, "places": 2.0, "sphere": 0.3}
"""First guess of the seconds that a photo takes in each step"""
_SURROUNDINGS_SECONDS = 0.1
"""The same for the comparison that tells a turntable"""
ENOUGH_ON_OBJECT, MUCH_BETTER = 0.9, 0.75
"""Features on the object alone are taken if they place this share of the photos that all features place, and if their error
is at most the second number times that of all features."""
_VIDEO_SECONDS = 0.7
"""The same for a frame that is taken from a video: some 20 others are looked at for it"""


@dataclass(frozen=True)
class CameraSearch:
    """What the command `cameras` is asked for."""

    photos: Path
    """Folder with photos, or a video; to improve cameras, a capture"""
    out: Path | None = None
    """Folder of the capture that is written; None: `photos`, and for a video the folder with its name, without the ending"""
    features: str = "everywhere"
    """Where features count: 'everywhere', or where masks allow them: on the 'object', or in its 'surroundings'"""
    improve: bool = False
    """Improve the capture's cameras instead of finding cameras anew"""
    overwrite: bool = False
    threads: int | None = None
    frames: int = 80
    """So many frames of a video become photos at most"""
    turntable: bool | None = None
    """Whether the object turned on a turntable; None: as the capture says, or as the photos show"""

    @property
    def capture(self) -> Path:
        """Folder of the capture that is written"""
        if self.out is not None:
            return self.out
        return self.photos.with_suffix("") if self.photos.is_file() else self.photos


def run(search: CameraSearch, events: Events, stop: StopRequest) -> int:
    """Find or improve the cameras, write the capture, and return the exit code. A stopped search writes nothing."""
    folder = search.capture

    def work() -> None:
        _refuse_capture(folder, search.overwrite)
        video = None if search.improve else video_of(search.photos)
        if video is None:
            find(search.photos, None)
            return
        _refuse_masks(search, video)
        check_writable(folder)
        with working_folder() as scratch:
            find(scratch, _frames_of(video, search, scratch, events, stop))

    def find(photos: Path, frames: _Frames | None) -> None:
        capture = load_capture(photos, use_masks=False) if search.improve else None
        found = find_photos(photos, search.features != "everywhere") if capture is None else photos_of(capture)
        check_writable(folder)
        of_masks = photo_mask_messages(photos, [photo.path for photo in found])
        brackets = bracket_warnings([photo.path for photo in found])
        for warning in of_masks + brackets if capture is None else capture.warnings:
            events.warning(warning)
        masked, still = _masked(search, found), None
        told = capture.turntable if capture is not None and search.turntable is None else search.turntable
        looks = masked is None and (capture is None if told is None else told)
        progress = _Progress(events, len(found), looks=looks) if frames is None else frames.progress
        turned = bool(told)
        if looks:
            still = look_for_still_surroundings(found, partial(_report_surroundings, progress, stop))
            turned |= still.turntable
            if turned and all(photo.mask is not None for photo in found):
                masked = True
        if masked is not None:
            found, of_meaning = _with_masks_read(found)
            for warning in of_meaning:
                events.warning(warning)
        given = None if capture is None else [view.camera for view in capture.views]
        with working_folder() as scratch:
            moving = still.moving if still is not None and masked is None else None
            groups = find_groups(
                found, scratch, progress, stop, masked=masked, moving=moving, threads=search.threads, given=given
            )
            drifts = masked is None and capture is None and still is not None and still.drift
            by_masks = _by_masks(found, groups, scratch, progress, stop, search.threads) if drifts else None
            if by_masks is not None:
                found, groups, of_meaning = by_masks
                for warning in of_meaning:
                    events.warning(warning)
            if capture is None:
                cameras = choose(found, groups)
                said, warnings = messages(cameras, groups)
                said += [] if by_masks is None else [Message("cameras.by_masks")]
                sure = still is not None and still.turntable and not still.shifted and _form_rows(cameras)
                cameras = replace(cameras, turntable=told if told is not None or not sure else True)
                if told is None and still is not None and still.turntable:
                    known = masked is not None or moving is not None
                    message = _of_turntable(still, known, sure)
                    (said if message.code == "cameras.turntable" else warnings).append(message)
                cameras = _with_sphere(cameras, scratch, progress, stop, warnings)
        if capture is not None:
            improved = take_over(found, [view.camera for view in capture.views], groups[0], capture.object_center)
            said, warnings = improved.messages()
            sphere = (capture.object_center, capture.object_radius)
            cameras = FoundCameras(_with_rows(improved.chosen, capture), groups[0].points, [], *sphere, told)
        if capture is None or improved.worthwhile or search.out is not None:
            stop_if_asked(stop)
            said += _keep_present(folder)
            if frames is not None:
                said = frames.said + said
                _write_with_frames(cameras, folder, photos)
            elif capture is None:
                write_capture(cameras, folder)
            else:  # a sphere that is only a guess from the cameras would keep later jobs from asking the masks
                stated = capture.bounds_source != "cameras"
                write_capture(cameras, folder, capture.color_space, with_sphere=stated)
        for warning in warnings:
            events.warning(warning)
        events.scene(said)
        for message in said:
            events.say(str(message))
        progress.end()
        events.done(folder)

    return exit_code(work, events, search.photos, "Start it again.")


@dataclass(frozen=True)
class _Frames:
    """What is known of a video's frames when they are photos."""

    said: list[Message]
    progress: _Progress


def _frames_of(video: Path, search: CameraSearch, folder: Path, events: Events, stop: StopRequest) -> _Frames:
    """Write the video's frames as photos into the folder `images` in `folder`, and report the warnings about them.

    Raises NepError where PyAV is not installed: photos need no PyAV.
    """
    if find_spec("av") is None:
        raise NepError("PyAV is not installed", "Install it: pip install av.", "unexpected.no_pyav")
    from blender_nep.cameras.video.taken_frames import take_frames

    progress = _Progress(events, search.frames, of_video=True, looks=search.turntable is not False)

    def report(step: int, steps: int) -> None:
        stop_if_asked(stop)
        progress("video", step, steps)

    with without_resume():
        taken = take_frames(video, search.frames, folder / FRAMES, report, search.threads)
    for warning in taken.warnings:
        events.warning(warning)
    return _Frames(taken.said, progress)


def _write_with_frames(cameras: FoundCameras, folder: Path, scratch: Path) -> None:
    """Write the capture together with the frames, which are in `scratch`. Raises OutputError; then both are missing."""
    with without_resume():
        frames = keep_frames(scratch / FRAMES, folder)
    placed = [replace(one, photo=replace(one.photo, path=frames / one.photo.path.name)) for one in cameras.placed]
    try:
        write_capture(replace(cameras, placed=placed), folder)
    except OutputError:
        shutil.rmtree(frames, ignore_errors=True)
        raise


def _with_masks_read(photos: list[Photo]) -> tuple[list[Photo], list[Message]]:
    """The photos with what their masks mean, and warnings about it. Raises CaptureError."""
    reading, warnings = read_photo_masks([photo.mask for photo in photos if photo.mask is not None])
    return [replace(photo, mask_reading=reading) for photo in photos], warnings


def _by_masks(
    photos: list[Photo], groups: list[Group], scratch: Path, progress: _Progress, stop: StopRequest, threads: int | None
) -> tuple[list[Photo], list[Group], list[Message]] | None:
    """The photos, their groups by features on the object alone, and warnings about the masks.

    None where a photo has no mask, or where these groups do not agree much better than `groups`. `scratch` is a folder for
    files of the search. Raises Stopped on request.
    """
    if any(photo.mask is None for photo in photos):
        return None
    place = scratch / "of_object"
    place.mkdir()
    try:
        read, warnings = _with_masks_read(photos)
        progress("way", len(groups[0].placed) if groups else 0, len(photos))
        of_object = find_groups(read, place, progress, stop, masked=True, threads=threads)
    except CaptureError:  # a mask cannot be read; cameras are there without masks, too
        return None
    return (read, of_object, warnings) if _agree_better(of_object, groups) else None


def _agree_better(of_object: list[Group], groups: list[Group]) -> bool:
    """Whether features on the object place about as many photos as all features do, and agree much better.

    After a walk, both agree alike. On a turntable, features on the surroundings contradict those on the object.
    """
    if not of_object or not groups:
        return bool(of_object)
    placed = [len(found[0].placed) for found in (of_object, groups)]
    errors = [float(np.median([one.error for one in found[0].placed])) for found in (of_object, groups)]
    return placed[0] >= ENOUGH_ON_OBJECT * placed[1] and errors[0] <= MUCH_BETTER * errors[1]


def _report_surroundings(progress: _Progress, stop: StopRequest, step: int, steps: int) -> None:
    """Raises Stopped on request."""
    stop_if_asked(stop)
    progress("surroundings", step, steps)


def _form_rows(cameras: FoundCameras) -> bool:
    """Whether the cameras are such as a turntable gives: in most photos, a camera stood still while the object turned."""
    views = [View(placed.photo.path.name, placed.photo.path, None, placed.camera) for placed in cameras.placed]
    try:
        on_turntable(Capture(Path(), views, "srgb", cameras.object_center, cameras.object_radius, "cameras"))
    except CaptureError:
        return False
    return True


def _with_rows(placed: list[PlacedPhoto], capture: Capture) -> list[PlacedPhoto]:
    """The photos with the rows and turns that the capture tells."""
    views = {view.image_path: view for view in capture.views}
    return [replace(one, row=views[one.photo.path].row, turn=views[one.photo.path].turn) for one in placed]


def _of_turntable(still: StillSurroundings, known: bool, sure: bool) -> Message:
    """What is said of a turntable. known: whether it was known what turned. sure: the cameras that were found fit."""
    values = {"percent": 100 * still.share}
    if sure or (known and still.shifted):
        return Message("cameras.turntable", values)
    return Message("cameras.turntable_shifted", values) if still.shifted else Message("cameras.turntable_unsure", values)


def _with_sphere(
    cameras: FoundCameras, scratch: Path, progress: _Progress, stop: StopRequest, warnings: list[Message]
) -> FoundCameras:
    """The cameras with the sphere of the object that the photos show. A warning is added where that is a guess.

    `scratch`: a folder for temporary files. Raises Stopped on request.
    """

    progress("sphere", 0, 1)
    write_capture(cameras, scratch / "capture")
    try:
        written = load_capture(scratch / "capture", use_masks=False)
        lines = [(found.camera.position, found.seen[:, 2:]) for found in cameras.placed]
        sphere = find_object_sphere(written, lines, check=lambda done, all_of_them: stop_if_asked(stop))
    except (BoundsError, CaptureError):  # the cameras are good all the same
        sphere = ObjectSphere(cameras.object_center, cameras.object_radius, False)
    if not sphere.sure:
        warnings.append(Message("cameras.sphere_unsure"))
    return replace(cameras, object_center=sphere.center, object_radius=sphere.radius)


def _keep_present(folder: Path) -> list[Message]:
    """Copy cameras that are about to be replaced to another file of the folder, and say to which. Raises OutputError."""
    kept = keep_present_file(folder)
    return [] if kept is None else [Message("cameras.backup", {"file": kept.name})]


def _masked(search: CameraSearch, photos: list[Photo]) -> bool | None:
    """`find_groups`' masked. Raises UsageError where masks are wanted and a photo has none."""
    if search.features == "everywhere":
        return None
    without = [photo.path.name for photo in photos if photo.mask is None]
    if without:
        which = f"{without[0]} has none" if len(without) == 1 else f"{len(without)} of {len(photos)} photos have none"
        raise UsageError(
            f"--features {search.features} needs a mask for each photo, but {which}",
            f"Put them into {search.photos / 'masks'}, under the photos' names.",
            "usage.no_masks",
            folder=search.photos / "masks",
        )
    return search.features == "object"


def _refuse_masks(search: CameraSearch, video: Path) -> None:
    """Raises UsageError where masks are wanted for a video."""
    if search.features != "everywhere":
        folder = search.capture / "masks"
        raise UsageError(
            f"--features {search.features} needs a mask for each photo, and {video.name} has none",
            f"Find the cameras without it, put masks of the frames into {folder}, and find the cameras of the folder again.",
            "usage.no_masks",
            folder=folder,
        )


def _refuse_capture(folder: Path, overwrite: bool) -> None:
    if os.path.exists(folder / transforms.FILE) and not overwrite:  # False in a folder that may not be read
        raise UsageError(
            f"{folder} has cameras already ({transforms.FILE})",
            "Choose another --out, or replace them with --overwrite.",
            "usage.cameras_exist",
            folder=folder,
        )


class _Progress:
    """Turns the steps of structure from motion into progress events with the time left."""

    def __init__(self, events: Events, photos: int, *, of_video: bool = False, looks: bool) -> None:
        """looks: the photos are compared, to find out whether they are from a turntable."""
        self._events, self._photos = events, photos
        before = {"video": _VIDEO_SECONDS} if of_video else {}
        self._begin(before | ({"surroundings": _SURROUNDINGS_SECONDS} if looks else {}))

    def _begin(self, before: Mapping[str, float] = MappingProxyType({})) -> None:
        seconds = {**before, **_SECONDS}
        self._timeline = Timeline({name: each * self._photos for name, each in seconds.items()})
        self._stage = ""

    def __call__(self, stage: str, step: int, steps: int) -> None:
        if stage == "way":  # the work begins anew, and nobody knows before how many ways it takes
            self._begin()
            note = Message("cameras.next_way", {"count": step, "photos": steps})
            self._events.say(str(note))
            self._events.progress(CAMERA_SEARCH, 0, steps, 0.0, sum(self._timeline.expected.values()), None, note)
            return
        if stage != self._stage:
            if self._stage:
                self._timeline.leave()
            self._timeline.enter(stage)
            self._stage = stage
        fraction, left = self._timeline.at(step / max(steps, 1))
        values = {"step": step, "steps": steps}
        notes = {
            "video": Message("cameras.video", {"percent": 100 * step / max(steps, 1)}),
            "surroundings": Message("cameras.surroundings", {"percent": 100 * step / max(steps, 1)}),
            "photos": Message("cameras.photos", values),
            "features": Message("cameras.features", values),
            "matches": Message("cameras.matches", values),
            "places": Message("cameras.places", values),
            "sphere": Message("cameras.sphere"),
        }
        self._events.progress(CAMERA_SEARCH, step, steps, fraction, left, None, notes[stage])

    def end(self) -> None:
        """Report that all is done."""
        self._events.progress(CAMERA_SEARCH, 1, 1, 1.0, 0.0, None)
