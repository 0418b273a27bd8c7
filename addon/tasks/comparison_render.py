"""The render of the relit comparison. A second Blender renders it from the asset folder; this Blender shows it."""

from bpy.app.handlers import persistent

from ...backend.rendering.comparison_process import ComparisonProcess
from ..scene.comparison_image import load_comparison
from . import clock
from .opened_file import opened_file


class ComparisonRender:
    """A render that is under way; `clock.follow` follows it. Its picture is loaded when it has ended."""

    def __init__(self, arguments: list[str]) -> None:
        """OSError where the second Blender cannot be started."""
        self.process = ComparisonProcess(arguments)
        self._file = opened_file()

    def poll(self) -> bool:
        """Whether the render has ended."""
        return self.process.poll()

    def displayed_state(self) -> tuple[int, int, bool]:
        """What the sidebar shows of the render."""
        return self.process.done, self.process.total, self.process.cancelled

    def finish(self) -> None:
        """Load the picture into the file that was open when the render began. Another file stays as it is."""
        global current, last_message
        current = None
        self.process.close()
        if opened_file() != self._file:
            return
        if self.process.path is None:
            last_message = self.process.error
            return
        last_message = f"Written: {self.process.path}"
        load_comparison(self.process.path)

    def close(self) -> None:
        """End the second Blender now."""
        self.process.close()


current: ComparisonRender | None = None  # the render under way
last_message = ""  # how the last render ended


def show_message(message: str) -> None:
    """Make the panel show this message, in place of how the last render ended."""
    global last_message
    last_message = message


@persistent
def on_file_loaded(*_: object) -> None:
    """Blender's handler after another file was opened: the message is about a picture of the file before."""
    show_message("")


def start_render(arguments: list[str], *, wait: bool) -> ComparisonRender:
    """Render a comparison with these arguments of backend/render_comparison.py.

    With `wait` this function returns after the render's end; else it returns at once.
    OSError where the second Blender cannot be started.
    """
    global current
    render = current = ComparisonRender(arguments)
    show_message("")
    clock.follow(render, wait=wait)
    return render


def close_all() -> None:
    """Blender or the add-on ends: end the render under way."""
    global current
    if current is not None:
        current.close()
    current = None
    show_message("")
