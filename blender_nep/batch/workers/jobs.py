"""What a job is, what is heard of it, and what the scheduler asks of those who run jobs."""

from __future__ import annotations

from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, Protocol


@dataclass(frozen=True)
class Job:
    """The work for one object. It goes on from the object's checkpoint if there is one."""

    name: str
    capture: Path
    """Absolute, as `out` and `files`: the job has another current folder"""
    out: Path
    photos_alone: bool
    options: tuple[str, ...]
    """Options of `blender-nep reconstruct`"""
    engine: tuple[str, ...]
    threads: int
    memory_mb: float
    gpus: int = 0
    files: tuple[Path, ...] = ()
    """All files that it reads, if they are to be sent to it"""


@dataclass(frozen=True)
class JobUpdate:
    """Something that is heard of a job."""

    name: str
    """The object's"""
    kind: str
    """'started', 'event', 'measured' or 'ended'"""
    content: dict[str, Any] = field(default_factory=dict)
    """started: `worker`. event: the event of the job. measured: `peak_mb`, `cpu_seconds`. ended: the same, `seconds`, `code`
    (the exit code, or minus the number of a signal, or None if the computer was lost), `error` (as the job has said it, or
    None), and `words` (its last ones on standard error)"""


class Jobs(Protocol):
    """Runs jobs: on this machine (`local_jobs`), or on a cluster (`ray_jobs`)."""

    def fits(self, job: Job, running: list[Job]) -> bool:
        """Whether `job` may start now, beside those that are running."""

    def limited(self, job: Job) -> Job:
        """The job with needs that can be met at all: never more memory or cores than there are."""

    def start(self, job: Job) -> None:
        """Start a job. Returns at once."""

    def poll(self) -> list[JobUpdate]:
        """What was heard since the last call, in order."""

    def stop(self, name: str) -> None:
        """Ask a job to write its checkpoint and to end."""

    def close(self) -> None:
        """End all jobs that are still there, at once."""
