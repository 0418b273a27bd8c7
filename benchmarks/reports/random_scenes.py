"""Fills `docs/random-scenes.md` after a run: the tables of random scenes, and pictures of the worst."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

import numpy as np
from PIL import Image

from benchmarks.reports.random_tables import COLUMNS, SETS, Scored, mean_table, part_of, scene_table, worst_scenes
from benchmarks.reports.report import fill, head
from benchmarks.reports.rows import values_of
from benchmarks.row_files import failure, read_row
from benchmarks.suite.kept_rows import kept
from benchmarks.suite.plan import Run
from benchmarks.suite.render import RANDOM
from benchmarks.suite.runner import last_line
from blender_nep.files import write_atomically
from blender_nep.safety.pictures import open_picture

TILE = 160
"""Width and height, in pixels, of a picture in the strips of the worst scenes."""


def scored_scenes(out: Path, captures: Path, seeds: Sequence[int], runs: Sequence[Run]) -> list[Scored]:
    """The scenes `seeds` in their order. Each has figures, or the message of the step that failed."""
    by_capture = {run.capture.name: run for run in runs}
    scenes = []
    for seed in seeds:
        capture = f"{RANDOM}{seed}"
        summary = read_row(captures / capture / "scene.json").get("summary", "")
        run = by_capture.get(capture)
        row = read_row(out / "rows" / f"{run.name}.json") if run else {}
        values: dict[str, float] = {}
        if run is None:
            log = captures / f"{capture}.log"
            message = f"render: {last_line(log)}" if log.is_file() else "not rendered"
        elif "learn" not in row:
            message = "not run"
        else:
            message = failure(row)
            if "error" not in row["learn"]:
                values = {k: v for k, v in values_of(kept(row)).means.items() if k in COLUMNS}
        scenes.append(Scored(seed, summary, values, message, run.name if run else ""))
    return scenes


def write_random_report(out: Path, captures: Path, seeds: Sequence[int], runs: Sequence[Run], document: Path) -> list[str]:
    """Write the tables between the document's markers, and the pictures into the folder with the document's name.

    Returns the names of the markers that the document does not have.
    """
    scenes = scored_scenes(out, captures, seeds, runs)
    rows = [row for row in (read_row(out / "rows" / f"{run.name}.json") for run in runs) if "learn" in row]
    parts = {"head": head([kept(row) for row in rows]), "means": mean_table(scenes)}
    for marker in SETS:
        parts[marker] = scene_table(part_of(scenes, marker))
    pictures = document.with_suffix("")
    for old in pictures.glob("*.png"):  # `pictures` may be `out`, so nothing else is deleted
        if old.stem.isdigit():
            old.unlink()
    shown = []
    for scene in worst_scenes(scenes):
        text = f"**Seed {scene.seed}.** {scene.summary or 'The scene was not rendered.'}"
        text += f" *Failed: {scene.message}*" if scene.message else ""
        if draw(out, captures / f"{RANDOM}{scene.seed}", scene.name, pictures / f"{scene.seed}.png"):
            text += f"\n\n![Seed {scene.seed}]({document.stem}/{scene.seed}.png)"
        shown.append(text)
    parts["worst"] = "\n\n".join(shown)
    return fill(document, parts)


def draw(out: Path, capture: Path, name: str, picture: Path) -> bool:
    """Draw a strip: a test photo, then normals, albedo, roughness and metallic, the true ones beside the learned ones.

    Draws only the photo where there is no asset. Returns False, and draws nothing, where there is no photo.
    """
    from benchmarks.scoring.geometry import load_test_views
    from blender_nep.capture import load_capture

    if not (capture / "transforms.json").is_file():
        return False
    tiles = []
    test = load_test_views(capture, load_capture(capture))
    scores = out / "pictures" / f"{name}.score.png"
    tiles.append(_photo(test))
    if (out / "assets" / name / "mesh.obj").is_file() and scores.is_file():
        tiles += _normals(out / "assets" / name, capture, test)
        strip = np.asarray(open_picture(scores).convert("RGB"))
        size = strip.shape[1] // 6
        tiles += [strip[:size, k * size : (k + 1) * size] for k in range(6)]
    picture.parent.mkdir(parents=True, exist_ok=True)
    small = [np.asarray(Image.fromarray(tile).resize((TILE, TILE), Image.Resampling.LANCZOS)) for tile in tiles]
    strip = Image.fromarray(np.concatenate(small, axis=1))
    write_atomically(picture, lambda part: strip.save(part, "PNG", optimize=True))
    return True


def _photo(test) -> np.ndarray:
    """The first test photo [H,W,3] uint8, sRGB."""
    from blender_nep.capture.photos.photo_files import open_image
    from blender_nep.color import linear_to_srgb

    radiance, _ = open_image(test.views[0].image_path, test.color_space).rows()
    return (linear_to_srgb(np.clip(radiance, 0, 1)) * 255).round().astype(np.uint8)


def _normals(asset: Path, capture: Path, test) -> list[np.ndarray]:
    """The true and our normals of the first test view, [H,W,3] uint8 each; 128 is 0."""
    from benchmarks.scoring.asset_mesh import read_asset_mesh
    from benchmarks.scoring.geometry import Body, camera_rays
    from benchmarks.scoring.materials import read_channels

    surface = read_asset_mesh(asset / "mesh.obj", test)
    body = Body(surface.vertices, surface.faces)
    origins, directions, size = camera_rays(test, 0, 1)
    _, ray, face = body.first_hits(origins, directions)
    ours = np.zeros((len(origins), 3))
    ours[ray] = body.mesh.face_normals[face]
    truth = read_channels(capture / "gt" / "000.exr")
    normal = np.stack([truth[f"Normal.{c}"] for c in "XYZ"], axis=-1)
    true = normal * (truth["mask.V"].reshape(*size, 1) > 0.5)
    return [((np.clip(n.reshape(*size, 3), -1, 1) + 1) * 127.5).round().astype(np.uint8) for n in (true, ours)]
