"""Runs a batch from its arguments to its exit code."""

from __future__ import annotations

import math
import os
from collections.abc import Iterable
from pathlib import Path

from blender_nep.batch.captures import FoundCapture, Size, find_captures, passed_over, size_of
from blender_nep.batch.outcome import read_report
from blender_nep.batch.progress import STAGE, BatchProgress
from blender_nep.batch.settings import BatchSettings
from blender_nep.batch.state import (
    DONE,
    FAILED,
    FILE,
    RUNNING,
    WAITING,
    BatchState,
    ObjectState,
    captures_before,
    is_batch,
    read_state,
    refuse_other_batch,
)
from blender_nep.batch.workers.job_process import CAPTURE
from blender_nep.batch.workers.jobs import Job, Jobs
from blender_nep.batch.workers.local_jobs import LocalJobs
from blender_nep.batch.workers.machine import free_memory_mb, jobs_in, wait_for_end
from blender_nep.batch.workers.needs import Needs
from blender_nep.batch.workers.scheduler import Plan, Scheduler
from blender_nep.cameras.written_capture import is_written_by_us
from blender_nep.errors import NepError, ObjectsFailed, OutputError, Stopped, UsageError
from blender_nep.files import output_errors, refuse_links
from blender_nep.gallery.gallery import INDEX, SHARED, VENDOR
from blender_nep.job.device import choose_device, usable_cores
from blender_nep.job.exit_code import exit_code, unexpected
from blender_nep.job.folders.job_folder import is_held, is_lock, lock_file
from blender_nep.job.folders.own_files import (
    ENTRIES,
    discard_run,
    is_ours,
    refuse_captures_folder,
    refuse_files,
    refuse_folder_of_captures,
    refuse_foreign_files,
)
from blender_nep.job.reporting.events import Events
from blender_nep.messages import Message
from blender_nep.presets import preset
from blender_nep.stop_request import StopRequest

_LOCK, _STOP = "batch.lock", "batch.stop"
"""Files in the batch's folder: the first is locked as long as a batch is at work there, the second asks it to stop"""


def run(settings: BatchSettings, events: Events, stop: StopRequest) -> int:
    """Run a batch to its end and return the exit code. An error becomes one `error` event."""
    return exit_code(lambda: Batch(settings, events, stop).run(), events, settings.out)


def _no_batch(out: Path) -> UsageError:
    hint = "Name captures: this folder holds no batch yet."
    return UsageError(f"there is no batch in {out}", hint, "usage.no_captures", path=out)


def _on_card(settings: BatchSettings) -> bool:
    """Whether the jobs use a graphics card. Raises UsageError when they must, and run on this machine, which has none."""
    if settings.ray is not None:
        return settings.device == "cuda"  # what the nodes have is not known here
    return choose_device(settings.device).type == "cuda"


def _remove_old_cameras(cameras: Path, photos: Path, files: Iterable[Path]) -> None:
    """Remove the cameras if they are older than the folder `photos` or one of its `files`, so that they are found anew.

    The time of a folder changes when a photo is added or removed. Raises UsageError where the cameras are not ours.
    """
    found = cameras / "transforms.json"
    if found.is_file():
        newest = max(path.stat().st_mtime for path in {photos, *files, *(file.parent for file in files)})
        if newest > found.stat().st_mtime:
            _remove_cameras(cameras)


def _remove_cameras(cameras: Path) -> None:
    """Remove the cameras that an earlier job has found. Raises UsageError where they are not ours, and OutputError."""
    found = cameras / "transforms.json"
    if os.path.lexists(found):
        if not is_written_by_us(found):
            refuse_files(cameras, [found.name])
        with output_errors(found):
            found.unlink()


def _refuse_foreign_batch(out: Path) -> None:
    """Raises UsageError where the folder holds files that a batch would replace, and no batch of ours was there.

    A batch has left its batch.json, or at least its lock, which is an empty file.
    """
    if is_batch(out) or is_lock(out / _LOCK):
        return
    names = (FILE, "log.txt", _LOCK, _STOP, INDEX, *(f"{SHARED}/{source.name}" for source in VENDOR.iterdir()))
    refuse_files(out, (name for name in names if os.path.lexists(out / name)))


