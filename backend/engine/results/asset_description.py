"""Describes an asset in words, for the Asset Browser. No bpy in this file."""

from pathlib import Path

from ...plain_files import read_json
from .asset_materials import AssetMaterial, read_materials

METAL, PAINT = "metal", "not metal"
GLOSS = ((0.15, "mirror-like"), (0.35, "glossy"), (0.6, "satin"), (1.0, "matte"))
"""(largest roughness, word)"""
TAGS = (METAL, PAINT, *(word for _, word in GLOSS))
"""All tags that an asset may get"""
LEAST_SHARE = 0.2
"""Of the surface: what covers less gives no tag"""


def describe_asset(asset: Path, preset: str = "") -> tuple[str, list[str]]:
    """(description, tags) of the asset in the folder.

    Both are short where the report cannot be read or names no materials.
    """
    materials = sorted(read_materials(asset), key=lambda material: -material.share)
    sentences = [_origin(asset, preset)]
    if materials:
        listed = ", ".join(
            f"{METAL if one.is_metal else PAINT} of roughness {one.roughness:.2f} ({one.share:.0%})" for one in materials
        )
        sentences.append(f"Materials: {listed}.")
    return " ".join(sentences), _tags(materials)


def _origin(asset: Path, preset: str) -> str:
    try:
        report = read_json(asset / "report.json")
        photos, preset = int(report["capture"]["views"]), str(report.get("preset") or preset)
    except (OSError, ValueError, KeyError, TypeError, AttributeError, OverflowError):
        return "Reconstructed from photos."
    return f"Reconstructed from {photos} photos, preset {preset}."


def _tags(materials: list[AssetMaterial]) -> list[str]:
    """What large parts of the surface are: metal or not, and how rough."""
    found: dict[str, float] = {}
    for one in materials:
        gloss = next((word for limit, word in GLOSS if one.roughness <= limit), GLOSS[-1][1])
        for tag in (METAL if one.is_metal else PAINT, gloss):
            found[tag] = found.get(tag, 0) + one.share
    return [tag for tag, share in found.items() if share >= LEAST_SHARE]
