"""Rows of the suite: one JSON file for each run, with its settings, scores and seconds."""

from __future__ import annotations

import json
from pathlib import Path


def write_row(file: Path, row: dict) -> None:
    """Write `row` as JSON, under a temporary name that is then changed to `file`."""
    file.parent.mkdir(parents=True, exist_ok=True)
    part = file.with_suffix(".part")
    part.write_text(json.dumps(row, indent=1), encoding="utf-8")
    part.replace(file)


def read_row(file: Path) -> dict:
    """The row in a file that `write_row` has written; {} where there is no such file."""
    return json.loads(file.read_text(encoding="utf-8")) if file.is_file() else {}


def failure(row: dict) -> str:
    """The message of the first step that failed; an empty string where none failed."""
    return next(
        (f"{step}: {row[step]['error']}" for step in ("learn", "score", "relight") if "error" in row.get(step, {})), ""
    )
