"""A capture of a pot, or of a solid block of the same outside, rendered by tracing rays against a mesh."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
from skimage.measure import marching_cubes

from blender_nep.geometry.ray_tracing import RayTracer
from support.captures import camera_ring, write_exr

RADIUS, BOTTOM, TOP = 0.55, -0.6, 0.6
SIZE, FOCAL = 96, 120.0
CELLS = 64
AXIS = (np.arange(CELLS) + 0.5) / CELLS * 2 - 1


def block(points: np.ndarray) -> np.ndarray:
    """Signed distance [...] of points [..., 3] from a solid cylinder."""
    beside = np.hypot(points[..., 0], points[..., 1]) - RADIUS
    above = np.maximum(points[..., 2] - TOP, BOTTOM - points[..., 2])
    outside = np.hypot(np.maximum(beside, 0), np.maximum(above, 0))
    return outside + np.minimum(np.maximum(beside, above), 0)


def pot(points: np.ndarray, wall: float) -> np.ndarray:
    """Signed distance [...] of points [..., 3] from the same cylinder, hollow and open at the top."""
    inside = np.maximum(np.hypot(points[..., 0], points[..., 1]) - RADIUS + wall, BOTTOM + wall - points[..., 2])
    return np.maximum(block(points), -inside)


def pipe(points: np.ndarray, wall: float) -> np.ndarray:
    """Signed distance [...] of points [..., 3] from the same cylinder, hollow and open at both ends."""
    return np.maximum(block(points), RADIUS - wall - np.hypot(points[..., 0], points[..., 1]))


def in_cells(distance) -> np.ndarray:
    """A distance function at the centers of the cells of [-1, 1]^3: [64, 64, 64] float32."""
    return distance(np.stack(np.meshgrid(AXIS, AXIS, AXIS, indexing="ij"), -1)).astype(np.float32)


def paint(points: np.ndarray) -> np.ndarray:
    """Linear radiance [n, 3] of points [n, 3] of a painted surface; the same from all sides."""
    x, y, z = 4 * points.T
    return np.stack([0.4 + 0.3 * np.sin(x), 0.4 + 0.3 * np.cos(y + z), 0.3 + 0.25 * np.sin(z - x)], 1)


def sky(directions):
    """Linear radiance [n, 3] of what is behind the body, far away, in directions [n, 3]: an array or a tensor."""
    return 0.3 + 0.2 * (3 * directions).sin() if hasattr(directions, "sin") else 0.3 + 0.2 * np.sin(3 * directions)


def everywhere(points: np.ndarray) -> np.ndarray:
    return np.ones(len(points), bool)


def nowhere(points: np.ndarray) -> np.ndarray:
    return np.zeros(len(points), bool)


def write_pot_scene(folder: Path, distance, *, mirror=nowhere, painted=paint, mirrored=paint) -> Path:
    """Write the capture of the body with this distance function. Returns its folder.

    mirror: tells of surface points [n, 3] whether they are a mirror [n] bool; else, they are painted. painted: the linear
    radiance [n, 3] of painted points [n, 3]. mirrored: that of mirrored directions [n, 3], scaled by 1.5.
    """
    axis = np.linspace(-1, 1, 97)
    vertices, faces, _, _ = marching_cubes(distance(np.stack(np.meshgrid(axis, axis, axis, indexing="ij"), -1)), 0.0)
    tracer = RayTracer((vertices / 48 - 1).astype(np.float32), faces)
    (folder / "images").mkdir(parents=True)
    frames = []
    for k, (position, matrix, directions) in enumerate(camera_ring(24, (20, 45, 65), SIZE, FOCAL)):
        directions = directions.astype(np.float32)
        origins = np.broadcast_to(position.astype(np.float32), directions.shape)
        t, face, _ = tracer.intersect(origins, directions)
        hit, normals = face >= 0, tracer.face_normals[face]
        reflected = directions - 2 * (directions * normals).sum(1, keepdims=True) * normals
        points = origins + np.where(hit, t, 0)[:, None] * directions
        seen = np.where(mirror(points)[:, None], mirrored(1.5 * reflected), painted(points))
        color = np.where(hit[:, None], seen, sky(directions))
        write_exr(folder / "images" / f"{k}.exr", color.reshape(SIZE, SIZE, 3))
        frames.append({"file_path": f"images/{k}.exr", "transform_matrix": matrix.tolist()})
    meta = {
        "camera_model": "PINHOLE",
        **{"w": SIZE, "h": SIZE, "fl_x": FOCAL, "fl_y": FOCAL, "cx": SIZE / 2, "cy": SIZE / 2},
        "color_space": "linear",
        "object_center": [0, 0, 0],
        "object_radius": 1.0,
        "frames": frames,
    }
    (folder / "transforms.json").write_text(json.dumps(meta))
    return folder
