"""How far found cameras are from the true ones, after the best similarity."""

from __future__ import annotations

import argparse
import json
from collections.abc import Sequence
from pathlib import Path

import numpy as np

from blender_nep.cameras.alignment import angle, similarity
from blender_nep.capture import load_capture
from blender_nep.capture.cameras.camera import Camera


def errors(found: Sequence[Camera], true: Sequence[Camera], center: np.ndarray) -> dict[str, float]:
    """Median and largest errors of found cameras: rotation [degrees], position and focal length [parts of 1].

    Positions count relative to the true camera's distance from `center` [3]. The direction error is the angle between the
    rays through a grid of pixels, after the similarity: it has the lens in it.
    """
    turn, scale, shift = similarity(found, true)
    rotation, position, direction = [], [], []
    for f, t in zip(found, true, strict=True):
        difference = t.camera_to_world[:3, :3].T @ turn @ f.camera_to_world[:3, :3]
        rotation.append(angle(difference))
        away = np.linalg.norm(scale * turn @ f.position + shift - t.position)
        position.append(float(away / np.linalg.norm(t.position - center)))
        x, y = (grid.ravel() for grid in np.meshgrid(*(np.linspace(0.05, 0.95, 7) * side for side in (t.width, t.height))))
        cosine = ((f.directions(x, y) @ turn.T) * t.directions(x, y)).sum(1)
        direction.append(float(np.degrees(np.arccos(cosine.clip(-1, 1))).mean()))
    focal = [abs(f.fl_x / t.fl_x - 1) for f, t in zip(found, true, strict=True)]
    return {
        "photos": len(found),
        "rotation_deg": float(np.median(rotation)),
        "rotation_deg_largest": max(rotation),
        "position": float(np.median(position)),
        "position_largest": max(position),
        "direction_deg": float(np.median(direction)),
        "focal_length": float(np.median(focal)),
    }


def compare(found: Path, true: Path) -> dict[str, float]:
    """`errors` of two captures of the same photos. Photos are matched by their names; those of `true` alone do not count."""
    by_name = {view.image_path.name: view.camera for view in load_capture(true, use_masks=False).views}
    views = load_capture(found, use_masks=False).views
    center = load_capture(true, use_masks=False).object_center
    result = errors([view.camera for view in views], [by_name[view.image_path.name] for view in views], center)
    return result | {"photos_of_all": len(by_name)}


if __name__ == "__main__":
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("found", type=Path, help="capture whose cameras were found")
    parser.add_argument("true", type=Path, help="capture of the same photos with the true cameras")
    options = parser.parse_args()
    print(json.dumps(compare(options.found, options.true), indent=1))
