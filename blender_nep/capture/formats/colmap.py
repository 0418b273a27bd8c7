"""Reads a COLMAP project: `cameras` and `images`, binary or text.

They lie in one of the places of `_PLACES`, such as `sparse/0`. COLMAP makes several models where photos fall into groups
that share no points: the one with the most photos counts. Some workspaces hold the same model twice, before and after the
photos were undistorted (COLMAP's `dense/0`, 3DGS's `distorted/`): the first one whose photos are there counts. The photos
lie in `images/` or beside. `mask_search.py` says where masks lie. The frame of the capture is COLMAP's own. The sparse
points are not read, and neither are rigs and frames (COLMAP 3.12 and later): each photo has its own pose in `images` all
the same.
"""

from __future__ import annotations

import struct
import sys
from collections.abc import Iterator
from pathlib import Path
from typing import NamedTuple

import numpy as np

from blender_nep.capture.cameras.camera import Camera
from blender_nep.capture.cameras.lens import Lens
from blender_nep.capture.capture import View
from blender_nep.capture.description import MINIMUM_VIEWS, CaptureDescription, check_number
from blender_nep.capture.formats.mask_search import with_masks
from blender_nep.capture.formats.photo_search import IMAGES, IMAGES_FIRST, check_distinct, photos_named
from blender_nep.capture.formats.photos import check_readable, fitted, rescaled_warnings
from blender_nep.capture.formats.poses import without_pose_warnings
from blender_nep.capture.photos.photo_lookup import PhotoLookup, stem
from blender_nep.errors import CaptureError
from blender_nep.messages import Message
from blender_nep.safety.plain_files import MEGABYTE, open_plain, read_bytes, read_text

NAME = "COLMAP"
_PLACES = (
    *("sparse/*", "sparse", "colmap/sparse/*", "colmap/sparse", "."),
    *("dense/*/sparse", "dense/sparse", "dense/*/sparse/*", "dense/sparse/*", "undistorted/sparse/*", "undistorted/sparse"),
    *("distorted/sparse/*", "distorted/sparse", "colmap_sparse/*", "colmap_sparse", "colmap_text"),
)
_OF_INPUT = "distorted"
"""In 3DGS's workspace: the model of the photos in `input/`. Those in `images/` are undistorted."""
_OWN_PHOTOS = ("dense", "undistorted")
"""Workspaces of image_undistorter, which have photos of their own"""
_MOST_BYTES = 2048 * MEGABYTE
"""Of a file. A photo with 10,000 features takes a quarter of a megabyte."""
_PANORAMA = "EQUIRECTANGULAR"
_MODELS = {
    "SIMPLE_PINHOLE": ("f", "cx", "cy"),
    "PINHOLE": ("fx", "fy", "cx", "cy"),
    "SIMPLE_RADIAL": ("f", "cx", "cy", "k1"),
    "RADIAL": ("f", "cx", "cy", "k1", "k2"),
    "OPENCV": ("fx", "fy", "cx", "cy", "k1", "k2", "p1", "p2"),
    "OPENCV_FISHEYE": ("fx", "fy", "cx", "cy", "k1", "k2", "k3", "k4"),
    "FULL_OPENCV": ("fx", "fy", "cx", "cy", "k1", "k2", "p1", "p2", "k3", "k4", "k5", "k6"),
    "FOV": ("fx", "fy", "cx", "cy", "omega"),
    "SIMPLE_RADIAL_FISHEYE": ("f", "cx", "cy", "k1"),
    "RADIAL_FISHEYE": ("f", "cx", "cy", "k1", "k2"),
    "THIN_PRISM_FISHEYE": ("fx", "fy", "cx", "cy", "k1", "k2", "p1", "p2", "k3", "k4", "sx1", "sy1"),
    "RAD_TAN_THIN_PRISM_FISHEYE": (
        *("fx", "fy", "cx", "cy", "k0", "k1", "k2", "k3", "k4", "k5"),
        *("p0", "p1", "s0", "s1", "s2", "s3"),
    ),
    "SIMPLE_DIVISION": ("f", "cx", "cy", "k"),
    "DIVISION": ("fx", "fy", "cx", "cy", "k"),
    "SIMPLE_FISHEYE": ("f", "cx", "cy"),
    "FISHEYE": ("fx", "fy", "cx", "cy"),
    "EUCM": ("fx", "fy", "cx", "cy", "alpha", "beta"),
    _PANORAMA: ("w", "h"),
}
"""Parameters of COLMAP's camera models. A model's number in binary files is its place here."""
_UNKNOWN = ("FOV", "THIN_PRISM_FISHEYE", "RAD_TAN_THIN_PRISM_FISHEYE", "SIMPLE_DIVISION", "DIVISION", "EUCM", _PANORAMA)
"""Models whose distortion `Lens` does not have."""


