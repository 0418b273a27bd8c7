"""The one registry of the work in other processes that this Blender follows.

A `Task` is such work. A kind of task is a class, which says only what differs from other kinds. The registry follows a task
by the add-on's timer until the task ends, and keeps it for the panels after that. It forgets a task when a newer one takes
its place, when another .blend file is opened, and when Blender or the add-on ends.

A task survives File > New, and undo. So it keeps no reference to Blender's data.
"""

from __future__ import annotations  # else `typing` would keep `Kind | None` to Python's end, and with it all of this module

import time
from pathlib import Path
from typing import ClassVar, TypeVar

from bpy.app.handlers import persistent

from ..folders import folder_key
from . import clock


class Task:
    """Work in another process, which is under way or has `ended`. The registry keeps the last task of each kind.

    `folder`: the folder that the work belongs to, and `key` that folder's key. `is_of_open_file`: whether the .blend file is
    open in which the task began. Save As keeps that file open.
    """

    one_per_folder: ClassVar[bool] = False
    """Whether the registry keeps the last task of each folder, and not only one of this kind"""
    shown_in: ClassVar[str] = "VIEW_3D"
    """The type of the areas that show the task; of 3D viewports, the sidebars"""

    def __init__(self, folder: Path | None = None) -> None:
        self.folder, self.key = folder, "" if folder is None else folder_key(folder)
        self.ended = False
        self.is_of_open_file = True
        self.is_news = False  # whether the status bar tells of its end
        self._displayed: object = None

    def poll(self) -> bool:
        """Read what is new. Returns whether the work has ended."""
        raise NotImplementedError

    def displayed_state(self) -> object:
        """What `shown_in` shows of the work. It is drawn again when this value changes, and when the work has ended."""
        return None

    @property
    def done_fraction(self) -> float:
        """The part of the work that is done, 0..1, of a task with a `status_name`."""
        return 0.0

    @property
    def has_failed(self) -> bool:
        """Whether the work has ended without its result."""
        return False

    def status_name(self) -> str:
        """What the status bar calls the work while it is under way; an empty string where it says nothing of it."""
        return ""

    def end_status(self) -> str:
        """What the status bar says of the end of a task with a `status_name`."""
        return ""

    def finish(self) -> None:
        """Called once, when the work has ended."""

    def close(self) -> None:
        """Called when the task is forgotten, at work or not: end the work that nobody waits for, and remove its files."""

    def outlives_file(self) -> bool:
        """Whether the task is still of use after another .blend file was opened."""
        return not self.ended

    def advance(self) -> bool:
        """Poll the work, once every clock period. Returns whether it goes on."""
        if self.ended:
            return False
        self.ended = self.poll()
        displayed = self.displayed_state()
        if self.ended or displayed != self._displayed:
            self._displayed = displayed
            clock.redraw_soon(self.shown_in)
            if self.status_name():
                clock.redraw_soon(clock.STATUS_BAR)
        if self.ended:
            self.is_news = bool(self.status_name())
            self.finish()
        return not self.ended


Kind = TypeVar("Kind", bound=Task)

_tasks: list[Task] = []


def start(task: Kind, *, wait: bool = False) -> Kind:
    """Keep the task, and follow it to its end. Returns the task.

    With `wait`, for scripts, this function returns at that end; else it returns at once.
    """
    keep(task)
    if not wait:
        clock.call_until_false(task.advance)
    while wait and task.advance():
        time.sleep(clock.PERIOD_S)
    task.is_news = task.is_news and not wait
    return task


def keep(task: Kind) -> Kind:
    """Keep the task for the panels, in place of an earlier one. Returns the task."""
    if task not in _tasks:
        for earlier in tasks_of(type(task)):
            if not task.one_per_folder or earlier.key == task.key:
                forget(earlier)
        _tasks.append(task)
    return task


def tasks_of(kind: type[Kind], folder: Path | None = None) -> list[Kind]:
    """The tasks of this kind that are kept; with `folder`, only those of that folder."""
    key = None if folder is None else folder_key(folder)
    return [task for task in _tasks if isinstance(task, kind) and key in (None, task.key)]


def find(kind: type[Kind], folder: Path | None = None) -> Kind | None:
    """The first of `tasks_of`; None where there is none."""
    return next(iter(tasks_of(kind, folder)), None)


def running(kind: type[Kind], folder: Path | None = None) -> Kind | None:
    """The first of `tasks_of` that is under way; None where there is none."""
    return next((task for task in tasks_of(kind, folder) if not task.ended), None)


def ended(kind: type[Kind], folder: Path | None = None) -> Kind | None:
    """The first of `tasks_of` that has ended; None where there is none."""
    return next((task for task in tasks_of(kind, folder) if task.ended), None)


def forget(task: Task) -> None:
    """Close the task, and follow and show it no more."""
    _tasks.remove(task)
    task.ended = True
    task.close()


def forget_ended(kind: type[Task]) -> None:
    """Forget the tasks of this kind that have ended."""
    for task in tasks_of(kind):
        if task.ended:
            forget(task)


@persistent
def on_file_loaded(*_: object) -> None:
    """Blender's handler after another .blend file was opened."""
    for task in list(_tasks):
        task.is_of_open_file = False
        if not task.outlives_file():
            forget(task)


def close_all() -> None:
    """Blender or the add-on ends: forget all tasks."""
    for task in list(_tasks):
        forget(task)
