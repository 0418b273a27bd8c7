"""Captures of the printed room that have cameras already, and what is wrong with these."""

from __future__ import annotations

import json
from collections.abc import Callable
from dataclasses import replace

import numpy as np
from PIL import Image

from blender_nep.capture.cameras.camera import Camera
from support.broken_photos import CENTER, RADIUS, Shoot


def _with(camera: Camera, matrix: np.ndarray) -> Camera:
    return replace(camera, camera_to_world=matrix)


def _every_matrix(change: Callable[[np.ndarray], np.ndarray]) -> Callable[[Shoot], None]:
    """A way to break that changes all matrices as a file tells them."""

    def broken(shoot: Shoot) -> None:
        content = shoot.capture()
        for frame in content["frames"]:
            frame["transform_matrix"] = change(np.array(frame["transform_matrix"])).tolist()
        (shoot.folder / "transforms.json").write_text(json.dumps(content))

    return broken


def _moved(factor: float) -> Callable[[np.ndarray], np.ndarray]:
    """Positions in another unit than the rest."""

    def change(matrix: np.ndarray) -> np.ndarray:
        return np.concatenate([matrix[:, :3], matrix[:, 3:] * [[factor], [factor], [factor], [1]]], 1)

    return change


def good(shoot: Shoot) -> None:
    shoot.capture()


def cut_transforms(shoot: Shoot) -> None:
    shoot.capture()
    path = shoot.folder / "transforms.json"
    path.write_bytes(path.read_bytes()[: path.stat().st_size // 2])


def one_mirrored_matrix(shoot: Shoot) -> None:
    content = shoot.capture()
    matrix = np.array(content["frames"][3]["transform_matrix"])
    matrix[:3, 0] *= -1
    content["frames"][3]["transform_matrix"] = matrix.tolist()
    (shoot.folder / "transforms.json").write_text(json.dumps(content))


mirrored_matrices = _every_matrix(lambda matrix: np.diag([-1.0, 1, 1, 1]) @ matrix)
"""As a program with left-handed axes tells them"""
mirrored_places = _every_matrix(lambda matrix: np.concatenate([matrix[:, :3], np.diag([-1.0, 1, 1, 1]) @ matrix[:, 3:]], 1))
opencv_axes = _every_matrix(lambda matrix: matrix * [1, -1, -1, 1])
"""OpenCV's cameras look along +z"""
world_to_camera = _every_matrix(np.linalg.inv)
millimeters = _every_matrix(_moved(1000.0))
kilometers = _every_matrix(_moved(0.001))


def all_in_millimeters(shoot: Shoot) -> None:
    """Cameras and the object's sphere are in millimeters, which is as good as meters."""
    changed = [_with(camera, _moved(1000.0)(camera.camera_to_world)) for camera in shoot.truth]
    shoot.capture(changed, object_center=1000 * CENTER, object_radius=1000 * RADIUS)


def one_far_away(shoot: Shoot) -> None:
    """The position of one camera is in millimeters."""
    changed = [_with(c, _moved(1000.0 if n == 3 else 1.0)(c.camera_to_world)) for n, c in enumerate(shoot.truth)]
    shoot.capture(changed)


def two_exchanged(shoot: Shoot) -> None:
    cameras = list(shoot.truth)
    cameras[2], cameras[5] = cameras[5], cameras[2]
    shoot.capture(cameras)


def focal_length_twice(shoot: Shoot) -> None:
    shoot.capture([replace(camera, fl_x=2 * camera.fl_x, fl_y=2 * camera.fl_y) for camera in shoot.truth])


def blank_photos(shoot: Shoot) -> None:
    shoot.put_all(lambda picture: Image.new("RGB", picture.size, (200, 200, 200)))
    shoot.capture()


def cut_photo(shoot: Shoot) -> None:
    shoot.capture()
    path = shoot.files[3]
    path.write_bytes(path.read_bytes()[: path.stat().st_size // 2])


def wide_fisheye(shoot: Shoot) -> None:
    """A lens with a k4, which COLMAP's models have no place for."""
    shoot.capture([replace(camera, lens=replace(camera.lens, k3=0.01, k4=0.001)) for camera in shoot.truth])
