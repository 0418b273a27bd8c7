"""Reads the cameras that Agisoft Metashape exports: an `.xml` file with `<document><chunk>`.

`photo_search.py` says where photos lie, `mask_search.py` where masks. A photo's name is the camera's label. Disabled
cameras and cameras without a pose are left out.

The capture has Metashape's local coordinates: the transform of the camera's component counts, or else that of the chunk. If
the chunk has a geographic reference, these transforms lead to coordinates around the center of the Earth. Then only their
scale (meters) counts.

Metashape's manual, appendix on camera models, has (with the center of the first pixel at 0.5, and x = X / Z, y = Y / Z):

    x' = x (1 + K1 r^2 + K2 r^4 + K3 r^6 + K4 r^8) + P1 (r^2 + 2 x^2) + 2 P2 x y      u = w / 2 + cx + x' (f + B1) + y' B2
    y' = y (1 + K1 r^2 + K2 r^4 + K3 r^6 + K4 r^8) + P2 (r^2 + 2 y^2) + 2 P1 x y      v = h / 2 + cy + y' f

So its P1 is OpenCV's p2, and its P2 is OpenCV's p1. For an equidistant fisheye lens, x and y are first made shorter to the
length atan(r), which is OpenCV's fisheye model if P1 and P2 are 0. An equisolid one is made shorter to 2 sin(atan(r) / 2).
"""

from __future__ import annotations

import math
import sys
from itertools import islice
from pathlib import Path
from typing import Any, NamedTuple
from xml.etree import ElementTree
from xml.etree.ElementTree import Element

import numpy as np

from blender_nep.capture.cameras.camera import Camera
from blender_nep.capture.cameras.lens import Lens
from blender_nep.capture.capture import View
from blender_nep.capture.description import CaptureDescription, check_number
from blender_nep.capture.formats.mask_search import with_masks
from blender_nep.capture.formats.photo_search import check_distinct, photos_named, view_name
from blender_nep.capture.formats.photos import check_readable, fitted, rescaled_warnings
from blender_nep.capture.formats.poses import (
    FROM_OPENCV,
    camera_to_world,
    check_intrinsics,
    rotation_of,
    without_pose_warnings,
)
from blender_nep.errors import CaptureError
from blender_nep.safety.plain_files import MEGABYTE, open_plain

_FISHEYE = ("fisheye", "equidistant_fisheye")
_DAMAGED = (OSError, ElementTree.ParseError, LookupError, ValueError, RecursionError)
"""What the parser raises: LookupError and ValueError are for encodings that Python does not know"""
_BEGIN_BYTES = 1 << 16
_MOST_BYTES = 256 * MEGABYTE


class _Sensor(NamedTuple):
    """The intrinsics of some cameras, in pixels."""

    width: int
    height: int
    fl_x: float
    fl_y: float
    cx: float
    cy: float
    lens: Lens


def recognizes(folder: Path) -> bool:
    """Whether the folder holds an export of Metashape."""
    return bool(_exports(folder))


def _exports(folder: Path) -> list[Path]:
    return [path for path in sorted(folder.glob("*.xml")) if _is_export(path)]


def _is_export(path: Path) -> bool:
    """Whether the file begins as an export does. The rest is not read."""
    try:
        with open_plain(path, sys.maxsize) as file:
            parser: ElementTree.XMLPullParser = ElementTree.XMLPullParser(("start",))
            parser.feed(file.read(_BEGIN_BYTES))
        events: Any = parser.read_events()
        return [element.tag for _, element in islice(events, 2)] == ["document", "chunk"]
    except _DAMAGED:
        return False


