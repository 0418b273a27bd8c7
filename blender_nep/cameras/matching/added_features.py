"""Adds the features and matches of an earlier way to those of this one, in pycolmap's process.

It runs in the process of `matching_process`, and imports no more of the package than that one.
"""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np


def add_features(pycolmap: Any, folder: Path, earlier: Path, verification: Any) -> None:
    """Put the features and matches of the database `earlier` behind those of the folder's own, and judge them together.

    Both databases are of the same photos. Features are matched with those of their own kind only, so no descriptors are
    needed any more: they are cleared. A pair of photos counts if the matches of both kinds agree on one geometry.
    """
    with pycolmap.Database.open(str(folder / "database.db")) as own, pycolmap.Database.open(str(earlier)) as other:
        numbers = {image.name: image.image_id for image in own.read_all_images()}
        number_of = {image.image_id: numbers[image.name] for image in other.read_all_images()}
        places = {number: np.asarray(own.read_keypoints(number)) for number in numbers.values()}
        added = {number_of[number]: np.asarray(other.read_keypoints(number)) for number in number_of}
        matches = _matches(pycolmap, own)
        for (first, second), found in _matches(pycolmap, other).items():
            pair, moved = (number_of[first], number_of[second]), found.copy()
            moved += np.array([len(places[number]) for number in pair], found.dtype)
            if pair[0] > pair[1]:
                pair, moved = pair[::-1], moved[:, ::-1]
            matches[pair] = np.vstack([matches[pair], moved]) if pair in matches else moved
        own.clear_two_view_geometries()
        own.clear_matches()
        own.clear_descriptors()
        own.clear_keypoints()
        for number, found in places.items():
            own.write_keypoints(number, np.vstack([found, added[number]]))
        for (first, second), found in matches.items():
            own.write_matches(first, second, np.ascontiguousarray(found))
    pycolmap.verify_matches(folder / "database.db", folder / "pairs.txt", verification)


def _matches(pycolmap: Any, database: Any) -> dict[tuple[int, int], np.ndarray]:
    """{(number of a photo, a larger one): [n, 2] numbers of the features that match}"""
    pairs, found = database.read_all_matches()
    return {tuple(pycolmap.pair_id_to_image_pair(pair)): np.asarray(one) for pair, one in zip(pairs, found, strict=True)}
