"""Records how many rows of photos and masks are made linear at a time."""

import pytest

from blender_nep.capture.photos.photo_files import Raster


def record_rows(monkeypatch: pytest.MonkeyPatch) -> list[int]:
    """A list that gets the number of rows of every later call of `Raster.rows`."""
    read, lengths = Raster.rows, []

    def recorded(raster, start=0, end=None):
        rows = read(raster, start, end)
        lengths.append(len(rows[0]))
        return rows

    monkeypatch.setattr(Raster, "rows", recorded)
    return lengths