def read(folder: Path) -> CaptureDescription:
    """What the file says; photos are opened only for their size. Raises CaptureError."""
    found = _exports(folder)
    if len(found) > 1:
        names = ", ".join(path.name for path in found)
        raise CaptureError(f"{folder} has several exports of Metashape: {names}", "Leave only the one that counts.")
    file = found[0].name
    chunk = _read_chunk(found[0])
    cameras = list(chunk.iterfind("cameras//camera"))
    check_number(len(cameras), file)
    placed = [camera for camera in cameras if _has_pose(camera)]
    if not placed:
        raise CaptureError(
            f"{file} has no photos with a pose", "Align the photos in Metashape, and export the cameras again."
        )
    used = {camera.get("sensor_id") for camera in placed}
    found_sensors = [sensor for sensor in chunk.iterfind("sensors/sensor") if sensor.get("id") in used]
    sensors = {sensor.get("id"): _sensor(sensor, file) for sensor in found_sensors}
    frames = _frames(chunk, list(dict.fromkeys(camera.get("component_id") for camera in placed)), file)
    photos, missing = photos_named(folder, [_label(camera, file) for camera in placed], file)
    rescaled: list[str] = []
    turned: list[str] = []
    views = []
    for camera in placed:
        label = _label(camera, file)
        if label not in photos:
            continue
        sensor = sensors.get(camera.get("sensor_id"))
        if sensor is None:
            raise CaptureError(f"{file}: camera {label} has no sensor", "Export the cameras again.")
        image = photos[label]
        check_readable(image, label)
        matrix = _pose(camera, frames[camera.get("component_id")], f"{file}: {label}")
        ours = Camera(*sensor[:6], matrix, sensor.lens)
        ours = fitted(ours, image, label, file, rescaled, turned)
        views.append(View(view_name(folder, image), image, None, ours))
    check_distinct(views, file)
    without = [_label(camera, file) for camera in cameras if not _has_pose(camera)]
    views, of_masks = with_masks(folder, views)
    warnings = without_pose_warnings(without) + missing + of_masks + rescaled_warnings(rescaled, turned)
    return CaptureDescription(name=file, files=(found[0],), views=views, warnings=warnings)


def _read_chunk(path: Path) -> Element:
    try:
        with open_plain(path, _MOST_BYTES) as file:
            chunks = ElementTree.parse(file).getroot().findall("chunk")
    except _DAMAGED as error:
        raise CaptureError(f"{path.name} cannot be read ({error})", "Export the cameras again.") from error
    with_cameras = [chunk for chunk in chunks if chunk.find("cameras//camera") is not None]
    if len(with_cameras) != 1:
        raise CaptureError(f"{path.name} has {len(with_cameras)} chunks with cameras", "Export the cameras of one chunk.")
    return with_cameras[0]


def _has_pose(camera: Element) -> bool:
    enabled = camera.get("enabled", "true").lower() not in ("false", "0")
    return enabled and camera.find("transform") is not None and not _is_blank(camera.findtext("transform", ""))


def _is_blank(text: str) -> bool:
    """Whether one of the numbers of a pose is NaN or infinite: no pose was found."""
    try:
        return not all(math.isfinite(float(word)) for word in text.split())
    except ValueError:
        return False


def _label(camera: Element, file: str) -> str:
    label = camera.get("label")
    if not label:
        raise CaptureError(f"{file}: a camera has no label", "The label is the name of the photo.")
    return label


def _values(text: str | None, count: int, what: str) -> np.ndarray:
    """The numbers [count] of a text."""
    try:
        values = np.array([float(word) for word in (text or "").split()])
    except ValueError:
        values = np.zeros(0)
    if values.shape != (count,) or not np.isfinite(values).all():
        raise CaptureError(f"{what} is not {count} number{'s'[: count - 1]}", "Export the cameras again.")
    return values


def _pose(camera: Element, frame: np.ndarray, what: str) -> np.ndarray:
    """The matrix camera-to-world [4, 4] with our axes, after `frame` [4, 4], a similarity."""
    matrix = _values(camera.findtext("transform"), 16, f"{what}: transform").reshape(4, 4)
    if np.abs(matrix[3] - [0, 0, 0, 1]).max() > 1e-6:
        raise CaptureError(f"{what}: its pose is not rigid", "Export the cameras again.")
    scale = np.cbrt(np.linalg.det(frame[:3, :3]))
    rotation = frame[:3, :3] / scale @ rotation_of(matrix[:3, :3], what)
    return camera_to_world(rotation * FROM_OPENCV, (frame @ matrix[:, 3])[:3], what)


