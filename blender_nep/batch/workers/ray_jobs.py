"""Runs jobs on a Ray cluster. Only this module needs ray, and only the driver writes batch.json.

Each object is a Ray task with the cores, memory and GPU that it needs. On its node, the task starts the same process as a
local batch and tells an actor of the driver, the mailbox, what it hears. The mailbox answers whether the job should stop. If
a node is lost, Ray runs the task again on another one; if that one reaches the folder, the job goes on from its checkpoint.
"""

from __future__ import annotations

import contextlib
import platform
import signal
import socket
import tempfile
import threading
import time
from dataclasses import replace
from pathlib import Path

import ray
from ray.util.scheduling_strategies import NodeAffinitySchedulingStrategy

from blender_nep.batch.workers.job_process import JobProcess
from blender_nep.batch.workers.jobs import Job, JobUpdate
from blender_nep.batch.workers.machine import jobs_in, wait_for_end
from blender_nep.batch.workers.shipping import pack, unpack
from blender_nep.errors import UsageError
from blender_nep.job.folders.job_folder import wait_until_free
from blender_nep.safety.isolated_python import NEUTRAL_FOLDER

_POLL_S = 0.5
_LONGEST_WAIT_S = 240.0
"""A lost job has heard nothing for 60 s before it stops, and is killed 120 s later."""
_RETRIES = 1
"""How often Ray runs a task again whose node or process was lost"""
_CONNECT_S, _ANSWER_S = 10.0, 60.0
"""Seconds after which a cluster counts as not there, and a driver as gone"""
_QUEUED = 2
"""Tasks that are handed to Ray for each core of the cluster. The rest waits here, so that its needs are still corrected."""


class Mailbox:
    """An actor beside the driver: tasks leave what they have heard, and learn whether they should stop."""

    def __init__(self) -> None:
        self._heard: list[JobUpdate] = []
        self._stopped: set[str] = set()

    def deliver(self, name: str, heard: list[JobUpdate]) -> bool:
        """Leave what was heard of the object `name`. Returns whether its job should stop."""
        self._heard += heard
        return name in self._stopped

    def take(self) -> list[JobUpdate]:
        """Everything that was left since the last call."""
        heard, self._heard = self._heard, []
        return heard

    def stop(self, name: str) -> None:
        """Let the job of an object stop."""
        self._stopped.add(name)

    def go_on(self, name: str) -> None:
        """Take `stop` back: the object is tried again."""
        self._stopped.discard(name)


def work(job: Job, mailbox: ray.actor.ActorHandle, shipped: bytes | None) -> bytes | None:
    """The task: run a job, tell the mailbox what is heard, and return the packed asset if the capture was `shipped`."""
    node = platform.node() + ":" + ray.get_runtime_context().get_node_id()[:6]
    if shipped is None:
        wait_for_end(jobs_in(job.out))  # a job that a lost task has left behind on this node
        # A job of a node that Ray has lost stops as soon as it notices that nobody answers.
        wait_until_free(job.out, _LONGEST_WAIT_S)
        _follow(JobProcess(job, node), mailbox)
        return None
    with tempfile.TemporaryDirectory(prefix="nep_") as folder:
        # The paths below the temporary folder are those of the driver: relative paths from folder to folder stay right.
        root = Path(folder).resolve()
        unpack(shipped, root)
        here = replace(job, capture=_below(root, job.capture), out=_below(root, job.out))
        _follow(JobProcess(here, node), mailbox)
        return pack([], root, here.out)


def _below(root: Path, path: Path) -> Path:
    return root / path.relative_to(path.anchor)


def _follow(process: JobProcess, mailbox: ray.actor.ActorHandle) -> None:
    """Tell the mailbox everything. If it cannot be reached any more, the driver is gone and the job stops.

    Answers are awaited as futures: while a task waits in `ray.get`, Ray gives its cores to other tasks.
    """
    answer, asked = None, time.monotonic()
    while process.running:
        time.sleep(_POLL_S)
        if answer is None or answer.done():
            if answer is not None and (answer.exception() is not None or answer.result()):
                process.stop()
            answer, asked = mailbox.deliver.remote(process.job.name, process.poll()).future(), time.monotonic()
        elif time.monotonic() - asked > _ANSWER_S:
            process.stop()
            process.poll()
    if answer is not None:
        with contextlib.suppress(ray.exceptions.RayError, TimeoutError):
            answer.result(_ANSWER_S)


