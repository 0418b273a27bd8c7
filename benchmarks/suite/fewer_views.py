"""Makes captures with fewer photos.

Such a capture is a folder with its own transforms.json and links to the files of the whole capture.
"""

from __future__ import annotations

import hashlib
import json
from pathlib import Path

import numpy as np

from benchmarks.suite.harness import MADE_FROM, is_made_from, link, write_made


def spread(positions: np.ndarray, count: int) -> list[int]:
    """Indices of `count` camera positions [n, 3] that are spread evenly.

    The first is position 0. Each next one is as far as possible from those before it. So a smaller `count` gives the
    beginning of the list that a larger one gives.
    """
    chosen = [0]
    nearest = np.linalg.norm(positions - positions[0], axis=1)
    while len(chosen) < min(count, len(positions)):
        chosen.append(int(nearest.argmax()))
        nearest = np.minimum(nearest, np.linalg.norm(positions - positions[chosen[-1]], axis=1))
    return chosen


def with_fewer_views(capture: Path, count: int, folder: Path) -> Path:
    """Write a capture with `count` photos of `capture` into `folder`, unless it is there already. Returns `folder`.

    It is made again where `capture` is another folder, or has other cameras, than when it was made. The photos are links.
    """
    text = (capture / "transforms.json").read_text(encoding="utf-8")
    source = f"{capture.resolve()}\n{hashlib.sha256(text.encode()).hexdigest()}"
    if is_made_from(folder, source):
        return folder
    meta = json.loads(text)
    positions = np.array([frame["transform_matrix"] for frame in meta["frames"]])[:, :3, 3]
    kept = sorted(spread(positions, count))
    folder.mkdir(parents=True, exist_ok=True)
    for entry in capture.iterdir():
        if entry.name not in ("transforms.json", MADE_FROM):
            link(folder / entry.name, entry)
    write_made(folder, meta | {"frames": [meta["frames"][k] for k in kept]}, source)
    return folder
