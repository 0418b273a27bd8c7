"""Scores a surface against the true mesh of a capture. Distances are in object radii.

The distances to a surface count at the points that the capture's cameras see. libigl measures the distances, Embree casts
the rays.
"""

from __future__ import annotations

from pathlib import Path

import igl
import numpy as np
import torch
import trimesh
from trimesh.ray.ray_pyembree import RayMeshIntersector

from blender_nep.capture import Capture, load_capture
from blender_nep.geometry.mesh import Surface
from blender_nep.shading import brdf
from blender_nep.shading.cones import spiral

VOXEL = 0.01
"""Width of a voxel in object radii. One point is kept in each voxel, so that places seen by many pixels do not dominate."""
_OFFSET = 1e-3
"""Rays that ask for the visibility of the sky begin so far above the surface, in object radii."""


class Body:
    """A mesh in the unit frame. Rays can be cast against it, and distances to it can be measured."""

    def __init__(self, vertices: np.ndarray, faces: np.ndarray) -> None:
        self.mesh = trimesh.Trimesh(vertices, faces, process=False)
        self.caster = RayMeshIntersector(self.mesh)

    def first_hits(self, origins: np.ndarray, directions: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Where rays [n, 3] first meet the mesh: (points [m, 3], indices [m] of the rays, indices [m] of the faces)."""
        return self.caster.intersects_location(origins, directions, multiple_hits=False)

    def distance(self, points: np.ndarray) -> np.ndarray:
        """Distances [n] of points [n, 3] to the surface."""
        v, f = np.asarray(self.mesh.vertices, np.float64), np.asarray(self.mesh.faces, np.int64)
        return np.sqrt(igl.point_mesh_squared_distance(np.ascontiguousarray(points, np.float64), v, f)[0])

    def sky_visibility(self, points: np.ndarray, normals: np.ndarray, rays: int = 64) -> np.ndarray:
        """The share [n] of the cosine-weighted hemisphere from which points [n, 3] on the mesh see its surroundings.

        `normals` [n, 3] of unit length point outward. It is 1 on a convex body, and less in its hollows. All points have the
        same `rays` directions in their frames.
        """
        even = torch.stack(spiral(rays, torch.tensor([0.5 / rays, 0.0])), -1)
        frames = brdf.frame(torch.from_numpy(np.asarray(normals, np.float32)))
        directions = torch.einsum("nij,rj->nri", frames, brdf.sample_cosine(even)[0]).reshape(-1, 3).numpy()
        hit = self.caster.intersects_any(np.repeat(points + _OFFSET * normals, rays, 0), directions)
        return 1 - hit.reshape(-1, rays).mean(1)

    def visible(self, cameras: list[tuple[np.ndarray, np.ndarray]], most: int, rng: np.random.Generator) -> np.ndarray:
        """At most `most` of the points [m, 3] that the cameras' rays meet first, one in each voxel.

        `cameras` holds (origins [n, 3], directions [n, 3]) for each camera.
        """
        points = np.concatenate([self.first_hits(*rays)[0] for rays in cameras])
        _, first = np.unique(np.floor(points / VOXEL).astype(np.int64), axis=0, return_index=True)
        return points[rng.permutation(first)[:most]]


def true_mesh(folder: Path, capture: Capture) -> Body:
    """The true mesh of a capture (`gt_mesh.ply`), in the unit frame."""
    mesh = trimesh.load(folder / "gt_mesh.ply", process=False, force="mesh")
    mesh.apply_transform(np.asarray(capture.to_unit, np.float64))
    return Body(mesh.vertices, mesh.faces)


def load_test_views(folder: Path, capture: Capture) -> Capture:
    """The test views of a capture, in the capture's own unit frame. No job learns from the test views."""
    test = load_capture(folder, file="transforms_test.json")
    test.object_center, test.object_radius = capture.object_center, capture.object_radius
    return test


def camera_rays(capture: Capture, view: int, stride: int) -> tuple[np.ndarray, np.ndarray, tuple[int, int]]:
    """The rays of every stride-th pixel of a view: (origins [n, 3], directions [n, 3], (rows, columns)). Unit frame."""
    camera = capture.views[view].camera
    x, y = np.meshgrid(np.arange(0, camera.width, stride) + 0.5, np.arange(0, camera.height, stride) + 0.5)
    directions = camera.directions(x.ravel(), y.ravel())
    origin = (camera.position - capture.object_center) / capture.object_radius
    return np.broadcast_to(origin, directions.shape), directions, x.shape


def inner(mask: np.ndarray) -> np.ndarray:
    """The pixels of mask [H, W] bool whose four neighbors belong to it, too. None is at the picture's border."""
    found = np.zeros_like(mask)
    found[1:-1, 1:-1] = mask[1:-1, 1:-1] & mask[:-2, 1:-1] & mask[2:, 1:-1] & mask[1:-1, :-2] & mask[1:-1, 2:]
    return found


def angles_between(a: np.ndarray, b: np.ndarray) -> np.ndarray:
    """Angles [n] in degrees between unit vectors [n, 3], whatever their signs: 0 .. 90."""
    return np.degrees(np.arccos(np.abs((a * b).sum(1)).clip(0, 1)))


def score(surface: Surface, folder: Path, capture: Capture, test: Capture, points: int = 60_000) -> dict[str, float]:
    """The geometry scores of `surface`.

    cd_visible: Chamfer distance between the points of both surfaces that the capture's cameras see. cd_full: Chamfer
    distance between points all over both surfaces. fscore_005: F-score of the visible points at a distance of 0.005.
    normal_deg: mean angle, in degrees, between the normals in the test views, whatever their signs. seen_from_behind: share
    of these pixels that show the back of a face; near 1 for a surface that is inside out. mask_iou: intersection over union
    of both silhouettes in the test views. All distances are in object radii. `points` is the most points a surface.
    """
    rng = np.random.default_rng(0)
    truth, ours = true_mesh(folder, capture), Body(surface.vertices, surface.faces)
    cameras = [camera_rays(capture, v, 6)[:2] for v in range(len(capture.views))]
    to_ours = ours.distance(truth.visible(cameras, points, rng))
    to_truth = truth.distance(ours.visible(cameras, points, rng))
    recall, precision = (to_ours < 0.005).mean(), (to_truth < 0.005).mean()
    full = [
        a.distance(trimesh.sample.sample_surface(b.mesh, points, seed=0)[0]).mean()
        for a, b in ((ours, truth), (truth, ours))
    ]
    angles, behind, shared, either = [], [], 0, 0
    for view in range(len(test.views)):
        origins, directions, size = camera_rays(test, view, 1)
        normals, hits = np.zeros((2, len(origins), 3)), np.zeros((2, len(origins)), bool)
        for k, body in enumerate((ours, truth)):
            _, ray, face = body.first_hits(origins, directions)
            normals[k, ray], hits[k, ray] = body.mesh.face_normals[face], True
        shared, either = shared + hits.all(0).sum(), either + hits.any(0).sum()
        # A pixel at the silhouette sees both object and background, so it does not count for the normals.
        chosen = hits[0] & inner(hits[1].reshape(size)).ravel()
        angles.append(angles_between(normals[0, chosen], normals[1, chosen]))
        behind.append((normals[0, chosen] * directions[chosen]).sum(1) > 0)
    return {
        "cd_visible": float((to_ours.mean() + to_truth.mean()) / 2),
        "cd_full": float(np.mean(full)),
        "fscore_005": float(2 * recall * precision / max(recall + precision, 1e-9)),
        "normal_deg": float(np.concatenate(angles).mean()),
        "seen_from_behind": float(np.concatenate(behind).mean()),
        "mask_iou": float(shared / max(either, 1)),
    }