class _Intrinsics(NamedTuple):
    model: str
    width: int
    height: int
    terms: dict[str, float]
    """{name of the parameter: value}"""


class _Pose(NamedTuple):
    name: str
    """The photo's file, relative to the folder of photos"""
    camera: int
    quaternion: tuple[float, ...]
    """w, x, y, z of the rotation from the world to the camera, whose axes are OpenCV's"""
    translation: tuple[float, ...]


def recognizes(folder: Path) -> bool:
    """Whether the folder holds a COLMAP project."""
    return next(_groups(folder), None) is not None


def _groups(folder: Path) -> Iterator[list[Path]]:
    """For each of the places that has any, the folders with models, sorted by their names."""
    for place in _PLACES:
        candidates = sorted(folder.glob(place)) if "*" in place else [folder / place]
        found = [model for model in candidates if _endings(model)]
        if found:
            yield found


def _photo_places(folder: Path, model: Path) -> tuple[str, ...]:
    """Where the photos of a model may lie, relative to the folder."""
    parts = model.relative_to(folder).parts
    if parts and parts[0] in _OWN_PHOTOS:
        own = "/".join(parts[: parts.index("sparse")])
        return (f"{own}/{IMAGES}", own)
    if parts and parts[0] == _OF_INPUT:
        return ("input", *(place for place in IMAGES_FIRST if place != "input"))
    if (folder / _OF_INPUT).is_dir():
        return tuple(place for place in IMAGES_FIRST if place != "input")
    return IMAGES_FIRST


def _choose(folder: Path) -> tuple[Path, list[Message]]:
    """The model to read, and a warning if there are others for other photos. Raises CaptureError."""
    chosen = [_largest(folder, models) for models in _groups(folder)]
    if len(chosen) == 1:
        return chosen[0]
    lookup = PhotoLookup(folder)

    def present(model: Path) -> int:
        try:
            poses = _read_model(model)[2]
        except CaptureError:
            return 0
        places = _photo_places(folder, model)
        return sum(lookup.find(pose.name, places, absolute_first=False) is not None for pose in poses)

    return max(chosen, key=lambda one: present(one[0]))  # the first one of equals


def _ending(model: Path) -> str | None:
    """The ending of the files of a model, 'bin' or 'txt'; None if the folder holds none.

    If both are there, the one with more poses counts, and the binary one of equals.
    """
    found = _endings(model)
    if len(found) == 2 and _pose_count(model, "txt") > _pose_count(model, "bin"):
        return "txt"
    return found[0] if found else None


def _endings(model: Path) -> list[str]:
    names = ("cameras", "images")
    return [ending for ending in ("bin", "txt") if all((model / f"{name}.{ending}").is_file() for name in names)]


def _two_forms(
    folder: Path, model: Path, files: tuple[Path, Path], cameras: dict[int, _Intrinsics], poses: list[_Pose]
) -> list[Message]:
    """A warning if the model is there as binary and as text, and they differ. One that cannot be read does not count."""
    others = [ending for ending in _endings(model) if files[0].suffix != f".{ending}"]
    if not others:
        return []
    try:
        _, other_cameras, other_poses = _read_model(model, others[0])
    except CaptureError:
        return []
    if not other_poses or _alike(cameras, poses, other_cameras, other_poses):
        return []
    values = {
        "place": model.relative_to(folder).as_posix(),
        "used": files[1].name,
        "photos": len(poses),
    }
    return [Message("capture.two_forms", values)]


def _alike(
    cameras: dict[int, _Intrinsics], poses: list[_Pose], other_cameras: dict[int, _Intrinsics], other_poses: list[_Pose]
) -> bool:
    """Whether two models say the same of the same photos, within what text rounds."""
    one, other = ({pose.name: pose for pose in some} for some in (poses, other_poses))
    if one.keys() != other.keys():
        return False

    def numbers(pose: _Pose, lenses: dict[int, _Intrinsics]) -> list[float]:
        lens = lenses.get(pose.camera)
        own = [] if lens is None else [lens.width, lens.height, *lens.terms.values()]
        return [*np.sign(pose.quaternion[0] or 1) * np.array(pose.quaternion), *pose.translation, *own]

    pairs = ((numbers(one[name], cameras), numbers(other[name], other_cameras)) for name in one)
    return all(len(a) == len(b) and np.allclose(a, b, 1e-4, 1e-5, equal_nan=True) for a, b in pairs)


def _with_pose(poses: list[_Pose]) -> tuple[list[_Pose], list[str]]:
    """The poses that are numbers, and the names of the photos of the others; all of them where too few are numbers."""
    good = [pose for pose in poses if np.isfinite([*pose.quaternion, *pose.translation]).all() and any(pose.quaternion)]
    if len(good) < MINIMUM_VIEWS:
        return poses, []
    kept = {id(pose) for pose in good}
    return good, [pose.name for pose in poses if id(pose) not in kept]


