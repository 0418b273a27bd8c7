"""The names of the effects, and the random numbers that each of them draws.

An effect draws from its own random numbers. So it is the same alone and among others.
"""

from collections.abc import Iterable
from dataclasses import dataclass

import numpy as np

PHOTOGRAPHER, ROOM, APERTURE, FRAMING, LONG, MATERIALS, TWO_DAYS = SCENE = (
    "photographer",
    "room",
    "aperture",
    "framing",
    "long",
    "materials",
    "two_days",
)
"""Effects of the scene and of where the cameras stand. They need a render."""
JPEG, EXPOSURE, NOISE, CURVE = DEVELOPMENT = ("jpeg", "exposure", "noise", "curve")
"""Effects of the camera's development. They need only photos of linear radiance."""
EFFECTS = (*SCENE, *DEVELOPMENT)
GROUPS = {"camera": DEVELOPMENT, "object": (LONG, MATERIALS), "all": EFFECTS}
"""Name of a group -> its effects. `object` is a clean render of the object that `all` photographs."""
ROOM_HEIGHT = 2.5
"""meters from floor to ceiling"""


@dataclass(frozen=True)
class Stage:
    """The size of what surrounds the object. Lengths are in object radii."""

    floor: float
    """height of the floor; the object's center is at 0"""
    ceiling: float
    half_width: float
    """distance of the walls; without walls, how far away things stand"""
    table: float = 0.0
    """half width of what the object stands on; 0 without support"""

    @property
    def meter(self) -> float:
        """A meter in object radii. People have their size by it."""
        return (self.ceiling - self.floor) / ROOM_HEIGHT


def chosen(names: Iterable[str]) -> frozenset[str]:
    """The effects of the names of effects and groups. `two_days` brings `jpeg` with it, whose EXIF tells the days."""
    found = {effect for name in names for effect in GROUPS.get(name, (name,))}
    return frozenset(found | {JPEG} if TWO_DAYS in found else found)


def develops(effects: Iterable[str]) -> bool:
    """Whether a camera develops the photos to JPEG files. Without that, they hold radiance."""
    return not set(DEVELOPMENT).isdisjoint(effects)


def draws(seed: int, effect: str, photo: int = 0) -> np.random.Generator:
    """The random numbers of an effect in a capture with this seed; of one photo, if it is drawn for each."""
    return np.random.default_rng((seed, 100 + EFFECTS.index(effect), photo))
