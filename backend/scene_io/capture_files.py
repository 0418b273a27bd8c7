"""Reads the cameras and photos of a capture that Blender shows (transforms.json, the form of instant-ngp).

The engine has its own reader, blender_nep/capture/formats/transforms.py. That reader checks everything and decides
what a valid capture is. It is not used here, because Blender's Python cannot import it.
"""

import math
import os
from dataclasses import dataclass, field, replace
from itertools import takewhile
from pathlib import Path
from typing import Any

import numpy as np

from ..photo_lookup import PhotoLookup
from ..plain_files import is_on_other_computer, read_json
from .image_files import load_pixels
from .photos.formats import HEIF, RAW, color_space
from .photos.image_size import image_size
from .srgb import srgb_to_linear

CAMERAS = "cameras.json"  # the engine writes it into every asset: blender_nep/asset/cameras_file.py
DISTORTION = ("camera_model", "k1", "k2", "k3", "k4", "p1", "p2", "distortion_params", "skew")
GRAY = 0.18  # radiance that is shown where a photo is transparent


class UnshownPhoto(OSError):
    """This Blender shows no photos of this format."""


@dataclass(frozen=True)
class Frame:
    """One photo: its file, its pinhole camera (in pixels; cx, cy from the top left) and its camera-to-world matrix [4,4]."""

    path: Path
    width: int
    height: int
    fl_x: float
    fl_y: float
    cx: float
    cy: float
    matrix: np.ndarray
    color_space: str
    gain: tuple[float, float, float] = (1.0, 1.0, 1.0)  # exposure and white balance, relative to the other photos
    distortion: dict[str, Any] = field(default_factory=dict)  # entries of transforms.json that Blender's cameras lack
    mask: Path | None = None
    # How the object of a turntable had moved since the first photo [4,4]. The light of the asset stood still.
    object_to_room: np.ndarray | None = None
    # How much brighter the object's light was than in the other photos, before `response`
    object_gain: float = 1.0
    # Strength, white and scale of the camera's response curve, which the photo has and the asset has not
    response: tuple[float, float, float] | None = None
    # The same in the values of the photos' files, after `gain`
    curve_of_files: tuple[float, float, float] | None = None
    # Whether the photo is whole although some of its pixels are transparent (photo_alpha.py)
    ignores_alpha: bool = False

    def photo(self) -> np.ndarray:
        """The photo as linear radiance [H,W,3], over GRAY where the file is transparent, unless it `ignores_alpha`.

        Raises OSError where the file cannot be read, UnshownPhoto where this Blender does not show its format.
        """
        if self.path.suffix.lower() in RAW:
            raise UnshownPhoto(f"Blender cannot develop the raw photo {self.path}")
        try:
            pixels = load_pixels(self.path)
        except OSError as error:
            if self.path.suffix.lower() in HEIF and self.path.is_file():
                raise UnshownPhoto(f"This Blender does not show the photo {self.path}") from error
            raise
        rgb, alpha = pixels[..., :3], pixels[..., 3:]
        if self.color_space == "srgb":
            rgb = srgb_to_linear(rgb)
        if self.ignores_alpha:
            return np.nan_to_num(rgb)
        # OpenEXR files hold colors that are multiplied by alpha already, other files do not
        shown = np.nan_to_num(rgb) * (1 if self.path.suffix.lower() == ".exr" else alpha)
        return shown + GRAY * (1 - alpha)


def read_frames(folder: Path, transforms: str = "transforms.json") -> list[Frame]:
    """The frames of the capture in `folder`.

    Raises OSError where a file is missing, and ValueError where a file does not have the form that is expected.
    """
    path = Path(folder) / transforms
    meta = _read_meta(path)
    entries = meta.get("frames")
    if not isinstance(entries, list) or not entries or not all(isinstance(entry, dict) for entry in entries):
        raise ValueError(f"{path} lists no frames")
    lookup = PhotoLookup(Path(folder))
    placed = [entry for entry in entries if not _is_blank(entry.get("transform_matrix"))]
    return [_frame(lookup, meta, entry) for entry in placed or entries]


def _is_blank(rows: object) -> bool:
    """Whether a matrix says that its photo has no pose: see blender_nep/capture/formats/transforms.py."""
    try:
        matrix = np.array(rows, np.float64)
    except (TypeError, ValueError, OverflowError):
        return rows is None
    return rows is None or (matrix.size in (12, 16) and not (np.isfinite(matrix).all() and matrix.ravel()[:12].any()))


