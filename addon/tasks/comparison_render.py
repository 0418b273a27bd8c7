"""The render of the relit comparison. A second Blender renders it from the asset folder; this Blender shows it."""

from ...backend.rendering.comparison_process import ComparisonProcess
from ..scene.comparison_image import load_comparison
from . import registry
from .registry import Task


class ComparisonRender(Task):
    """A render. Its picture is loaded when it has ended; `message` then says how it ended.

    Picture and message are for the file that was open when the render began. Another file stays as it is.
    """

    def __init__(self, process: ComparisonProcess | None, message: str = "") -> None:
        """`process` is None for a render that could not be started: `message` then says why."""
        super().__init__()
        self.process, self.message, self.ended = process, message, process is None

    def poll(self) -> bool:
        return self.process.poll()

    def displayed_state(self) -> object:
        return self.process.done, self.process.total, self.process.cancelled

    def finish(self) -> None:
        self.close()
        path = self.process.path
        if self.is_of_open_file:
            self.message = self.process.error if path is None else f"Written: {path}"
            if path is not None:
                load_comparison(path)

    def close(self) -> None:
        if self.process is not None:
            self.process.close()


def start_render(arguments: list[str], *, wait: bool) -> ComparisonRender:
    """Render a comparison with these arguments of backend/render_comparison.py.

    With `wait` this function returns after the render's end; else it returns at once.
    OSError where the second Blender cannot be started.
    """
    return registry.start(ComparisonRender(ComparisonProcess(arguments)), wait=wait)


def last_message() -> str:
    """How the last render ended, for the panel; empty where there is nothing to say."""
    render = registry.ended(ComparisonRender)
    return "" if render is None else render.message
