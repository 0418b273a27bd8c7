"""What the benchmarks share: presets with fields changed, resumable runs, Markdown tables."""

from __future__ import annotations

import argparse
import json
import os
from collections.abc import Callable, Iterable, Sequence
from dataclasses import replace
from pathlib import Path

import numba
import torch

from blender_nep.errors import NepError, Stopped
from blender_nep.presets import PRESETS, Preset


def with_changes(preset: Preset, changes: dict[str, dict]) -> Preset:
    """The preset with some fields of its parts changed: {"material": {"levels": 1}}."""
    return replace(preset, **{part: replace(getattr(preset, part), **values) for part, values in changes.items()})


def learning_parser(description: str, ablations: Iterable[str], out: str) -> argparse.ArgumentParser:
    """Arguments of a benchmark that learns: captures, presets, ablations, seed, threads, output folder."""
    parser = argparse.ArgumentParser(description=description.split("\n")[0])
    parser.add_argument("captures", nargs="+", type=Path)
    parser.add_argument("--preset", nargs="+", default=["balanced"], choices=list(PRESETS))
    parser.add_argument("--ablation", nargs="+", default=["full"], choices=list(ablations))
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--threads", type=int, default=os.cpu_count())
    parser.add_argument("--out", type=Path, default=Path(out))
    return parser


def use_threads(count: int) -> None:
    """For torch and Numba."""
    torch.set_num_threads(count)
    numba.set_num_threads(min(count, numba.config.NUMBA_NUM_THREADS))


def resumed(file: Path, row: dict, run: Callable[[], dict]) -> dict:
    """What `file` holds; where there is none, `row` with what run() gives or its message, written there. Who is stopped
    leaves no row."""
    if not file.is_file():
        try:
            row = row | run()
        except Stopped:
            raise
        except NepError as error:
            row = row | {"error": str(error)}
        write_row(file, row)
    return json.loads(file.read_text(encoding="utf-8"))


def write_row(file: Path, row: dict) -> None:
    """As JSON, whole or not at all."""
    file.parent.mkdir(parents=True, exist_ok=True)
    part = file.with_suffix(".part")
    part.write_text(json.dumps(row, indent=1), encoding="utf-8")
    part.replace(file)


def markdown(header: Sequence[str], rows: Iterable[Sequence[object]]) -> str:
    """A table; numbers with four digits."""
    lines = ["| " + " | ".join(header) + " |", "|---" * len(header) + "|"]
    lines += ["| " + " | ".join(f"{c:.4g}" if isinstance(c, float) else str(c) for c in row) + " |" for row in rows]
    return "\n".join(lines)
