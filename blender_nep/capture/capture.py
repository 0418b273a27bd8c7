"""A capture: photos of one object among its surroundings, with cameras and the object's bounding sphere."""

from __future__ import annotations

from dataclasses import dataclass, field
from pathlib import Path

import numpy as np

from blender_nep.capture.cameras.camera import Camera
from blender_nep.capture.photos.mask_files import MaskMeaning, MaskRaster, MaskReading
from blender_nep.capture.photos.photo_files import Raster, open_image
from blender_nep.errors import CaptureError
from blender_nep.messages import Message


@dataclass(frozen=True)
class View:
    """One photo, its camera, and the mask of the object if there is one."""

    name: str
    image_path: Path
    mask_path: Path | None
    camera: Camera
    row: int | None = None
    """On a turntable: the photos of one row were taken from one place of the camera. None: not told, or no turntable"""
    turn: float | None = None
    """On a turntable: the angle of the table in degrees, as the capture tells it. None: not told"""
    in_room: np.ndarray | None = None
    """[4, 4] float64: how the object of a turntable stood: from the capture's frame, in which the object rests, to the
    room's. None: not known, or no turntable"""


@dataclass
class Capture:
    """Views, and the sphere that holds the object, in the capture's own coordinates and units."""

    folder: Path
    views: list[View]
    color_space: str
    """How photos are encoded that are not OpenEXR: 'linear', or 'srgb', which means as the file says, else sRGB."""
    object_center: np.ndarray
    object_radius: float
    bounds_source: str
    """Where the sphere comes from: 'options', 'masks', 'cameras', or the name of the file that says it."""
    warnings: list[Message] = field(default_factory=list)
    files: tuple[Path, ...] = ()
    """The files that describe the capture, without photos and masks."""
    turntable: bool | None = None
    """Whether the object turned on a turntable, as the files say. None: they do not say"""
    mask_reading: MaskReading = field(default_factory=MaskReading)
    """What the mask files mean"""
    ignores_alpha: bool = False
    """The photos' alpha does not cut out the object, and they count as whole ones. Else alpha means the object."""

    @property
    def to_unit(self) -> np.ndarray:
        """[4, 4] float64: capture frame to unit frame, where the object's sphere is the unit sphere at the origin."""
        matrix = np.eye(4)
        matrix[:3, :3] /= self.object_radius
        matrix[:3, 3] = -self.object_center / self.object_radius
        return matrix

    @property
    def from_unit(self) -> np.ndarray:
        """[4, 4] float64: unit frame to capture frame."""
        matrix = np.eye(4)
        matrix[:3, :3] *= self.object_radius
        matrix[:3, 3] = self.object_center
        return matrix

    def open_photo(self, i: int) -> Raster:
        """Photo `i` as its file stores it; `Raster.rows` makes it linear. Raises CaptureError."""
        view = self.views[i]
        raster = open_image(view.image_path, self.color_space)
        self._check_size(view, view.image_path, raster.size)
        return raster.without_alpha() if self.ignores_alpha else raster

    def open_mask(self, i: int) -> MaskRaster | None:
        """The object's mask of view `i` from its file, or None where no file shows the object. Raises CaptureError."""
        shows_object = self.mask_reading.meaning in (MaskMeaning.OBJECT, MaskMeaning.BACKGROUND)
        return self._open_mask_file(i) if shows_object else None

    def open_usable(self, i: int) -> MaskRaster | None:
        """Which pixels of view `i` may be used, by its mask file; None: all of them. Raises CaptureError."""
        return self._open_mask_file(i) if self.mask_reading.meaning == MaskMeaning.USABLE else None

    def _open_mask_file(self, i: int) -> MaskRaster | None:
        view = self.views[i]
        if view.mask_path is None:
            return None
        mask = MaskRaster.of(view.mask_path, self.mask_reading).fitted(view.camera.height, view.camera.width)
        self._check_size(view, view.mask_path, mask.size)
        return mask

    def load_photo(self, i: int) -> tuple[np.ndarray, np.ndarray | None]:
        """Radiance [H, W, 3] linear float32 of photo `i`, which may hold NaN, and the photo's alpha [H, W] in 0..1.

        Alpha is None where the file has none, or where all of it is at least 0.999. Where alpha is 0, the photo is cut
        out: nothing is known of the surroundings there. Raises CaptureError.
        """
        raster = self.open_photo(i)
        radiance, alpha = raster.rows()
        return radiance, alpha if raster.has_alpha else None

    def load_mask(self, i: int, step: int = 1) -> np.ndarray | None:
        """Coverage by the object [h, w] float32 in 0..1: from the mask file, else the photo's alpha, else None.

        step: every `step`-th pixel in both directions is read, from pixel step // 2 on. Raises CaptureError.
        """
        mask = self.open_mask(i)
        return self.open_photo(i).alpha(step) if mask is None else mask.coverage(step)

    @staticmethod
    def _check_size(view: View, path: Path, size: tuple[int, int]) -> None:
        if size != (view.camera.height, view.camera.width):
            raise CaptureError(
                f"{path.name} is {size[1]} x {size[0]} pixels, but its photo is {view.camera.width} x {view.camera.height}",
                "A photo and its mask need the same aspect.",
            )
