"""Names the program whose camera files lie in a folder that holds no capture, and says how to export something readable."""

from __future__ import annotations

import sys
from collections.abc import Callable
from pathlib import Path
from typing import NamedTuple

from blender_nep.safety.plain_files import open_plain

_BEGIN_BYTES = 1 << 16


class ForeignCameras(NamedTuple):
    """Camera files that no reader understands."""

    program: str
    file: Path
    hint: str
    """How to get cameras that can be read"""


def _is_trajectory(begin: bytes) -> bool:
    """Whether a text begins with three whole numbers, and four lines of four numbers."""
    rows = [line.split() for line in begin.decode("ascii", "replace").splitlines()[:5]]
    try:
        numbers = [[float(word) for word in row] for row in rows]
    except ValueError:
        return False
    return [len(row) for row in numbers] == [3, 4, 4, 4, 4] and all(word.isdigit() for word in rows[0])


def _holds(mark: bytes) -> Callable[[bytes], bool]:
    return lambda begin: mark in begin


def _always(begin: bytes) -> bool:
    return True


_REALITYSCAN = (
    "In RealityScan, export Registration > Bundler v0.3 (negative z), or Internal/External camera parameters (.csv)."
)
_TABLE: tuple[tuple[str, str, Callable[[bytes], bool], str], ...] = (
    ("*.psx", "Metashape", _always, "In Metashape, choose File > Export > Export Cameras, and save an .xml file here."),
    ("*.psz", "Metashape", _always, "In Metashape, choose File > Export > Export Cameras, and save an .xml file here."),
    ("*.rcproj", "RealityScan", _always, _REALITYSCAN),
    ("*.rsproj", "RealityScan", _always, _REALITYSCAN),
    ("*.rcalign", "RealityScan", _always, _REALITYSCAN),
    ("*.rsalign", "RealityScan", _always, _REALITYSCAN),
    ("*.mg", "Meshroom", _holds(b'"pipelineVersion"'), "Copy cameras.sfm of Meshroom's node StructureFromMotion here."),
    (
        "sfm*.abc",
        "Meshroom",
        _always,
        "In Meshroom, add the node ConvertSfMFormat with the format sfm, and copy its result here.",
    ),
    ("sfm_data.bin", "OpenMVG", _always, "Convert it: openMVG_main_openMVG2Colmap -i sfm_data.bin -o colmap_text"),
    ("*.mvs", "OpenMVS", _holds(b"MVSI"), "Copy the COLMAP or OpenMVG project here of which it was made."),
    ("*.p4d", "Pix4D", _always, "Export the cameras in Bundler's form, with the list of photos."),
    (
        "*calibrated_camera_parameters.txt",
        "Pix4D",
        _always,
        "Export the cameras in Bundler's form, with the list of photos.",
    ),
    ("*.zep", "3DF Zephyr", _always, "In 3DF Zephyr, export the cameras as a COLMAP or Bundler project."),
    ("*.xml", "iTwin Capture", _holds(b"<BlocksExchange"), "Import it into Metashape, and export the cameras there."),
    ("*.log", "Tanks and Temples", _is_trajectory, "It says no focal lengths: use a COLMAP project of the photos."),
    ("*.r3d", "Record3D", _always, "An .r3d file is a zip file: unpack it into this folder."),
    ("odometry.csv", "Stray Scanner", _always, "Make a transforms.json of camera_matrix.csv and odometry.csv."),
    (
        "mesh_info.json",
        "Polycam",
        _always,
        "In Polycam, export Raw Data, with the folders keyframes/images and keyframes/cameras.",
    ),
    ("sparse/*/images.*", "COLMAP", _always, "The files cameras and images belong together: copy both, .bin or .txt."),
    ("sparse/images.*", "COLMAP", _always, "The files cameras and images belong together: copy both, .bin or .txt."),
    ("*.r3d.zip", "Record3D", _always, "Unpack it into this folder."),
    ("frame_*.json", "3D Scanner App", _holds(b'"cameraPoseARFrame"'), "Make a transforms.json of these files."),
)
"""(pattern of the file's place, program, what the file's begin must hold, what to do)"""


def foreign_cameras(folder: Path) -> ForeignCameras | None:
    """The first camera files in `folder` that are those of a known program, and what to do; None without such files."""
    for pattern, program, is_one, hint in _TABLE:
        for path in sorted(folder.glob(pattern)):
            if not path.name.startswith(".") and (begin := _begin(path)) is not None and is_one(begin):
                return ForeignCameras(program, path, hint)
    return None


def _begin(path: Path) -> bytes | None:
    try:
        with open_plain(path, sys.maxsize) as file:
            return file.read(_BEGIN_BYTES)
    except OSError:
        return None
