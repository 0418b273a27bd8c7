"""The names of the five stages: in events, in the files of a run, in the report and in the benchmarks.

`backend/engine/progress.py` has a copy, because Blender's Python has no engine; a test compares the two.
"""

from __future__ import annotations

from enum import StrEnum


class StageName(StrEnum):
    """In the order in which a report lists the stages. With a given mesh, `SURFACE` runs before `FIELDS_LEARNING`."""

    CAPTURE = "capture"
    FIELDS_LEARNING = "fields_learning"
    SURFACE = "surface"
    MATERIAL_LEARNING = "material_learning"
    ASSET = "asset"
