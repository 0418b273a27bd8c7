"""The pages of a batch, while the engine writes them. They are opened in the web browser when they are there."""

from pathlib import Path

import bpy

from ...backend.engine.commands.gallery_process import GalleryProcess
from .registry import Task
from .shelf_batch import batch_in


class GalleryPages(Task):
    """The pages of the batch in `folder`."""

    one_per_folder = True

    def __init__(self, python: str, folder: Path) -> None:
        """Start the engine. NoEngineError where it cannot be started."""
        super().__init__(folder)
        self._process = GalleryProcess(python, folder)

    def poll(self) -> bool:
        return self._process.poll()

    def close(self) -> None:
        self._process.close()

    def finish(self) -> None:
        failed = self._process.failed
        batch_in(self.folder).gallery_problem = "" if failed is None else str(failed)
        if failed is None and not bpy.app.background:
            bpy.ops.wm.url_open(url=self._process.page.resolve().as_uri())
