"""What may hide a point from a camera: a mesh, or an SDF in the cells of a cube."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
import torch
from torch import Tensor

from blender_nep.evidence.observation import LinesOfSight
from blender_nep.evidence.sdf_grid import SdfGrid, sampled
from blender_nep.geometry.ray_tracing import RayTracer


class MeshOccluder:
    """A mesh that hides what lies behind it.

    A line of sight must not meet the surface on which its point lies. Where the points lie exactly on faces of the mesh,
    `faces` [n] int tells on which. Else the line begins `ahead` nearer to the camera, or farther by the vector `above` [3].
    Both are in the unit frame.
    """

    def __init__(
        self, tracer: RayTracer, *, faces: np.ndarray | None = None, ahead: float = 0.0, above: np.ndarray | None = None
    ) -> None:
        self._tracer, self._faces, self._ahead, self._above = tracer, faces, ahead, above

    def hides(self, lines: LinesOfSight) -> Tensor:
        """Whether the mesh lies on each of k lines of sight: [k] bool."""
        start, towards = lines.points.cpu().numpy(), lines.towards.cpu().numpy()
        if self._faces is not None:
            start = self._tracer.leave(start, self._faces[lines.index.cpu().numpy()], towards)
        if self._ahead:
            start = start + self._ahead * towards
        if self._above is not None:
            start = start + self._above
        return torch.from_numpy(self._tracer.occluded(start, towards)).to(lines.points.device)


class SdfOccluder:
    """An object that hides a point if its SDF is below `level` somewhere on the line of sight.

    It is asked at `steps` places of the line, at distances from `first` to `last` from the point, in the unit frame. A level
    above 0 takes the object larger than it is, a level below 0 its core alone. counts(places [..., 3]) -> [...] bool tells
    which places can hide anything; None: all.
    """

    def __init__(
        self,
        grid: SdfGrid,
        *,
        level: float,
        first: float,
        last: float,
        steps: int,
        counts: Callable[[Tensor], Tensor] | None = None,
    ) -> None:
        self._values, self._level, self._counts = torch.from_numpy(grid.values).float(), level, counts
        self._first, self._last, self._steps = first, last, steps

    def hides(self, lines: LinesOfSight) -> Tensor:
        """Whether the object lies on each of k lines of sight: [k] bool."""
        self._values = self._values.to(lines.points.device)
        way = torch.linspace(self._first, self._last, self._steps, device=lines.points.device)
        between = lines.points[:, None] + way[:, None] * lines.towards[:, None]
        within = sampled(self._values, between) < self._level
        return (within if self._counts is None else within & self._counts(between)).any(1)
