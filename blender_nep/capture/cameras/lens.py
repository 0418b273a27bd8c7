"""Lens distortion: the OpenCV model and its fisheye model, with the coefficients that nerfstudio and COLMAP use.

Image places (u, v) and directions are in OpenCV's axes: x right, y down, z ahead. A place is (pixel - principal point) /
focal length. Without a lens, the place of a direction is (x / z, y / z). The tensors of a batch may hold a different lens in
each row.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import astuple, dataclass

import numpy as np
import torch
from torch import Tensor

_ITERATIONS = 12
"""Most Newton steps of the inverse. Real lenses need 3 or 4."""
_HALVINGS = 30
"""Rounds for the few places that Newton's method does not find"""
_CLOSE = 1e-6
"""The step that begins this near to the place, in focal lengths, is the last one: it ends at the limit of the precision."""
_MISSED = 1e-4
"""A place counts as reached if the inverse leads back to it within this distance, in focal lengths."""
_AHEAD = 1e-6
"""Least depth of a direction that is projected."""


@dataclass(frozen=True)
class Lens:
    """The distortion of one camera.

    OpenCV: radial factor 1 + k1 r^2 + k2 r^4 + k3 r^6 + k4 r^8 with r^2 = (x^2 + y^2) / z^2, and tangential terms p1, p2.
    Fisheye: distance theta (1 + k1 theta^2 + k2 theta^4 + k3 theta^6 + k4 theta^8) from the principal point for an angle of
    theta radians to the optical axis; p1 and p2 must be 0.
    Both: the pixels of the sensor may be no rectangles. Then `skew` v is added to the place u of what is distorted already.
    """

    k1: float = 0.0
    k2: float = 0.0
    k3: float = 0.0
    k4: float = 0.0
    p1: float = 0.0
    p2: float = 0.0
    fisheye: bool = False
    skew: float = 0.0
    """Relative to the focal length fl_x: in a matrix K of pixels it is K[0, 1] / K[0, 0]"""

    @property
    def is_pinhole(self) -> bool:
        """Whether the lens distorts nothing."""
        return self == NO_DISTORTION


NO_DISTORTION = Lens()