def _frames(chunk: Element, components: list[str | None], file: str) -> dict[str | None, np.ndarray]:
    """{component: the similarity [4, 4] from its coordinates to the capture's}"""
    whole = chunk.find("transform")
    own = {component.get("id"): component.find("transform") for component in chunk.iterfind("components/component")}
    if len(components) > 1 and any(own.get(name) is None for name in components):
        raise CaptureError(
            f"{file}: the cameras fall into {len(components)} components, and nothing says how these lie to each other",
            "Merge the components in Metashape, or disable the cameras of all but one.",
        )
    chosen = {name: whole if own.get(name) is None else own[name] for name in components}
    frames = {name: _similarity(transform, file) for name, transform in chosen.items()}
    reference = chunk.findtext("reference", "").strip()
    if not reference or reference.startswith("LOCAL_CS"):
        return frames
    # Millions of meters from the origin, meshes in single precision would be torn.
    first = frames[components[0]]
    turn = first[:3, :3].T / np.cbrt(np.linalg.det(first[:3, :3]))
    back = camera_to_world(turn, -turn @ first[:3, 3], file)
    return {name: back @ frame for name, frame in frames.items()}


def _similarity(transform: Element | None, file: str) -> np.ndarray:
    """The matrix [4, 4] of a `<transform>`, each of whose three parts may be missing."""
    matrix = np.eye(4)
    if transform is None:
        return matrix
    what = f"{file}: the transform of the chunk or component"
    if transform.find("rotation") is not None:
        values = _values(transform.findtext("rotation"), 9, f"{what}: rotation")
        matrix[:3, :3] = rotation_of(values.reshape(3, 3), what)
    if transform.find("translation") is not None:
        matrix[:3, 3] = _values(transform.findtext("translation"), 3, f"{what}: translation")
    if transform.find("scale") is not None:
        scale = float(_values(transform.findtext("scale"), 1, f"{what}: scale")[0])
        if scale <= 0:
            raise CaptureError(f"{what}: scale must be positive", "Export the cameras again.")
        matrix[:3, :3] *= scale
    return matrix


def _sensor(sensor: Element, file: str) -> _Sensor:
    """The intrinsics of a `<sensor>`. Raises CaptureError for lenses that `Lens` does not have."""
    what = f"{file}: sensor {sensor.get('label') or sensor.get('id')}"
    calibrations = sorted(sensor.findall("calibration"), key=lambda calibration: calibration.get("class") != "adjusted")
    kind = (calibrations[0].get("type") if calibrations else None) or sensor.get("type") or "frame"
    if kind != "frame" and kind not in _FISHEYE:
        raise CaptureError(
            f"{what}: camera type {kind} is not supported",
            "Use frame or an equidistant fisheye, or export the photos without distortion (Convert Images).",
        )
    if not calibrations or calibrations[0].find("f") is None:
        raise CaptureError(f"{what} has no calibration with a focal length f", "Export the cameras again, with Metashape.")
    calibration = calibrations[0]

    def term(name: str) -> float:
        text = calibration.findtext(name)
        return 0.0 if text is None else float(_values(text, 1, f"{what}: {name}")[0])

    resolution = calibration.find("resolution")
    if resolution is None:
        resolution = sensor.find("resolution")
    size = "" if resolution is None else f"{resolution.get('width')} {resolution.get('height')}"
    width, height = _values(size, 2, f"{what}: resolution").tolist()
    focal, b1, b2 = term("f"), term("b1"), term("b2")
    check_intrinsics(what, width, height, focal, focal + b1)
    k1, k2, k3, k4, p1, p2 = (term(name) for name in ("k1", "k2", "k3", "k4", "p1", "p2"))
    refused = [name for name in (("p1", "p2", "p3", "p4") if kind in _FISHEYE else ("p3", "p4")) if term(name)]
    if refused:
        raise CaptureError(
            f"{what}: the distortion {', '.join(refused)} of camera type {kind} is not supported",
            "Calibrate it in Metashape with these fixed, or export the photos without distortion (Convert Images).",
        )
    lens = Lens(
        k1, k2, k3, k4, p1=p2, p2=p1, fisheye=kind in _FISHEYE, skew=b2 / (focal + b1)
    )  # see above: the two are swapped
    cx, cy = width / 2 + term("cx"), height / 2 + term("cy")
    return _Sensor(round(width), round(height), focal + b1, focal, cx, cy, lens)
