"""Reads the captures of NeRF's Blender scenes: `transforms_train.json`, and photos with alpha, which is the mask.

The file has the form of transforms.json. `transforms_test.json` and `transforms_val.json` are not read.
"""

from __future__ import annotations

from pathlib import Path

from blender_nep.capture.description import CaptureDescription
from blender_nep.capture.formats import transforms

FILE = "transforms_train.json"


def recognizes(folder: Path) -> bool:
    """Whether the folder holds a capture of this format."""
    return transforms.recognizes(folder, FILE)


def read(folder: Path) -> CaptureDescription:
    """What the file says; photos are opened only for their size. Raises CaptureError."""
    return transforms.read(folder, FILE)
