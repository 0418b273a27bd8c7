"""What material learning tells: its report, and its steps while it goes on."""

from __future__ import annotations

import time
from collections.abc import Callable
from dataclasses import dataclass, field, fields
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from blender_nep.materials.palette import Palette

_STEPS = 100


@dataclass
class MaterialReport:
    """What was learned, and what that took. What is None or empty did not come up, and `as_dict` leaves it out."""

    samples: int
    """Pixels that the materials were learned from"""
    left_out: dict[str, float]
    """Shares of the pixels tried that were left out, by reason"""
    seconds: dict[str, float] = field(default_factory=dict)
    """Of each phase"""
    unseen_light_radius: float | None = None
    """Of the map of the light that no photo shows, unit frame"""
    light_not_in_photos: float | None = None
    """Share of the light that no photo shows"""
    metal_or_not_margin: float | None = None
    """How much worse, as a share, the photos are explained with the least certain material the other way round"""
    merged_shades: int = 0
    """Materials that became one with another of their hue"""
    materials: list[dict[str, Any]] = field(default_factory=list)
    """Of each: share of the samples, albedo, roughness, metallic"""
    residual_one_material: float | None = None
    """Mean tone-mapped error with one material for everything"""
    residual: float | None = None
    """The same in the end"""
    texture_texels: int | None = None
    """Side of the textures"""
    cones_traced: int | None = None
    self_reflection_rays: int | None = None
    """How many of the cones met the object again"""
    neighbours_error: float | None = None
    """Median error with which the other samples of a photo tell what a sample shows"""
    skipped: dict[str, dict] = field(default_factory=dict)
    """What was left out, and why"""
    seconds_saved: dict[str, float] = field(default_factory=dict)
    """What leaving it out saved, about"""

    def tell_materials(self, palette: Palette, shares: list[float]) -> None:
        """Fills `materials`; shares [K]: of the samples."""
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

    def as_dict(self) -> dict[str, Any]:
        """As plain values, for the asset's report."""
        always = {"samples", "left_out", "seconds", "materials"}
        values = {f.name: getattr(self, f.name) for f in fields(self)}
        empty: tuple[Any, ...] = (None, {}, [])
        found = {name: value for name, value in values.items() if name in always or value not in empty}
        if not self.merged_shades:
            del found["merged_shades"]
        return found


class TrainingProgress:
    """Tells the steps of material learning, saves the checkpoints that are due, and takes the time of each phase."""

    def __init__(self, callback: Callable, checkpoint, seconds: dict[str, float], start: float) -> None:
        """callback(step, steps, loss) may raise; seconds: where the phases' times are written; start: of the first one, by
        `time.monotonic`."""
        self.callback, self.checkpoint, self.seconds = callback, checkpoint, seconds
        self.done, self.loss, self.start = 0, float("nan"), start
        self.state: dict = {}
        """For the checkpoint. Before the light is gathered there is nothing worth keeping: a resumed job repeats what comes
        before and after it."""

    def step(self, step: int) -> None:
        """Reached `step` of 100."""
        self.done = step
        if self.checkpoint.due():
            self.checkpoint.save(self.state)
        self.callback(step, _STEPS, self.loss)

    def phase_ended(self, name: str) -> None:
        """The time since the last phase ended is that of this one."""
        now = time.monotonic()
        self.seconds[name] = round(now - self.start, 2)
        self.start = now
