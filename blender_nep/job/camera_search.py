"""The command that finds the cameras of photos, and writes a capture with them."""

from __future__ import annotations

import tempfile
from pathlib import Path

from blender_nep.cameras.found_cameras import choose, messages
from blender_nep.cameras.photo_folder import find_photos
from blender_nep.cameras.structure_from_motion import find_groups
from blender_nep.cameras.written_capture import write_capture
from blender_nep.capture.formats import transforms
from blender_nep.errors import UsageError
from blender_nep.job.events import Events
from blender_nep.job.exit_code import exit_code
from blender_nep.job.stage_names import CAMERA_SEARCH
from blender_nep.job.timeline import Timeline
from blender_nep.messages import Message
from blender_nep.stop_request import StopRequest

_SECONDS = {"photos": 0.1, "features": 2.0, "matches": 4.0, "places": 2.0}
"""First guess of the seconds that a photo takes in each step"""


def run(
    photos: Path,
    out: Path | None,
    events: Events,
    stop: StopRequest,
    *,
    features: str = "everywhere",
    overwrite: bool = False,
    threads: int | None = None,
) -> int:
    """Find the cameras of the photos in the folder `photos`, and return the exit code.

    The capture is written to `out` (None: to `photos` itself). features: 'everywhere', or where masks allow them: on the
    'object', or in its 'surroundings'. Stops on request, and then writes nothing.
    """

    def work() -> None:
        folder = photos if out is None else out
        _refuse_capture(folder, overwrite)
        found = find_photos(photos)
        masked = {"everywhere": None, "object": True, "surroundings": False}[features]
        if masked is not None and any(photo.mask is None for photo in found):
            raise UsageError(
                f"--features {features} needs a mask for each photo",
                f"Put them into {photos / 'masks'}, under the photos' names.",
                "usage.no_masks",
                folder=photos / "masks",
            )
        progress = _Progress(events, len(found))
        with tempfile.TemporaryDirectory(prefix="nep_cameras_") as scratch:
            groups = find_groups(found, Path(scratch), masked, threads, progress, stop)
        cameras = choose(found, groups)
        said, warnings = messages(cameras, groups)
        write_capture(cameras, folder)
        for warning in warnings:
            events.warning(warning)
        events.scene(said)
        for message in said:
            events.say(str(message))
        progress.end()
        events.done(folder)

    return exit_code(work, events, photos)


def _refuse_capture(folder: Path, overwrite: bool) -> None:
    if (folder / transforms.FILE).exists() and not overwrite:
        raise UsageError(
            f"{folder} has cameras already ({transforms.FILE})",
            "Choose another --out, or replace them with --overwrite.",
            "usage.cameras_exist",
            folder=folder,
        )


class _Progress:
    """Turns the steps of structure from motion into progress events with the time left."""

    def __init__(self, events: Events, photos: int) -> None:
        self._events = events
        self._timeline = Timeline({name: seconds * photos for name, seconds in _SECONDS.items()})
        self._stage = ""

    def __call__(self, stage: str, step: int, steps: int) -> None:
        if stage != self._stage:
            if self._stage:
                self._timeline.leave()
            self._timeline.enter(stage)
            self._stage = stage
        fraction, left = self._timeline.at(step / max(steps, 1))
        values = {"step": step, "steps": steps}
        notes = {
            "photos": Message("cameras.photos", values),
            "features": Message("cameras.features", values),
            "matches": Message("cameras.matches", values),
            "places": Message("cameras.places", values),
        }
        self._events.progress(CAMERA_SEARCH, step, steps, fraction, left, None, notes[stage])

    def end(self) -> None:
        """Report that all is done."""
        self._events.progress(CAMERA_SEARCH, 1, 1, 1.0, 0.0, None)
