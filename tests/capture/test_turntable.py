"""Photos from a turntable: its axis, its rows, how the object stood in a photo, and what transforms.json may say of it."""

import numpy as np
import pytest
import torch

from blender_nep.capture import load_capture
from blender_nep.capture.turntable.axis import find_axis
from blender_nep.capture.turntable.motions import in_unit_frame, on_turntable
from blender_nep.capture.turntable.rows import find_rows
from blender_nep.errors import CaptureError

PLACE = np.array([0.3, -0.2, 0.0])
"""A point of the axis. The object's center lies beside it"""
TILT = np.array([0.02, 0.03, 1.0]) / np.linalg.norm([0.02, 0.03, 1.0])


def rotation(vector: np.ndarray) -> np.ndarray:
    """The rotation [3, 3] about a vector [3] by its length in radians: the series of the matrix exponential."""
    x, y, z = vector
    cross, term, total = np.array([[0, -z, y], [z, 0, -x], [-y, x, 0]]), np.eye(3), np.eye(3)
    for k in range(1, 60):
        term = term @ cross / k
        total = total + term
    return total


def turned(degrees: float) -> np.ndarray:
    """The object's motion about the axis, [4, 4]."""
    motion = np.eye(4)
    motion[:3, :3] = rotation(TILT * np.radians(degrees))
    motion[:3, 3] = PLACE - motion[:3, :3] @ PLACE
    return motion


def camera(azimuth: float, elevation: float, distance: float = 4.0) -> np.ndarray:
    """The pose of a camera in the room that looks at the object, [4, 4]."""
    a, e = np.radians([azimuth, elevation])
    back = np.array([np.cos(e) * np.cos(a), np.cos(e) * np.sin(a), np.sin(e)])
    right = np.cross([0, 0, 1.0], back)
    right /= np.linalg.norm(right)
    matrix = np.eye(4)
    matrix[:3, :3], matrix[:3, 3] = np.stack([right, np.cross(back, right), back], 1), distance * back
    return matrix


def photographed(rows, noise: float = 0.0) -> tuple[np.ndarray, np.ndarray]:
    """The true motions and the cameras in the object's frame, of rows: (camera in the room, angles of the table)."""
    motions = np.stack([turned(angle) for _, angles in rows for angle in angles])
    poses = np.linalg.inv(motions) @ np.stack([pose for pose, angles in rows for _ in angles])
    rng = np.random.default_rng(0)
    for pose in poses:
        pose[:3, :3] = pose[:3, :3] @ rotation(rng.normal(0, noise, 3))
        pose[:3, 3] += rng.normal(0, 4 * noise, 3)
    return motions, poses


TWO_ROWS = ((camera(10, 15), range(0, 360, 20)), (camera(10, 40, 3.6), range(70, 430, 30)))


def error(found: np.ndarray, true: np.ndarray) -> tuple[float, float]:
    """The largest angle [degrees] and the largest shift between motions [n, 4, 4]."""
    left = found @ np.linalg.inv(true)
    cosine = (np.trace(left[:, :3, :3], axis1=1, axis2=2) - 1) / 2
    return float(np.degrees(np.arccos(cosine.clip(-1, 1)).max())), float(np.linalg.norm(left[:, :3, 3], axis=1).max())


def write(make_capture, poses, frames=None, **top):
    """A capture of photos from these poses [n, 4, 4] in the object's frame."""
    tiny = make_capture(views=len(poses))
    tiny.meta |= {"object_center": [0, 0, 0], "object_radius": 1.0} | top
    for k, (frame, pose) in enumerate(zip(tiny.meta["frames"], poses, strict=True)):
        frame["transform_matrix"] = pose.tolist()
        frame |= {} if frames is None else frames[k]
    tiny.save()
    return tiny.folder


def test_the_axis_and_the_rows_are_found_from_the_cameras():
    _, poses = photographed(TWO_ROWS, noise=0.001)
    rows = find_rows(poses, np.zeros(3))
    assert rows.tolist() == [0] * 18 + [1] * 12
    axis = find_axis(poses, rows)
    assert np.degrees(np.arccos(axis.direction @ TILT)) < 0.1
    away = axis.point - PLACE
    assert np.linalg.norm(away - (away @ TILT) * TILT) < 0.01


def test_a_walk_by_hand_has_no_rows():
    rng = np.random.default_rng(1)
    poses = np.stack([camera(*rng.uniform([0, -10], [360, 60]), rng.uniform(3, 5)) for _ in range(40)])
    rows = find_rows(poses, np.zeros(3))
    assert rows is None or (rows >= 0).mean() < 0.3


@pytest.mark.parametrize(("count", "arc", "jitter"), [(24, 60, 0.03), (48, 360, 0.02), (80, 200, 0.02), (80, 360, 0.01)])
def test_a_careful_walk_by_hand_is_refused(make_capture, count, arc, jitter):
    """Each photo is near another one of the walk, but the camera did not stand still."""
    rng = np.random.default_rng(count)
    poses = []
    for azimuth in np.linspace(0, arc, count):
        pose = camera(azimuth, 25 + np.degrees(rng.normal(0, jitter)), 4 * (1 + rng.normal(0, jitter)))
        pose[:3, :3] = pose[:3, :3] @ rotation(rng.normal(0, jitter, 3))
        poses.append(pose)
    with pytest.raises(CaptureError) as refused:
        on_turntable(load_capture(write(make_capture, np.stack(poses), turntable=True)))
    assert refused.value.name == "capture.turntable_no_rows"


