"""The capture stage reads the photos, cameras and masks, and finds the object's bounding sphere."""

from blender_nep.capture.cameras.camera import Camera
from blender_nep.capture.capture import Capture, View
from blender_nep.capture.loading import MINIMUM_VIEWS, load_capture
from blender_nep.capture.rays.pixel_rays import PixelRays

__all__ = ["MINIMUM_VIEWS", "Camera", "Capture", "PixelRays", "View", "load_capture"]
