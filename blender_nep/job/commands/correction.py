"""Corrects the materials of a finished asset, as an artist wants them, from the light that the job has kept."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from blender_nep.asset.export import TEXTURES, Placement, write_asset
from blender_nep.asset.preview import PreviewView
from blender_nep.checkpoints import DAMAGED
from blender_nep.errors import UsageError
from blender_nep.files import output_errors, refuse_links
from blender_nep.job.exit_code import exit_code
from blender_nep.job.folders.job_folder import held
from blender_nep.job.folders.own_files import ENTRIES, LOG, PREVIEW
from blender_nep.job.folders.run_folder import FORMAT, RunFolder
from blender_nep.job.reporting.events import Events
from blender_nep.job.stage_names import StageName
from blender_nep.job.stages import SurfaceResult, surface_result
from blender_nep.materials.corrections import Correction, KeptMaterials
from blender_nep.presets import preset
from blender_nep.safety.arrays import check_array
from blender_nep.safety.plain_files import read_json
from blender_nep.stop_request import StopRequest

_STEPS = 3


@dataclass(frozen=True)
class _Finished:
    """What an asset folder holds of its job."""

    kept: KeptMaterials
    shape: SurfaceResult
    view: PreviewView
    light: np.ndarray


def run(asset: Path, corrections: Mapping[int, Correction], events: Events) -> int:
    """Correct the materials of the asset in the folder `asset`, and return the exit code.

    `corrections` {number of the material: correction} is complete: a material that it does not name becomes as it was
    learned. It takes seconds, and nothing stops it but a second Ctrl-C.
    """

    def work() -> None:
        refuse_links(asset, ENTRIES)
        read_report(asset)  # to refuse a folder that is no asset of ours before a lock is made in it
        with held(asset), StopRequest().signals():  # nobody asks for the stop
            _correct(asset, corrections, events)

    return exit_code(work, events, asset, "Correct it again. If it then is no finished asset, reconstruct it again.")


def _correct(asset: Path, corrections: Mapping[int, Correction], events: Events) -> None:
    report = read_report(asset)
    _refuse_unknown(report, corrections)
    with output_errors(asset):
        events.open_log(asset / LOG)
    events.log(f"correction: {_to_dict(corrections)}")
    _progress(events, 0)
    found = _load(asset, events)
    _refuse_paint_without_irradiance(found.kept, corrections)
    _progress(events, 1)
    baked, materials = found.kept.bake(found.shape.surface, corrections, preset(report["preset"]).material)
    textures = dict(zip(TEXTURES, baked, strict=True))
    _progress(events, 2)
    picture = found.view.render(found.shape.surface, textures, found.light)
    capture = report["capture"]
    place = Placement(np.array(capture["object_center"]), capture["object_radius"])
    mesh = place.mesh(found.shape.of_asset, textures | found.shape.textures)
    corrected = report | {"materials": materials, "corrections": _to_dict(corrections)}
    write_asset(asset, mesh, picture, None, None, lambda: corrected)
    _progress(events, _STEPS)
    events.preview(asset / "preview.png")
    events.done(asset)


def _progress(events: Events, step: int) -> None:
    events.progress(str(StageName.MATERIAL_LEARNING), step, _STEPS, step / _STEPS, 0.0, None)


def read_report(asset: Path) -> dict[str, Any]:
    """The content of report.json. Raises UsageError where `asset` is no finished asset of this version."""
    try:
        report = read_json(asset / "report.json")
        version = report["fingerprint"]["format"]
    except (OSError, ValueError, KeyError, TypeError) as error:
        hint = "Give the folder of a finished reconstruction."
        raise UsageError(f"{asset} holds no finished asset", hint, "usage.no_asset", folder=asset) from error
    if version != FORMAT:
        raise UsageError(
            f"the asset in {asset} is of another version of blender_nep",
            "Reconstruct it again, or correct it with that version.",
            "usage.asset_of_other_version",
            folder=asset,
        )
    return report


def _refuse_unknown(report: dict[str, Any], corrections: Mapping[int, Correction]) -> None:
    count = len(report.get("materials", ()))
    for number in corrections:
        if not 0 <= number < count:
            raise UsageError(
                f"there is no material {number}: the asset has {count}, counted from 0",
                "`blender-nep materials ASSET` lists them.",
                "usage.no_such_material",
                number=number,
                count=count,
            )


def _refuse_paint_without_irradiance(kept: KeptMaterials, corrections: Mapping[int, Correction]) -> None:
    """Raise UsageError where a material is to be a dielectric and the light for that was not gathered (--metal yes)."""
    if not kept.irradiance_known and any(correction.metallic == 0 for correction in corrections.values()):
        raise UsageError(
            "the job was told that the object is metal, so it has not gathered the light that a dielectric needs",
            "Reconstruct it again with --metal auto or --metal no.",
            "usage.told_to_be_metal",
        )


def _load(asset: Path, events: Events) -> _Finished:
    """What the job has kept. Raises UsageError where it was removed or is damaged."""
    folder = RunFolder(asset, StopRequest(), events.warning)
    surface, materials, preview = (
        folder.load_result(name) for name in (StageName.SURFACE, StageName.MATERIAL_LEARNING, PREVIEW)
    )
    if surface is None or materials is None or preview is None or materials[0]["kept"] is None:
        raise UsageError(
            f"the asset in {asset} cannot be corrected: its folder checkpoints is not complete",
            "Reconstruct it again, without --clean.",
            "usage.not_correctable",
            folder=asset,
        )
    state = preview[0]
    try:
        found = _Finished(
            KeptMaterials.from_state(materials[0]["kept"]),
            surface_result(surface[0]),
            PreviewView(**state["view"]),
            state["light"],
        )
        found.kept.check(found.shape.surface)
        found.view.check()
        check_array("light", found.light, (None, None, 3))
    except DAMAGED as error:
        raise UsageError(
            f"the asset in {asset} cannot be corrected: its checkpoints are damaged ({type(error).__name__}: {error})",
            "Reconstruct it again.",
            "usage.not_correctable",
            folder=asset,
        ) from error
    return found


def _to_dict(corrections: Mapping[int, Correction]) -> dict[str, dict[str, float]]:
    """The corrections for report.json."""
    return {
        str(number): {name: value for name, value in vars(correction).items() if value is not None}
        for number, correction in sorted(corrections.items())
    }
