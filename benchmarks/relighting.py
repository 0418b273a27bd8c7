"""Relighting against ground truth: an asset and the true object in Cycles under HDRIs that no photo showed.

    python -m benchmarks.relighting CAPTURE=ASSET... [--worlds 3] [--views 3] [--out out/benchmarks/relighting]

A capture is a folder with `transforms_test.json`, `test_masks/` and `scene.blend`, whose object is named `target`; an asset
is what `blender-nep reconstruct` wrote. Scores are PSNR (dB, tone-mapped by log(1 + 4x) / log 5, white = 1 after the
exposure that suits the true rendering) over the pixels of the true object. Pictures: one row a view, truth beside ours for
each light. Needs the `bpy` extra.
"""

from __future__ import annotations

import argparse
import json
import sys
from pathlib import Path

import bpy
import numpy as np
from PIL import Image

from backend.asset_import import import_asset
from backend.capture_files import Frame, linear_to_srgb, read_frames, spread_frames
from backend.comparison import exposure
from backend.relight import RelitScene
from backend.world import blender_hdris, build_world
from benchmarks.harness import markdown, write_row

OBJECT = "target"


def tone(radiance: np.ndarray) -> np.ndarray:
    """log(1 + 4x) / log 5 of radiance clipped to 0..1."""
    return np.log1p(4 * radiance.clip(0, 1)) / np.log(5)


def true_object(blend: Path):
    """The capture's own object with its material, linked into no scene yet."""
    with bpy.data.libraries.load(str(blend)) as (source, loaded):
        if OBJECT not in source.objects:
            raise OSError(f"{blend} has no object {OBJECT!r}: it holds {', '.join(source.objects)}")
        loaded.objects = [OBJECT]
    return loaded.objects[0]


def mask(folder: Path, frame: Frame, width: int, height: int) -> np.ndarray:
    """[height, width] bool: pixels that lie wholly on the true object."""
    file = folder / "test_masks" / f"{frame.path.stem}.png"
    with Image.open(file) as image:
        return np.asarray(image.convert("L").resize((width, height), Image.Resampling.BOX)) > 250


def compare(folder: Path, asset: Path, worlds: int, views: int, pixels: int, samples: int, picture: Path) -> dict:
    """Renders both objects under every light; PSNR for each light and their mean."""
    bpy.ops.wm.read_factory_settings(use_empty=True)
    frames = spread_frames(read_frames(folder, "transforms_test.json"), views)
    lights = [build_world(path, name=path.stem) for path in blender_hdris()[:worlds]]
    items = [true_object(folder / "scene.blend"), import_asset(asset, bpy.context.scene.collection)]
    width = pixels
    height = round(pixels * frames[0].height / frames[0].width)
    rendered = []
    for item in items:
        relit = RelitScene(item, width, height, samples)
        rendered.append([[relit.render(frame, light) for light in lights] for frame in frames])
        relit.close()
    errors: dict[str, list] = {light.name: [] for light in lights}
    rows = []
    for frame, true, ours in zip(frames, *rendered, strict=True):
        inside, row = mask(folder, frame, width, height), []
        for light, a, b in zip(lights, true, ours, strict=True):
            gain = exposure(a[inside])
            errors[light.name].append(((tone(gain * a) - tone(gain * b)) ** 2)[inside])
            row += [linear_to_srgb(gain * a), linear_to_srgb(gain * b)]
        rows.append(np.concatenate(row, 1))
    Image.fromarray(np.round(255 * np.concatenate(rows)).astype(np.uint8)).save(picture)
    psnr = {name: float(-10 * np.log10(np.concatenate(e).mean())) for name, e in errors.items()}
    return {"capture": folder.name, "asset": str(asset), "psnr": psnr, "mean": float(np.mean(list(psnr.values())))}


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.split("\n")[0])
    parser.add_argument("pairs", nargs="+", metavar="CAPTURE=ASSET")
    parser.add_argument("--worlds", type=int, default=3)
    parser.add_argument("--views", type=int, default=3)
    parser.add_argument("--pixels", type=int, default=256)
    parser.add_argument("--samples", type=int, default=64)
    parser.add_argument("--out", type=Path, default=Path("out/benchmarks/relighting"))
    arguments = parser.parse_args()
    arguments.out.mkdir(parents=True, exist_ok=True)
    rows = []
    for pair in arguments.pairs:
        folder, _, asset = pair.partition("=")
        if not asset:
            parser.error(f"{pair}: expected CAPTURE=ASSET")
        folder, asset = Path(folder), Path(asset)
        name = f"{folder.name}-{asset.name}"
        try:
            row = compare(folder, asset, arguments.worlds, arguments.views, arguments.pixels, arguments.samples,
                          arguments.out / f"{name}.png")
        except OSError as error:
            row = {"capture": folder.name, "asset": str(asset), "error": str(error)}
        write_row(arguments.out / f"{name}.json", row)
        print(json.dumps(row), file=sys.stderr, flush=True)
        lights = ", ".join(f"{light} {value:.1f}" for light, value in row.get("psnr", {}).items())
        rows.append([folder.name, asset.name, lights, row.get("mean", row.get("error"))])
    print(markdown(["capture", "asset", "PSNR by light, dB", "mean"], rows))


if __name__ == "__main__":
    main()
