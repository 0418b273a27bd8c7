"""The button Check Photos, and what the engine has found: where photos are missing, the main facts, and what is wrong."""

import bpy
from bpy.app.translations import pgettext_iface

from ...backend.engine.command import NoEngineError
from ...backend.engine.results.capture_facts import facts_of, warnings_of
from ..engine_errors import error_text
from ..folders import resolve_folder
from ..tasks import registry
from ..tasks.photo_check import PICTURE, PhotoCheck, last_check
from ..wrapped_text import draw_wrapped
from .pictures import draw_halves

SIDES = ("From Above", "From Below")  # what the two halves of the picture show
SHADES = "Green: near a photo. Yellow to red: photos are missing."
ALL_WELL = "Nothing looks wrong"


def draw_photo_check(layout: bpy.types.UILayout, context: bpy.types.Context) -> None:
    """Draw the button, or that the check is under way, and below it the result of the last check of this folder."""
    folder = resolve_folder(context.scene.nep.capture)
    if folder is not None and registry.running(PhotoCheck, folder) is not None:
        row = layout.row(align=True)
        row.label(text="Looking at the photos...", icon="TIME")
        row.operator("nep.cancel_check_photos", text="", icon="X")
        return
    layout.operator("nep.check_photos", icon="VIEWZOOM")
    check = last_check(folder)
    if check is None:
        return
    box = layout.box()
    if check.error is not None:
        draw_wrapped(box, context, error_text(check.error), "ERROR")
        if isinstance(check.error, NoEngineError):
            box.operator("nep.open_preferences", icon="PREFERENCES")
        return
    warnings = warnings_of(check.found)
    if check.picture is not None:
        draw_halves(box, context, PICTURE, SIDES)
        draw_wrapped(box, context, SHADES)
        box.operator("nep.show_coverage", icon="IMAGE_DATA")
    column = box.column(align=True)
    for line in facts_of(check.found, pgettext_iface):
        draw_wrapped(column, context, line, "DOT")
    for warning in warnings:
        draw_wrapped(box, context, warning.words(pgettext_iface), "ERROR")
    if not warnings:
        box.label(text=ALL_WELL, icon="CHECKMARK")
