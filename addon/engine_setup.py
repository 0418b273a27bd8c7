"""Checking and installing the engine from the preferences. Both are other processes; Blender only looks at them."""

import os
import sys
from pathlib import Path

import bpy

from ..backend.engine import install as engine_install
from ..backend.engine.check import EngineCheck
from ..backend.engine.command import EngineError, find_engine_python
from ..backend.engine.job_files import EventFile, last_lines
from ..backend.engine.started_process import StartedProcess
from . import clock, preferences

EXTENSION = Path(__file__).resolve().parent.parent
ONLINE_FIRST = "It is a download: allow it in Preferences, System, Network, Allow Online Access"
CANCEL_GRACE = 100  # clock periods that a cancelled installation has to clean up


class Installation:
    """The installer at work; `python` is its result, `error` (message, hint) its failure."""

    def __init__(self, command: list[str]):
        self.process = StartedProcess(command)
        self._events = EventFile(self.process.folder / "events.jsonl")
        self.fraction, self.message = 0.0, "Starting"
        self.python, self.error = "", None
        self.cancelling = 0

    def advance(self) -> bool:
        """Whether it has ended."""
        ended = not self.process.running()
        for event in self._events.read():
            if event["event"] == "progress":
                self.fraction, self.message = float(event["fraction"]), str(event["message"])
            elif event["event"] == "done":
                self.python = str(event["python"])
            elif event["event"] == "error":
                self.error = str(event["message"]), str(event["hint"])
        if self.cancelling and not ended:
            self.cancelling += 1
            if self.cancelling > CANCEL_GRACE:
                self.process.send(kill=True)
        if ended:
            if not self.python and self.error is None:
                said = last_lines(self.process.folder / "engine.log", 1)
                self.error = "The installation ended without a word.", said or "Install again: it begins anew."
            self.process.close()
        return ended

    def cancel(self) -> None:
        self.message = "Cancelling: removing what was made"
        self.cancelling = 1
        self.process.ask_to_stop()


check: EngineCheck | None = None
checking = False
installation: Installation | None = None
installing = False


def advance() -> bool:
    """Once every clock period; whether there is more to do."""
    global checking, installing
    if checking and check.poll():
        checking = False
    if installing and installation.advance():
        installing = False
        if installation.python:
            start_check(installation.python)
    clock.redraw("PREFERENCES")
    return checking or installing


def start_check(python: str) -> None:
    """Ask a Python what it has."""
    global check, checking
    if checking:
        check.close()
    check, checking = EngineCheck(python), True
    clock.watch(advance)


def let_go() -> None:
    """Blender or the add-on ends: an installation sees that, and cleans up."""
    global checking, installing
    if checking:
        check.close()
    if installing:
        installation.process.close()
    checking = installing = False


class NEP_OT_check_engine(bpy.types.Operator):
    bl_idname = "nep.check_engine"
    bl_label = "Check"
    bl_description = "Say which Python runs the engine, and what it has or lacks"

    @classmethod
    def poll(cls, context):
        if checking:
            cls.poll_message_set("The Python is being asked")
        return not checking

    def execute(self, context):
        global check
        try:
            start_check(find_engine_python(configured=preferences.engine_python(context)))
        except EngineError as error:
            self.report({"WARNING"}, str(error))
            check = None
            return {"CANCELLED"}
        return {"FINISHED"}


class NEP_OT_install_engine(bpy.types.Operator):
    bl_idname = "nep.install_engine"
    bl_label = "Install Engine"
    bl_description = "Download what the engine needs (torch and others) into an environment of its own"

    @classmethod
    def poll(cls, context):
        if installing:
            cls.poll_message_set("It is being installed")
            return False
        if not bpy.app.online_access:
            cls.poll_message_set(ONLINE_FIRST)
            return False
        return True

    def execute(self, context):
        global installation, installing
        folder, chosen = preferences.engine_folder(context), preferences.of(context)
        if folder is None:
            self.report({"ERROR"}, "Choose a folder to install into")
            return {"CANCELLED"}
        command = [
            sys.executable,
            "-I",
            engine_install.__file__,
            "--source",
            str(EXTENSION),
            "--folder",
            str(folder),
            "--python",
            preferences.base_python(context),
            "--build",
            chosen.build if chosen else "cpu",
        ]
        try:
            installation, installing = Installation(command), True
        except OSError as error:
            self.report({"ERROR"}, f"The installation cannot be started: {error}")
            return {"CANCELLED"}
        clock.watch(advance)
        return {"FINISHED"}


class NEP_OT_cancel_install(bpy.types.Operator):
    bl_idname = "nep.cancel_install"
    bl_label = "Cancel"
    bl_description = "Stop the installation and remove what it has made"

    @classmethod
    def poll(cls, context):
        if not installing or installation.cancelling:
            cls.poll_message_set("It is being cancelled" if installing else "Nothing is being installed")
            return False
        return True

    def execute(self, context):
        installation.cancel()
        return {"FINISHED"}


class NEP_OT_open_preferences(bpy.types.Operator):
    bl_idname = "nep.open_preferences"
    bl_label = "Engine Preferences"
    bl_description = "Open the preferences where the engine is installed or chosen"

    def execute(self, context):
        bpy.ops.preferences.addon_show(module=preferences.ROOT_PACKAGE)
        return {"FINISHED"}


def draw(layout, chosen) -> None:
    """The preferences' whole content."""
    box = layout.box()
    row = box.row()
    row.label(text="Engine", icon="SYSTEM")
    row.operator("nep.check_engine", icon="VIEWZOOM")
    _draw_check(box.column(align=True))
    box.prop(chosen, "engine_python", placeholder="The installed engine")
    box = layout.box()
    box.label(text="Installation", icon="IMPORT")
    column = box.column()
    column.enabled = not installing
    column.prop(chosen, "engine_folder", placeholder="The extension's own folder")
    column.prop(chosen, "base_python", placeholder="Blender's own Python")
    column.prop(chosen, "build")
    version = "{}.{}".format(*sys.version_info)
    if not chosen.base_python and sys.version_info >= (3, 14):
        column.label(text=f"Blender's Python is {version}: where parts of the engine have no build for it yet,", icon="INFO")
        column.label(text="choose a Python 3.11, 3.12 or 3.13 as Base Python.", icon="BLANK1")
    if installing:
        box.progress(factor=installation.fraction, text=f"{100 * installation.fraction:.0f} %")
        box.label(text=installation.message)
        box.operator("nep.cancel_install", icon="CANCEL")
        return
    if not bpy.app.online_access:
        box.label(text=ONLINE_FIRST, icon="INFO")
    box.operator("nep.install_engine", icon="IMPORT")
    if installation is not None and installation.error is not None:
        for text, icon in zip(installation.error, ("ERROR", "BLANK1"), strict=True):
            if text:
                box.label(text=text, icon=icon)


def _draw_check(column) -> None:
    if checking:
        column.label(text="Asking the Python; the first time this takes half a minute", icon="TIME")
    elif check is None:
        named = os.path.basename(preferences.engine_python(bpy.context))
        column.label(
            text="Not checked yet" if named else "No engine yet: install it below, or choose a Python that has it",
            icon="QUESTION" if named else "ERROR",
        )
    else:
        column.label(text=check.python, icon="CHECKMARK" if check.works else "ERROR")
        for line in check.lines:
            column.label(text=line, icon="BLANK1")


CLASSES = (NEP_OT_check_engine, NEP_OT_install_engine, NEP_OT_cancel_install, NEP_OT_open_preferences)