def read(folder: Path) -> CaptureDescription:
    """What the project says; photos are opened only for their size. Raises CaptureError."""
    model, warnings = _choose(folder)
    files, cameras, poses = _read_model(model)
    warnings = warnings + _two_forms(folder, model, files, cameras, poses)
    poses, blank = _with_pose(poses)
    if not poses:
        raise CaptureError(f"the COLMAP project in {model} has no photos with a pose", "Run COLMAP's mapper again.")
    photos, missing = photos_named(folder, [pose.name for pose in poses], NAME, _photo_places(folder, model))
    placed = sorted((pose for pose in poses if pose.name in photos), key=lambda pose: pose.name)
    rescaled: list[str] = []
    turned: list[str] = []
    views = [_view(cameras, pose, photos[pose.name], rescaled, turned) for pose in placed]
    check_distinct(views, NAME)
    views, found = with_masks(folder, views)
    warnings += without_pose_warnings(blank) + missing + found + rescaled_warnings(rescaled, turned)
    return CaptureDescription(name=NAME, files=files, views=views, warnings=warnings)


def _largest(folder: Path, models: list[Path]) -> tuple[Path, list[Message]]:
    """The model with the most poses, and a warning if there are others."""
    if len(models) == 1:
        return models[0], []
    counts = [_pose_count(model, _ending(model) or "txt") for model in models]
    most = max(counts)
    model = models[counts.index(most)]
    values = {
        "models": len(models),
        "place": model.relative_to(folder).as_posix(),
        "photos": most,
        "others": sum(counts) - most,
    }
    return model, [Message("capture.several_models", values)]


def _pose_count(model: Path, ending: str) -> int:
    """The number of photos that a model has a pose of; 0 where its file cannot be read."""
    try:
        if ending == "bin":
            with open_plain(model / "images.bin", sys.maxsize) as file:
                return _count(file.read(8))
        return len(_text_pose_lines(read_text(model / "images.txt", _MOST_BYTES, "utf-8-sig")))
    except (OSError, ValueError, struct.error):
        return 0


def read_cameras(model: Path) -> dict[str, Camera]:
    """The cameras of the COLMAP model in the folder `model`, by the names of their photos. Raises CaptureError."""
    _, cameras, poses = _read_model(model)
    return {pose.name: _camera(cameras[pose.camera], pose) for pose in poses}


def _read_model(model: Path, ending: str | None = None) -> tuple[tuple[Path, Path], dict[int, _Intrinsics], list[_Pose]]:
    """The two files of a model, its intrinsics by their numbers, and its poses. Raises CaptureError."""
    ending = ending or _ending(model) or "txt"
    files = (model / f"cameras.{ending}", model / f"images.{ending}")
    try:
        if ending == "bin":
            lenses, places = (read_bytes(file, _MOST_BYTES) for file in files)
            cameras, poses = _binary_cameras(lenses), _binary_poses(places)
        else:
            texts = [read_text(file, _MOST_BYTES, "utf-8-sig") for file in files]
            cameras, poses = _text_cameras(texts[0]), _text_poses(texts[1])
    except (OSError, ValueError, IndexError, struct.error) as error:
        raise CaptureError(
            f"the COLMAP project in {model} cannot be read ({error})", "Export it again, as text or binary."
        ) from error
    check_number(len(poses), "the COLMAP project")
    return files, cameras, poses


def _view(
    cameras: dict[int, _Intrinsics],
    pose: _Pose,
    image: Path,
    rescaled: list[str],
    turned: list[str],
) -> View:
    check_readable(image, pose.name)
    if pose.camera not in cameras:
        raise CaptureError(f"{pose.name}: the project has no camera {pose.camera}", "Export the project again.")
    camera = fitted(_camera(cameras[pose.camera], pose), image, pose.name, NAME, rescaled, turned)
    return View(stem(pose.name), image, None, camera)


