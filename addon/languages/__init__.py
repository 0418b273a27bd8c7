"""The languages of the panel beside English, one file each. docs/translating.md tells how to add one."""

import bpy

from . import german, spanish

LANGUAGES = {"de_DE": german.TEXTS, "es": spanish.TEXTS}
"""Blender's name of a language -> its texts"""
OTHER_NAMES = {"es": ("es_ES",)}
"""Names that other versions of Blender have for a language"""
CONTEXTS = ("*", "Operator")
"""Blender looks up the texts of buttons in the second one, and all other texts in the first one."""


def register() -> None:
    """Let Blender translate the panel's words."""
    tables = {}
    for language, texts in LANGUAGES.items():
        table = {(context, english): text for english, text in texts.items() for context in CONTEXTS}
        tables |= dict.fromkeys((language, *OTHER_NAMES.get(language, ())), table)
    bpy.app.translations.register(__package__, tables)


def unregister() -> None:
    """Undo `register`."""
    bpy.app.translations.unregister(__package__)
