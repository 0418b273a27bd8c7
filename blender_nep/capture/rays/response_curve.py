"""A camera's response curve: what a camera makes of light before it writes a photo, beside the sRGB encoding.

Cameras lift middle tones, deepen shadows and compress highlights. With light x and photo y, both linear after sRGB decoding
and 1 at white, the curve is log-logistic (Naka and Rushton 1966; film and many tone mappers have this form):

    y = (1 + q) x^n / (1 + q x^n),    n = 1 + 0.25 strength,    q = 1.7 strength

Strength 0 is sRGB alone. At strength 1, a gray that fills 12.7 % of the sensor's range becomes about the middle gray of sRGB
(18 %), as ISO 12232 says of a camera's own photos, and middle tones have the contrast of 1.1 to 1.2 that is usual.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

from torch import Tensor

CONTRAST, SHOULDER = 0.25, 1.7
"""n - 1 and q at strength 1"""
MOST_STRENGTH = 2.0
"""Stronger curves are not looked for."""


@dataclass(frozen=True)
class ResponseCurve:
    """One curve for all photos and all channels of a capture. Photos are as if all had one exposure."""

    strength: float
    """0..MOST_STRENGTH"""
    white: float
    """The radiance of white in photos, as `PixelRays.photo` gives it"""
    scale: float
    """The light that makes white, in the same unit. Which one is a choice: see `of`"""

    @classmethod
    def of(cls, strength: float, white: float, middle: float) -> ResponseCurve:
        """The curve that leaves the radiance `middle` as it is, so that light is about as bright as photos are.

        Raises ValueError if the strength is out of its range.
        """
        if not 0 <= strength <= MOST_STRENGTH:
            raise ValueError(f"the strength {strength} of a response curve is not in 0..{MOST_STRENGTH:g}")
        n, q = _constants(strength)
        relative = min(max(middle / white, 1e-4), 1.0)
        return cls(strength, white, middle / (relative / (1 + q * (1 - relative))) ** (1 / n))

    @classmethod
    def of_files(cls, strength: float) -> ResponseCurve:
        """The curve in the files' own values: white is 1, and the light that makes it is 1. Raises ValueError as `of`."""
        return cls.of(strength, 1.0, 1.0)

    def light(self, photo: Tensor) -> Tensor:
        """The light [...] that made a photo's linear radiance [...] >= 0. Beyond white, both grow in proportion."""
        n, q = _constants(self.strength)
        y = photo / self.white
        below = y.clamp(0, 1)
        return self.scale * ((below / (1 + q * (1 - below))) ** (1 / n) + (y - 1).clamp_min(0))

    def photo(self, light: Tensor) -> Tensor:
        """The inverse of `light`: the radiance [...] that a photo shows of light [...] >= 0."""
        n, q = _constants(self.strength)
        x = light / self.scale
        power = x.clamp(0, 1) ** n
        return self.white * ((1 + q) * power / (1 + q * power) + (x - 1).clamp_min(0))

    @classmethod
    def from_state(cls, state: dict[str, float]) -> ResponseCurve:
        """The inverse of `state`. Raises ValueError if it is no curve."""
        curve = cls(**{name: float(state[name]) for name in ("strength", "white", "scale")})
        if not (0 <= curve.strength <= MOST_STRENGTH and 0 < curve.white < math.inf and 0 < curve.scale < math.inf):
            raise ValueError(f"{state} is no response curve")
        return curve

    def state(self) -> dict[str, float]:
        """The curve as plain numbers, for a checkpoint and a report."""
        return {"strength": self.strength, "white": self.white, "scale": self.scale}


def _constants(strength: float) -> tuple[float, float]:
    """n and q of the formula."""
    return 1 + CONTRAST * strength, SHOULDER * strength
