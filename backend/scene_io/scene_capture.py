"""Writes a capture folder from the cameras of a Blender scene that have a photo as background image."""

import json
import os
from pathlib import Path

import bpy

from ..plain_files import read_json
from .cameras import intrinsics
from .color_spaces import is_linear
from .image_files import write_whole
from .photo_cameras import ASPECT_KEY, DISTORTION_KEY, MASK_KEY, SIZE_KEY
from .photos.formats import HEIF, RAW, SHOWN
from .photos.image_size import image_size

SOURCE = "Blender scene"  # marks a transforms.json that this file has written, and that it may therefore replace
MINIMUM_PHOTOS = 3
ASPECT_TOLERANCE = 0.01


class UnusableCamera(ValueError):
    """A camera cannot be part of a capture. The message names the camera and says why."""


def photo_cameras(scene: bpy.types.Scene) -> list[bpy.types.Object]:
    """The scene's cameras that have a background image, in the order of their names."""
    return sorted(
        (item for item in scene.objects if item.type == "CAMERA" and _photo(item) is not None), key=lambda item: item.name
    )


def write_scene_capture(scene: bpy.types.Scene, folder: Path) -> int:
    """Write `folder`/transforms.json with the scene's cameras and photos. Returns the number of photos.

    A photo stays where it is if a relative path leads to it. Otherwise the photo is copied to `folder`/images. Raises
    ValueError where cameras cannot be used; the message says which and why, and nothing is written then. Raises OSError
    where the folder cannot be written.
    """
    folder = Path(folder)
    target = folder / "transforms.json"
    if target.exists() and _read_source(target) != SOURCE:
        raise ValueError(f"{folder} already holds a capture that was not made from a scene. Choose another folder")
    cameras = photo_cameras(scene)
    if len(cameras) < MINIMUM_PHOTOS:
        raise ValueError(
            f"{len(cameras)} cameras have a photo as background image; at least {MINIMUM_PHOTOS} from "
            "different places are needed. Add the photos in each camera's Background Images"
        )
    frames, packed, problems = [], {}, []
    for camera in cameras:
        try:
            frames.append(_frame(scene, camera, folder, packed))
        except (UnusableCamera, OSError) as error:
            problems.append(str(error))
    if problems:
        more = f" (and {len(problems) - 3} more)" if len(problems) > 3 else ""
        raise ValueError("; ".join(problems[:3]) + more)
    spaces = {is_linear(_photo(camera)) for camera in cameras}
    meta = {
        "camera_model": "PINHOLE",
        "source": SOURCE,
        "color_space": "linear" if spaces == {True} else "srgb",
        "frames": frames,
    }
    folder.mkdir(parents=True, exist_ok=True)
    for name, data in packed.items():
        (folder / name).parent.mkdir(exist_ok=True)
        write_whole(folder / name, data)
    write_whole(target, (json.dumps(meta, indent=1) + "\n").encode())
    return len(frames)


def _frame(scene: bpy.types.Scene, camera: bpy.types.Object, folder: Path, packed: dict[str, bytes]) -> dict:
    """The camera's entry in transforms.json. A photo that must be copied is added to `packed` {path in folder: content}."""
    data, background = camera.data, _background(camera)
    if data.type != "PERSP":
        kind = {"PANO": "panoramic", "ORTHO": "orthographic"}.get(data.type, data.type.lower())
        raise UnusableCamera(f"{camera.name} is a {kind} camera: only perspective ones can be used")
    if (
        (background.scale, background.rotation, tuple(background.offset)) != (1.0, 0.0, (0.0, 0.0))
        or background.use_flip_x
        or background.use_flip_y
    ):
        raise UnusableCamera(f"{camera.name} has its photo moved, turned, scaled or flipped: reset its Background Image")
    if camera.matrix_world.determinant() <= 0:
        raise UnusableCamera(f"{camera.name} is mirrored: make its scale positive")
    name, width, height = _photo_file(camera, folder, packed)
    if ASPECT_KEY in camera:
        aspect = tuple(camera[ASPECT_KEY])
        frame_width, frame_height = camera[SIZE_KEY]
    else:
        render = scene.render
        aspect = render.pixel_aspect_x, render.pixel_aspect_y
        frame_width, frame_height = render.resolution_x, render.resolution_y
    if abs(width * frame_height / (height * frame_width) - 1) > ASPECT_TOLERANCE:
        raise UnusableCamera(
            f"{camera.name}: its photo has {width} x {height} pixels, its frame {frame_width} x "
            f"{frame_height}. Set the render size to the photos'"
        )
    lens = intrinsics(data, width, height, aspect)
    location, rotation, _ = camera.matrix_world.decompose()
    matrix = rotation.to_matrix().to_4x4()
    matrix.translation = location
    return {
        **_loaded_with(camera, folder),
        "file_path": name,
        "w": width,
        "h": height,
        "fl_x": lens.fl_x,
        "fl_y": lens.fl_y,
        "cx": lens.cx,
        "cy": lens.cy,
        "transform_matrix": [list(row) for row in matrix],
    }


def _loaded_with(camera: bpy.types.Object, folder: Path) -> dict:
    """Lens distortion and mask of a camera that was loaded from a capture, as transforms.json in `folder` has them.

    A mask that is missing is left out.
    """
    entry = json.loads(camera.get(DISTORTION_KEY, "{}"))
    mask = Path(_photo(camera).filepath_from_user()).parent / camera.get(MASK_KEY, "")
    if MASK_KEY in camera and mask.is_file():
        try:
            entry["mask_path"] = Path(os.path.relpath(mask, folder)).as_posix()
        except ValueError:  # no relative path leads to another drive of Windows
            entry["mask_path"] = Path(mask).as_posix()
    return entry


def _photo_file(camera: bpy.types.Object, folder: Path, packed: dict[str, bytes]) -> tuple[str, int, int]:
    """(path for transforms.json, width, height) of the camera's photo.

    A photo that must be copied is added to `packed` {path in `folder`: content}.
    """
    image = _photo(camera)
    path = Path(image.filepath_from_user())
    if path.suffix.lower() in (*HEIF, *RAW):
        raise UnusableCamera(
            f"{camera.name}: {image.name} is a raw or HEIC photo, which not every Blender shows. Save the photos as TIFF, "
            "PNG or JPEG, or use the folder of the photos as capture"
        )
    if image.source != "FILE" or path.suffix.lower() not in SHOWN:
        raise UnusableCamera(f"{camera.name}: {image.name} is no photo file ({', '.join(s[1:] for s in SHOWN)})")
    if path.is_file():
        try:
            return Path(os.path.relpath(path, folder)).as_posix(), *image_size(path)
        except ValueError:  # no relative path leads to another drive of Windows
            content, size = path.read_bytes(), image_size(path)
    elif image.packed_file:
        content, size = image.packed_file.data, tuple(image.size)
    else:
        raise UnusableCamera(f"{camera.name}: its photo {path} is missing")
    name = f"images/{len(packed):03d}_{path.name}"
    packed[name] = content
    return name, *size


def _background(camera: bpy.types.Object) -> bpy.types.CameraBackgroundImage | None:
    """The camera's first background that shows an image (not a movie); None where the camera has none."""
    return next((item for item in camera.data.background_images if item.source == "IMAGE" and item.image), None)


def _photo(camera: bpy.types.Object) -> bpy.types.Image | None:
    background = _background(camera)
    return background.image if background else None


def _read_source(path: Path) -> str:
    try:
        meta = read_json(path)
    except ValueError:
        return ""
    return meta.get("source", "") if isinstance(meta, dict) else ""
