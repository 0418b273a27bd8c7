"""Writes the gallery while a batch runs."""

from __future__ import annotations

import time
from pathlib import Path

from blender_nep.errors import NepError
from blender_nep.gallery import write_gallery
from blender_nep.job.reporting.events import Events
from blender_nep.messages import Message

_SHARE = 0.02
"""Largest share of the time that is spent on the gallery. With very many objects, index.html is large."""


class GalleryPages:
    """The gallery of a batch. Pages that cannot be written end no batch."""

    def __init__(self, folder: Path, events: Events) -> None:
        self._folder, self._events = folder, events
        self._next, self._warned = 0.0, False

    def write_if_due(self) -> None:
        """Write the pages, if the last time was long enough ago."""
        if time.monotonic() >= self._next:
            self.write()

    def write(self) -> None:
        """Write the pages. batch.json must be written before."""
        began = time.monotonic()
        try:
            write_gallery(self._folder)
        except Exception as error:  # also what nobody foresaw: the gallery is no reason to stop the jobs
            if not self._warned:
                self._warned = True
                self._events.log_traceback(error)
                reason = error.message if isinstance(error, NepError) else str(error)
                self._events.warning(Message("batch.no_gallery", {"reason": reason}))
        ended = time.monotonic()
        self._next = ended + (ended - began) / _SHARE
