"""What pycolmap's process says and writes, for `structure_from_motion` to read.

It runs in the process of `matching_process`, and imports no more of the package than that one.
"""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import numpy as np

from blender_nep.cameras.matching.adjustment import support


def say(stage: str, step: int, steps: int) -> None:
    """Say on standard output how far the work is."""
    print(json.dumps({"stage": stage, "step": step, "steps": steps}), flush=True)


def write(folder: Path, models: list[tuple[Any, dict]]) -> None:
    """Write models in COLMAP's form, and `result.json`. Each model comes with what else is to be said of its photos."""
    told = []
    for number, (model, more) in enumerate(models):
        target = folder / "sparse" / str(number)
        target.mkdir(parents=True, exist_ok=True)
        model.write_binary(str(target))
        images = [model.images[i] for i in model.reg_image_ids()]
        photos = {image.name: support(model, image) for image in images}
        for image in images:
            seen = [(*p.xy, *model.points3D[p.point3D_id].xyz) for p in image.points2D if p.has_point3D()]
            np.save(target / f"{image.name}.npy", np.array(seen).reshape(-1, 5))
        told.append({"folder": str(number), "photos": photos} | more)
        points = [point.xyz for point in model.points3D.values() if point.track.length() >= 3]
        np.save(folder / f"points_{number}.npy", np.array(points).reshape(-1, 3))
    (folder / "result.json").write_text(json.dumps(told), encoding="utf-8")