def _camera(intrinsics: _Intrinsics, pose: _Pose) -> Camera:
    terms = intrinsics.terms
    # FULL_OPENCV divides by a polynomial of k4, k5 and k6. Without them it is OpenCV's model with k3.
    rational = intrinsics.model == "FULL_OPENCV" and any(terms[name] for name in ("k4", "k5", "k6"))
    if intrinsics.model in _UNKNOWN or rational:
        raise _not_supported(intrinsics.model)
    fl_x, fl_y = terms.get("f", terms.get("fx", 0.0)), terms.get("f", terms.get("fy", 0.0))
    if min(fl_x, fl_y, intrinsics.width, intrinsics.height) <= 0:
        raise CaptureError(f"{pose.name}: focal length and size must be positive")
    lens = Lens(
        **{name: value for name, value in terms.items() if name[0] in "kp" and value},
        fisheye=intrinsics.model.endswith("FISHEYE"),
    )
    length = float(np.linalg.norm(pose.quaternion))
    if not (np.isfinite(length) and length > 0):
        raise CaptureError(f"{pose.name}: its pose is not finite", "Run COLMAP's mapper again.")
    w, x, y, z = np.array(pose.quaternion) / length
    to_camera = np.array(
        [
            [1 - 2 * (y * y + z * z), 2 * (x * y - z * w), 2 * (x * z + y * w)],
            [2 * (x * y + z * w), 1 - 2 * (x * x + z * z), 2 * (y * z - x * w)],
            [2 * (x * z - y * w), 2 * (y * z + x * w), 1 - 2 * (x * x + y * y)],
        ]
    )
    matrix = np.eye(4)
    matrix[:3, :3] = to_camera.T * [1, -1, -1]  # from OpenCV's axes to ours: y up, looking down -z
    matrix[:3, 3] = -to_camera.T @ np.array(pose.translation)
    if not np.isfinite(matrix).all():
        raise CaptureError(f"{pose.name}: its pose is not finite", "Run COLMAP's mapper again.")
    return Camera(intrinsics.width, intrinsics.height, fl_x, fl_y, terms["cx"], terms["cy"], matrix, lens)


def _not_supported(model: str) -> CaptureError:
    hint = "Let COLMAP use OPENCV or OPENCV_FISHEYE, or undistort the photos with COLMAP's image_undistorter."
    if model == _PANORAMA:  # image_undistorter refuses it
        hint = "Cut the panoramas into ordinary photos, and let COLMAP find the cameras of these."
    return CaptureError(f"camera model {model} is not supported", hint)


def _intrinsics(model: str, width: int, height: int, values: list[float]) -> _Intrinsics:
    if model not in _MODELS:
        raise _not_supported(model)
    if len(values) != len(_MODELS[model]) or not np.isfinite(values).all():
        raise ValueError(f"{model} with the parameters {values}")
    return _Intrinsics(model, width, height, dict(zip(_MODELS[model], values, strict=True)))


def _text_cameras(text: str) -> dict[int, _Intrinsics]:
    out = {}
    for words in (line.split() for line in text.splitlines() if line.strip() and not line.startswith("#")):
        out[int(words[0])] = _intrinsics(words[1], int(words[2]), int(words[3]), [float(word) for word in words[4:]])
    return out


def _text_poses(text: str) -> list[_Pose]:
    out = []
    for line in _text_pose_lines(text):
        words = line.split(maxsplit=9)
        numbers = tuple(float(word) for word in words[1:8])
        out.append(_Pose(words[9], int(words[8]), numbers[:4], numbers[4:]))
    return out


def _text_pose_lines(text: str) -> list[str]:
    """The lines with poses. COLMAP writes two lines a photo: its pose, and its features, which may be none.

    Scripts leave out the lines of features, or the empty ones among them. So the lines are told by what they hold. Raises
    ValueError where a line is neither.
    """
    out = []
    for line in text.split("\n"):
        line = line.strip()
        if not line or line.startswith("#"):
            continue
        words = line.split(maxsplit=9)
        if not all(map(_is_number, words[:9])):
            raise ValueError(f"images.txt has the line {line[:60]!r}")
        if len(words) == 10 and words[0].isdigit() and words[8].isdigit() and not _ends_as_features(words[9]):
            out.append(line)
    return out


def _ends_as_features(text: str) -> bool:
    """Whether a line has features, if `text` comes after nine numbers. A feature is x, y and the number of a scene point."""
    words = text.split()
    return len(words) % 3 == 0 and all(map(_is_number, words))


def _is_number(word: str) -> bool:
    try:
        float(word)
    except ValueError:
        return False
    return True


def _binary_cameras(data: bytes) -> dict[int, _Intrinsics]:
    out, at = {}, 8
    for _ in range(_count(data)):
        number, model, width, height = struct.unpack_from("<iiQQ", data, at)
        name = list(_MODELS)[model] if 0 <= model < len(_MODELS) else str(model)
        count = len(_MODELS.get(name, ()))
        out[number] = _intrinsics(name, width, height, list(struct.unpack_from(f"<{count}d", data, at + 24)))
        at += 24 + 8 * count
    return out


def _binary_poses(data: bytes) -> list[_Pose]:
    out, at = [], 8
    for _ in range(_count(data)):
        values = struct.unpack_from("<i7di", data, at)
        end = data.index(b"\0", at + 64)
        (features,) = struct.unpack_from("<Q", data, end + 1)
        out.append(_Pose(data[at + 64 : end].decode("utf-8"), values[8], values[1:5], values[5:8]))
        at = end + 9 + 24 * features
    return out


def _count(data: bytes) -> int:
    return struct.unpack_from("<Q", data)[0]