class Lenses:
    """A batch of n lenses. Coefficients are float64 or float32 tensors; `at` picks rows."""

    def __init__(self, terms: Tensor, fisheye: Tensor, reach: Tensor, kinds: frozenset[bool]) -> None:
        """terms [n, 7]: k1, k2, k3, k4, p1, p2, skew; fisheye [n] bool; reach [n]: see `_reach`.

        kinds: the values that `fisheye` may have, so that a model that no lens has is not computed.
        """
        self.terms, self.fisheye, self.reach, self.kinds = terms, fisheye, reach, kinds

    @classmethod
    def of(cls, lenses: Sequence[Lens], device: torch.device | str = "cpu", dtype: torch.dtype = torch.float64) -> Lenses:
        """The lenses as one batch."""
        terms = torch.tensor([(*astuple(lens)[:6], lens.skew) for lens in lenses], dtype=dtype, device=device)
        fisheye = torch.tensor([lens.fisheye for lens in lenses], device=device)
        reach = torch.tensor([_reach(lens) for lens in lenses], dtype=dtype, device=device)
        return cls(terms, fisheye, reach, frozenset(lens.fisheye for lens in lenses))

    def at(self, index: Tensor | int) -> Lenses:
        """The lenses of the rows `index` [m]; with an int, that one lens, which then holds for any number of places."""
        rows = slice(index, index + 1) if isinstance(index, int) else index
        return Lenses(self.terms[rows], self.fisheye[rows], self.reach[rows], self.kinds)

    def directions(self, u: Tensor, v: Tensor) -> tuple[Tensor, Tensor, Tensor]:
        """What the image places u, v [n] show.

        Returns unit directions [n, 3], the solid angle [n] of an area of 1 at each place (sr per squared focal length), and
        whether any direction is shown there [n] bool. No direction is shown beyond the place where the distortion folds.
        """
        u = u - self.terms[:, 6] * v
        if True not in self.kinds:
            return self._perspective(u, v)
        if False not in self.kinds:
            return self._round(u, v)
        flat, flat_density, flat_shown = self._perspective(u, v)
        round_, density, shown = self._round(u, v)
        fisheye = self.fisheye.expand(len(u))
        return (
            torch.where(fisheye[:, None], round_, flat),
            torch.where(fisheye, density, flat_density),
            torch.where(fisheye, shown, flat_shown),
        )

    def places(self, directions: Tensor) -> tuple[Tensor, Tensor, Tensor]:
        """Image places u, v [n] of directions [n, 3] of any length, and whether the camera can show them [n] bool.

        The camera cannot show what lies behind it, or beyond the place where the distortion folds. u and v mean nothing
        there.
        """
        x, y, z = directions.unbind(-1)
        ahead = z > _AHEAD
        safe = torch.where(ahead, z, torch.ones_like(z))
        radius = torch.hypot(x, y)
        u, v = self._distorted(x / safe, y / safe)
        shown = ahead & (radius / safe < self.reach)
        if True in self.kinds:
            theta = torch.atan2(radius, z)
            scale = self._radial(theta * theta) * theta / radius.clamp_min(1e-12)
            u, v = torch.where(self.fisheye, scale * x, u), torch.where(self.fisheye, scale * y, v)
            shown = torch.where(self.fisheye, theta < self.reach, shown)
        return u + self.terms[:, 6] * v, v, shown

    def _radial(self, squared: Tensor) -> Tensor:
        """1 + k1 s + k2 s^2 + k3 s^3 + k4 s^4 [n] for s = `squared`."""
        k1, k2, k3, k4 = self.terms[:, :4].unbind(-1)
        return 1 + squared * (k1 + squared * (k2 + squared * (k3 + squared * k4)))

    def _radial_slope(self, squared: Tensor) -> Tensor:
        """The derivative of `_radial`."""
        k1, k2, k3, k4 = self.terms[:, :4].unbind(-1)
        return k1 + squared * (2 * k2 + squared * (3 * k3 + squared * 4 * k4))

    def _distorted(self, x: Tensor, y: Tensor) -> tuple[Tensor, Tensor]:
        """The places of the directions (x, y, 1) by the OpenCV model."""
        p1, p2 = self.terms[:, 4:6].unbind(-1)
        squared = x * x + y * y
        radial = self._radial(squared)
        u = x * radial + 2 * p1 * x * y + p2 * (squared + 2 * x * x)
        return u, y * radial + 2 * p2 * x * y + p1 * (squared + 2 * y * y)

    def _slopes(self, x: Tensor, y: Tensor) -> tuple[Tensor, Tensor, Tensor, Tensor]:
        """The derivatives du/dx, du/dy, dv/dx, dv/dy of `_distorted`."""
        p1, p2 = self.terms[:, 4:6].unbind(-1)
        squared = x * x + y * y
        radial, slope = self._radial(squared), self._radial_slope(squared)
        mixed = 2 * x * y * slope + 2 * p1 * x + 2 * p2 * y
        ux = radial + 2 * x * x * slope + 2 * p1 * y + 6 * p2 * x
        vy = radial + 2 * y * y * slope + 2 * p2 * x + 6 * p1 * y
        return ux, mixed, mixed, vy

    def _perspective(self, u: Tensor, v: Tensor) -> tuple[Tensor, Tensor, Tensor]:
        """`directions` by the OpenCV model: Newton's method, inside the radius where the distortion folds."""
        most = (self.reach * 0.999).clamp_max(1e3)
        x, y = self._undistorted(u, v, u, v, most)
        at_u, at_v = self._distorted(x, y)
        radius = torch.hypot(u, v)
        lost = self._lost(torch.hypot(at_u - u, at_v - v), radius, most)
        if bool(lost.any()):
            scale = self._halved(radius, most) / radius.clamp_min(1e-12)
            again_x, again_y = self._undistorted(u, v, scale * u, scale * v, most)
            x, y = torch.where(lost, again_x, x), torch.where(lost, again_y, y)
            at_u, at_v = self._distorted(x, y)
        ux, uy, vx, vy = self._slopes(x, y)
        determinant = ux * vy - uy * vx
        missed = torch.hypot(at_u - u, at_v - v)
        shown = (missed < _MISSED) & (torch.hypot(x, y) < self.reach) & (determinant > 0)
        x, y = torch.nan_to_num(x), torch.nan_to_num(y)
        cosine = torch.rsqrt(x * x + y * y + 1)
        direction = torch.stack([x * cosine, y * cosine, cosine], -1)
        return direction, cosine**3 / determinant.clamp_min(1e-6), shown

    def _undistorted(self, u: Tensor, v: Tensor, x: Tensor, y: Tensor, most: Tensor) -> tuple[Tensor, Tensor]:
        """Newton's method for the x / z and y / z [n] that the places u, v [n] show, from x, y on, in the radius `most`."""
        for _ in range(_ITERATIONS):
            shrink = (most / torch.hypot(x, y).clamp_min(1e-12)).clamp_max(1)
            x, y = x * shrink, y * shrink
            at_u, at_v = self._distorted(x, y)
            ux, uy, vx, vy = self._slopes(x, y)
            determinant = ux * vy - uy * vx
            determinant = torch.where(determinant.abs() < 1e-9, torch.full_like(determinant, 1e-9), determinant)
            x = x + (vy * (u - at_u) - uy * (v - at_v)) / determinant
            y = y + (ux * (v - at_v) - vx * (u - at_u)) / determinant
            if bool(((at_u - u).abs() + (at_v - v).abs() < _CLOSE).all()):
                break
        return x, y

    def _round(self, u: Tensor, v: Tensor) -> tuple[Tensor, Tensor, Tensor]:
        """`directions` by the fisheye model: Newton's method for the angle theta."""
        radius = torch.hypot(u, v)
        most = self.reach * 0.999
        theta = self._angle(radius, torch.minimum(radius, most), most)
        lost = self._lost((theta * self._radial(theta * theta) - radius).abs(), radius, most)
        if bool(lost.any()):
            theta = torch.where(lost, self._angle(radius, self._halved(radius, most), most), theta)
        squared = theta * theta
        slope = self._radial(squared) + 2 * squared * self._radial_slope(squared)
        missed = (theta * self._radial(squared) - radius).abs()
        per_radius = theta.sin() / radius.clamp_min(1e-12)
        near = radius < 1e-6
        direction = torch.stack([u * per_radius, v * per_radius, theta.cos()], -1)
        density = torch.where(near, torch.ones_like(theta), per_radius) / slope.clamp_min(1e-3)
        return direction, density, (missed < _MISSED) & (theta < self.reach)

    def _angle(self, radius: Tensor, theta: Tensor, most: Tensor) -> Tensor:
        """Newton's method for the angle [n] that a fisheye shows at `radius` [n], from `theta` [n] on, up to `most`."""
        for _ in range(_ITERATIONS):
            squared = theta * theta
            slope = self._radial(squared) + 2 * squared * self._radial_slope(squared)
            missed = theta * self._radial(squared) - radius
            theta = torch.minimum((theta - missed / slope.clamp_min(1e-3)).clamp_min(0), most)
            if bool((missed.abs() < _CLOSE).all()):
                break
        return theta

    def _lost(self, missed: Tensor, radius: Tensor, most: Tensor) -> Tensor:
        """Where [n] Newton's method has missed by `missed` a place at `radius` that is inside the fold.

        It goes in circles for some lenses that are flat just before they fold.
        """
        return ~(missed < _MISSED) & (radius < most * self._radial(most * most))

    def _halved(self, radius: Tensor, most: Tensor) -> Tensor:
        """The r [n] in 0..most that the radial terms take to `radius` [n], by halving the interval."""
        low, high = torch.zeros_like(radius), most.expand_as(radius)
        for _ in range(_HALVINGS):
            middle = (low + high) / 2
            short = middle * self._radial(middle * middle) < radius
            low, high = torch.where(short, middle, low), torch.where(short, high, middle)
        return (low + high) / 2


def _reach(lens: Lens) -> float:
    """The radius r (fisheye: the angle theta, at most pi) where the distorted radius stops growing; inf if it never does.

    Only the radial terms count. The derivative of r (1 + k1 r^2 + ...) is 1 + 3 k1 s + 5 k2 s^2 + 7 k3 s^3 + 9 k4 s^4 with
    s = r^2.
    """
    roots = np.roots([9 * lens.k4, 7 * lens.k3, 5 * lens.k2, 3 * lens.k1, 1])
    folds = [root.real for root in roots if abs(root.imag) < 1e-9 * max(1, abs(root)) and root.real > 0]
    reach = float(np.sqrt(min(folds))) if folds else float("inf")
    return min(reach, np.pi) if lens.fisheye else reach
