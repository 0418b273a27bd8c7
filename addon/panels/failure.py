"""Draws why a command of the engine has failed."""

import bpy
from bpy.app.translations import pgettext_iface

from ...backend.engine.commands.short_command import CommandError
from ...backend.engine.exit_codes import STOPPED
from ..wrapped_text import draw_wrapped

NEEDS_ENGINE = ("engine.missing", "unexpected.no_pycolmap")  # names of the errors that the preferences can mend


def draw_failure(layout: bpy.types.UILayout, context: bpy.types.Context, failed: CommandError) -> None:
    """Draw the message, the hint and the end of the log, and the button that leads to the preferences where they help."""
    message, hint = failed.words(pgettext_iface)
    draw_wrapped(layout, context, message, "PAUSE" if failed.code == STOPPED else "ERROR")
    draw_wrapped(layout, context, "\n".join(text for text in (hint, failed.log) if text), "BLANK1")
    if failed.name in NEEDS_ENGINE:
        layout.operator("nep.open_preferences", icon="PREFERENCES")
