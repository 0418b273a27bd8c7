"""The first room: photos, cameras, masks, the object's bounding sphere."""

from blender_nep.capture.camera import Camera
from blender_nep.capture.capture import Capture, View
from blender_nep.capture.rays import PixelRays
from blender_nep.capture.transforms import MINIMUM_VIEWS, load_capture

__all__ = ["MINIMUM_VIEWS", "Camera", "Capture", "PixelRays", "View", "load_capture"]
