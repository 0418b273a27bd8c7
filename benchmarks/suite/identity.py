"""Says what runs are made from: `python -m benchmarks.suite.identity ORDER RESULT`, both JSON files.

The order holds runs by their names, the result holds `made_from` by the same names. This is a process of its own, because
the suite's runner must stay small (see harness.py).
"""

from __future__ import annotations

import argparse
import sys
from collections.abc import Sequence
from pathlib import Path

from benchmarks.row_files import read_row, write_row
from benchmarks.suite.plan import Run

PARTS = ("capture", "preset", "choice of metal or not", "faces", "mesh")
"""The parts of a job's fingerprint that tell the capture and the preset. The seed is in the run's name."""


def made_from(run: Run) -> dict[str, object]:
    """{part: value} of the fingerprint that tells the whole capture and the changed preset of a run.

    It is {} where the capture cannot be read: the step `learn` then says why.
    """
    from blender_nep.capture import load_capture
    from blender_nep.errors import NepError
    from blender_nep.job.folders.run_folder import fingerprint

    try:
        capture = load_capture(run.capture, use_masks=False)
        mesh = run.capture / "gt_mesh.ply" if run.geometry == "true" else None
        whole = fingerprint(capture, run.changed_preset, run.seed, False, mesh)
    except (NepError, OSError):
        return {}
    return {part: whole[part] for part in PARTS}


def photos_of(folder: Path, masks: bool) -> str:
    """A digest of the photos, cameras and (with `masks`) masks of the capture in a folder. Raises CaptureError."""
    from blender_nep.capture import load_capture
    from blender_nep.job.folders.run_folder import fingerprint
    from blender_nep.presets import PRESETS

    return fingerprint(load_capture(folder, use_masks=masks), PRESETS["preview"], 0, masks, None)["capture"]


def looked_at(parser: argparse.ArgumentParser, folders: Sequence[Path], masks: bool, truth: bool = True) -> list[str]:
    """The `photos_of` each capture. A command asks this before its hours of work.

    The command ends with the parser's error where a folder holds no capture that can be read, where two folders have the
    same name, or, with `truth`, where a capture has no ground truth.
    """
    from blender_nep.errors import NepError

    names = [folder.resolve().name for folder in folders]
    if twice := [name for name in names if names.count(name) > 1]:
        parser.error(f"two captures have the name {twice[0]}, and rows are told apart by it")
    found = []
    for folder in folders:
        try:
            found.append(photos_of(folder, masks))
        except NepError as error:
            parser.error(str(error))
        for file in ("gt_mesh.ply", "transforms_test.json") if truth else ():
            if not (folder / file).is_file():
                parser.error(f"{folder} has no ground truth: {file} is missing")
    return found


def main() -> None:
    order = read_row(Path(sys.argv[1]))
    write_row(Path(sys.argv[2]), {name: made_from(Run.from_json(run)) for name, run in order.items()})


if __name__ == "__main__":
    main()
