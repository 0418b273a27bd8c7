"""Shows a capture's cameras in Blender: a collection with a camera for each photo, and the photo as its background image."""

import json
import os
from pathlib import Path

import bpy
import numpy as np

from .cameras import new_camera, pixel_aspect
from .capture_files import Frame
from .color_spaces import DATA, set_color_space
from .image_files import load_pixels, relative_path
from .photo_alpha import shown_whole
from .photos.formats import HEIF, RAW

COLLECTION_NAME = "NeP cameras: {}"
CAPTURE_KEY = "nep_capture"  # custom property of the collection: the capture's folder
# Custom properties of a camera: its photo's size and pixel aspect. Blender itself has one size and aspect for all cameras.
SIZE_KEY, ASPECT_KEY = "nep_photo_size", "nep_pixel_aspect"
# What Blender's cameras lack: the lens distortion as JSON text, and the mask's path from the photo's folder on, so that it
# is found after both were moved. A capture from the scene gets both.
DISTORTION_KEY, MASK_KEY = "nep_distortion", "nep_mask"
PHOTO_KEY = "nep_photo"  # custom property that marks an image which `load_cameras` has loaded
# Custom properties of the scene: its camera before `load_cameras`, its render size and pixel aspect before, and those given.
CAMERA_BEFORE_KEY, RENDER_BEFORE_KEY, RENDER_GIVEN_KEY = "nep_camera_before", "nep_render_before", "nep_render_given"
RENDER_SETTINGS = ("resolution_x", "resolution_y", "pixel_aspect_x", "pixel_aspect_y")
DISPLAY_SIZE = 0.06  # drawn size of a camera, relative to the median distance of the cameras from their mean position


def load_cameras(
    scene: bpy.types.Scene, capture: Path, frames: list[Frame], *, match_render: bool = True
) -> tuple[list[bpy.types.Object], list[Path], list[Path]]:
    """Make a camera for each frame in `scene`; return (cameras, paths of missing photos, paths that Blender cannot show).

    The cameras of an earlier call are removed first. Blender reads a photo only when somebody looks through its camera, so
    hundreds of photos take no time here; up to five are read if they may have transparent pixels. With `match_render` the
    scene gets the first photo's size and pixel aspect, so that photo and view line up. `remove_cameras` gives the scene's
    own values back.
    """
    remove_cameras(scene)
    collection = bpy.data.collections.new(COLLECTION_NAME.format(Path(capture).resolve().name))
    collection[CAPTURE_KEY] = str(capture)
    scene.collection.children.link(collection)
    positions = np.array([frame.matrix[:3, 3] for frame in frames])
    size = DISPLAY_SIZE * float(np.median(np.linalg.norm(positions - positions.mean(axis=0), axis=1))) or 0.1
    cameras, missing, not_shown = [], [], []
    shows_heif = _shows_heif(frames)
    for frame in shown_whole(frames):
        camera = new_camera(frame, collection, frame.path.stem)
        camera[SIZE_KEY], camera[ASPECT_KEY] = [frame.width, frame.height], pixel_aspect(frame)
        camera.data.display_size = size
        if frame.distortion:
            camera[DISTORTION_KEY] = json.dumps(frame.distortion)
        if frame.mask is not None:
            camera[MASK_KEY] = _from_folder(frame.path, frame.mask)
        ending = frame.path.suffix.lower()
        hidden = ending in RAW or (ending in HEIF and not shows_heif)
        image = None if hidden else _photo(frame)
        if hidden and frame.path.is_file():
            not_shown.append(frame.path)
        elif image is None:
            missing.append(frame.path)
        else:
            background = camera.data.background_images.new()
            background.image, background.alpha, background.frame_method = image, 1.0, "STRETCH"
            camera.data.show_background_images = True
        cameras.append(camera)
    if match_render:
        scene[RENDER_BEFORE_KEY] = _render_settings(scene)
        scene.render.resolution_x, scene.render.resolution_y = frames[0].width, frames[0].height
        scene.render.pixel_aspect_x, scene.render.pixel_aspect_y = pixel_aspect(frames[0])
        scene[RENDER_GIVEN_KEY] = _render_settings(scene)
    if scene.camera is not None:
        scene[CAMERA_BEFORE_KEY] = scene.camera
    scene.camera = scene.camera or cameras[0]
    return cameras, missing, not_shown