def read_frames_of(capture: Path, asset: Path) -> list[Frame]:
    """The frames of the capture from which `asset` was made.

    The asset's cameras.json tells them as the engine has read them, whatever the form of the capture. Its photos must be
    there. If the capture has been moved or has changed, its own transforms.json counts. How the object of a turntable had
    moved is then taken from cameras.json by the photo's name; photos that are not there are left out. Raises as
    `read_frames`.
    """
    if not (Path(asset) / CAMERAS).is_file():
        return read_frames(capture)
    frames = read_frames(Path(asset).resolve(), CAMERAS)
    own = (Path(capture) / "transforms.json").is_file()
    if all(frame.path.is_file() and (own or _lies_in(frame.path, Path(capture))) for frame in frames):
        return frames
    found = read_frames(capture)
    return _with_motions(found, frames) if any(frame.object_to_room is not None for frame in frames) else found


def _with_motions(frames: list[Frame], known: list[Frame]) -> list[Frame]:
    """Those of `frames` whose photo is in `known`, with its motion. The photos may lie in another folder than then.

    Raises ValueError where it is not clear which photo is which.
    """
    moved, taken = [], set()
    for frame in frames:
        alike = [_shared_end(frame.path, other.path) for other in known]
        best = max(alike)
        if best and (alike.count(best) > 1 or alike.index(best) in taken):
            raise ValueError(f"the asset has several photos {frame.path.name}. Put the photos back where they were")
        if best:
            taken.add(alike.index(best))
            moved.append(replace(frame, object_to_room=known[alike.index(best)].object_to_room))
    if not moved:
        raise ValueError("the asset was made from photos of other names. Put them back, or reconstruct the object again")
    return moved


def _shared_end(one: Path, other: Path) -> int:
    """How many names at the end of two paths are the same. Endings do not count: a photo may have been converted."""
    pairs = zip(reversed(one.with_suffix("").parts), reversed(other.with_suffix("").parts), strict=False)
    return sum(1 for _ in takewhile(lambda pair: pair[0] == pair[1], pairs))


def _lies_in(path: Path, folder: Path) -> bool:
    """Whether the file, or the link to it, lies in the folder."""
    as_written = Path(os.path.abspath(path)).is_relative_to(os.path.abspath(folder))
    return as_written or path.resolve().is_relative_to(folder.resolve())


def read_bounds(folder: Path) -> tuple[list[float], float] | None:
    """(center [3], radius) of the object's sphere; None where transforms.json does not have both.

    None also for a folder without transforms.json: the engine knows other forms of captures. Raises OSError where there is
    no folder, and ValueError for the same reasons as `read_frames`.
    """
    path = Path(folder) / "transforms.json"
    if path.parent.is_dir() and not path.is_file():
        return None
    meta = _read_meta(path)
    center, radius = meta.get("object_center"), meta.get("object_radius")
    if center is None or radius is None:
        return None
    sphere = np.array([*center, radius] if isinstance(center, list) else [], np.float64)
    if len(sphere) != 4 or not np.isfinite(sphere).all() or sphere[3] <= 0:
        raise ValueError(f"{folder}: object_center must be three numbers and object_radius a positive one")
    return sphere[:3].tolist(), float(sphere[3])


def with_exposures(frames: list[Frame], asset: Path) -> list[Frame]:
    """The frames from which `asset` was made, with the exposures and the camera's response curve that its report gives.

    `frames` must be all frames of the capture, or those from which the asset was made, as its cameras.json has them. They
    come back unchanged where the report does not fit them.
    """
    try:
        report = read_json(Path(asset) / "report.json")
        capture = report["capture"]
        left_out = set(capture.get("photos_left_out", ()))
        used = frames
        if len(frames) != capture["views"]:
            used = [frame for index, frame in enumerate(frames) if index not in left_out]
        if len(used) != capture["views"]:  # the asset was made from other photos
            return frames
        curve = (float(capture["camera_curve"]), 1.0, 1.0) if "camera_curve" in capture else None
        used = [replace(frame, response=_response(report), curve_of_files=curve) for frame in used]
        of_object = report.get("stages", {}).get("material_learning", {}).get("object_gains", [1.0] * len(used))
        gains = np.array(capture.get("photo_gains", np.ones((len(used), 3))), np.float64)
        told = zip(gains.reshape(len(used), 3).tolist(), np.array(of_object, np.float64).tolist(), strict=True)
        both = zip(used, told, strict=True)
        return [replace(frame, gain=(r, g, b), object_gain=bright) for frame, ((r, g, b), bright) in both]
    except (OSError, ValueError, KeyError, TypeError, AttributeError):  # another program wrote the asset
        return frames


