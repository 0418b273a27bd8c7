"""Errors of the engine, in the words and the language of the panel."""

from bpy.app.translations import pgettext_iface

from ..backend.engine.command import EngineError


def error_text(error: EngineError) -> str:
    """The message, the hint and the end of the log, a line each."""
    return "\n".join(text for text in (*error.words(pgettext_iface), error.log) if text)
