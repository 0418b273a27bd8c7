"""Compare our stage 2 with a peer: inverse path tracing with Mitsuba 3, on the true mesh and from the same photos.

    python -m benchmarks.baselines.peer_mitsuba CAPTURE... [--minutes 3 10] [--materials texture one] [--threads 1]
                                      [--beside out/benchmarks] [--write docs/peer.md]

This program needs `pip install '.[peer]'` and an LLVM shared library, version 15 or newer (DRJIT_LIBLLVM_PATH names it).
Captures, scores and pictures are those of `python -m benchmarks run --geometry true`. `--beside` puts the rows of that
command into the table too. Their CPU seconds include F_e, because the peer also learns its light within its minutes.

`--materials texture` learns a texture for each of albedo, roughness and metallic. `--materials one` learns a single
material, which is the peer's best case for an object of one material. Minutes are CPU minutes; they start when the photos
are loaded and the mesh is unwrapped. Every run writes one JSON file and pictures, and is skipped when the JSON file exists
(its name has a hash of the settings). A run that fails is a row with its message. At the end the program prints the table,
and `--write` puts it between the markers of a document.
"""

from __future__ import annotations

import argparse
import hashlib
import itertools
import sys
import time
from collections.abc import Iterable
from dataclasses import asdict, replace
from functools import partial
from pathlib import Path

import numpy as np
from PIL import Image

from benchmarks.reports.report import fill, require_markers
from benchmarks.reports.rows import Results
from benchmarks.reports.tables import presets_of
from benchmarks.scoring.geometry import load_test_views
from benchmarks.scoring.materials import score
from benchmarks.suite.harness import markdown, resumed, use_threads
from benchmarks.suite.identity import looked_at
from benchmarks.suite.kept_rows import load
from blender_nep.capture import PixelRays, load_capture
from blender_nep.color import linear_to_srgb
from blender_nep.errors import LearningError
from blender_nep.materials.training import Materials
from blender_nep.presets import preset
from blender_nep.surface.mesh_file import load_surface

COLUMNS = {"mse_roughness": "roughness", "mse_metallic": "metallic", "mse_albedo": "albedo", "cpu_seconds": "CPU s"}


def run(folder: Path, minutes: float, settings, seed: int, picture: Path) -> dict:
    """Run the peer once with `settings` (PeerSettings), and return its scores."""
    from benchmarks.baselines.inverse_path_tracing import learn

    balanced = preset("balanced")
    capture = load_capture(folder)
    test = load_test_views(folder, capture)
    rays = PixelRays.from_capture(capture, balanced.max_pixels_per_photo, False)
    surface, _ = load_surface(folder / "gt_mesh.ply", capture, balanced.surface)
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
        picture.with_suffix(".textures.png")
    )
    return out | {"settings": asdict(settings), "report": learned.report}


def cells(row: dict) -> list:
    """One line of the table. The line of a failed run shows its message."""
    name = {"texture": "peer, textures", "one": "peer, one material"}[row["materials"]]
    scores = [float(row[c]) for c in COLUMNS] if "error" not in row else [row["error"]]
    return [row["capture"], f"{name}, {row['minutes']:g} min", *scores]


def our_cells(suite: Path, captures: Iterable[str]) -> list[list]:
    """The table's lines of our own runs: those on the true meshes that were scored. They have the same columns."""
    ours, lines = Results(load(suite)).whole(geometry="true", ablation="full", seed=0), []
    for capture in captures:
        for preset_name in presets_of(ours.where(capture=capture)):
            at = ours.where(capture=capture, preset=preset_name)
            scores = [at.figure(name) for name in COLUMNS if name != "cpu_seconds"]
            stages = [at.figure(f"cpu_seconds_{stage}") for stage in ("fields_learning", "material_learning")]
            if None not in scores + stages:
                lines.append([capture, f"ours, {preset_name}", *(f.mean for f in scores), sum(f.mean for f in stages)])
    return lines


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.split("\n")[0])
    parser.add_argument("captures", nargs="+", type=Path)
    parser.add_argument("--minutes", nargs="+", type=float, default=[3.0, 10.0])
    parser.add_argument("--materials", nargs="+", default=["texture", "one"], choices=["texture", "one"])
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--threads", type=int, default=1)
    parser.add_argument("--out", type=Path, default=Path("out/benchmarks/peer"))
    parser.add_argument("--beside", type=Path, help="a suite's folder: its runs on the true meshes stand in the table")
    parser.add_argument("--write", type=Path, help="a document with the marker `peer`")
    arguments = parser.parse_args()
    require_markers(parser, arguments.write, "peer")
    photos = dict(zip(arguments.captures, looked_at(parser, arguments.captures, masks=True), strict=True))
    try:
        import drjit

        from benchmarks.baselines.inverse_path_tracing import PeerSettings
    except ImportError as error:
        sys.exit(
            f"the peer needs Mitsuba 3 (pip install '.[peer]') and libLLVM 15 or newer, named by DRJIT_LIBLLVM_PATH "
            f"where it is not found: {error}"
        )
    use_threads(arguments.threads)
    drjit.set_thread_count(arguments.threads)
    header, rows = ["capture", "method", *COLUMNS.values()], []
    for folder, kind, minutes in itertools.product(arguments.captures, arguments.materials, arguments.minutes):
        row = {
            "capture": folder.name,
            "photos": photos[folder],
            "materials": kind,
            "minutes": minutes,
            "seed": arguments.seed,
            "threads": arguments.threads,
        }
        settings = PeerSettings() if kind == "texture" else replace(PeerSettings(), levels=(1,))
        tag = hashlib.sha256(repr(asdict(settings)).encode()).hexdigest()[:8]
        file = arguments.out / f"{folder.name}-{kind}-{minutes:g}-{arguments.seed}-{tag}.json"
        rows.append(
            cells(resumed(file, row, partial(run, folder, minutes, settings, arguments.seed, file.with_suffix(".png"))))
        )
        print(markdown(header, rows[-1:]).splitlines()[-1], flush=True)
    if arguments.beside:
        rows = sorted(
            our_cells(arguments.beside, [folder.name for folder in arguments.captures]) + rows, key=lambda line: line[0]
        )
    text = markdown(header, rows)
    print("\n" + text)
    if arguments.write:
        fill(arguments.write, {"peer": text})


if __name__ == "__main__":
    main()
