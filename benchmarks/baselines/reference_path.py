"""Run the slow reference path, with large MLPs and many rays as published, to show what the fast path loses.

    python -m benchmarks.baselines.reference_path CAPTURE... [--size small] [--hours 8] [--steps N] [--threads 1]
                                        [--out out/benchmarks/reference]

Stage 1 learns the SDF as an MLP (`benchmarks.baselines.reference_field`) that starts as a sphere. F_e, the losses and the
rest are our own. `--size published` is NeuS's size: 8 layers of 256, and 512 rays of 64 + 64 samples. Its 300,000 steps take
50 days here. `--size small` has 4 layers of 128, and 256 rays of 32 + 32 samples. In a night it comes further than
`published`. Stage 2 sends 256 + 128 rays instead of cones, on the mesh of this stage 1. Scores are those of
`python -m benchmarks run`.

Hours are CPU hours of stage 1. A few steps are timed, and as many steps are planned as fit into the hours. `--steps` gives
the number of steps directly. The plan, and a checkpoint every 25 seconds or less, lie beside the results. So the same
command goes on where it was ended.
"""

from __future__ import annotations

import argparse
import time
from dataclasses import replace
from functools import partial
from pathlib import Path

import torch

from benchmarks.baselines.reference_field import ReferenceField
from benchmarks.row_files import read_row, write_row
from benchmarks.scoring import geometry, materials
from benchmarks.scoring.environment import background_psnr, exposures_differ
from benchmarks.scoring.scores import BACKGROUND_PIXELS
from benchmarks.suite.harness import markdown, resumed, use_threads, with_changes
from benchmarks.suite.identity import looked_at
from blender_nep.capture import PixelRays, load_capture
from blender_nep.checkpoints import Checkpoint, NoCheckpoint, load_state, save_state
from blender_nep.errors import Stopped
from blender_nep.fields.training import Fields, FieldsLearning, learn_fields
from blender_nep.geometry.mesh import Surface
from blender_nep.job.stages import SurfaceResult, SurfaceStage
from blender_nep.materials.training import learn_materials
from blender_nep.presets import REFINEMENTS, Preset, preset
from blender_nep.scene.scene import Scene
from blender_nep.stop_request import StopRequest
from blender_nep.surface.extraction import extract_surface

SIZES = {
    "published": {
        "width": 256,
        "layers": 8,
        "fields": {"object_rays": 256, "sphere_rays": 256, "outside_rays": 512, "first_samples": 128, "samples": 128},
        "environment": {"rays_per_step": 1024},
    },
    "small": {
        "width": 128,
        "layers": 4,
        "fields": {"object_rays": 128, "sphere_rays": 128, "outside_rays": 256, "first_samples": 64, "samples": 64},
        "environment": {"rays_per_step": 512},
    },
}
"""Sizes of the MLP and of a step. Half of the rays that meet the sphere go to object pixels."""
REFERENCE = {
    "fields": {
        "without": tuple(name for name in REFINEMENTS if name not in ("support", "object_pixels")),
        "sdf_rate": 5e-4,
        "sdf_betas": (0.9, 0.999),
        "head_rate": 5e-4,
        "eikonal": 0.1,
        "curvature": 0.0,
        "first_levels": 1,
        "last_levels": 1,
        "patience": 1_000_000,
    },
    "material": {"use_cones": False, "diffuse_cones": 256, "irradiance_cones": 256, "specular_cones": 128, "samples": 1500},
}
"""Changes of the preset `balanced`: NeuS's rates and weights.

Learning starts from a sphere and not from the visual hull, because an MLP cannot be carved, and it takes all its steps.
Stage 2 has fewer photo samples, since each costs as much as 45 do with cones."""
TIMED_STEPS = 3
"""Steps of both fields together that are timed, to learn how long a step takes."""


def step_seconds(scene: Scene, settings: Preset, size: str, seed: int) -> float:
    """CPU seconds of a step of both fields. The learning in which the steps are timed is thrown away."""
    settings = with_changes(settings, {"fields": {"background_steps": 0}})
    learning = FieldsLearning(scene, settings, seed, reference_field(settings, size))
    learning.learn_step()
    start = time.process_time()
    for _ in range(TIMED_STEPS):
        learning.learn_step()
    return (time.process_time() - start) / TIMED_STEPS


def reference_field(settings: Preset, size: str) -> ReferenceField:
    """A new reference field of this size, on the CPU. FieldsLearning does not move it to another device."""
    return ReferenceField(
        settings.fields.initial_radius, settings.fields.decomposition, SIZES[size]["width"], SIZES[size]["layers"]
    )


def planned(file: Path, scene: Scene, settings: Preset, size: str, hours: float, steps: int | None, seed: int) -> dict:
    """The plan {"steps", "step_seconds", "hours", "asked_steps"} that `file` holds.

    Where there is no file, make the plan and write it first. A plan for other hours, or for another number of steps, is
    refused by SystemExit.
    """
    asked = asked_for(hours, steps)
    if not file.is_file():
        seconds = step_seconds(scene, settings, size, seed)
        write_row(file, {"step_seconds": seconds, "steps": steps or max(1, round(3600 * hours / seconds))} | asked)
    plan = read_row(file)
    if any(plan.get(key) != value for key, value in asked.items()):
        raise SystemExit(f"{file} holds a plan for other hours or steps: use another --out, or remove its folder")
    return plan


