"""The environment as f_p needs it. The environment field F_e has these methods, and so have analytic lights in tests."""

from __future__ import annotations

from typing import Protocol

from torch import Tensor


class Environment(Protocol):
    """The light around the object, by its radiance in cones."""

    def query_cone(self, origins: Tensor, directions: Tensor, half_angle: Tensor) -> tuple[Tensor, Tensor]:
        """Mean radiance [n, 3] in cones of what the photos show, and their coverage [n] by the photos in 0..1."""
        ...

    def equirect(self, height: int) -> tuple[Tensor, Tensor]:
        """The same as seen from the center: radiance [height, 2 height, 3] and coverage [height, 2 height]."""
        ...

    def extrapolated(self, height: int) -> Tensor:
        """The radiance [height, 2 height, 3] that the field holds, shown by photos or not."""
        ...

    def typical_distance(self) -> float:
        """Median distance of the surroundings from the object's center, in the unit frame."""
        ...