def _response(report: dict) -> tuple[float, float, float] | None:
    """The response curve of an asset's report, in the brightness of the photos' files; None where there is none."""
    try:
        curve = report["stages"]["material_learning"]["response"]
        strength, white, scale = (float(curve[name]) for name in ("strength", "white", "scale"))
        brighter = float(report["capture"].get("exposure", 1.0))  # as the engine saw the photos
    except (KeyError, TypeError, ValueError, AttributeError):
        return None
    found = strength, white / brighter, scale / brighter
    return found if np.isfinite(found).all() and strength >= 0 and min(found[1:]) > 0 else None


def spread_frames(frames: list[Frame], count: int) -> list[Frame]:
    """Up to `count` frames whose viewing directions differ as much as possible, beginning with the first frame."""
    directions = np.array([frame.matrix[:3, 2] for frame in frames])
    chosen = [0]
    while len(chosen) < min(count, len(frames)):
        nearest = (directions @ directions[chosen].T).max(axis=1)
        nearest[chosen] = np.inf
        chosen.append(int(nearest.argmin()))
    return [frames[index] for index in chosen]


def _read_meta(path: Path) -> dict:
    if not path.is_file():
        raise OSError(f"{path.parent} has no {path.name}" if path.parent.is_dir() else f"there is no folder {path.parent}")
    try:
        meta = read_json(path, None)
    except ValueError as error:
        raise ValueError(f"{path} is no JSON text: {error}") from error
    if not isinstance(meta, dict):
        raise ValueError(f"{path} holds no JSON object")
    return meta


def _frame(lookup: PhotoLookup, meta: dict, entry: dict) -> Frame:
    """The frame that `entry` describes. A value that `entry` does not have is taken from `meta`, which is for all frames."""
    folder = lookup.folder

    def value(name: str, default: float | None = None) -> Any:
        found = entry.get(name, meta.get(name, default))
        if found is None:
            raise ValueError(f"{folder}: a frame has no {name}")
        return found

    name = str(value("file_path"))
    for said in (name, str(entry.get("mask_path") or "")):
        if is_on_other_computer(said, folder):
            raise ValueError(f"{said} lies on another computer. Copy the photos into the capture's folder")
    path = lookup.find(name) or folder / name
    if "w" in entry or "w" in meta:
        width, height = int(value("w")), int(value("h"))
    else:
        width, height = image_size(path)
    distortion = {name: entry.get(name, meta.get(name)) for name in DISTORTION}
    if entry.get("is_fisheye", meta.get("is_fisheye")):  # as instant-ngp says it
        distortion["camera_model"] = distortion["camera_model"] or "OPENCV_FISHEYE"
    mask = entry.get("mask_path")
    across, down = (_focal_by_angle({**meta, **entry}, *axis) for axis in (("x", width), ("y", height)))
    given_y = entry.get("fl_y", meta.get("fl_y"))
    fl_x = float(value("fl_x", given_y if across is None and given_y else across or down))
    # As in the engine, OpenEXR is linear, whatever the capture says of its other photos.
    space = "linear" if path.suffix.lower() == ".exr" else str(meta.get("color_space") or _color_space(path)).lower()
    return Frame(
        path,
        width,
        height,
        fl_x,
        float(value("fl_y", fl_x)),
        float(value("cx", width / 2)),
        float(value("cy", height / 2)),
        _matrix(value("transform_matrix"), path),
        space,
        distortion={name: found for name, found in distortion.items() if found},
        mask=lookup.at(str(mask)) or folder / str(mask) if mask else None,
        object_to_room=_matrix(entry["object_to_room"], path, "object_to_room") if "object_to_room" in entry else None,
    )


def _focal_by_angle(keys: dict, axis: str, side: int) -> float | None:
    """The focal length in pixels by the angle of view along an axis, in radians or in degrees; None where there is none."""
    angle, degrees = keys.get(f"camera_angle_{axis}"), keys.get(f"{axis}_fov")
    if angle is None and degrees is not None:
        angle = math.radians(degrees)
    return None if angle is None else 0.5 * side / math.tan(0.5 * angle)


def _color_space(path: Path) -> str:
    """The color space of a photo that its file alone tells; of a missing photo that which its name suggests."""
    try:
        return color_space(path)
    except OSError:
        return "srgb"


def _matrix(rows: list, path: Path, name: str = "transform_matrix") -> np.ndarray:
    matrix = np.array(rows, np.float64)
    if matrix.shape == (3, 4):
        matrix = np.concatenate([matrix, [[0.0, 0.0, 0.0, 1.0]]])
    if matrix.shape != (4, 4) or not np.isfinite(matrix).all():
        raise ValueError(f"{path.name}: {name} is not a 4 x 4 matrix of numbers")
    return matrix
