"""Runs jobs as processes of this machine, and never promises them more cores and memory than there are."""

from __future__ import annotations

from dataclasses import replace

from blender_nep.batch.workers.job_process import JobProcess
from blender_nep.batch.workers.jobs import Job, JobUpdate

WORKER = "local"


class LocalJobs:
    """The jobs of this machine."""

    def __init__(self, workers: int, cores: int, memory_mb: float) -> None:
        self._workers, self._cores, self._memory_mb = workers, cores, memory_mb
        self._processes: dict[str, JobProcess] = {}

    def fits(self, job: Job, running: list[Job]) -> bool:
        """Whether there are enough cores and memory left. A job that needs more memory than there is must run alone."""
        if not running:
            return True
        return (
            len(running) < self._workers
            and sum(one.threads for one in running) + job.threads <= self._cores
            and sum(one.memory_mb for one in running) + job.memory_mb <= self._memory_mb
        )

    def limited(self, job: Job) -> Job:
        """The job with at most all cores. Its memory stays as it is predicted: alone, it may try."""
        return replace(job, threads=min(job.threads, self._cores))

    def start(self, job: Job) -> None:
        """Start the process of a job. Raises OSError if there is no such program."""
        self._processes[job.name] = JobProcess(job, WORKER)

    def poll(self) -> list[JobUpdate]:
        """What was heard since the last call."""
        heard = [one for process in self._processes.values() for one in process.poll()]
        self._processes = {name: process for name, process in self._processes.items() if process.running}
        return heard

    def stop(self, name: str) -> None:
        """Ask a job to write its checkpoint and to end."""
        if name in self._processes:
            self._processes[name].stop()

    def close(self) -> None:
        """Kill what is still running."""
        for process in self._processes.values():
            process.kill()
        self._processes.clear()