@pytest.mark.parametrize("told", [True, False], ids=["rows told", "rows found"])
def test_how_the_object_stood_is_found(make_capture, told):
    motions, poses = photographed(TWO_ROWS)
    rows = [{"row": 5}] * 18 + [{"row": 7}] * 12
    capture = load_capture(write(make_capture, poses, rows if told else None, turntable=True))
    found = on_turntable(capture)
    assert found.rows == 2 and not found.angles_known and not found.left_out
    degrees, shift = error(np.stack([view.in_room for view in found.capture.views]), motions)
    assert degrees < 1.5 and shift < 0.1  # the cameras are on one side about z, and the axis is tilted
    unit = in_unit_frame(found.capture, found.capture.views[0])
    assert np.allclose(unit.rotation[0], np.eye(3), atol=1e-6) and np.allclose(unit.offset[0], 0, atol=1e-6)
    places = unit.points(torch.tensor(poses[:, :3, 3], dtype=torch.float32))
    assert np.allclose(places[:18], places[0], atol=1e-5) and np.allclose(places[18:], places[18], atol=1e-5)


def test_one_row_is_exact_even_if_the_table_wobbles(make_capture):
    rng = np.random.default_rng(3)
    motions = np.stack([turned(angle) for angle in range(0, 360, 24)])
    for motion in motions[1:]:
        motion[:3, :3] = rotation(rng.normal(0, 0.01, 3)) @ motion[:3, :3]
        motion[:3, 3] += rng.normal(0, 0.01, 3)
    poses = np.linalg.inv(motions) @ camera(40, 20)
    found = on_turntable(load_capture(write(make_capture, poses, turntable=True)))
    degrees, shift = error(np.stack([view.in_room for view in found.capture.views]), motions)
    assert degrees < 1e-4 and shift < 1e-6 and found.angles_known


@pytest.mark.parametrize("sense", [1, -1], ids=["counterclockwise", "clockwise"])
def test_angles_that_are_told_join_the_rows(make_capture, sense):
    rows = ((camera(10, 15), range(0, 360, 20)), (camera(75, 40), range(70, 430, 30)))
    motions, poses = photographed(rows)
    frames = [{"turn": sense * angle + 3} for _, angles in rows for angle in angles]
    found = on_turntable(load_capture(write(make_capture, poses, frames, turntable=True)))
    degrees, shift = error(np.stack([view.in_room for view in found.capture.views]), motions)
    assert found.angles_known and degrees < 1e-3 and shift < 1e-4


def test_a_photo_by_hand_is_left_out(make_capture):
    motions, poses = photographed(TWO_ROWS[:1])
    poses[4] = camera(200, 55, 5)
    found = on_turntable(load_capture(write(make_capture, poses, turntable=True)))
    assert found.left_out == (4,) and len(found.capture.views) == 17
    degrees, _ = error(np.stack([view.in_room for view in found.capture.views]), np.delete(motions, 4, 0))
    assert degrees < 1e-3


def test_cameras_of_a_walk_cannot_be_those_of_a_turntable(make_capture):
    rng = np.random.default_rng(1)
    poses = np.stack([camera(*rng.uniform([0, -10], [360, 60]), rng.uniform(3, 5)) for _ in range(20)])
    with pytest.raises(CaptureError) as refused:
        on_turntable(load_capture(write(make_capture, poses, turntable=True)))
    assert refused.value.name == "capture.turntable_no_rows"


def test_a_row_whose_camera_moved_is_refused(make_capture):
    _, poses = photographed(TWO_ROWS)
    with pytest.raises(CaptureError) as refused:
        on_turntable(load_capture(write(make_capture, poses, [{"row": 0}] * 30, turntable=True)))
    assert refused.value.name == "capture.turntable_row_moved" and refused.value.values["names"]


@pytest.mark.parametrize(
    ("top", "frame", "message"),
    [
        ("yes", {}, "turntable is 'yes'"),
        (True, {"row": -1}, "row is -1"),
        (True, {"row": True}, "row is True"),
        (True, {"row": 1.5}, "row is 1.5"),
        (True, {"turn": "x"}, "turn is 'x'"),
        (True, {"turn": float("nan")}, "turn is nan"),
        (None, {"turn": "x"}, "turn is 'x'"),
        (None, {"row": 0}, "001.exr has no row"),
        (True, {"row": 0}, "001.exr has no row"),
        (True, {"turn": 10}, "001.exr has no turn"),
    ],
)
def test_nonsense_in_the_file_is_told(make_capture, top, frame, message):
    _, poses = photographed(TWO_ROWS[:1])
    with pytest.raises(CaptureError, match=message):
        load_capture(write(make_capture, poses, [frame] + [{}] * 17, turntable=top))


def test_without_a_turntable_the_keys_of_frames_mean_nothing(make_capture):
    _, poses = photographed(TWO_ROWS[:1])
    capture = load_capture(write(make_capture, poses, [{"row": "a", "turn": "b"}] * 18, turntable=False))
    assert capture.turntable is False and all(view.row is None and view.turn is None for view in capture.views)


def test_rows_and_turns_are_read_before_it_is_known_to_be_one(make_capture):
    """`--turntable yes` and the photos may say so later."""
    motions, poses = photographed(((camera(10, 15), range(0, 360, 20)), (camera(75, 40), range(70, 430, 30))))
    frames = [{"row": 0, "turn": angle} for angle in range(0, 360, 20)]
    frames += [{"row": 1, "turn": angle} for angle in range(70, 430, 30)]
    capture = load_capture(write(make_capture, poses, frames))
    found = on_turntable(capture)
    assert capture.turntable is None and found.rows == 2 and found.angles_known
    degrees, _ = error(np.stack([view.in_room for view in found.capture.views]), motions)
    assert degrees < 1e-3
