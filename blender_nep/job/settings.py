"""The options of one job."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

from blender_nep.capture.photos.mask_files import MaskMeaning
from blender_nep.presets import Preset


@dataclass(frozen=True)
class Settings:
    """The options of one job, as the user gave them (`blender_nep/cli.py`)."""

    capture: Path
    out: Path
    preset: Preset
    device: str = "auto"
    seed: int = 0
    use_masks: bool = True
    mask_meaning: MaskMeaning | None = None
    """What white in the masks means. None: as the masks look"""
    turntable: bool | None = None
    """Whether the object turned while the camera and the light stood still. None: as the capture says, or as it looks"""
    all_photos: bool = False
    """Learn from all photos, also from those that were taken in another light than most (`capture.other_light`)."""
    mesh: Path | None = None
    sphere: tuple[tuple[float, float, float], float] | None = None
    """Center and radius of the object's sphere in capture coordinates. None: from transforms.json, or estimated."""
    hold_out: int | None = None
    """One photo of this many is held out from learning, and the asset is scored on these. None: no photo is held out."""
    resume: bool = False
    overwrite: bool = False
    clean: bool = False
    threads: int | None = None
    job_files: bool = False
    preview: bool = False
    profile: bool = False