def _render_settings(scene: bpy.types.Scene) -> list[float]:
    return [float(getattr(scene.render, name)) for name in RENDER_SETTINGS]


def _give_back(scene: bpy.types.Scene, removed: list[bpy.types.Object]) -> None:
    """Give the scene the camera and the render size that it had before `load_cameras`.

    What the artist has chosen since then stays: another camera than one of a photo, and each setting that has changed.
    """
    before = scene.get(CAMERA_BEFORE_KEY)
    if scene.camera in removed:
        scene.camera = before if before is not None and before.name in scene.objects else None
    if RENDER_BEFORE_KEY in scene and RENDER_GIVEN_KEY in scene:
        values = zip(
            RENDER_SETTINGS, scene[RENDER_BEFORE_KEY], scene[RENDER_GIVEN_KEY], _render_settings(scene), strict=True
        )
        for name, own, given, now in values:
            if now == given:
                setattr(scene.render, name, int(own) if name.startswith("resolution") else own)
    for key in (CAMERA_BEFORE_KEY, RENDER_BEFORE_KEY, RENDER_GIVEN_KEY):
        if key in scene:
            del scene[key]


def _from_folder(photo: Path, mask: Path) -> str:
    """The mask's path relative to the photo's folder; absolute if they lie on different drives of Windows."""
    try:
        return os.path.relpath(mask, photo.parent)
    except ValueError:
        return os.path.abspath(mask)


def remove_cameras(scene: bpy.types.Scene) -> int:
    """Remove the cameras that `load_cameras` made in this scene, and their photos. Returns the number of cameras.

    The scene gets back its own camera and render size, where it still has those of the photos.
    """
    collections = camera_collections(scene)
    cameras = [item for collection in collections for item in collection.objects if SIZE_KEY in item]
    _give_back(scene, cameras)
    data = [camera.data for camera in cameras]
    bpy.data.batch_remove(cameras)
    bpy.data.batch_remove([block for block in data if not block.users])
    bpy.data.batch_remove([image for image in bpy.data.images if PHOTO_KEY in image and not image.users])
    for collection in collections:
        # The collection stays where the artist has put something into it.
        if not collection.objects and not collection.children:
            bpy.data.collections.remove(collection)
        else:
            del collection[CAPTURE_KEY]
    return len(cameras)


def has_loaded_cameras(scene: bpy.types.Scene) -> bool:
    """Whether there is something that `remove_cameras` removes or gives back."""
    return bool(camera_collections(scene)) or RENDER_BEFORE_KEY in scene


def camera_collections(scene: bpy.types.Scene) -> list[bpy.types.Collection]:
    """The collections that `load_cameras` made in this scene."""
    return [collection for collection in scene.collection.children_recursive if CAPTURE_KEY in collection]


def _shows_heif(frames: list[Frame]) -> bool:
    """Whether this Blender can show the HEIF files among the photos. One of them is read to see it."""
    paths = [frame.path for frame in frames if frame.path.suffix.lower() in HEIF and frame.path.is_file()]
    try:
        return bool(paths) and load_pixels(paths[0]).size > 0
    except OSError:
        return False


def _photo(frame: Frame) -> bpy.types.Image | None:
    """An image data-block that refers to the photo's file; None where the file is missing.

    The path is relative to the .blend file if that is saved.
    """
    if not frame.path.is_file():  # Blender would wait for ever for a pipe
        return None
    known = len(bpy.data.images)
    try:
        image = bpy.data.images.load(str(frame.path.resolve()), check_existing=True)
    except RuntimeError:
        return None
    if len(bpy.data.images) > known:  # otherwise the artist had already loaded this image, and it stays as it is
        image[PHOTO_KEY] = True
        if frame.color_space == "linear" and frame.path.suffix.lower() != ".exr":
            set_color_space(image, DATA)
        if frame.ignores_alpha:
            image.alpha_mode = "NONE"
        if bpy.data.is_saved:
            image.filepath = relative_path(frame.path.resolve())
    return image
