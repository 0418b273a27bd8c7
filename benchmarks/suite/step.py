"""One step of one run, in a process of its own: `python -m benchmarks.suite.step ORDER RESULT`, both JSON files.

learn: capture -> asset, with the preset that an ablation has changed. score: the asset against the truth. relight: the
same in Cycles under lights that no photo showed. The order says which; the result is written last.
"""

from __future__ import annotations

import shutil
import sys
import time
from dataclasses import fields, replace
from pathlib import Path

from benchmarks.suite.fewer_views import with_fewer_views
from benchmarks.suite.harness import read_row, write_row
from benchmarks.suite.plan import WITHOUT_F_E, Run
from blender_nep.job.stage_names import StageName

REPORTED = ("device", "threads", "versions", "seconds", "seconds_total", "resumed_stages", "skipped", "losses", "warnings")
STAGE_1 = (StageName.FIELDS_LEARNING, StageName.SURFACE)


class NoLight:
    """Stands for F_e in stage 2: it has seen nothing, so that all light has to be found by reflections."""

    def __init__(self, distance: float) -> None:
        self.distance = distance

    def query_cone(self, origins, directions, half_angle):
        """Radiance [n, 3] and coverage [n], all 0."""
        return origins * 0, origins[:, 0] * 0

    def typical_distance(self) -> float:
        """Where the light that no photo saw is put, object radii."""
        return self.distance


class Timed:
    """A stage of a job whose CPU seconds are written down."""

    def __init__(self, stage, cpu: dict[str, float]) -> None:
        self._stage, self._cpu = stage, cpu

    def __getattr__(self, name: str):
        return getattr(self._stage, name)

    def run(self, *arguments):
        """The stage's own work."""
        start = time.process_time()
        try:
            return self._stage.run(*arguments)
        finally:
            self._cpu[str(self._stage.name)] = time.process_time() - start


def learn(run: Run, asset: Path, order: dict) -> dict:
    """The job. An error is {"error": message}."""
    from blender_nep.errors import NepError
    from blender_nep.job import runner as job
    from blender_nep.job.events import Events
    from blender_nep.job.stages import MaterialsInput, MaterialsStage, Stages
    from blender_nep.stop_request import StopRequest

    class Heard(Events):
        """Keeps the error."""

        failure = ""

        def error(self, error: NepError) -> None:
            self.failure = error.message
            super().error(error)

    class WithoutEnvironment(MaterialsStage):
        """Stage 2 with the ablation's light."""

        def run(self, given: MaterialsInput, *how):
            return super().run(replace(given, environment=NoLight(run.changed_preset.environment.outer_radius)), *how)

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
    given = order.get("stage_1") and _take_stage_1(Path(order["stage_1"]), asset, capture, run, mesh)
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
    stop, events = StopRequest(), Heard(None, sys.stderr)
    stop.watch()
    if job.run(settings, events, stop, stages):
        return {"error": events.failure.replace(str(run.capture), run.capture.name)}
    report = read_row(asset / "report.json")
    found = {key: report[key] for key in REPORTED}
    found["views"], found["pixels"] = report["capture"]["views"], report["capture"]["pixels"]
    found["faces"] = report["stages"][StageName.SURFACE].get("faces")
    found["materials"] = report["stages"][StageName.MATERIAL_LEARNING].get("materials")
    found["steps"] = report["stages"][StageName.FIELDS_LEARNING].get("steps")
    return found | {"stage_cpu_seconds": cpu}


def _take_stage_1(other: Path, asset: Path, capture: Path, run: Run, mesh: Path | None) -> bool:
    """Put the finished stage 1 of the run without ablation into this one's folder, as a job that was stopped there; not if
    that was made of another capture or preset than it would be now."""
    from blender_nep.capture import load_capture
    from blender_nep.job.run_folder import fingerprint

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
    """Geometry, F_e and materials against the truth; what belongs to the whole capture counts, however few photos were
    learned from."""
    from benchmarks.scoring.scores import score_asset

    return score_asset(run.capture, asset, run.changed_preset, order["settings"]["device"], Path(order["picture"]))


def relight(run: Run, asset: Path, order: dict) -> dict:
    """In Cycles."""
    from benchmarks.scoring.relighting import compare

    return compare(run.capture, asset, Path(order["picture"]), Path(order["truth"]), order["settings"]["threads"])


STEPS = {"learn": learn, "score": score, "relight": relight}


def main() -> None:
    order = read_row(Path(sys.argv[1]))
    write_row(Path(sys.argv[2]), STEPS[order["step"]](Run.from_json(order["run"]), Path(order["asset"]), order))


if __name__ == "__main__":
    main()
