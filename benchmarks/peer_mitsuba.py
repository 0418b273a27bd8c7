"""A peer beside our stage 2: inverse path tracing with Mitsuba 3 on the true mesh, from the same photos.

    python -m benchmarks.peer_mitsuba CAPTURE... [--minutes 3 10] [--materials texture one] [--threads 1]

Needs `pip install '.[peer]'` and an LLVM shared library, version 15 or newer (DRJIT_LIBLLVM_PATH names it). Captures,
scores and pictures are those of `python -m benchmarks run --geometry true`, the row to put beside these. `texture`
is a texture for each of albedo, roughness and metallic, `one` a single material, which is the peer's best case for an
object of one. Minutes are of CPU, from the loaded photos and the unwrapped mesh on. Every run writes one JSON file and a
picture and is skipped when that exists (names have the settings' hash); a run that fails is a row with its message. Ends
with a table.
"""

from __future__ import annotations

import argparse
import hashlib
import itertools
import sys
import time
from dataclasses import asdict, replace
from functools import partial
from pathlib import Path

import numpy as np
from PIL import Image

from benchmarks.harness import markdown, resumed, use_threads
from benchmarks.materials import score
from blender_nep.capture import PixelRays, load_capture
from blender_nep.capture.images import linear_to_srgb
from blender_nep.errors import LearningError
from blender_nep.material_learning import Materials
from blender_nep.presets import preset
from blender_nep.surface import load_surface

COLUMNS = ("mse_roughness", "mse_metallic", "mse_albedo", "seconds", "cpu_seconds")


def run(folder: Path, minutes: float, settings, seed: int, picture: Path) -> dict:
    """One run of the peer with `PeerSettings`, and its scores."""
    from benchmarks.inverse_path_tracing import learn

    balanced = preset("balanced")
    capture, test = load_capture(folder), load_capture(folder, transforms="transforms_test.json")
    test.object_center, test.object_radius = capture.object_center, capture.object_radius
    rays = PixelRays.from_capture(capture, balanced.max_pixels_per_photo, False)
    surface = load_surface(folder / "gt_mesh.ply", capture, balanced.surface)
    wall, cpu = time.perf_counter(), time.process_time()
    learned = learn(surface, rays, settings, minutes, seed)
    out = {"seconds": time.perf_counter() - wall, "cpu_seconds": time.process_time() - cpu}
    if not all(np.isfinite(x).all() for x in (learned.albedo, learned.roughness, learned.metallic, learned.environment)):
        raise LearningError("the peer diverged: a texture or the environment map is not finite", "lower its rates")
    materials = Materials(learned.albedo, learned.roughness, learned.metallic, np.ones_like(learned.metallic))
    out |= score(surface, materials, folder, capture, test, picture)
    light = linear_to_srgb(learned.environment / (1 + learned.environment))
    Image.fromarray((255 * light.clip(0, 1)).astype(np.uint8)).save(picture.with_suffix(".light.png"))
    textures = [learned.albedo, *(np.repeat(x[..., None], 3, -1) for x in (learned.roughness, learned.metallic))]
    textures[0] = linear_to_srgb(textures[0])
    Image.fromarray((255 * np.concatenate(textures, 1).clip(0, 1)).astype(np.uint8)).save(
        picture.with_suffix(".textures.png"))
    return out | {"settings": asdict(settings), "report": learned.report}


def cells(row: dict) -> list:
    """One line of the table; a failed run shows its message."""
    scores = [float(row[c]) if c in row else row.get("error", "") for c in COLUMNS]
    return [row["capture"], row["materials"], row["minutes"], *scores, row.get("report", {}).get("steps", "")]


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.split("\n")[0])
    parser.add_argument("captures", nargs="+", type=Path)
    parser.add_argument("--minutes", nargs="+", type=float, default=[3.0, 10.0])
    parser.add_argument("--materials", nargs="+", default=["texture", "one"], choices=["texture", "one"])
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--threads", type=int, default=1)
    parser.add_argument("--out", type=Path, default=Path("out/benchmarks/peer"))
    arguments = parser.parse_args()
    try:
        import drjit

        from benchmarks.inverse_path_tracing import PeerSettings
    except ImportError as error:
        sys.exit(f"the peer needs Mitsuba 3 (pip install '.[peer]') and libLLVM 15 or newer, named by DRJIT_LIBLLVM_PATH "
                 f"where it is not found: {error}")
    use_threads(arguments.threads)
    drjit.set_thread_count(arguments.threads)
    header, rows = ["capture", "materials", "minutes", *COLUMNS, "steps"], []
    for folder, kind, minutes in itertools.product(arguments.captures, arguments.materials, arguments.minutes):
        row = {"capture": folder.name, "materials": kind, "minutes": minutes, "seed": arguments.seed,
               "threads": arguments.threads}
        settings = PeerSettings() if kind == "texture" else replace(PeerSettings(), levels=(1,))
        tag = hashlib.sha256(repr(asdict(settings)).encode()).hexdigest()[:8]
        file = arguments.out / f"{folder.name}-{kind}-{minutes:g}-{arguments.seed}-{tag}.json"
        rows.append(cells(resumed(file, row, partial(run, folder, minutes, settings, arguments.seed,
                                                     file.with_suffix(".png")))))
        print(markdown(header, rows[-1:]).splitlines()[-1], flush=True)
    print("\n" + markdown(header, rows))


if __name__ == "__main__":
    main()