def _join(address: str) -> None:
    """Join the cluster. Raises UsageError if there is none."""
    handlers = {number: signal.getsignal(number) for number in (signal.SIGTERM, signal.SIGINT)}
    host, _, port = address.removeprefix("ray://").rpartition(":")
    try:
        if port.isdigit():
            socket.create_connection((host, int(port)), timeout=_CONNECT_S).close()  # Ray itself would try for minutes
        with contextlib.chdir(NEUTRAL_FOLDER):  # Ray lets the processes of the nodes import from the current folder
            ray.init(address=address, log_to_driver=False, logging_level="error")
    except (OSError, ValueError, RuntimeError) as error:
        hint = "Start one with `ray start --head`, and name its address."
        raise UsageError(f"there is no Ray cluster at {address}: {error}", hint, "usage.no_ray", address=address) from error
    finally:
        if threading.current_thread() is threading.main_thread():
            for number, handler in handlers.items():  # Ray has put its own in their place, which end the process at once
                signal.signal(number, handler)


class RayJobs:
    """The jobs on a cluster. Ray decides where each one runs, and when."""

    def __init__(self, address: str, workers: int | None, ship: bool) -> None:
        """Join the cluster at `address` ('auto': the one of this machine). Raises UsageError if there is none."""
        _join(address)
        nodes = [node["Resources"] for node in ray.nodes() if node["Alive"]]
        self.cores = int(sum(node.get("CPU", 0) for node in nodes))
        self.workers = workers or self.cores
        memory_mb = [node.get("memory", 0) / (1 << 20) for node in nodes]
        self.largest_memory_mb = max(memory_mb)
        self.computers = sum(memory_mb) / (self.largest_memory_mb or 1.0)
        self._largest_cores = int(max(node.get("CPU", 0) for node in nodes))
        self._limit = workers or _QUEUED * self.cores
        self._ship = ship
        here = NodeAffinitySchedulingStrategy(ray.get_runtime_context().get_node_id(), soft=False)
        self._mailbox = ray.remote(Mailbox).options(num_cpus=0, scheduling_strategy=here).remote()
        self._tasks: dict[str, tuple[ray.ObjectRef, Job]] = {}
        self._begun: set[str] = set()
        self._ends: dict[str, JobUpdate] = {}

    def fits(self, job: Job, running: list[Job]) -> bool:
        """Whether Ray's queue is short enough."""
        return len(running) < self._limit

    def limited(self, job: Job) -> Job:
        """The job with at most what the largest node has. Otherwise it would wait for ever."""
        memory = min(job.memory_mb, self.largest_memory_mb)
        return replace(job, threads=min(job.threads, self._largest_cores), memory_mb=memory)

    def start(self, job: Job) -> None:
        """Hand a job to Ray."""
        shipped = ray.put(pack(job.files, Path(job.out.anchor), job.out)) if self._ship else None
        task = ray.remote(work).options(
            name=job.name,
            num_cpus=job.threads,
            num_gpus=job.gpus,
            memory=int(job.memory_mb * (1 << 20)),
            max_retries=_RETRIES,
        )
        ray.get(self._mailbox.go_on.remote(job.name))
        self._tasks[job.name] = (task.remote(job, self._mailbox, shipped), job)

    def poll(self) -> list[JobUpdate]:
        """What was heard since the last call. A job has ended when its task has: then its files are here."""
        heard = []
        ended = self._ended_tasks()
        for one in ray.get(self._mailbox.take.remote()):
            if one.name not in self._tasks:
                continue
            if one.kind == "ended":
                self._ends[one.name] = one
                continue
            self._begun.add(one.name)
            heard.append(one)
        for name in ended:
            heard.append(self._end(name))
        return heard

    def _ended_tasks(self) -> list[str]:
        names = {task: name for name, (task, _) in self._tasks.items()}
        if not names:
            return []
        ready, _ = ray.wait(list(names), num_returns=len(names), timeout=0)
        return [names[task] for task in ready]

    def _end(self, name: str) -> JobUpdate:
        task, job = self._tasks.pop(name)
        self._begun.discard(name)
        said = self._ends.pop(name, None)
        try:
            asset = ray.get(task)
            if asset is not None:
                unpack(asset, Path(job.out.anchor))
        except ray.exceptions.TaskCancelledError:
            said = _ended(name, 7, "")
        except ray.exceptions.RayError as error:
            said = _ended(name, None, str(error).splitlines()[0])
        return said or _ended(name, None, "the task has said nothing")

    def stop(self, name: str) -> None:
        """Let a job stop. One that Ray has not started yet is taken back."""
        if name not in self._tasks:
            return
        ray.get(self._mailbox.stop.remote(name))
        if name not in self._begun:
            ray.cancel(self._tasks[name][0])

    def close(self) -> None:
        """Leave the cluster; tasks that are still there end."""
        ray.shutdown()


def _ended(name: str, code: int | None, words: str) -> JobUpdate:
    nothing = {"peak_mb": 0.0, "cpu_seconds": 0.0, "seconds": 0.0}
    return JobUpdate(name, "ended", {"code": code, "error": None, "words": words, **nothing})
