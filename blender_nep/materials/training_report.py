"""The report of material learning."""

from __future__ import annotations

from dataclasses import dataclass, field, fields
from typing import TYPE_CHECKING, Any

import torch

if TYPE_CHECKING:
    from blender_nep.materials.palette.palette import Palette


@dataclass
class MaterialReport:
    """What was learned, and what that took. `as_dict` leaves out most values that are None or empty."""

    samples: int
    """Number of pixels from which the materials were learned"""
    left_out: dict[str, float]
    """{reason: share of the tried pixels that were left out for it}"""
    seconds: dict[str, float] = field(default_factory=dict)
    """{phase: seconds}"""
    response: dict[str, float] | None = None
    """The camera's response curve (`ResponseCurve.state`), if there is one"""
    response_errors: dict[str, float] = field(default_factory=dict)
    """{strength of the response curve that was tried: mean tone-mapped error}"""
    object_gains: list[float] = field(default_factory=list)
    """[views] how much brighter the object is in each photo than in the others, if that differs"""
    photographer: float = 0.0
    """Strength of the person who takes light from the object (`shading.photographer`); 0: nobody was found"""
    photographer_errors: dict[str, float] = field(default_factory=dict)
    """{strength beyond the one found before: error of held-out photos}, the last time that it was looked for"""
    unseen_light_radius: float | None = None
    """Radius of the sphere on which the unseen light lies, in the unit frame"""
    unseen_light_gain: float | None = None
    """Factor by which materials that vary have changed the unseen light"""
    light_not_in_photos: float | None = None
    """Share of the light that no photo shows"""
    metal_or_not_margin: float | None = None
    """Share by which the error grows if the least certain material changes its class (metal or dielectric). It counts
    what the hues say, too."""
    merged_shades: int = 0
    """Number of materials that were merged into another material of their hue"""
    materials: list[dict[str, Any]] = field(default_factory=list)
    """For each material: share of the samples, albedo, roughness, metallic"""
    evidence: dict[str, dict[str, Any]] = field(default_factory=dict)
    """{name of an evidence: what it decided (`acted`), or the message `skipped`} (`Account.report`)"""
    residual_one_material: float | None = None
    """Mean tone-mapped error with one material for all samples"""
    residual: float | None = None
    """Mean tone-mapped error with the final palette"""
    texture_texels: int | None = None
    """Side of the textures in texels"""
    cones_traced: int | None = None
    self_reflection_rays: int | None = None
    """Number of cones that met the object again"""
    neighbors_error: float | None = None
    """Median error of predicting a sample's radiance from the nearest other samples of its photo, tone-mapped"""
    varied_gain: float | None = None
    """Share by which a material for each segment lowers the palette's residual, on held-out photos"""
    segments: int | None = None
    """Number of segments, if each has a material of its own"""
    skipped: dict[str, dict] = field(default_factory=dict)
    """{part that was left out: state of the message that says why}"""
    seconds_saved: dict[str, float] = field(default_factory=dict)
    """{part that was left out: seconds that this saved, estimated}"""

    def add_materials(self, palette: Palette, shares: list[float]) -> None:
        """Fill `materials` from the palette; shares [K] are the shares of the samples."""
        self.materials = [
            {
                "share": round(share, 4),
                "albedo": [round(x, 4) for x in albedo],
                "roughness": round(roughness, 4),
                "metallic": metallic,
            }
            for share, albedo, roughness, metallic in zip(
                shares, palette.albedo.tolist(), palette.roughness.tolist(), palette.metallic.tolist(), strict=True
            )
        ]

    def tell_segments(self, palette: Palette) -> None:
        """Report the materials of segments: how many there are, and what the residual has decided of them."""
        self.segments = len(palette)
        spread = palette.roughness.quantile(torch.tensor([0.1, 0.5, 0.9], device=palette.roughness.device)).tolist()
        decided = {"metal": round(float(palette.metallic.mean()), 3), "roughness": [round(value, 4) for value in spread]}
        self.evidence = self.evidence | {"residual": self.evidence.get("residual", {}) | {"segments": decided}}

    def as_dict(self) -> dict[str, Any]:
        """The report as plain values, for report.json."""
        always = {"samples", "left_out", "seconds", "materials"}
        values = {f.name: getattr(self, f.name) for f in fields(self)}
        empty: tuple[Any, ...] = (None, {}, [])
        found = {name: value for name, value in values.items() if name in always or value not in empty}
        for name in ("merged_shades", "photographer"):
            if not found[name]:
                del found[name]
        return found
