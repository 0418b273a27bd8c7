"""The add-on's preferences, and how Blender draws them: which Python runs the engine, and the engine's installation."""

import os
import sys

import bpy
from bpy.app.translations import pgettext_iface

from ..backend.engine.install import NAME
from .engine_paths import EXTENSION_PACKAGE, engine_python
from .tasks import registry
from .tasks.engine_setup import ALLOW_ONLINE_ACCESS, Installation, PythonCheck
from .wrapped_text import draw_wrapped

BUILDS = (
    ("cpu", "CPU", "For every computer; the smallest download (about 1.7 GB on the disk)"),
    (
        "cuda",
        "CUDA",
        "For NVIDIA graphics cards, on Linux (several GB). On Windows install torch as pytorch.org says, "
        "and choose that Python as Engine Python",
    ),
)
REPLACED = "Engine Python was {}. It is empty now, so that jobs use the installed engine."


def _forget_failure(preferences: "NepPreferences", context: bpy.types.Context) -> None:
    """What was chosen for the installation has changed, so that the failure of the last one no longer concerns it."""
    registry.forget_ended(Installation)


class NepPreferences(bpy.types.AddonPreferences):
    bl_idname = EXTENSION_PACKAGE

    engine_python: bpy.props.StringProperty(
        name="Engine Python",
        subtype="FILE_PATH",
        description="The Python that has blender-nep and torch. Empty: the installed engine. Never Blender's own. "
        "Install Engine empties it",
    )
    engine_folder: bpy.props.StringProperty(
        name="Install Into",
        subtype="DIR_PATH",
        description=f"The engine is installed into its subfolder {NAME}. Empty: the extension's own user folder",
        update=_forget_failure,
    )
    base_python: bpy.props.StringProperty(
        name="Base Python",
        subtype="FILE_PATH",
        description="The Python 3.11 or newer that makes the engine's environment. Empty: Blender's own",
        update=_forget_failure,
    )
    build: bpy.props.EnumProperty(
        name="Build of Torch", description="What the engine can compute on", items=BUILDS, update=_forget_failure
    )

    def draw(self, context: bpy.types.Context) -> None:
        _draw_engine(self.layout.box(), context, self)
        _draw_installation(self.layout.box(), context, self)


def _draw_engine(box: bpy.types.UILayout, context: bpy.types.Context, preferences: NepPreferences) -> None:
    """Which Python runs the engine, and what the last check of it has found."""
    row = box.row()
    row.label(text="Engine", icon="SYSTEM")
    row.operator("nep.check_engine", icon="VIEWZOOM")
    _draw_check(box.column(align=True), context)
    box.prop(preferences, "engine_python", placeholder="The installed engine")


def _draw_check(column: bpy.types.UILayout, context: bpy.types.Context) -> None:
    check = registry.find(PythonCheck)
    if check is None:
        named = os.path.basename(engine_python(context))
        column.label(
            text="Not checked yet" if named else "No engine yet: install it below, or choose a Python that has it",
            icon="QUESTION" if named else "ERROR",
        )
    elif not check.ended:
        column.label(text="Asking the Python; the first time this takes half a minute", icon="TIME")
    else:
        draw_wrapped(column, context, check.answer.python, "CHECKMARK" if check.answer.works else "ERROR")
        for line in check.answer.lines:
            draw_wrapped(column, context, line, "BLANK1")


def _draw_installation(box: bpy.types.UILayout, context: bpy.types.Context, preferences: NepPreferences) -> None:
    """The choices for an installation, its progress, and its failure."""
    installation = registry.find(Installation)
    installing = installation is not None and not installation.ended
    box.label(text="Installation", icon="IMPORT")
    column = box.column()
    column.enabled = not installing
    column.prop(preferences, "engine_folder", placeholder="The extension's own folder")
    column.prop(preferences, "base_python", placeholder="Blender's own Python")
    column.prop(preferences, "build")
    version = "{}.{}".format(*sys.version_info)
    if not preferences.base_python and sys.version_info >= (3, 14):
        column.label(text=f"Blender's Python is {version}: where parts of the engine have no build for it yet,", icon="INFO")
        column.label(text="choose a Python 3.11, 3.12 or 3.13 as Base Python.", icon="BLANK1")
    if installing:
        box.progress(factor=installation.fraction, text=f"{100 * installation.fraction:.0f} %")
        box.label(text=installation.message)
        box.operator("nep.cancel_install", icon="CANCEL")
        return
    if not bpy.app.online_access:
        box.label(text=ALLOW_ONLINE_ACCESS, icon="INFO")
    box.operator("nep.install_engine", icon="IMPORT")
    if installation is not None and installation.error is not None:
        for text, icon in zip(installation.error, ("ERROR", "BLANK1"), strict=True):
            draw_wrapped(box, context, text, icon)
    elif installation is not None and installation.replaced:
        draw_wrapped(box, context, pgettext_iface(REPLACED).format(installation.replaced), "INFO")
