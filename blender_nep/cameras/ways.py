"""The ways of finding cameras: a ladder, which is climbed while too few photos are placed.

docs/lab/cameras.md says what each way finds and costs.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

from blender_nep.messages import Message

ENOUGH = 0.95
"""No further way is tried if this share of the photos is placed, or all but one. Below, a warning lists those missing."""
LONGEST_SIDE = 1600
"""Pixels. Larger photos are scaled down before pycolmap sees them."""
LEAST = 0.5
"""Cameras of fewer photos than this share are an error."""


def enough(photos: int) -> int:
    """The number of placed photos that is enough."""
    return min(math.ceil(ENOUGH * photos), photos - 1)


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
    partners: int = 24
    """Photos that each photo is compared with, if there are more"""
    globally: bool = False
    """If one photo after the other does not place enough, all are placed together (global mapping)."""
    affine: bool = False
    """Features are compared as if each was seen from straight above (affine shape), and in several sizes (domain size
    pooling; Dong and Soatto, CVPR 2015). So a floor is found again that other photos see at a grazing angle."""
    added: bool = False
    """The features and matches of the way before count, too."""
    least_photos: int = 0
    """The way is not tried with fewer photos. Among few photos, a wrong group looks like a right one: with two lenses and
    without EXIF, five of eight photos were placed 4 degrees off."""

    def settings(self, longest: int, photos: int) -> dict:
        """What the settings of `matching_process` say of the way.

        longest: pixels of the longest side of all photos. photos: their number.
        """
        return {
            "features": self.features,
            "first_octave": -1 if longest < self.doubled_below else 0,
            "all_pairs_up_to": self.all_pairs_up_to,
            "partners": self.partners,
            "global": self.globally,
            "affine": self.affine,
            "enough": enough(photos),
        }


WAYS = (
    Way(None, features=6000, doubled_below=1100, all_pairs_up_to=25),
    Way(
        Message("cameras.way_all_pairs"),
        features=8192,
        doubled_below=LONGEST_SIDE + 1,
        all_pairs_up_to=150,
        globally=True,
    ),
    Way(
        Message("cameras.way_affine"),
        features=8192,
        doubled_below=LONGEST_SIDE + 1,
        all_pairs_up_to=150,
        globally=True,
        affine=True,
        added=True,
        least_photos=16,
    ),
)
"""The first one is cheap and finds the cameras of most captures. The second one has pycolmap's own features
and pairs. The third one takes twice as long for its features, and adds them to those of the second."""
