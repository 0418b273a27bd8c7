"""Reads from an asset's report which materials it has, and how they were corrected. No bpy in this file."""

from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from ...plain_files import read_json


@dataclass(frozen=True)
class AssetMaterial:
    """A material of an asset.

    `share`: the part of the surface that has this material, 0..1. `albedo`: linear Rec.709, 0..1. `albedo`, `roughness` and
    `is_metal` are the values that the textures have now. `learned_roughness` and `learned_is_metal` are what the photos
    said. `correction`: what somebody has corrected, by the names `metallic` and `roughness`.
    """

    share: float
    albedo: tuple[float, float, float]
    roughness: float
    is_metal: bool
    learned_roughness: float
    learned_is_metal: bool
    correction: dict[str, float] = field(default_factory=dict)


def read_materials(asset: Path) -> list[AssetMaterial]:
    """The materials of the asset in the folder, in the order of their numbers.

    An empty list where the report cannot be read, or names no materials, as the reports of older assets.
    """
    try:
        report = read_json(asset / "report.json")
        corrections = report.get("corrections") or {}
        return [
            _material(described, corrections.get(str(number)) or {}) for number, described in enumerate(report["materials"])
        ]
    except (OSError, ValueError, KeyError, TypeError, AttributeError, OverflowError):
        return []


def _material(described: dict[str, Any], correction: dict[str, Any]) -> AssetMaterial:
    red, green, blue = map(float, described["albedo"])
    learned = described["learned"]
    return AssetMaterial(
        float(described["share"]),
        (red, green, blue),
        float(described["roughness"]),
        _is_metal(described["metallic"]),
        float(learned["roughness"]),
        _is_metal(learned["metallic"]),
        {name: float(correction[name]) for name in ("metallic", "roughness") if name in correction},
    )


def _is_metal(metallic: float) -> bool:
    return float(metallic) > 0.5
