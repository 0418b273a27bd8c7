"""What report.json says about an asset, as far as the gallery shows it."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from blender_nep.color import linear_to_srgb, to_bytes
from blender_nep.safety.plain_files import read_json


@dataclass(frozen=True)
class Material:
    """A material that was found."""

    color: str
    """The base color as #rrggbb, sRGB"""
    roughness: float
    metal: bool
    share: float
    """Its share of the surface, 0..1"""


@dataclass(frozen=True)
class AssetSummary:
    """The part of report.json that the gallery shows. What the report does not say is None."""

    materials: tuple[Material, ...] = ()
    faces: int | None = None
    seconds: float | None = None
    peak_memory_mb: float | None = None
    held_out_error: float | None = None
    """`stages.fields_learning.held_out_error`, the last: of pixels that stage 1 did not learn from, tone-mapped"""
    material_residual: float | None = None
    """`stages.material_learning.residual`: what the materials leave unexplained of the photos, tone-mapped"""
    warnings: tuple[str, ...] = ()
    """In words"""


def read_summary(folder: Path) -> AssetSummary | None:
    """The summary of the asset in `folder`, or None if its report.json is missing or damaged."""
    try:
        return _summary(read_json(folder / "report.json"))
    except (OSError, AttributeError, LookupError, TypeError, ValueError, OverflowError):
        return None


def _summary(report: Mapping[str, Any]) -> AssetSummary:
    stages = report.get("stages") or {}
    fields, surface, materials = (stages.get(name) or {} for name in ("fields_learning", "surface", "material_learning"))
    errors = [error for error in fields.get("held_out_error") or () if error is not None]
    return AssetSummary(
        materials=tuple(sorted(map(_material, report.get("materials") or ()), key=lambda found: -found.share)),
        faces=None if (faces := _number(surface.get("faces"))) is None else int(faces),
        seconds=_number(report.get("seconds_total")),
        peak_memory_mb=_number(report.get("peak_memory_mb")),
        held_out_error=_number(errors[-1]) if errors else None,
        material_residual=_number(materials.get("residual")),
        warnings=tuple(str(warning["message"]) for warning in report.get("warnings") or ()),
    )


def _number(told: float | None) -> float | None:
    """The number that the report has at a place, None where it is not finite. Raises ValueError, TypeError for others."""
    return None if told is None or not math.isfinite(number := float(told)) else number


def _material(told: Mapping[str, Any]) -> Material:
    numbers = [*told["albedo"], told["roughness"], told["metallic"], told["share"]]
    if not all(math.isfinite(number) for number in numbers):
        raise ValueError("a material's numbers are not finite")
    red, green, blue = to_bytes(linear_to_srgb(np.array(told["albedo"], np.float32)))
    return Material(
        color=f"#{red:02x}{green:02x}{blue:02x}",
        roughness=float(told["roughness"]),
        metal=float(told["metallic"]) > 0.5,
        share=float(told["share"]),
    )
