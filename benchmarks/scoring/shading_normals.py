"""Scores the normals that a renderer shades with, against the normals of a capture's `gt/NNN.exr` (Normal.XYZ, mask.V).

Photos of a smoothly shaded object show its interpolated normals, and not those of the true mesh's faces. A mesh that follows
the photos exactly is off the true faces by as much as the true mesh bends within a face.
"""

from __future__ import annotations

from pathlib import Path

import numpy as np
import trimesh

from benchmarks.scoring.geometry import Body, angles_between, camera_rays, inner, true_mesh
from benchmarks.scoring.materials import read_channels
from blender_nep.capture.capture import Capture
from blender_nep.geometry.mesh import Surface, normalized
from blender_nep.geometry.uv_raster import look_up
from blender_nep.surface.normal_map import tangent_frames

HOLLOW = 0.7
"""A place lies in a hollow if the true mesh lets it see less of the sky than this share."""
_HOLLOW_PIXELS = 4
"""One of so many pixels is asked whether it shows a hollow."""


def score(
    surface: Surface, folder: Path, capture: Capture, test: Capture, normal_map: np.ndarray | None = None
) -> dict[str, float]:
    """The errors of shading normals in the test views, in degrees; {} for a capture whose ground truth has no normals.

    shading_normal_deg: mean angle between the surface's interpolated normals and the rendered ones. If there is a normal map
    [S, S, 3], it tilts the surface's normals. hollow_normal_deg: the same where the true mesh has a hollow; it is missing if
    there is none. normal_floor_deg: mean angle between the true mesh's face normals and the rendered ones, which
    `normal_deg` of an exact copy of the photos would have.
    """
    ours, truth = Body(surface.vertices, surface.faces), true_mesh(folder, capture)
    normals = surface.normals
    tangents, handedness = (None, None) if normal_map is None else tangent_frames(surface)
    found: list[np.ndarray] = []
    in_hollows: list[np.ndarray] = []
    floor: list[np.ndarray] = []
    for view in range(len(test.views)):
        gt = read_channels(folder / "gt" / f"{view:03d}.exr")
        if "Normal.X" not in gt:
            return {}
        rendered = normalized(np.stack([gt[f"Normal.{axis}"].ravel() for axis in "XYZ"], 1))
        origins, directions, _ = camera_rays(test, view, 1)
        whole = inner(gt["mask.V"] > 0.99).ravel()
        point, ray, face = truth.first_hits(origins, directions)
        on_truth = np.zeros(len(origins), bool)
        on_truth[ray] = True
        floor.append(angles_between(truth.mesh.face_normals[face], rendered[ray])[whole[ray]])
        some = np.flatnonzero(whole[ray])[::_HOLLOW_PIXELS]
        hollow = np.zeros(len(origins), bool)
        hollow[ray[some]] = truth.sky_visibility(point[some], rendered[ray[some]]) < HOLLOW
        point, ray, face = ours.first_hits(origins, directions)
        barycentric = trimesh.triangles.points_to_barycentric(surface.vertices[surface.faces[face]], point)
        corners = surface.faces[face]
        smooth = (normals[corners] * barycentric[..., None]).sum(1)
        if normal_map is not None and tangents is not None and handedness is not None:
            tangent = (tangents[corners] * barycentric[..., None]).sum(1)
            bitangent = handedness[corners[:, :1]] * np.cross(smooth, tangent)
            uv = (surface.atlas[corners] * barycentric[..., None]).sum(1)
            red, green, blue = 2 * look_up(normal_map, uv).T[..., None] - 1
            smooth = red * tangent + green * bitangent + blue * smooth
        angles = angles_between(normalized(smooth), rendered[ray])
        found.append(angles[(whole & on_truth)[ray]])
        in_hollows.append(angles[hollow[ray]])
    scores = {"shading_normal_deg": found, "normal_floor_deg": floor}
    if any(map(len, in_hollows)):
        scores["hollow_normal_deg"] = in_hollows
    return {name: float(np.concatenate(each).mean()) for name, each in scores.items()}
