"""Order, promises of cores and memory, and putting back, with jobs that are only counted."""

from __future__ import annotations

from pathlib import Path

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from blender_nep.batch.state import DONE, ObjectState
from blender_nep.batch.workers.jobs import Job, JobUpdate
from blender_nep.batch.workers.local_jobs import LocalJobs
from blender_nep.batch.workers.needs import Needs, threads_for
from blender_nep.batch.workers.scheduler import Listener, Plan, Scheduler
from blender_nep.presets import preset
from blender_nep.stop_request import StopRequest

MEGAPIXEL = 1_000_000


class CountedJobs(LocalJobs):
    """Jobs that take two polls for each megapixel of their object, and that note what was promised at the same time."""

    def __init__(self, plan: Plan, objects: list[ObjectState], needed: dict[str, float]) -> None:
        super().__init__(plan.workers, plan.cores, plan.memory_mb)
        self.objects, self.needed = {one.name: one for one in objects}, needed
        self.now: dict[str, Job] = {}
        self.left: dict[str, int] = {}
        self.begun: list[str] = []
        self.moments: list[list[Job]] = []
        self.heard: list[JobUpdate] = []

    def start(self, job: Job) -> None:
        self.begun.append(job.name)
        self.now[job.name] = job
        self.left[job.name] = 2 * self.objects[job.name].size["pixels"] // MEGAPIXEL
        self.heard.append(JobUpdate(job.name, "started", {"worker": "local"}))
        self.moments.append(list(self.now.values()))

    def poll(self) -> list[JobUpdate]:
        for name in list(self.now):
            if name in self.needed:
                self.heard.append(JobUpdate(name, "measured", {"peak_mb": self.needed[name], "cpu_seconds": 0.0}))
            self.left[name] -= 1
            if self.left[name] <= 0:
                self.end(name, 0, None)
        heard, self.heard = self.heard, []
        return heard

    def end(self, name: str, code: int, error: dict | None) -> None:
        if self.now.pop(name, None) is not None:
            content = {"code": code, "error": error, "words": "", "seconds": 1.0, "cpu_seconds": 1.0, "peak_mb": 0.0}
            self.heard.append(JobUpdate(name, "ended", content))

    def stop(self, name: str) -> None:
        self.end(name, 7, {"name": "stopped", "message": "stopped"})


class CountedNeeds(Needs):
    """As much memory [MB] as an object has megapixels, times 100."""

    def memory_mb(self, size, photos_alone: bool) -> float:
        return size["pixels"] / 10_000


def schedule(tmp_path: Path, sizes: list[int], plan: Plan, needed: dict[str, float] | None = None) -> CountedJobs:
    objects = [
        ObjectState(f"{i:02d}", f"/{i}", size={"photos": 10, "pixels": size * MEGAPIXEL}) for i, size in enumerate(sizes)
    ]
    jobs = CountedJobs(plan, objects, needed or {})

    def job(one: ObjectState, threads: int, memory: float) -> Job:
        return Job(one.name, Path(one.capture), tmp_path / one.name, False, (), (), threads, memory)

    for one in objects:
        (tmp_path / one.name).mkdir(exist_ok=True)
        (tmp_path / one.name / "report.json").write_text("{}")
    scheduler = Scheduler(objects, jobs, plan, CountedNeeds(preset("preview")), job, Listener(), tmp_path)
    scheduler.poll_s = 0.0
    scheduler.run(StopRequest())
    assert all(one.state == DONE for one in objects)
    return jobs


@settings(max_examples=60, deadline=None)
@given(
    sizes=st.lists(st.integers(1, 12), min_size=1, max_size=30),
    cores=st.integers(1, 8),
    workers=st.integers(1, 8),
    memory=st.integers(100, 2000),
    threads=st.sampled_from([None, 1, 3]),
)
def test_never_more_cores_and_memory_than_there_are(tmp_path_factory, sizes, cores, workers, memory, threads):
    plan = Plan(cores, min(workers, cores), float(memory), threads)
    jobs = schedule(tmp_path_factory.mktemp("x"), sizes, plan)
    for together in jobs.moments:
        assert sum(job.threads for job in together) <= cores and len(together) <= plan.workers
        assert sum(job.memory_mb for job in together) <= memory or len(together) == 1
    assert sorted(jobs.begun) == [f"{i:02d}" for i in range(len(sizes))], "each one is started once"


