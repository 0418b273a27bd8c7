"""Tells which faces of the mesh the photos show. What no photo shows, such as the foot on a table, has no confidence."""

from __future__ import annotations

import numpy as np
import torch

from blender_nep.capture.pixel_rays import PixelRays
from blender_nep.geometry.mesh import Surface
from blender_nep.geometry.ray_tracing import RayTracer
from blender_nep.profiling import profiled


@profiled("shown faces")
def shown_faces(surface: Surface, tracer: RayTracer, rays: PixelRays) -> np.ndarray:
    """Whether a photo shows the center of each face: [F] bool.

    The face must look towards the camera, lie in the frame, and not be hidden by the mesh. `tracer` holds the same mesh.
    """
    center = surface.vertices[surface.faces].mean(1).astype(np.float32)
    shown = np.zeros(len(center), bool)
    for view in range(rays.views):
        place, ahead = rays.project(view, torch.from_numpy(center).to(rays.radiance.device))
        in_frame = (ahead & (place.abs() < 1).all(-1)).cpu().numpy()
        direction = rays.camera(view)[0].cpu().numpy().astype(np.float32) - center
        direction /= np.maximum(np.linalg.norm(direction, axis=1, keepdims=True), 1e-9)
        facing = np.einsum("ij,ij->i", direction, tracer.face_normals) > 0
        asked = np.flatnonzero(in_frame & facing & ~shown)
        start = tracer.leave(center[asked], asked, direction[asked])
        shown[asked] = ~tracer.occluded(start, direction[asked])
    return shown
