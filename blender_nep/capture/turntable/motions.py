"""How the object of a turntable stood in each photo: the rigid motions from its frame to that of the still room.

The room stands still relative to the camera of a row. So the poses of a row's cameras in the object's frame give the motions
between its photos exactly, without the axis, also where the turntable wobbles. Between two rows one angle is missing: how
far the table had turned when the second row began. The photos' angles tell it, where the capture has them. Else the cameras
of all rows are taken to stand on the same side of the object, as those of a tripod do that is raised.
"""

from __future__ import annotations

import itertools
from dataclasses import dataclass, replace

import numpy as np
import torch

from blender_nep.capture.capture import Capture, View
from blender_nep.capture.rays.rigid_motions import RigidMotions
from blender_nep.capture.turntable.axis import Axis, find_axis
from blender_nep.capture.turntable.rows import LEAST_PHOTOS, find_rows, spread
from blender_nep.errors import CaptureError

MOST_SPREAD = 0.15
"""The camera of a row that the capture tells may deviate by this much from its median, as `rows.spread` measures it."""
_ABOVE = 0.2
"""A camera that is nearer to the axis than this share of its distance from the object stands above the object. Its place
does not tell on which side it stands, but its lower edge does."""


@dataclass(frozen=True)
class Turntable:
    """A capture whose views know how the object stood, and how that was found."""

    capture: Capture
    """Only with the photos of rows. Each view has `in_room`."""
    rows: int
    left_out: tuple[int, ...]
    """The photos of no row, counted from 0. `capture` lacks them."""
    angles_known: bool
    """Whether the turns between the rows are known. False: the cameras of all rows are taken to stand on the same side."""
    axis: Axis | None
    """None where no axis was found, so that only one row counts"""


def on_turntable(capture: Capture) -> Turntable:
    """The capture as one from a turntable.

    Raises CaptureError where its cameras do not fit that: where a camera that stood still is told and did not, or where for
    most photos no camera stood still.
    """
    views = capture.views
    poses = np.stack([view.camera.camera_to_world for view in views])
    rows = _rows(capture, poses)
    kept = np.flatnonzero(rows >= 0)
    if len(kept) < max(LEAST_PHOTOS, 0.5 * len(views)):
        raise CaptureError(
            f"the camera stood still in only {len(kept)} of {len(views)} photos: they are not from a turntable",
            "Give --turntable no, or photograph again with the camera on a tripod.",
            "capture.turntable_no_rows",
            kept=len(kept),
            photos=len(views),
        )
    axis = find_axis(poses, rows)
    turns = [view.turn for view in views]
    motions, known = _motions(poses, rows, axis, turns, capture.object_center)
    seen = [replace(views[i], row=int(rows[i]), in_room=motions[i]) for i in kept]
    left_out = tuple(np.flatnonzero(rows < 0).tolist())
    return Turntable(replace(capture, views=seen), int(rows.max()) + 1, left_out, known, axis)


def _rows(capture: Capture, poses: np.ndarray) -> np.ndarray:
    """The row [n] of each photo, as the capture tells or else as the cameras stand. -1: no row. Raises CaptureError."""
    views = capture.views
    if any(view.row is None for view in views):
        found = find_rows(poses, capture.object_center)
        return np.full(len(views), -1) if found is None else found
    rows = np.unique([view.row for view in views], return_inverse=True)[1]
    axis = find_axis(poses, rows)
    if axis is None:
        return np.full(len(views), -1)
    rows = np.where(np.bincount(rows)[rows] >= LEAST_PHOTOS, rows, -1)
    moved = [row for row in range(rows.max() + 1) if (rows == row).any() and spread(axis, poses[rows == row]) > MOST_SPREAD]
    if moved:
        names = [view.name for view, row in zip(views, rows, strict=True) if row == moved[0]]
        raise CaptureError(
            f"the camera did not stand still in a row of the turntable: {', '.join(names[:3])} ...",
            "Correct 'row' in transforms.json, or take it out, so that the rows are found from the cameras.",
            "capture.turntable_row_moved",
            names=names,
        )
    numbers = {row: number for number, row in enumerate(sorted(set(rows[rows >= 0].tolist())))}
    return np.array([numbers.get(row, -1) for row in rows.tolist()])


def _motions(
    poses: np.ndarray, rows: np.ndarray, axis: Axis | None, turns: list[float | None], center: np.ndarray
) -> tuple[np.ndarray, bool]:
    """The motions [n, 4, 4] from the object's frame to the room's, and whether the turns between rows are known.

    The room's frame is the object's frame as it stood in the first photo of the first row.
    """
    motions, known = np.tile(np.eye(4), (len(poses), 1, 1)), True
    first = np.flatnonzero(rows == 0)[0]
    told = all(turn is not None for turn in turns)
    for row in range(rows.max() + 1):
        of_row = np.flatnonzero(rows == row)
        room = poses[of_row[0]]
        if row:
            assert axis is not None  # without an axis there is one row
            if told:
                angle = _sense(poses, rows, axis, turns) * np.radians(turns[of_row[0]] - turns[first])  # type: ignore[operator]
            else:
                angle = _side(axis, poses[first], center) - _side(axis, poses[of_row[0]], center)
                known = False
            room = axis.turn(angle) @ room
        motions[of_row] = room @ np.linalg.inv(poses[of_row])
    return motions, known


def _sense(poses: np.ndarray, rows: np.ndarray, axis: Axis, turns: list[float | None]) -> int:
    """1 if the angles that the capture tells grow counterclockwise as seen from above, else -1."""
    votes = 0.0
    for row in range(rows.max() + 1):
        of_row = np.flatnonzero(rows == row)
        for one, other in itertools.pairwise(of_row):
            motion = poses[one] @ np.linalg.inv(poses[other])  # of the object, from photo `one` to `other`
            sine = axis.direction @ np.array([motion[2, 1], motion[0, 2], motion[1, 0]])
            sine -= axis.direction @ np.array([motion[1, 2], motion[2, 0], motion[0, 1]])
            votes += sine * np.sin(np.radians(turns[other] - turns[one]))  # type: ignore[operator]
    return 1 if votes >= 0 else -1


def _side(axis: Axis, pose: np.ndarray, center: np.ndarray) -> float:
    """The azimuth of the side of the object on which the camera stands, in radians."""
    place = pose[:3, 3] - axis.point
    across = place - (place @ axis.direction) * axis.direction
    if np.linalg.norm(across) < _ABOVE * np.linalg.norm(pose[:3, 3] - center):
        return axis.azimuth(-pose[:3, 1])
    return axis.azimuth(across)


def in_unit_frame(capture: Capture, first: View, device: torch.device | str = "cpu") -> RigidMotions:
    """The motions of the views of a turntable, [views], in object radii. `first` is the view whose motion is the identity.

    Raises ValueError for views of no turntable.
    """
    if first.in_room is None or any(view.in_room is None for view in capture.views):
        raise ValueError("how the object stood in the photos is not known")
    to_first = capture.to_unit @ np.linalg.inv(first.in_room)
    motions = np.stack([to_first @ view.in_room @ capture.from_unit for view in capture.views if view.in_room is not None])
    found = torch.from_numpy(motions.astype(np.float32)).to(device)
    return RigidMotions(found[:, :3, :3], found[:, :3, 3])