class Batch:
    """One start of a batch."""

    def __init__(self, settings: BatchSettings, events: Events, stop: StopRequest) -> None:
        self._settings, self._events, self._stop = settings, events, stop
        self._needs = Needs(preset(settings.preset), _on_card(settings))
        self._files: dict[str, tuple[Path, ...]] = {}
        """{object: all files that its job reads}, known for captures that were looked at in this start"""

    def run(self) -> None:
        """Make all assets. Raises UsageError, OutputError, Stopped, and ObjectsFailed where objects failed."""
        s = self._settings
        captures = find_captures(s.captures, s.out)
        if s.out.exists() and not s.out.is_dir():
            raise OutputError(f"{s.out} is a file, not a folder", "Choose another --out.", "output.is_a_file", path=s.out)
        if not captures and not (s.out / FILE).is_file():
            raise _no_batch(s.out)
        refuse_links(s.out, (FILE, _LOCK, _STOP, "log.txt"))
        for capture in captures:
            refuse_folder_of_captures(s.out, capture.path.parent)
            if not is_batch(s.out):  # a batch may hold pictures of its objects
                refuse_captures_folder(s.out, capture.path)
        _refuse_foreign_batch(s.out)
        with output_errors(s.out):
            s.out.mkdir(parents=True, exist_ok=True)
            lock = lock_file(s.out / _LOCK, s.out, holder="another batch")
            (s.out / _STOP).unlink(missing_ok=True)
        self._stop.watch_file(s.out / _STOP)
        try:
            self._run(captures)
        finally:
            os.close(lock)

    def _run(self, captures: list[FoundCapture]) -> None:
        s = self._settings
        if s.overwrite and not captures:
            captures = captures_before(s.out)
        state = self._state(captures)
        if s.overwrite:
            state.start_again(captures)
        work = state.take(captures) if captures else state.objects
        if not work:
            raise _no_batch(s.out)
        refuse_links(s.out, (one.name for one in work))
        for one in work:
            refuse_links(s.out / one.name, (CAPTURE, *ENTRIES))
        with output_errors(s.out):
            self._events.open_log(s.out / "log.txt")
        for message in passed_over(s.captures, s.out, captures):
            self._events.warning(message)
        self._end_leftovers()
        self._note_interrupted(state.objects, work)
        self._prepare(work)
        jobs, plan = self._jobs()
        state.machine = {"workers": plan.workers, "cores": plan.cores, "memory_mb": round(plan.memory_mb)}
        progress = BatchProgress(state, work, self._needs, plan, self._events, s.out)
        self._events.emit("batch", folder=str(s.out.resolve()), objects=len(work), **state.machine)
        self._look(work, progress)
        scheduler = Scheduler(work, jobs, plan, self._needs, self._job, progress, s.out)
        try:
            progress.write()
            if not self._stop.requested:
                scheduler.run(self._stop)
        finally:
            jobs.close()
            for one in work:
                if one.state == RUNNING:  # after a second Ctrl-C or an unforeseen error: its job is killed
                    one.interrupt()
            progress.end()
        progress.show()
        self._events.say(*progress.table())
        self._report_end(work)

    def _state(self, captures: list[FoundCapture]) -> BatchState:
        """The state of the folder, or a new one. Raises UsageError where another batch is there and goes on."""
        s = self._settings
        try:
            state = read_state(s.out) or BatchState(s.identity())
        except UsageError:
            if not s.overwrite:
                raise
            state = BatchState(s.identity())
        if s.overwrite and state.holds_only(captures):
            state = BatchState(s.identity(), objects=state.objects)
        refuse_other_batch(s.out, state, s)
        state.arguments = s.arguments()
        return state

    def _end_leftovers(self) -> None:
        """Wait for the jobs of a batch that was killed. They have noticed it, and are writing their checkpoints."""
        left = jobs_in(self._settings.out)
        if left:
            self._events.say(str(Message("batch.leftovers", {"count": len(left)})))
            wait_for_end(left, self._stop)

    def _note_interrupted(self, objects: list[ObjectState], work: list[ObjectState]) -> None:
        """Objects that a killed batch has left running and that this start does not name have stopped.

        One at which somebody is at work, such as a job of a lost node or a run by hand, stays as it is.
        """
        named = {one.name for one in work}
        for one in objects:
            if one.state == RUNNING and one.name not in named and not is_held(self._settings.out / one.name):
                one.interrupt()

    def _prepare(self, work: list[ObjectState]) -> None:
        """Let everything that is not done wait, and learn from what is done."""
        for one in work:
            out = self._settings.out / one.name
            try:
                self._make_ready(one, out)
            except NepError as error:
                one.state, one.error = FAILED, error.to_dict()
                continue
            report = read_report(out) if one.state == DONE else None
            if report is not None:
                if (report.get("device") != "cpu") == self._needs.on_card:
                    self._needs.learn(one.size, one.photos_alone, one.peak_memory_mb, one.seconds)
            else:
                if one.state == FAILED:
                    one.size = None  # its capture may have been corrected
                one.state, one.error, one.stage, one.eta_s, one.worker = WAITING, None, None, None, None

    def _make_ready(self, one: ObjectState, out: Path) -> None:
        """Check that the object's folder may be written, and with --overwrite remove what earlier jobs have left there.

        Raises UsageError where the folder, or something in it that would be replaced, is not ours, and OutputError.
        """
        refuse_captures_folder(out, Path(one.capture))
        refuse_foreign_files(out)
        if self._settings.overwrite and not is_held(out):  # a run that somebody else has started keeps its files
            if one.photos_alone:
                _remove_cameras(out / CAPTURE)
            if is_ours(out):
                discard_run(out)

    def _look(self, work: list[ObjectState], progress: BatchProgress) -> None:
        """Find out how large the captures are. An object whose capture cannot be read has failed already."""
        left = [one for one in work if one.state == WAITING and (one.size is None or self._settings.ship)]
        for number, one in enumerate(left):
            if self._stop.requested:
                return
            note = Message("batch.looking", {"step": number + 1, "steps": len(left)})
            self._events.progress(STAGE, 0, len(work), 0.0, math.nan, None, note)
            try:
                size: Size = size_of(FoundCapture(Path(one.capture), one.photos_alone))
                if one.photos_alone and one.size is None:
                    _remove_old_cameras(self._settings.out / one.name / CAPTURE, Path(one.capture), size.files)
                one.size, self._files[one.name] = size.to_dict(), size.files
            except Exception as error:  # whatever is wrong with one capture stops no other one
                if not isinstance(error, NepError):
                    self._events.log_traceback(error)
                    error = unexpected(error, "The details are in log.txt.")
                one.state, one.error = FAILED, error.to_dict()
                progress.changed(one)

    def _jobs(self) -> tuple[Jobs, Plan]:
        s = self._settings
        if s.ray is not None:
            from blender_nep.batch.workers.ray_jobs import RayJobs

            jobs = RayJobs(s.ray, s.workers, s.ship)
            return jobs, Plan(jobs.cores, jobs.workers, jobs.largest_memory_mb, s.threads or 1, jobs.computers)
        cores = usable_cores()
        plan = Plan(cores, min(s.workers or cores, cores), s.memory_mb or free_memory_mb(), s.threads)
        return LocalJobs(plan.workers, plan.cores, plan.memory_mb), plan

    def _job(self, one: ObjectState, threads: int, memory_mb: float) -> Job:
        s = self._settings
        options = ["--preset", s.preset, "--masks", s.masks, "--metal", s.metal, "--seed", str(s.seed)]
        options += [] if s.turntable == "auto" else ["--turntable", s.turntable]
        options += [] if s.faces is None else ["--faces", str(s.faces)]
        options += ["--all-photos"] if s.all_photos else []
        # a task of Ray may use the cards of its node without being counted, if it has asked for none
        device = "cpu" if s.ray is not None and s.device == "auto" else s.device
        options += ["--device", device, *(["--clean"] if s.clean else [])]
        return Job(
            name=one.name,
            capture=Path(one.capture).absolute(),
            out=s.out.resolve() / one.name,
            photos_alone=one.photos_alone,
            options=tuple(options),
            engine=s.engine,
            threads=threads,
            memory_mb=memory_mb,
            gpus=int(s.device == "cuda"),
            files=self._files.get(one.name, ()),
        )

    def _report_end(self, work: list[ObjectState]) -> None:
        left = sum(one.state not in (DONE, FAILED) for one in work)
        failed = [one.name for one in work if one.state == FAILED]
        if left:
            reason = self._stop.reason
            hint = "Start it again with the same --out: it does only what is left."
            raise Stopped(f"stopped ({reason}): {left} objects are left", hint, "stopped.batch", reason=reason, left=left)
        if failed:
            raise ObjectsFailed(
                f"{len(failed)} of {len(work)} objects failed",
                "The table says what to do. Start the batch again with the same --out: it tries only these.",
                names=failed,
                objects=len(work),
            )
        self._events.done(self._settings.out)
