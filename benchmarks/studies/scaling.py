"""Measure how time and memory grow with the size of the input.

    python -m benchmarks.studies.scaling [--factor NAME...] [--threads 1] [--out out/benchmarks/scaling]

One size is varied at a time. The CPU seconds of each stage and the peak memory are measured, and the exponents of their
growth are fitted by least squares in log-log space. Stages are the sections of `blender_nep.profiling`. All kernels run once
before anything is timed, so that no measurement contains their compilation. Every measurement writes one JSON file, and is
skipped when that file exists. At the end the program prints a table of exponents, and draws a plot where matplotlib is
installed (the extra `bench`). Peak memory is that of this process, and is reset before each measurement (Linux only).
"""

from __future__ import annotations

import argparse
from collections.abc import Callable
from dataclasses import replace
from functools import cache, partial
from pathlib import Path

import numpy as np
import torch

from benchmarks.suite.harness import markdown, resumed, use_threads, with_changes
from benchmarks.suite.identity import looked_at
from blender_nep.capture import PixelRays, load_capture
from blender_nep.checkpoints import NoCheckpoint
from blender_nep.fields.fields import Fields
from blender_nep.fields.training import FieldsLearning, learn_fields
from blender_nep.files import write_atomically
from blender_nep.geometry.mesh import Surface
from blender_nep.materials.baking import LabeledPoints, bake
from blender_nep.materials.training import learn_materials
from blender_nep.presets import PRESETS, Preset
from blender_nep.profiling import Profile
from blender_nep.scene.scene import Scene
from blender_nep.surface.extraction import extract_surface

PIXELS = 36_864
"""Pixels of a photo where that number is not varied: the 192 x 192 of the small capture."""
STEPS = 8
"""Steps of each kind that are timed. As many steps before them are not timed."""
CPU = torch.device("cpu")


class Bench:
    """Does the work that is measured, on one capture."""

    def __init__(self, folder: Path) -> None:
        self.capture = load_capture(folder)

    def rays(self, views: int | None = None, pixels: int = PIXELS) -> PixelRays:
        """The pixel rays of `views` of the views, spread evenly; of all views where `views` is None."""
        views = views or len(self.capture.views)
        pick = np.linspace(0, len(self.capture.views) - 1, views).round().astype(int)
        some = replace(self.capture, views=[self.capture.views[k] for k in pick])
        return PixelRays.from_capture(some, pixels, False, CPU)

    @cache  # noqa: B019  one bench a process
    def learned(self) -> tuple[Fields, Surface]:
        """The fields and the surface of a short run of stage 1. Their shapes and sizes are those of a full run."""
        preset = base(fields={"background_steps": 60, "steps": 120, "least_explanation_ratio": 0.0})
        fields = learn_fields(Scene.of(self.rays()), preset, seed=0, progress=lambda *_: None, checkpoint=NoCheckpoint())
        return fields, extract_surface(fields.object_field, preset.surface, fields.support).surface

    def learn(self, preset: Preset, views: int | None = None, pixels: int = PIXELS) -> Profile:
        """Load photos, do some steps of F_e alone, the hull and the object pixels, and some steps of both fields."""
        profile = Profile()
        with profile.recording():
            rays = self.rays(views, pixels)
        fields = replace(preset.fields, background_steps=2 * STEPS, colors_first_steps=0)
        learning = FieldsLearning(Scene.of(rays), replace(preset, fields=fields), 0)
        for _ in range(STEPS):
            learning.learn_step()
        with profile.recording():
            for _ in range(STEPS):
                learning.learn_step()
            learning.prepare_joint_step()
        for _ in range(STEPS):
            learning.learn_step()
        with profile.recording():
            for _ in range(STEPS):
                learning.learn_step()
        return profile

    def surface(self, preset: Preset) -> Profile:
        """Extract the surface: all steps from marching cubes to the UV atlas."""
        fields = self.learned()[0]
        profile = Profile()
        with profile.recording():
            extract_surface(fields.object_field, preset.surface, fields.support)
        return profile

    def textures(self, size: int) -> Profile:
        """Bake textures of size x size texels from 3000 random samples."""
        surface = self.learned()[1]
        random = np.random.default_rng(0)
        at = random.integers(len(surface.vertices), size=3000)
        position, normal = surface.vertices[at].astype(np.float32), surface.normals[at].astype(np.float32)
        gray, even = np.full((3000, 3), 0.5, np.float32), np.full(3000, 0.1, np.float32)
        points = LabeledPoints(position, normal, random.integers(40, size=3000), gray, even, even, even)
        profile = Profile()
        with profile.recording():
            bake(surface, points, size)
        return profile

    def materials(self, preset: Preset) -> Profile:
        """Run stage 2 with one material, and without light that F_e does not have."""
        fields = self.learned()[0]
        surface = extract_surface(fields.object_field, preset.surface, fields.support).surface
        profile = Profile()
        scene = Scene.of(self.rays())
        with profile.recording():
            learn_materials(
                surface,
                fields.environment,
                scene,
                preset.material,
                seed=0,
                progress=lambda *_, **__: None,
                checkpoint=NoCheckpoint(),
            )
        return profile


