"""The time left that a batch tells, which depends on how many jobs may run at once."""

from __future__ import annotations

import pytest

from blender_nep.batch.progress import BatchProgress
from blender_nep.batch.state import DONE, RUNNING, BatchState, ObjectState
from blender_nep.batch.workers.needs import Needs
from blender_nep.batch.workers.scheduler import Plan
from blender_nep.job.reporting.events import Events
from blender_nep.presets import preset

SECONDS = 100.0


class EvenNeeds(Needs):
    """100 seconds for every object, and as much memory [MB] as it has pixels."""

    def memory_mb(self, size, photos_alone: bool) -> float:
        return size["pixels"]

    def seconds(self, size, photos_alone: bool) -> float:
        return SECONDS


def objects(*megabytes: int) -> list[ObjectState]:
    return [ObjectState(f"{i:02d}", f"/{i}", size={"photos": 9, "pixels": size}) for i, size in enumerate(megabytes)]


def place(tmp_path, work: list[ObjectState], plan: Plan) -> tuple[float, float]:
    needs = EvenNeeds(preset("preview"))
    return BatchProgress(BatchState({}, objects=work), work, needs, plan, Events(), tmp_path).place()


@pytest.mark.parametrize(
    ("plan", "at_once"),
    [
        (Plan(8, 8, 1e5, None), 8),
        (Plan(8, 8, 250.0, None), 2),
        (Plan(8, 8, 50.0, None), 1),
        (Plan(8, 8, 1e5, 3), 2),
        (Plan(8, 2, 350.0, 1), 2),
        (Plan(8, 8, 150.0, 1, computers=3.5), 3),
        (Plan(8, 8, 50.0, 1, computers=2.0), 2),
    ],
)
def test_the_time_left_counts_the_jobs_that_run_at_once(tmp_path, plan, at_once):
    """Where the memory or the cores let only two of eight workers run, 24 objects take twelve rounds and not three."""
    assert place(tmp_path, objects(*[100] * 24), plan) == (0.0, pytest.approx(24 / at_once * SECONDS))


def test_only_objects_that_are_large_wait_for_memory(tmp_path):
    """Large objects run alone, small ones four at a time."""
    assert place(tmp_path, objects(900, 900, *[100] * 8), Plan(4, 4, 1000.0, 1))[1] == pytest.approx((2 + 8 / 4) * SECONDS)


def test_objects_done_or_running_take_less_of_the_time_left(tmp_path):
    work = objects(*[100] * 6)
    work[0].state, work[1].state, work[1].eta_s, work[1].fraction = DONE, RUNNING, 40.0, 0.5
    fraction, left = place(tmp_path, work, Plan(8, 8, 250.0, None))
    assert fraction == pytest.approx(1.5 / 6) and left == pytest.approx((40 + 4 * SECONDS) / 2)
    work = work[:2]
    assert place(tmp_path, work, Plan(8, 8, 250.0, None))[1] == 40, "it runs alone, and nothing waits"
