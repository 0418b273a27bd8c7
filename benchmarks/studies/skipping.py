"""Compare whole jobs with and without scene analysis: what it leaves out, the time it saves, and whether errors grow.

    python -m benchmarks.studies.skipping SCENE... [--preset preview] [--seeds 0 1 2] [--out out/benchmarks/skipping]
                                  [--write docs/benchmarks.md]

A scene is the folder of a capture with ground truth. Words after a colon, with commas between them, change the capture or
the job. `cut-out`, `clipped`, `auto-exposed` and `distant` make a variant of the capture (see derived_captures). `masks`
uses the masks of the capture, which are ignored otherwise; variants always use them. `metal` runs the job with
`--metal yes`.

Every run writes one JSON file, and is skipped when that file exists. A run that fails is a row with its message. Stage 1 is
learned once where leaving out changes nothing in it. Seconds are CPU seconds of the whole job, with the scene analysis. Two
small jobs run before anything is timed, so that no run contains the compilation of kernels. At the end the program prints
the table, and `--write` puts it between the markers of a document.
"""

from __future__ import annotations

import argparse
import hashlib
import io
import itertools
import math
import sys
import tempfile
import time
from collections.abc import Iterable
from dataclasses import dataclass, replace
from functools import partial
from pathlib import Path

import numpy as np

from benchmarks.reports.report import fill, require_markers
from benchmarks.scoring import geometry, materials
from benchmarks.stress.scenes import Case, write_capture
from benchmarks.suite.derived_captures import VARIANTS, derive
from benchmarks.suite.harness import commit_now, markdown, resumed, use_threads
from benchmarks.suite.identity import photos_of
from benchmarks.suite.runner import is_same_code
from benchmarks.suite.step import Timed
from blender_nep.capture import load_capture
from blender_nep.checkpoints import Checkpoint, load_state, save_state
from blender_nep.errors import CaptureError, NepError
from blender_nep.fields.training import Fields
from blender_nep.job.reporting.events import Events
from blender_nep.job.runner import Job, Settings
from blender_nep.job.stages import (
    AssetInput,
    AssetStage,
    FieldsInput,
    FieldsStage,
    MaterialsStage,
    Progress,
    Stages,
    SurfaceStage,
)
from blender_nep.presets import PRESETS, Preset
from blender_nep.stop_request import StopRequest


@dataclass(frozen=True)
class Scene:
    """A capture and the settings of the job on it. `metal`: the job is told that the object is metal."""

    folder: Path
    name: str
    masks: bool
    metal: bool

    @classmethod
    def parse(cls, text: str, out: Path) -> Scene:
        """The scene that the text `FOLDER[:word,word]` describes. A variant of the capture is made in `out`.

        Raises CaptureError where there is no usable capture, and SystemExit for a word that is unknown.
        """
        path, _, words = text.partition(":")
        folder, told = Path(path), [word for word in words.split(",") if word]
        name = "-".join([folder.name, *told])
        unknown = set(told) - set(VARIANTS) - {"masks", "metal"}
        if unknown:
            raise SystemExit(f"unknown: {', '.join(unknown)}")
        if not (folder / "transforms.json").is_file():
            raise CaptureError(f"{folder} is no capture: it has no transforms.json")
        for variant in set(told) & set(VARIANTS):
            folder = derive(folder, variant, out / "captures" / f"{folder.name}-{variant}")
        return cls(folder, name, bool(set(told) & ({"masks"} | set(VARIANTS))), "metal" in told)


def found_scenes(texts: Iterable[str], out: Path) -> list[Scene]:
    """The scenes that the texts describe. A scene whose capture cannot be read is left out, with a message."""
    scenes = []
    for text in texts:
        try:
            scenes.append(Scene.parse(text, out))
        except NepError as error:
            print(f"{text} is left out: {error}", file=sys.stderr, flush=True)
    return scenes


def without_skipping(preset: Preset) -> Preset:
    """The preset without any skipping: the job also does the work that this scene does not need."""
    m = preset.material
    return replace(preset, skip_needless=False, material=replace(m, sure_margin=math.inf, uniform_texels=m.most_texels))


