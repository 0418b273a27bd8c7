"""The names of the five stages, in events, in the files of a run, in the report and in the benchmarks.

`backend/engine/progress.py` has a copy, because Blender's Python cannot import the engine. A test compares the two.
"""

from __future__ import annotations

from enum import StrEnum


class StageName(StrEnum):
    """The stages, in the order of a report. With a given mesh, `SURFACE` runs before `FIELDS_LEARNING`."""

    CAPTURE = "capture"
    FIELDS_LEARNING = "fields_learning"
    SURFACE = "surface"
    MATERIAL_LEARNING = "material_learning"
    ASSET = "asset"


CAMERA_SEARCH = "finding_cameras"
"""The one stage of `blender-nep cameras`, in its events."""