def base(**changes: dict) -> Preset:
    """The preset that is varied: `preview` with a short stage 2, and with the fields that `changes` gives."""
    short = {
        "rounds": 1,
        "most_materials": 1,
        "learn_unseen_light": False,
        "samples": 3000,
        "terminal_steps": 20,
        "most_texels": 256,
    }
    parts = {"material": short, "surface": {"grid": 96, "unwrapped_faces": 6000, "faces": 6000, "atlas_texels": 512}}
    for part, values in changes.items():
        parts[part] = parts.get(part, {}) | values
    return with_changes(PRESETS["preview"], parts)


STEP = {"steps of F_e alone": STEPS, "steps of both fields": STEPS}
READ = {"decode photos": 1, "rays that meet the sphere": 1}
PASS = {"visual hull": 1, "object pixels": 1}
"""Stages that are reported -> the number by which their seconds are divided."""

FACTORS: dict[str, tuple[tuple[int, ...], Callable, dict[str, float]]] = {
    "views": ((5, 10, 20, 40), lambda b, n: b.learn(base(), views=n), READ | STEP | PASS),
    "pixels a photo": ((2304, 9216, 36864), lambda b, n: b.learn(base(), pixels=n), READ | STEP | PASS),
    "rays a step": (
        (704, 1408, 2816, 5632),
        lambda b, n: b.learn(
            base(
                fields={"object_rays": n // 2, "sphere_rays": n // 4, "outside_rays": n // 4},
                environment={"rays_per_step": n},
            )
        ),
        STEP,
    ),
    "samples a ray": (
        (8, 16, 32, 64),
        lambda b, n: b.learn(base(fields={"samples": n, "first_samples": n})),
        STEP | {"object field": STEPS, "backward": 2 * STEPS},
    ),
    "SDF grid cells": (
        (32, 64, 128, 256),
        lambda b, n: b.learn(base(fields={"coarsest_cells": n // 4})),
        STEP | {"object field": STEPS, "backward": 2 * STEPS, "optimizers": 2 * STEPS},
    ),
    "marching-cubes grid": (
        (64, 96, 144, 216),
        lambda b, n: b.surface(base(surface={"grid": n})),
        {"SDF grid": 1, "marching cubes": 1, "keep the object": 1, "decimation": 1},
    ),
    "faces": (
        (2000, 4000, 8000, 16000),
        lambda b, n: b.materials(base(surface={"grid": 160, "unwrapped_faces": n, "faces": n})),
        {"select samples": 1, "gather light": 1, "textures": 1},
    ),
    "faces of the atlas": (
        (2000, 4000, 8000, 16000),
        lambda b, n: b.surface(base(surface={"grid": 160, "unwrapped_faces": n, "faces": n})),
        {"decimation": 1, "UV atlas": 1},
    ),
    "material samples": (
        (1500, 3000, 6000, 12000),
        lambda b, n: b.materials(base(material={"samples": n})),
        {"select samples": 1, "gather light": 1, "fits": 1, "self reflection": 1, "votes": 1},
    ),
    "texels a side": ((256, 512, 1024, 2048), lambda b, n: b.textures(n), {"textures": 1}),
    "bounces (levels)": (
        (1, 2, 3),
        lambda b, n: b.materials(base(material={"levels": n})),
        {"gather light": 1, "self reflection": 1},
    ),
}
"""Name of a size -> (its values, the work that is measured, {stage that is reported: divisor of its seconds})."""


def measure(bench: Bench, value: int, work: Callable, stages: dict[str, float]) -> dict:
    """Do the work, and return the CPU seconds of each stage, all its calls together, and the peak memory in MB."""
    reset_peak()
    profile = work(bench, value)
    seconds: dict[str, float] = {}
    for row in profile.report():
        name = row["section"].rpartition(" / ")[2]
        if name in stages:
            seconds[name] = seconds.get(name, 0.0) + row["cpu_s"] / stages[name]
    return {"cpu_seconds": seconds, "peak_mb": peak()}


def reset_peak() -> None:
    """Reset the operating system's record of this process's largest memory (Linux only)."""
    path = Path("/proc/self/clear_refs")
    if path.exists():
        path.write_text("5")


def peak() -> float | None:
    """The largest resident memory in MB since `reset_peak`; None where the operating system does not give it."""
    status = Path("/proc/self/status")
    if not status.exists():
        return None
    line = next(line for line in status.read_text().splitlines() if line.startswith("VmHWM"))
    return int(line.split()[1]) / 1024


def exponent(values: list[float], costs: list[float]) -> float:
    """The slope of log cost over log value, by least squares.

    It is NaN where there are fewer than two costs, or where a cost is too small to be timed.
    """
    if len(costs) < 2 or min(costs) < 1e-3:
        return float("nan")
    return float(np.polyfit(np.log(values), np.log(costs), 1)[0])


def curves(rows: list[dict]) -> list[tuple[str, str, list[int], list[float]]]:
    """(factor, stage, values, costs) of each stage of each factor. Peak memory counts as a stage."""
    found = []
    for name in dict.fromkeys(row["factor"] for row in rows):
        own = sorted((r for r in rows if r["factor"] == name and "error" not in r), key=lambda r: r["value"])
        for stage in own[0]["cpu_seconds"] if own else ():
            found.append((name, stage, [r["value"] for r in own], [r["cpu_seconds"].get(stage, 0.0) for r in own]))
        if own and all(r["peak_mb"] for r in own):
            found.append((name, "peak memory, MB", [r["value"] for r in own], [r["peak_mb"] for r in own]))
    return found


def table(rows: list[dict]) -> str:
    """A table of the exponents and of the costs to which they are fitted."""
    lines = []
    for name, stage, values, costs in curves(rows):
        power = exponent(values, costs)
        lines.append(
            [
                name,
                stage,
                ", ".join(map(str, values)),
                ", ".join(f"{c:.3g}" for c in costs),
                "" if np.isnan(power) else f"{power:.2f}",
            ]
        )
    return markdown(["varied", "stage", "values", "CPU s (or MB)", "exponent"], lines)


def plot(rows: list[dict], path: Path) -> None:
    """Draw a panel for each factor, with logarithmic axes.

    Nothing is drawn without matplotlib, or where no stage has two costs that are large enough to be timed.
    """
    try:
        from matplotlib.figure import Figure
    except ImportError:
        print("no plot: matplotlib is not installed (the extra `bench`)")
        return
    found = [c for c in curves(rows) if not c[1].startswith("peak") and not np.isnan(exponent(*c[2:]))]
    names = list(dict.fromkeys(c[0] for c in found))
    if not names:
        print("no plot: no stage was timed at two sizes")
        return
    figure = Figure(figsize=(16, 4 * -(-len(names) // 4)), layout="constrained")
    for k, name in enumerate(names):
        axes = figure.add_subplot(-(-len(names) // 4), min(4, len(names)), k + 1)
        for _, stage, values, costs in (c for c in found if c[0] == name):
            axes.loglog(values, costs, "o-", label=f"{stage}: {exponent(values, costs):.2f}")
        axes.set(title=name, ylabel="CPU s")
        ticks = next(c[2] for c in found if c[0] == name)
        axes.set_xticks(ticks, [str(v) for v in ticks])
        axes.minorticks_off()
        axes.legend(fontsize=7)
        axes.grid(True, which="both", alpha=0.3)
    path.parent.mkdir(parents=True, exist_ok=True)
    write_atomically(path, lambda part: figure.savefig(part, format=path.suffix[1:] or "png", dpi=80))


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.split("\n")[0])
    parser.add_argument("--capture", type=Path, default=Path("data/suzanne_small"))
    parser.add_argument("--factor", nargs="+", default=list(FACTORS), choices=list(FACTORS))
    parser.add_argument("--threads", type=int, default=1)
    parser.add_argument("--out", type=Path, default=Path("out/benchmarks/scaling"))
    parser.add_argument("--plot", type=Path, help="where the plot goes (OUT/scaling.png)")
    arguments = parser.parse_args()
    use_threads(arguments.threads)
    (photos,) = looked_at(parser, [arguments.capture], masks=False, truth=False)
    bench, rows, warm = Bench(arguments.capture), [], False
    for name in arguments.factor:
        values, work, stages = FACTORS[name]
        for value in values:
            file = arguments.out / f"{name.replace(' ', '_')}-{value}.json"
            if not file.is_file() and not warm:
                # Kernels are compiled or loaded at their first use, which must not be timed.
                bench.materials(base(material={"samples": 500}))
                bench.learn(base(), views=4)
                warm = True
            row = {"factor": name, "value": value, "threads": arguments.threads, "photos": photos}
            rows.append(resumed(file, row, partial(measure, bench, value, work, stages)))
            print(rows[-1], flush=True)
    print("\n" + table(rows))
    plot(rows, arguments.plot or arguments.out / "scaling.png")


if __name__ == "__main__":
    main()
