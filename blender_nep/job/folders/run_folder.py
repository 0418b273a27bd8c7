"""The folder `checkpoints/` of one run: the fingerprint of the run, and the result of each finished stage."""

from __future__ import annotations

import dataclasses
import hashlib
import json
import os
from collections.abc import Callable
from pathlib import Path

from blender_nep.capture import Capture
from blender_nep.capture.photos.mask_files import MaskMeaning
from blender_nep.checkpoints import Checkpoint, load_state, save_state
from blender_nep.errors import UsageError
from blender_nep.files import write_atomically
from blender_nep.job.folders.own_files import (
    CHECKPOINTS,
    RUN_FILE,
    discard_run,
    is_discarded,
    refuse_foreign_files,
    remove_checkpoints,
)
from blender_nep.messages import Message
from blender_nep.presets import Preset
from blender_nep.safety.plain_files import read_json
from blender_nep.stop_request import StopRequest

FORMAT = 21
"""Version of the files in `checkpoints/` and of `report.json`. A run of another version is refused.

Version 3 has new names: the stages (rooms before), and the fields of the preset. Version 6 keeps what a correction of the
materials needs. Version 7 keeps the lean mesh and its normal map. Version 8 keeps the SDF's fine level.
Version 9 keeps clear and veiled object pixels apart. Version 11 counts F_e as light only as far as photos show it.
Version 12 keeps the normals of labeled points. Version 13 keeps which parts of a face the photos show. Version 14
keeps the moments of our own optimizers. Version 15 keeps what each refinement of stage 1 has done. Version 16 keeps the
camera's response curve. Version 17 keeps how the object of a turntable stood where it reflects itself.
Version 18 keeps how much brighter the object is in each photo. Version 19 keeps where photos end at white.
Version 20 keeps how much light the photographer takes in each lobe. Version 21 has another form of the photographer.
"""


def fingerprint(
    capture: Capture,
    preset: Preset,
    seed: int,
    masks: bool,
    mesh: Path | None,
    sphere: tuple[tuple[float, float, float], float] | None = None,
    all_photos: bool = False,
    hold_out: int | None = None,
    mask_meaning: MaskMeaning | None = None,
    turntable: bool | None = None,
) -> dict[str, object]:
    """{name: value} of all inputs that decide the result of a run. A resume must agree with all of them.

    Photos and masks enter by their names and file sizes, the capture's own files and a given mesh by their content. The
    object's sphere, the wish for all photos, `hold_out` and `turntable` enter only if they were given as options.
    """
    paths = [p for v in capture.views for p in (v.image_path, v.mask_path) if p is not None]
    photos = "\n".join(f"{_place(p, capture.folder)} {p.stat().st_size}" for p in paths)
    settings = dataclasses.asdict(preset)
    # options of the user: so the fingerprint names them separately
    metallic, faces = settings["material"].pop("metallic"), settings["surface"].pop("asset_faces")
    what = {
        "format": FORMAT,
        "capture": _digest(b"".join(file.read_bytes() for file in capture.files) + photos.encode()),
        "preset": preset.name + " " + _digest(json.dumps(settings, sort_keys=True).encode()),
        "seed": seed,
        "masks": str(mask_meaning or "use") if masks else "ignore",
        "choice of metal or not": list(metallic),
        "faces": faces,
        "mesh": "" if mesh is None else _digest(mesh.read_bytes()),
    }
    if all_photos:
        what["photos"] = "all"
    if hold_out is not None:
        what["photos held out"] = hold_out
    if turntable is not None:
        what["turntable"] = turntable
    return what if sphere is None else what | {"object bounds": [*map(float, sphere[0]), float(sphere[1])]}


def _place(path: Path, folder: Path) -> str:
    """The path relative to the folder, or absolute if they lie on different drives of Windows."""
    try:
        return os.path.relpath(path, folder)
    except ValueError:
        return os.path.abspath(path)


def _digest(data: bytes) -> str:
    return hashlib.sha256(data).hexdigest()[:16]


def refuse_other_run(asset: Path, before: dict[str, object], what: dict[str, object]) -> None:
    """Raises UsageError when the run in `asset`, with the fingerprint `before`, is not the run `what` that is asked for."""
    if before.get("format") != what.get("format"):
        raise UsageError(
            f"cannot resume: the run in {asset} is of another version of blender_nep",
            "Finish it with that version, or start again with --overwrite.",
            "usage.other_version",
            folder=asset,
        )
    different = [name for name in {**what, **before} if before.get(name) != what.get(name)]
    if different:
        raise UsageError(
            f"cannot resume: the run in {asset} had another {', '.join(different)}",
            "Use the same capture and options as then, or start again with --overwrite.",
            "usage.other_run",
            folder=asset,
            different=different,
        )


class RunFolder:
    """The folder `asset`/checkpoints: results of finished stages, and the checkpoint of the current stage."""

    def __init__(self, asset: Path, stop: StopRequest, warn: Callable[[Message], None]) -> None:
        self.asset = asset
        self.path = asset / CHECKPOINTS
        self._stop, self._warn = stop, warn

    @property
    def _run_file(self) -> Path:
        return self.path / RUN_FILE

    def can_be_resumed(self, what: dict[str, object]) -> bool:
        """Whether the folder holds the run `what`. False if it holds no run, or if its run.json is damaged.

        Raises UsageError when the folder holds another run, or checkpoints that are not ours. Changes nothing.
        """
        refuse_foreign_files(self.asset)
        if not self._run_file.is_file():
            return False
        before = self._read_run()
        if is_discarded(before):
            return False
        refuse_other_run(self.asset, before or what, what)
        return bool(before)

    def begin(self, what: dict[str, object]) -> None:
        """Make the folder of the new run `what`, and remove the checkpoints and the reports of an earlier one.

        Raises UsageError where the folder holds files that are not ours and would be replaced, and OutputError.
        """
        discard_run(self.asset)
        write_atomically(self._run_file, lambda file: file.write_text(json.dumps(what, indent=1), encoding="utf-8"))

    def _read_run(self) -> dict[str, object]:
        try:
            run = read_json(self._run_file)
            return run if isinstance(run, dict) else {}
        except ValueError:
            self._warn(Message("job.run_file_damaged"))
            return {}

    def checkpoint(self, stage: str) -> Checkpoint:
        """The checkpoint of a stage that begins now."""
        return Checkpoint(self.path, stage, self._stop, self._warn)

    def save_result(self, stage: str, result: dict, seconds: float) -> None:
        """Write a stage's result, and the seconds that the stage took. Raises OutputError."""
        save_state(self.path / f"{stage}.done.pt", {"seconds": seconds, "result": result})

    def load_result(self, stage: str) -> tuple[dict, float] | None:
        """A finished stage's (result, seconds). None if there is no such file; None and a warning if it is damaged."""
        path = self.path / f"{stage}.done.pt"
        if not path.is_file():
            return None
        try:
            saved = load_state(path)
            return saved["result"], float(saved["seconds"])
        except (ValueError, KeyError, TypeError) as error:
            self._warn(Message("job.result_damaged", {"file": path.name, "reason": str(error)}))
            return None

    def remove(self) -> None:
        """Remove all checkpoints (--clean). Raises OutputError."""
        remove_checkpoints(self.asset)