class FieldsOnce(FieldsStage):
    """Stage 1 that is learned once for the same capture, seed, settings, commit and number of threads.

    The learned fields are stored in the folder `kept`, and the next run takes them from there. Nothing is stored or taken
    where no commit holds the code.
    """

    def __init__(self, scene: Scene, kept: Path, photos: str, commit: str, threads: int = 1) -> None:
        self.scene, self.kept, self.photos, self.commit, self.threads = scene, kept, photos, commit, threads
        self.taken_over: float | None = None
        """The CPU seconds of the stored stage 1 that this run has taken; None where this run has learned its own."""

    def run(self, given: FieldsInput, progress: Progress, checkpoint: Checkpoint) -> Fields:
        if not is_same_code(self.commit, self.commit):
            return super().run(given, progress, checkpoint)
        preset = given.preset
        same = repr(
            (
                self.photos,
                self.commit,
                self.scene.masks,
                given.seed,
                preset.fields,
                preset.environment,
                preset.max_pixels_per_photo,
                preset.even_exposure,
                preset.brightness,
                self.threads,
            )
        )
        file = self.kept / f"{self.scene.folder.name}-{hashlib.sha256(same.encode()).hexdigest()[:16]}.stage_1.pt"
        if file.is_file():
            state = load_state(file)
            self.taken_over = state["cpu_seconds"]
            return self.unpack(state["fields"], given)
        start = time.process_time()
        fields = super().run(given, progress, checkpoint)
        self.kept.mkdir(parents=True, exist_ok=True)
        save_state(file, {"fields": self.pack(fields), "cpu_seconds": time.process_time() - start})
        return fields


class KeptAsset(AssetStage):
    """Writes no asset. It keeps the stage's input, and the report of the job, in memory."""

    def __init__(self) -> None:
        self.given: AssetInput | None = None
        self.report: dict = {}

    def run(self, given: AssetInput) -> None:
        self.given, self.report = given, given.report()


def run(scene: Scene, preset: Preset, seed: int, threads: int, kept: Path, picture: Path, photos: str) -> dict:
    """Run one job, and return its seconds, its scores and what it skipped. `photos`: the scene's `photos_of`."""
    capture = load_capture(scene.folder, use_masks=scene.masks)
    stage_1, asset, cpu = FieldsOnce(scene, kept, photos, commit_now(), threads), KeptAsset(), {}
    stages = Stages(Timed(stage_1, cpu), Timed(SurfaceStage(), cpu), Timed(MaterialsStage(), cpu), asset)
    start = time.process_time()
    with tempfile.TemporaryDirectory() as out:
        settings = Settings(
            scene.folder, Path(out) / "asset", preset, device="cpu", seed=seed, use_masks=scene.masks, threads=threads
        )
        job = Job(settings, Events(None, io.StringIO()), StopRequest(), stages)
        try:
            job.run()
        finally:
            job.close()
    seconds = time.process_time() - start
    if stage_1.taken_over is not None:
        seconds += stage_1.taken_over
        cpu[str(stage_1.name)] = stage_1.taken_over
    test = geometry.load_test_views(scene.folder, capture)
    return {
        "cpu": cpu,
        "seconds": seconds,
        **geometry.score(asset.given.surface.surface, scene.folder, capture, test),
        **materials.score(asset.given.surface.surface, asset.given.materials, scene.folder, capture, test, picture),
        "skipped": asset.report["skipped"],
        "skipped_seconds": asset.report["skipped_seconds"],
        "scene": asset.report["scene"],
        "report": asset.report["stages"],
    }


def warm_up(threads: int) -> None:
    """Run small jobs, with skipping and without it, so that all kernels are compiled or loaded. Nothing of them is kept."""
    with tempfile.TemporaryDirectory() as name:
        capture = Path(name) / "ball"
        case = Case(threads=threads)
        write_capture(case, capture)
        told = case.settings(capture, Path(name) / "with")
        whole = replace(told, preset=without_skipping(told.preset), out=Path(name) / "without")
        for settings in (told, whole):
            job = Job(settings, Events(None, io.StringIO()), StopRequest(), Stages(asset=KeptAsset()))
            try:
                job.run()
            finally:
                job.close()


