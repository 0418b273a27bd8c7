"""Shows how far a batch is: one line or bar for all objects, a sentence for each object that ends, a table at the end."""

from __future__ import annotations

import time
from pathlib import Path

from blender_nep.batch.outcome import read_report
from blender_nep.batch.pages import GalleryPages
from blender_nep.batch.state import DONE, FAILED, RUNNING, STOPPED, WAITING, BatchState, ObjectState
from blender_nep.batch.workers.needs import Needs
from blender_nep.batch.workers.scheduler import Listener, Plan
from blender_nep.job.reporting.events import Events
from blender_nep.job.reporting.timeline import time_text
from blender_nep.messages import Message

STAGE = "batch"
"""The stage in `progress` events of a batch"""
_SHOW_S, _WRITE_S = 0.5, 1.0
"""Seconds from one look at the progress to the next, and from one time that batch.json is written for it to the next"""
_WRITE_SHARE = 0.02
"""Largest share of the time that is spent on writing batch.json. With 10,000 objects, writing it takes half a second."""


class BatchProgress(Listener):
    """Shows and writes the state of a batch."""

    def __init__(
        self, state: BatchState, work: list[ObjectState], needs: Needs, plan: Plan, events: Events, out: Path
    ) -> None:
        """`work`: the objects of this start, among them those that are done."""
        self._state, self._work, self._needs, self._plan = state, work, needs, plan
        self._events, self._out, self._pages = events, out, GalleryPages(out, events)
        self._pause, self._written, self._shown = 0.0, 0.0, 0.0
        self._changed = False

    def warn(self, message: Message) -> None:
        """Say it to people, and to programs as a warning."""
        self._events.warning(message)

    def changed(self, one: ObjectState) -> None:
        """Send the object to programs, say its end to people, and write batch.json."""
        self._events.emit("object", **one.to_dict())
        if one.state == DONE:
            faces, materials = _made(self._out / one.name)
            values = {"name": one.name, "time": time_text(one.seconds), "faces": faces, "materials": materials}
            self._events.say(str(Message("batch.object_done", values)))
        elif one.state == FAILED and one.error is not None:
            self._events.say(str(Message("batch.object_failed", {"name": one.name, "reason": one.error["message"]})))
        elif one.state == STOPPED:
            self._events.say(str(Message("batch.object_stopped", {"name": one.name})))
        self._changed = True
        self._write_if_due()
        if one.state in (DONE, FAILED):
            self._pages.write_if_due()

    def end(self) -> None:
        """Write batch.json and the gallery. Raises OutputError."""
        self.write()
        self._pages.write()

    def write(self) -> None:
        """Write batch.json. Raises OutputError."""
        began = time.monotonic()
        self._state.write(self._out)
        self._written = time.monotonic()
        self._pause, self._changed = (self._written - began) / _WRITE_SHARE, False

    def _write_if_due(self) -> None:
        pause = self._pause if self._changed else max(self._pause, _WRITE_S)
        if time.monotonic() - self._written >= pause:
            self.write()

    def tick(self) -> None:
        """Show how far the batch is; write it if the last time was long enough ago."""
        if time.monotonic() - self._shown >= _SHOW_S:
            self._shown = time.monotonic()
            self.show()
            self._write_if_due()

    def show(self) -> None:
        """Show how far the batch is."""
        counts = self._counts()
        fraction, left = self.place()
        values = {
            "objects": len(self._work),
            "done": counts[DONE],
            "running": counts[RUNNING],
            "waiting": counts[WAITING] + counts[STOPPED],
            "failed": counts[FAILED],
        }
        note = Message("batch.progress", values)
        ended = counts[DONE] + counts[FAILED]
        self._events.progress(STAGE, ended, len(self._work), fraction, left, None, note)

    def _counts(self) -> dict[str, int]:
        counts = dict.fromkeys((WAITING, RUNNING, DONE, FAILED, STOPPED), 0)
        for one in self._work:
            counts[one.state] += 1
        return counts

    def place(self) -> tuple[float, float]:
        """(fraction of all work, seconds left), where objects count by the seconds that are expected for them.

        The seconds left of an object are divided by the number of jobs of its memory that may run at once.
        """
        whole = done = shared = 0.0
        running = [0.0]
        for one in self._work:
            seconds = max(self._needs.seconds(one.size, one.photos_alone), 1.0)
            whole += seconds
            if one.state in (DONE, FAILED):
                done += seconds
            else:
                done += one.fraction * seconds
                left = (1 - one.fraction) * seconds
                if one.state == RUNNING:
                    left = left if one.eta_s is None else one.eta_s
                    running.append(left)
                memory = self._needs.memory_mb(one.size, one.photos_alone)
                shared += left / min(self._plan.at_once(memory), len(self._work))
        return done / whole if whole else 1.0, max(shared, *running)

    def table(self) -> list[str]:
        """The lines of a table of all objects of this start: name, state, time, and what was made or what is to do."""
        rows = [("object", "state", "time", "memory", "result")]
        for one in self._work:
            rows.append((one.name, one.state, time_text(one.seconds), f"{one.peak_memory_mb:.0f} MB", self._result(one)))
        widths = [max(len(row[column]) for row in rows) for column in range(4)]
        return ["  ".join([*(f"{text:{w}}" for text, w in zip(row, widths, strict=False)), row[4]]) for row in rows]

    def _result(self, one: ObjectState) -> str:
        if one.state == DONE:
            faces, materials = _made(self._out / one.name)
            return f"{faces} faces, {materials} material{'s' if materials != 1 else ''}"
        if one.error is not None:
            return f"{one.error['message']}. {one.error['hint']}".replace("\n", " ")
        return "" if one.state == WAITING else "goes on from its checkpoint at the next start"


def _made(asset: Path) -> tuple[int, int]:
    """The numbers of faces and materials of an asset."""
    report = read_report(asset) or {}
    return int(report.get("stages", {}).get("surface", {}).get("faces") or 0), len(report.get("materials") or [])