def asked_for(hours: float, steps: int | None) -> dict:
    """What tells how long stage 1 learns, for the plan and the row. The hours do not count where `steps` are given."""
    return {"hours": None if steps else hours, "asked_steps": steps}


def run(folder: Path, size: str, hours: float, steps: int | None, seed: int, kept: Path) -> dict:
    """Run stage 1, the surface and stage 2 on one capture, and return all scores.

    Raises Stopped where a stop is asked for. The checkpoint is written then.
    """
    capture = load_capture(folder)
    test = geometry.load_test_views(folder, capture)
    device = torch.device("cpu")
    settings = with_changes(replace(preset("balanced"), name="reference"), REFERENCE)
    settings = with_changes(settings, {part: SIZES[size][part] for part in ("fields", "environment")})
    scene = Scene.of(PixelRays.from_capture(capture, settings.max_pixels_per_photo, False, device))
    plan = planned(kept / "plan.json", scene, settings, size, hours, steps, seed)
    settings = with_changes(settings, {"fields": {"steps": plan["steps"]}})
    done = kept / "fields.done.pt"
    if not done.is_file():
        stop = StopRequest()
        checkpoint = Checkpoint(kept, "fields", stop, print)

        def progress(step: int, of: int, loss: float) -> None:
            if step % 50 == 0:
                print(f"{folder.name}: step {step} of {of}, loss {loss:.4f}, {checkpoint.seconds():.0f} s", flush=True)

        torch.manual_seed(seed)
        with stop.signals():
            fields = learn_fields(
                scene,
                settings,
                seed=seed,
                progress=progress,
                checkpoint=checkpoint,
                object_field=reference_field(settings, size),
            )
        mesh = SurfaceResult(*extract_surface(fields.object_field, settings.surface, fields.support))
        save_state(
            done,
            {
                "surface": SurfaceStage().pack(mesh),
                "environment": fields.environment.state_dict(),
                "report": fields.report,
                "seconds": checkpoint.seconds(),
            },
        )
        checkpoint.remove()
    state = load_state(done)
    surface = Surface(**state["surface"]["arrays"])
    learned = {"object": None, "environment": state["environment"], "report": {}, "support": None}
    environment = Fields.from_state(learned, settings, device).environment
    out = plan | {"seconds": state["seconds"], "fields": state["report"]}
    out |= geometry.score(surface, folder, capture, test)
    test_rays = PixelRays.from_capture(test, BACKGROUND_PIXELS, False, device)
    out["background_psnr"] = background_psnr(
        environment, test_rays, geometry.true_mesh(folder, capture), exposures_differ(folder)
    )
    start = time.process_time()
    learned = learn_materials(
        surface,
        environment,
        scene,
        settings.material,
        seed=seed,
        progress=lambda *_, **__: None,
        checkpoint=NoCheckpoint(),
    )
    out["material_cpu_seconds"] = time.process_time() - start
    return out | materials.score(surface, learned, folder, capture, test, kept / "materials.png")


COLUMNS = (
    "steps",
    "step_seconds",
    "seconds",
    "cd_visible",
    "normal_deg",
    "mask_iou",
    "background_psnr",
    "material_cpu_seconds",
    "mse_roughness",
    "mse_metallic",
    "mse_albedo",
)


def cells(row: dict) -> list:
    """One line of the table. The line of a failed run shows its message."""
    scores = [float(row[c]) for c in COLUMNS] if "error" not in row else [row["error"]]
    return [row["capture"], row["size"], *scores]


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.split("\n")[0])
    parser.add_argument("captures", nargs="+", type=Path)
    parser.add_argument("--size", default="published", choices=list(SIZES))
    parser.add_argument("--hours", type=float, default=8.0)
    parser.add_argument("--steps", type=int)
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--threads", type=int, default=1)
    parser.add_argument("--out", type=Path, default=Path("out/benchmarks/reference"))
    arguments = parser.parse_args()
    use_threads(arguments.threads)
    header, rows, looked = ["capture", "size", *COLUMNS], [], looked_at(parser, arguments.captures, masks=False)
    for folder, photos in zip(arguments.captures, looked, strict=True):
        kept = arguments.out / f"{folder.name}-{arguments.size}-{arguments.seed}"
        kept.mkdir(parents=True, exist_ok=True)
        row = {"capture": folder.name, "size": arguments.size, "seed": arguments.seed, "threads": arguments.threads}
        row |= {"photos": photos} | asked_for(arguments.hours, arguments.steps)
        try:
            row = resumed(
                kept.parent / f"{kept.name}.json",
                row,
                partial(run, folder, arguments.size, arguments.hours, arguments.steps, arguments.seed, kept),
            )
        except Stopped as stopped:
            parser.exit(7, f"{stopped}\n")
        rows.append(cells(row))
        print(markdown(header, rows[-1:]).splitlines()[-1], flush=True)
    print("\n" + markdown(header, rows))


if __name__ == "__main__":
    main()
