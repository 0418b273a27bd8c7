"""Decides which job starts when, and what follows from its end. Who runs the jobs does not matter here."""

from __future__ import annotations

import time
from collections import Counter
from collections.abc import Callable
from dataclasses import dataclass, replace
from pathlib import Path

from blender_nep.batch.outcome import failure, is_crash, lacked_memory, read_report, refused_checkpoints
from blender_nep.batch.state import DONE, FAILED, RUNNING, STOPPED, WAITING, ObjectState
from blender_nep.batch.workers.jobs import Job, Jobs, JobUpdate
from blender_nep.batch.workers.needs import Needs, threads_for
from blender_nep.errors import NepError
from blender_nep.job.folders.job_folder import is_held
from blender_nep.job.folders.own_files import discard_run
from blender_nep.messages import Message
from blender_nep.stop_request import StopRequest

_LOOK_AHEAD = 20
"""Objects that are looked at for one that fits into the memory that is left"""
_MORE_MEMORY = 1.5
"""Factor of the promise for a second attempt, if memory may have been short"""
_TRIES = 2
"""Attempts for an object whose job is killed or crashes"""


@dataclass(frozen=True)
class Plan:
    """What the scheduler may use."""

    cores: int
    workers: int
    memory_mb: float
    threads: int | None
    """Threads of each job; None: the cores are divided"""
    computers: float = 1.0
    """The memory of all computers together, divided by `memory_mb`"""

    def at_once(self, memory_mb: float) -> int:
        """How many jobs that are promised `memory_mb` [MB] each may run at once. One of them may always run alone."""
        by_cores = self.cores // self.threads if self.threads else self.workers
        by_memory = int(self.computers * max(1, self.memory_mb // memory_mb))
        return max(1, min(self.workers, by_cores, by_memory))


class Listener:
    """Is told what happens. The batch shows and writes it."""

    def changed(self, one: ObjectState) -> None:
        """The state of an object has changed."""

    def warn(self, message: Message) -> None:
        """There is something to say."""

    def tick(self) -> None:
        """Some time has passed."""


class Scheduler:
    """Runs jobs for objects until none is left or a stop is asked for."""

    poll_s = 0.2
    """Seconds from one look at the jobs to the next"""

    def __init__(
        self,
        objects: list[ObjectState],
        jobs: Jobs,
        plan: Plan,
        needs: Needs,
        make_job: Callable[[ObjectState, int, float], Job],
        listener: Listener,
        out: Path,
    ) -> None:
        """`make_job(object, threads, memory_mb)` gives the job of an object. `out`: the folder of the batch."""
        self._jobs, self._plan, self._needs, self._make_job = jobs, plan, needs, make_job
        self._listener, self._out = listener, out
        self._waiting = sorted((one for one in objects if one.state == WAITING), key=self._largest_first)
        self._objects = {one.name: one for one in objects}
        self._running: dict[str, Job] = {}
        self._tries: Counter[str] = Counter()
        self._more_memory: dict[str, float] = {}
        self._overtaken: Counter[str] = Counter()
        self._put_back: set[str] = set()
        self._alone: set[str] = set()
        self._cleared: set[str] = set()
        self._stopping = False

    def _largest_first(self, one: ObjectState) -> tuple[float, int, str]:
        size = one.size or {"photos": 0, "pixels": 0}
        return -self._needs.seconds(one.size, one.photos_alone), -size["pixels"], one.name

    def run(self, stop: StopRequest) -> None:
        """Run all jobs. If a stop is asked for, all of them write their checkpoints first. Ends when no job runs."""
        while True:
            if stop.requested and not self._stopping:
                self._stopping = True
                self._listener.warn(Message("batch.stopping", {"count": len(self._running)}))
                for name in self._running:
                    self._jobs.stop(name)
            for heard in self._jobs.poll():
                self._take(heard)
            if not self._stopping:
                self._start_more()
            self._listener.tick()
            if not self._running and (self._stopping or not self._waiting):
                return
            time.sleep(self.poll_s)

    def _start_more(self) -> None:
        """Start the waiting objects that fit, in their order.

        An object that does not fit may be overtaken by smaller ones, but only a few times: then it has to come next.
        """
        passed: list[ObjectState] = []
        for one in self._waiting[:_LOOK_AHEAD]:
            if any(self._overtaken[other.name] >= self._plan.workers for other in passed):
                break
            job = self._jobs.limited(self._job(one))
            if not self._jobs.fits(job, list(self._running.values())):
                passed.append(one)
                continue
            for other in passed:
                self._overtaken[other.name] += 1
            self._waiting.remove(one)
            self._start(one, job)

    def _job(self, one: ObjectState) -> Job:
        plan, left = self._plan, len(self._running) + len(self._waiting)
        memory = max(self._needs.memory_mb(one.size, one.photos_alone), self._more_memory.get(one.name, 0.0))
        return self._make_job(one, plan.threads or threads_for(plan.cores, plan.at_once(memory), left), memory)

    def _start(self, one: ObjectState, job: Job) -> None:
        if job.memory_mb > self._plan.memory_mb and one.name not in self._alone:
            self._alone.add(one.name)
            values = {"name": one.name, "needed": round(job.memory_mb), "memory": round(self._plan.memory_mb)}
            self._listener.warn(Message("batch.alone", values))
        one.promised_memory_mb, one.threads, one.error = round(job.memory_mb, 1), job.threads, None
        self._tries[one.name] += 1
        self._running[one.name] = job
        self._jobs.start(job)

    def _take(self, heard: JobUpdate) -> None:
        one, content = self._objects[heard.name], heard.content
        if heard.kind == "started":
            one.attempts += 1
            one.state, one.worker, one.stage, one.eta_s = RUNNING, content["worker"], None, None
            self._listener.changed(one)
        elif heard.kind == "event" and content["event"] == "progress":
            one.stage, one.fraction, one.eta_s = content["stage"], content["fraction"], content["eta_s"]
        elif heard.kind == "event" and content["event"] == "warning":
            told = {key: content.get(key) for key in ("code", "values", "message")}
            if told not in one.warnings:
                one.warnings.append(told)
        elif heard.kind == "measured":
            one.peak_memory_mb = max(one.peak_memory_mb, content["peak_mb"])
            self._keep_in_memory(heard.name, content["peak_mb"])
        elif heard.kind == "ended":
            self._end(one, content)

    def _keep_in_memory(self, name: str, peak_mb: float) -> None:
        """If a job takes more memory than it was promised and there is too little now, put the youngest job back."""
        job = self._running[name]
        if peak_mb <= job.memory_mb:
            return
        self._running[name] = replace(job, memory_mb=peak_mb)
        youngest = list(self._running)[-1]
        others = [other for key, other in self._running.items() if key != youngest]
        if others and youngest not in self._put_back and not self._jobs.fits(self._running[youngest], others):
            self._put_back.add(youngest)
            self._listener.warn(Message("batch.put_back", {"name": youngest}))
            self._jobs.stop(youngest)

    def _end(self, one: ObjectState, content: dict) -> None:
        job = self._running.pop(one.name)
        one.seconds += content["seconds"]
        one.cpu_seconds += content["cpu_seconds"]
        one.peak_memory_mb = max(one.peak_memory_mb, content["peak_mb"])
        one.stage = one.eta_s = None
        code, error, words = content["code"], content["error"], content["words"]
        report = read_report(self._out / one.name) if code == 0 else None
        if report is not None:
            one.peak_memory_mb = max(one.peak_memory_mb, float(report.get("peak_memory_mb") or 0))
            one.state, one.fraction, one.error = DONE, 1.0, None
            self._needs.learn(one.size, one.photos_alone, one.peak_memory_mb, one.seconds)
        elif one.name in self._put_back:
            self._put_back.discard(one.name)
            self._tries[one.name] -= 1
            # Its own peak may be what was too much. With the old promise it would start at once and be put back again.
            self._more_memory[one.name] = max(self._more_memory.get(one.name, 0.0), job.memory_mb)
            self._wait_again(one)
        elif refused_checkpoints(error) and self._clear(one):
            self._tries[one.name] -= 1
            self._try_again(one, failure(code, error, words))
        elif self._stopping and is_crash(code, error):
            one.state = STOPPED
        elif is_crash(code, error) and self._tries[one.name] < _TRIES:
            if lacked_memory(code, error):
                self._more_memory[one.name] = _MORE_MEMORY * max(job.memory_mb, one.peak_memory_mb)
            self._try_again(one, failure(code, error, words))
        else:
            one.state, one.error = FAILED, failure(code, error, words)
        self._listener.changed(one)

    def _clear(self, one: ObjectState) -> bool:
        """Remove the checkpoints of an object, once. Returns whether it was done.

        Those of a complete asset are kept, those of a run that somebody else has started and that is at work, and those that
        are not ours.
        """
        folder = self._out / one.name
        if one.name in self._cleared or (folder / "report.json").exists() or is_held(folder):
            return False
        self._cleared.add(one.name)
        try:
            discard_run(folder)
        except NepError:  # it cannot be removed, or it is not ours: the job says so again
            return False
        return True

    def _try_again(self, one: ObjectState, failed: dict) -> None:
        self._listener.warn(Message("batch.tried_again", {"name": one.name, "reason": failed["message"]}))
        self._wait_again(one)

    def _wait_again(self, one: ObjectState) -> None:
        """Let the object wait at the head: it goes on from its checkpoint, and a large one must not come last."""
        one.state = STOPPED if self._stopping else WAITING
        self._waiting.insert(0, one)
