"""Questions before something is replaced, which a double click on the button does not answer."""

import time

import bpy

LEAST_S = 0.6
"""A confirmation that comes earlier is the second half of a double click: Blender puts the answer under the mouse."""


class Asks:
    """What operators share that ask before they begin."""

    _asked_at = 0.0

    def _ask(self, context: bpy.types.Context, event: bpy.types.Event, *, title: str, message: str) -> set[str]:
        """Show the question; what `invoke` returns then. Blender calls `execute` when it was answered."""
        self._asked_at = time.monotonic()
        return context.window_manager.invoke_confirm(self, event, title=title, confirm_text=title, message=message)

    def _is_double_click(self) -> bool:
        """Whether `execute` was called by the second click of a double click."""
        return self.options.is_invoke and time.monotonic() - self._asked_at < LEAST_S