ERRORS = {
    "cd_visible": "distance",
    "normal_deg": "normals",
    "mse_roughness": "roughness",
    "mse_metallic": "metallic",
    "mse_albedo": "albedo",
}


def line(name: str, rows: dict[bool, list[dict]]) -> list[str]:
    """The table's line of one scene. `rows` holds the rows of the runs with skipping (True) and without it (False).

    The line shows the number of seeds, what only the runs with skipping left out, the seconds of both, the time saved in
    percent, and the errors of both. Numbers are means over the seeds ± their deviation. Only the seeds whose runs did not
    fail on either side count.
    """
    failed = {row["seed"]: row["error"] for found in rows.values() for row in found if "error" in row}
    tried = {row["seed"] for found in rows.values() for row in found}
    if not tried - set(failed):
        return [name, f"0 of {len(tried)}", next(iter(failed.values()))]
    good = {skip: [row for row in found if row["seed"] not in failed] for skip, found in rows.items()}
    left_out = {what for row in good[True] for what in row["skipped"]} - {w for row in good[False] for w in row["skipped"]}
    seeds = f"{len(tried) - len(failed)} of {len(tried)}" if failed else str(len(tried))
    cells = [name, seeds, ", ".join(sorted(left_out)) or "nothing"]
    for key in ("seconds", *ERRORS):
        cells.append(" / ".join(_spread([row[key] for row in good[skip]]) for skip in (True, False)))
    spent, whole = (np.mean([row["seconds"] for row in good[skip]]) for skip in (True, False))
    cells.insert(4, f"{100 * (1 - spent / whole):.0f} %")
    return cells


def _spread(values: list[float]) -> str:
    mean = f"{np.mean(values):.3g}"
    return mean if len(values) == 1 else f"{mean} ± {float(f'{np.std(values, ddof=1):.1g}'):g}"


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.split("\n")[0])
    parser.add_argument("scenes", nargs="+")
    parser.add_argument("--preset", default="preview", choices=list(PRESETS))
    parser.add_argument("--seeds", nargs="+", type=int, default=[0])
    parser.add_argument("--threads", type=int, default=1)
    parser.add_argument("--out", type=Path, default=Path("out/benchmarks/skipping"))
    parser.add_argument("--write", type=Path, help="a document with the marker `skipping`")
    arguments = parser.parse_args()
    require_markers(parser, arguments.write, "skipping")
    use_threads(arguments.threads)
    table, scenes = [], found_scenes(arguments.scenes, arguments.out)
    if not scenes:
        parser.error("no capture can be studied")
    if len({scene.name for scene in scenes}) < len(scenes):
        parser.error("two scenes have the same name, and rows are told apart by it")
    warm = False
    for scene in scenes:
        preset = PRESETS[arguments.preset]
        if scene.metal:
            preset = replace(preset, material=replace(preset.material, metallic=(1.0,)))
        rows: dict[bool, list[dict]] = {True: [], False: []}
        photos = photos_of(scene.folder, scene.masks)
        for seed, skip in itertools.product(arguments.seeds, (True, False)):
            word = "with" if skip else "without"
            name = f"{scene.name}-{arguments.preset}-{seed}-{word}"
            file = arguments.out / f"{name}.json"
            if not file.is_file() and not warm:
                warm_up(arguments.threads)
                warm = True
            row = {"scene_name": scene.name, "preset": arguments.preset, "seed": seed, "skip": skip, "photos": photos}
            row["threads"] = arguments.threads
            work = partial(
                run,
                scene,
                preset if skip else without_skipping(preset),
                seed,
                arguments.threads,
                arguments.out / "stage_1",
                arguments.out / f"{name}.png",
                photos,
            )
            rows[skip].append(resumed(file, row, work))
            print(name, {k: rows[skip][-1].get(k) for k in ("error", "seconds", *ERRORS, "skipped")}, flush=True)
        table.append(line(scene.name, rows))
    text = markdown(["scene", "seeds", "left out", "CPU s with / without", "saved", *ERRORS.values()], table)
    print("\n" + text)
    if arguments.write:
        fill(arguments.write, {"skipping": text})


if __name__ == "__main__":
    main()
