"""Does one step of one run, as a separate process: `python -m benchmarks.suite.step ORDER RESULT`, both JSON files.

The order says which step. `learn` makes the asset from the capture, with the preset that the ablation has changed. `score`
compares the asset with the ground truth. `relight` compares both in Cycles under lights that no photo showed. The result is
written last.
"""

from __future__ import annotations

import shutil
import sys
import time
from dataclasses import fields, replace
from pathlib import Path

from benchmarks.row_files import read_row, write_row
from benchmarks.suite.fewer_views import with_fewer_views
from benchmarks.suite.plan import WITHOUT_F_E, Run
from blender_nep.job.stage_names import StageName

REPORTED = ("device", "threads", "versions", "seconds", "seconds_total", "resumed_stages", "skipped", "losses", "warnings")
ACTED = ("refinements", "evidence")
"""Parts of the report that say of each mechanism what it found, or why it was skipped; {} where a stage has none."""
STAGE_1 = (StageName.FIELDS_LEARNING, StageName.SURFACE)


class NoLight:
    """Takes the place of F_e in stage 2 and gives no light. So stage 2 must find all light by the object's reflections."""

    def __init__(self, distance: float) -> None:
        self.distance = distance

    def query_cone(self, origins, directions, half_angle):
        """(radiance [n, 3], coverage [n]), both 0 everywhere."""
        return origins * 0, origins[:, 0] * 0

    def equirect(self, height):
        """(radiance [height, 2 height, 3], coverage [height, 2 height]), both 0 everywhere."""
        radiance = self.extrapolated(height)
        return radiance, radiance[..., 0]

    def extrapolated(self, height):
        """Radiance [height, 2 height, 3], 0 everywhere."""
        import torch

        return torch.zeros(height, 2 * height, 3)

    def typical_distance(self) -> float:
        """The distance, in object radii, at which stage 2 puts the light that no photo has seen."""
        return self.distance


class Timed:
    """Wraps a stage of a job, and writes the CPU seconds of the stage into `cpu`."""

    def __init__(self, stage, cpu: dict[str, float]) -> None:
        self._stage, self._cpu = stage, cpu

    def __getattr__(self, name: str):
        return getattr(self._stage, name)

    def run(self, *arguments):
        """Run the stage, and write down its CPU seconds."""
        start = time.process_time()
        try:
            return self._stage.run(*arguments)
        finally:
            self._cpu[str(self._stage.name)] = time.process_time() - start


def learn(run: Run, asset: Path, order: dict) -> dict:
    """Run the job. Returns figures of its report, or {"error": message} where the job fails."""
    from blender_nep.errors import NepError
    from blender_nep.fields.environment.field import FAR
    from blender_nep.job import runner as job
    from blender_nep.job.reporting.events import Events
    from blender_nep.job.stages import MaterialsInput, MaterialsStage, Stages
    from blender_nep.stop_request import StopRequest

    class EventsWithError(Events):
        """Events that also keep the message of the job's error."""

        failure = ""

        def error(self, error: NepError) -> None:
            self.failure = error.message
            super().error(error)

    class WithoutEnvironment(MaterialsStage):
        """Stage 2 without F_e, for the ablation WITHOUT_F_E."""

        def run(self, given: MaterialsInput, *how):
            return super().run(replace(given, environment=NoLight(FAR)), *how)

    cpu: dict[str, float] = {}
    stages = Stages()
    if run.ablation == WITHOUT_F_E:
        stages.materials = WithoutEnvironment()
    for part in fields(stages):
        setattr(stages, part.name, Timed(getattr(stages, part.name), cpu))
    capture, settings_of = run.capture, order["settings"]
    if run.views:
        capture = with_fewer_views(capture, run.views, Path(order["variant"]))
    shutil.rmtree(asset, ignore_errors=True)
    mesh = run.capture / "gt_mesh.ply" if run.geometry == "true" else None
    given = order.get("stage_1") and take_stage_1(Path(order["stage_1"]), asset, capture, run, mesh)
    settings = job.Settings(
        capture=capture,
        out=asset,
        preset=run.changed_preset,
        seed=run.seed,
        use_masks=False,
        mesh=mesh,
        resume=bool(given),
        **settings_of,
    )
    stop, events = StopRequest(), EventsWithError(None, sys.stderr)
    stop.watch()
    if job.run(settings, events, stop, stages):
        return {"error": events.failure.replace(str(run.capture), run.capture.name)}
    report = read_row(asset / "report.json")
    found = {key: report[key] for key in REPORTED}
    found |= {key: report[key] for key in ACTED if key in report}
    found["views"], found["pixels"] = report["capture"]["views"], report["capture"]["pixels"]
    found["faces"] = report["stages"][StageName.SURFACE].get("faces")
    found["materials"] = report["stages"][StageName.MATERIAL_LEARNING].get("materials")
    found["steps"] = report["stages"][StageName.FIELDS_LEARNING].get("steps")
    return found | {"stage_cpu_seconds": cpu}


def take_stage_1(other: Path, asset: Path, capture: Path, run: Run, mesh: Path | None) -> bool:
    """Copy the finished stage 1 of another run into the folder `asset`, so that `asset` looks like a job stopped after it.

    The runner offers only runs that learned with the same commit.

    `other` is the asset of the run without ablation. Returns False, and copies nothing, where that run has no finished stage
    1, or was made from another capture or preset than it would be made from now.
    """
    from blender_nep.capture import load_capture
    from blender_nep.job.folders.run_folder import fingerprint

    stages = [other / "checkpoints" / f"{stage}.done.pt" for stage in STAGE_1]
    loaded = load_capture(capture, use_masks=False)

    def identity(of: Run) -> dict:
        return fingerprint(loaded, of.changed_preset, of.seed, False, mesh)

    made = read_row(other / "report.json").get("fingerprint")
    if made != identity(run.same_stage_1) or not all(stage.is_file() for stage in stages):
        return False
    (asset / "checkpoints").mkdir(parents=True)
    for stage in stages:
        shutil.copy(stage, asset / "checkpoints")
    write_row(asset / "checkpoints" / "run.json", identity(run))
    return True


def score(run: Run, asset: Path, order: dict) -> dict:
    """The scores of geometry, F_e and materials against the ground truth.

    The scores use the cameras of the whole capture, even where the run has learned from only some of its photos.
    """
    from benchmarks.scoring.scores import score_asset

    return score_asset(run.capture, asset, run.changed_preset, order["settings"]["device"], Path(order["picture"]))


def relight(run: Run, asset: Path, order: dict) -> dict:
    """The scores of the asset in Cycles, under lights that no photo showed."""
    from benchmarks.scoring.relighting import compare

    picture, truth, threads = Path(order["picture"]), Path(order["truth"]), order["settings"]["threads"]
    return compare(run.capture, asset, picture, truth, threads, order["albedo_ratio"])


STEPS = {"learn": learn, "score": score, "relight": relight}


def main() -> None:
    order = read_row(Path(sys.argv[1]))
    write_row(Path(sys.argv[2]), STEPS[order["step"]](Run.from_json(order["run"]), Path(order["asset"]), order))


if __name__ == "__main__":
    main()
