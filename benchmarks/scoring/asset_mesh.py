"""Reads the mesh of an asset as it is: nothing is turned, welded or unwrapped, as a reader of given meshes may do."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from blender_nep.capture.capture import Capture
from blender_nep.geometry.mesh import Surface


def read_asset_mesh(path: Path, capture: Capture) -> Surface:
    """The mesh.obj of an asset in the unit frame of `capture`, with the file's normals and UV map.

    In these files a vertex has one UV and one normal of the same number, and all faces are triangles.
    """
    rows: dict[str, list[list[float]]] = {"v": [], "vt": [], "vn": []}
    faces = []
    with open(path, encoding="utf-8") as file:
        for line in file:
            kind, *values = line.split() or [""]
            if kind in rows:
                rows[kind].append([float(value) for value in values])
            elif kind == "f":
                faces.append([int(corner.split("/")[0]) - 1 for corner in values])
    transform = np.asarray(capture.to_unit, np.float64)
    vertices = np.array(rows["v"]) @ transform[:3, :3].T + transform[:3, 3]
    return Surface(vertices, np.array(faces, np.int64), np.array(rows["vn"]), np.array(rows["vt"]))
