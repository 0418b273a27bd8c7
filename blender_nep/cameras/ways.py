"""The ways of finding cameras: a ladder, which is climbed while too few photos are placed.

docs/lab/cameras.md says what each way finds and costs.
"""

from __future__ import annotations

from dataclasses import dataclass

from blender_nep.messages import Message

ENOUGH = 0.9
"""No further way is tried if this share of the photos is placed. Below, a warning lists the photos that are missing."""
LEAST = 0.5
"""Cameras of fewer photos than this share are an error."""


@dataclass(frozen=True)
class Way:
    """How features are sought and which photos are compared."""

    found: Message | None
    """Said where this way has found the cameras; None: nothing is to be said"""
    features: int
    """Largest number of features in a photo"""
    doubled_below: int
    """Photos whose longest side is shorter [pixels] are doubled before features are sought, as SIFT's paper does."""
    all_pairs_up_to: int
    """Up to so many photos are all compared with each other."""
    partners: int
    """Photos that each photo is compared with, if there are more"""

    def first_octave(self, longest: int) -> int:
        """pycolmap's first octave of features for photos whose longest side has so many pixels."""
        return -1 if longest < self.doubled_below else 0


WAYS = (
    Way(None, features=6000, doubled_below=1100, all_pairs_up_to=25, partners=24),
    Way(Message("cameras.way_all_pairs"), features=8192, doubled_below=10_000, all_pairs_up_to=150, partners=24),
)
"""From the cheapest to the most expensive one"""