def test_the_largest_come_first(tmp_path):
    jobs = schedule(tmp_path, [2, 9, 4, 7], Plan(1, 1, 9999.0, None))
    assert jobs.begun == ["01", "03", "02", "00"]


def test_small_ones_fill_the_gap_but_delay_no_large_one_for_ever(tmp_path):
    jobs = schedule(tmp_path, [9, 8] + [1] * 12, Plan(3, 3, 1000.0, 1))
    assert jobs.begun[:2] == ["00", "02"], "a small one fits beside the first"
    assert jobs.begun.index("01") <= 5


def test_an_object_that_needs_more_than_there_is_runs_alone(tmp_path):
    jobs = schedule(tmp_path, [12, 3, 3], Plan(4, 4, 1000.0, 1))
    assert [len(together) for together in jobs.moments] == [1, 1, 2]


def test_the_youngest_is_put_back_if_a_job_exceeds_its_promise(tmp_path):
    jobs = schedule(tmp_path, [5, 4, 1], Plan(2, 2, 1000.0, 1), needed={"00": 700.0})
    assert jobs.begun.count("01") == 2 and jobs.begun.count("00") == 1


def test_a_job_that_itself_takes_too_much_is_put_back_once(tmp_path):
    jobs = schedule(tmp_path, [50, 4], Plan(2, 2, 5500.0, 1), needed={"01": 700.0})
    assert jobs.begun == ["00", "01", "01"]
    assert [sum(job.memory_mb for job in together) for together in jobs.moments] == [5000, 5400, 700]


def test_cores_are_divided_among_the_jobs_that_fit_into_memory(tmp_path):
    jobs = schedule(tmp_path, [27] * 40, Plan(16, 16, 9000.0, None))
    *others, last = jobs.moments
    assert {job.threads for together in others for job in together} == {5} and max(map(len, others)) == 3
    assert [job.threads for job in last] == [16], "it is alone"


def test_a_job_that_needs_all_memory_gets_all_cores(tmp_path):
    jobs = schedule(tmp_path, [27] * 3, Plan(16, 16, 2000.0, None))
    assert [[job.threads for job in together] for together in jobs.moments] == [[16]] * 3


def test_threads_are_divided():
    assert [threads_for(8, 8, left) for left in (20, 8, 5, 3, 1)] == [1, 1, 1, 2, 8]
    assert threads_for(8, 2, 20) == 4


@pytest.mark.parametrize(("name", "most"), [("preview", 1365), ("balanced", 2156), ("quality", 3532)])
def test_the_promise_covers_what_was_measured_and_learns(name, most):
    """The largest peaks that were measured with captures of 40 to 119 photos (docs/batch.md)."""
    needs, size = Needs(preset(name)), {"photos": 60, "pixels": 9_600_000}
    first = needs.memory_mb(size, False)
    assert most < first < 1.5 * most
    needs.learn(size, False, 0.5 * first, 100.0)
    assert needs.memory_mb(size, False) == first, "one small job proves nothing"
    needs.learn(size, False, 2 * first, 100.0)
    assert needs.memory_mb(size, False) > 2 * first


@pytest.mark.parametrize(("name", "most"), [("preview", 2629), ("balanced", 3040)])
def test_the_promise_covers_what_a_graphics_card_was_measured(name, most):
    """The largest peaks of jobs with CUDA (docs/batch.md)."""
    size = {"photos": 60, "pixels": 9_600_000}
    promised = Needs(preset(name), on_card=True).memory_mb(size, False)
    assert most < promised < 1.5 * most
    assert promised > Needs(preset(name)).memory_mb(size, False)


def test_many_small_jobs_lower_the_promise_and_times_are_learned():
    needs, size = Needs(preset("preview")), {"photos": 60, "pixels": 2_400_000}
    first, guess = needs.memory_mb(size, False), needs.seconds(size, False)
    for _ in range(8):
        needs.learn(size, False, 0.6 * first, 2 * guess)
    assert 0.6 * first < needs.memory_mb(size, False) < first
    assert needs.seconds(size, False) == pytest.approx(2 * guess)


def test_large_photos_need_memory_while_they_are_read():
    needs = Needs(preset("preview"))
    small, large = ({"photos": 100, "pixels": 100 * pixels} for pixels in (40_000, 100 * MEGAPIXEL))
    assert needs.memory_mb(large, False) > needs.memory_mb(small, False) + 500
    assert needs.memory_mb(small, True) > needs.memory_mb(small, False)
