"""Fills `docs/random-scenes.md`: the scores of random scenes, odd and even seeds apart, and pictures of the worst.

Odd seeds are for working. Even seeds are only reported, so nothing may be changed for the sake of one of them.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from PIL import Image

from benchmarks.reports.report import fill, head
from benchmarks.reports.rows import figures, name_of
from benchmarks.reports.tables import COSTS, NONE, SCORES
from benchmarks.row_files import read_row
from benchmarks.suite.harness import markdown
from benchmarks.suite.plan import Run
from benchmarks.suite.render import RANDOM
from benchmarks.suite.runner import failure, last_line
from blender_nep.files import write_atomically

COLUMNS = {
    name: (SCORES | COSTS)[name]
    for name in (
        "cd_visible",
        "normal_deg",
        "mask_iou",
        "background_psnr",
        "mse_roughness",
        "mse_metallic",
        "mse_albedo",
        "cpu_seconds",
    )
}
WANTED = {"cd_visible": 0.008, "mse_roughness": 0.01, "mse_metallic": 0.05, "mse_albedo": 0.015}
"""Figure -> the mean over even seeds that the project wants to reach at most."""
HIGHER_IS_BETTER = ("mask_iou", "background_psnr")
WORST = 3
SETS = {"odd": (1, "odd seeds, for working"), "even": (0, "even seeds, only reported")}
"""Marker -> (remainder of the seed by 2, heading)."""
TILE = 160
"""Width and height, in pixels, of a picture in the strips of the worst scenes."""


@dataclass
class Scored:
    """What became of a random scene."""

    seed: int
    summary: str
    """the scene in words; empty where it was not rendered"""
    values: dict[str, float]
    """figures of COLUMNS; empty where the job failed"""
    message: str
    """why there are no figures; empty where there are"""
    name: str
    """the name of the run's files"""

    @property
    def badness(self) -> float:
        """The mean of the figures of WANTED, each divided by what is wanted; infinite where one is missing."""
        if not WANTED.keys() <= self.values.keys():
            return math.inf
        return float(np.mean([self.values[name] / wanted for name, wanted in WANTED.items()]))


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
                values = {k: v for k, v in figures(row, {name_of(row): row}).items() if k in COLUMNS}
        scenes.append(Scored(seed, summary, values, message, run.name if run else ""))
    return scenes


def scene_table(scenes: Sequence[Scored]) -> str:
    """A table with a line for each scene. A scene without figures has its message instead."""
    rows = [
        [scene.seed, scene.summary or NONE, *(_cell(scene.values.get(name), name) for name in COLUMNS), scene.message or ""]
        for scene in scenes
    ]
    return markdown(["seed", "scene", *(heading for heading, _ in COLUMNS.values()), "failed"], rows)


def mean_table(scenes: Sequence[Scored]) -> str:
    """The means and the worst values of odd and of even seeds, and how many scenes they count."""
    rows = []
    for remainder, heading in SETS.values():
        own = [scene for scene in scenes if scene.seed % 2 == remainder]
        scored = [scene for scene in own if not scene.message]
        for word, pick in (("mean", _mean), ("worst", _worst)):
            cells = [_cell(pick([s.values[name] for s in scored if name in s.values], name), name) for name in COLUMNS]
            rows.append([heading, word, f"{len(scored)} of {len(own)}", *cells])
    wanted = [_cell(WANTED.get(name), name) for name in COLUMNS]
    rows.append(["**wanted for even seeds**", "mean", "all", *wanted])
    return markdown(["scenes", "", "scored", *(heading for heading, _ in COLUMNS.values())], rows)


def _cell(value: float | None, name: str) -> str:
    return NONE if value is None else f"{value:.{COLUMNS[name][1]}f}"


def _mean(values: list[float], name: str) -> float | None:
    return float(np.mean(values)) if values else None


def _worst(values: list[float], name: str) -> float | None:
    return (min if name in HIGHER_IS_BETTER else max)(values) if values else None


def worst_scenes(scenes: Sequence[Scored]) -> list[Scored]:
    """The WORST scenes of all, the worst first. A scene without figures is worse than any scene with figures."""
    return sorted(scenes, key=lambda scene: -scene.badness)[:WORST]


def write_random_report(out: Path, captures: Path, seeds: Sequence[int], runs: Sequence[Run], document: Path) -> list[str]:
    """Write the tables between the document's markers, and the pictures into the folder with the document's name.

    Returns the names of the markers that the document does not have.
    """
    scenes = scored_scenes(out, captures, seeds, runs)
    rows = [row for row in (read_row(out / "rows" / f"{run.name}.json") for run in runs) if "learn" in row]
    parts = {"head": head(rows), "means": mean_table(scenes)}
    for marker, (remainder, _) in SETS.items():
        parts[marker] = scene_table([scene for scene in scenes if scene.seed % 2 == remainder])
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
        strip = np.asarray(Image.open(scores).convert("RGB"))
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
