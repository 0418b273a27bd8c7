"""What the doctor says of a turntable: what a job would find, without ending where a job would."""

from __future__ import annotations

from dataclasses import dataclass

from blender_nep.capture.capture import Capture
from blender_nep.capture.doctor.turntable import MOST_STILL
from blender_nep.capture.turntable.motions import on_turntable
from blender_nep.errors import CaptureError
from blender_nep.messages import Message


@dataclass(frozen=True)
class Turns:
    """Whether the object turned, and what is known of it."""

    turntable: bool
    """Whether a job would take the capture for one from a turntable"""
    capture: Capture | None
    """Only with the photos that a job keeps; each view has `in_room`. None: no turntable, or the cameras do not fit one"""
    left_out: tuple[int, ...]
    """The photos that `capture` lacks, counted from 0"""
    messages: list[Message]

    @classmethod
    def of(cls, capture: Capture, still: float | None, told: bool | None = None) -> Turns:
        """What a job would find. still: of `still_share`. told: whether the object turned, as the user says."""
        wanted = capture.turntable if told is None else told
        found: list[Message] = []
        if wanted is None and still is not None and still > MOST_STILL:
            found.append(Message("capture.on_turntable", {"percent": 100 * still}))
        if not (found if wanted is None else wanted):
            return cls(False, None, (), [])
        try:
            turned = on_turntable(capture)
        except CaptureError as error:
            return cls(True, None, (), [*found, Message("capture.turntable_unfit", {"reason": error.message})])
        if turned.left_out:
            names = [capture.views[i].name for i in turned.left_out]
            found.append(Message("capture.turntable_left_out", {"count": len(names), "names": names}))
        if not turned.angles_known:
            found.append(Message("capture.turntable_side", {"rows": turned.rows}))
        return cls(True, turned.capture, turned.left_out, found)
