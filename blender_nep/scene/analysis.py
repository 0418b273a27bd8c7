"""What an analysis of the scene is: facts with numbers, sentences about them, and a preset without needless parts.

There are two, both cheap and without side effects: one of the photos (`PhotoAnalysis.of`), and one of the mesh once it is
there (`SurfaceAnalysis.of`). If `Preset.skip_needless` is False, all parts are kept, and the sentences are still said.
"""

from __future__ import annotations

from abc import ABC, abstractmethod
from dataclasses import asdict, dataclass
from typing import TYPE_CHECKING

from blender_nep.messages import Message, Part

if TYPE_CHECKING:
    from blender_nep.presets import MaterialPreset, Preset


@dataclass(frozen=True)
class Plan:
    """The preset for this scene, and {part that is left out: why}."""

    preset: Preset
    skipped: dict[str, Message]


@dataclass(frozen=True)
class Analysis(ABC):
    """Facts about the scene: the fields of a subclass."""

    def facts(self) -> dict:
        """All fields as plain values, rounded, for report.json."""
        return {k: float(f"{v:.4g}") if isinstance(v, float) else v for k, v in asdict(self).items()}

    @abstractmethod
    def sentences(self) -> list[Message]:
        """Sentences that an artist wants to know."""

    @abstractmethod
    def plan(self, preset: Preset) -> Plan:
        """The preset without the parts that this scene does not need."""


def percent(share: float) -> float:
    """The share in percent, rounded to a whole number; below 10 % to a tenth."""
    return round(100 * share, 1 if share < 0.1 else 0)


def seconds_of_cones(whole: MaterialPreset, less: MaterialPreset, seconds: float) -> dict[str, float]:
    """{part: seconds saved} for the cones of `whole` that `less` leaves out; the cones of `less` took `seconds`."""
    dropped_levels = len(whole.roughness_levels) - len(less.roughness_levels)
    left_out = {
        str(Part.IRRADIANCE): whole.irradiance_cones - less.irradiance_cones,
        str(Part.NARROW_CONES): dropped_levels * whole.specular_cones,
    }
    traced = less.irradiance_cones + len(less.roughness_levels) * less.specular_cones
    return {what: seconds * cones / traced for what, cones in left_out.items() if cones}
