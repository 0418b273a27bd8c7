"""What a job says of its scene and of what it leaves out because of it, for the report, the console and the UI."""

from __future__ import annotations

from typing import TYPE_CHECKING

from blender_nep.job.events import Events
from blender_nep.job.scene_analysis import Plan, SceneAnalysis, SurfaceAnalysis

if TYPE_CHECKING:
    from blender_nep.capture import PixelRays

_IN_PLAIN_WORDS = {
    "environment field": "the surroundings",
    "mask term": "comparing with masks",
    "surface extraction": "making a mesh",
    "object field": "learning the shape",
    "irradiance": "diffuse light",
    "indirect light": "reflections of the object in itself",
    "second bounces": "light that the object reflects twice",
    "narrow cones": "sharp reflections",
    "residual": "light that no photo shows",
    "further steps of both fields": "the rest of learning shape and light",
    "material boundaries": "boundaries between materials",
    "votes of all pixels": "asking every pixel for its material",
}
"""What is left out, as told to an artist; the report has the method's own words."""


class SceneReport:
    """Grows as the stages are entered; every addition is told at once."""

    def __init__(self, events: Events) -> None:
        self._events = events
        self.facts: dict[str, dict] = {}
        self.sentences: list[str] = []
        self.skipped: dict[str, str] = {}
        """{what: why}"""
        self.seconds_saved: dict[str, float] = {}
        """{what: seconds}, only where this very run measured what a part of it takes"""

    def add(self, name: str, found: SceneAnalysis | SurfaceAnalysis, plan: Plan) -> None:
        """What a look at the photos or at the surface has found."""
        self.facts[name] = found.facts()
        self.sentences += found.sentences()
        self.skipped |= plan.skipped
        self._tell(found.sentences() + _lines(plan.skipped, {}))

    def left_out(self, rays: PixelRays, *, masks_ignored: bool, mesh_given: bool) -> None:
        """What there is nothing to do for, whatever the settings."""
        if rays.mask is None:
            self.skipped["mask term"] = "masks are ignored (--masks ignore)" if masks_ignored else "the capture has no masks"
        if rays.background and len(rays.outside) == 0:
            self.skipped["pixels outside the sphere"] = "the sphere fills all photos"
        if mesh_given:
            self.skipped["surface extraction"] = "a mesh was given (--mesh)"

    def skip(self, skipped: dict[str, str], seconds: dict[str, float]) -> None:
        """What a stage has left out by itself; what was left out before keeps its reason."""
        new = {what: why for what, why in skipped.items() if what not in self.skipped}
        self.skipped |= new
        self.seconds_saved |= {what: round(value, 2) for what, value in seconds.items()}
        if new or seconds:
            self._tell(_lines(new, seconds))

    def stopped_early(self, steps_saved: float, seconds: float) -> None:
        """Stage 1 took so many seconds; all steps that the preset allows would be this share more."""
        if steps_saved > 0:
            what = "further steps of both fields"
            self.skip({what: "the error on held-out pixels did not fall any more"}, {what: seconds * steps_saved})

    def report(self) -> dict:
        """For report.json."""
        return {
            "scene": {**self.facts, "sentences": self.sentences},
            "skipped": self.skipped,
            "skipped_seconds": self.seconds_saved,
        }

    def _tell(self, new: list[str]) -> None:
        for line in new:
            self._events.say(f"  {line}")
        self._events.scene(self.sentences + _lines(self.skipped, self.seconds_saved))


def _lines(skipped: dict[str, str], seconds: dict[str, float]) -> list[str]:
    """A sentence for each reason."""
    reasons: dict[str, list[str]] = {}
    for what, why in skipped.items():
        reasons.setdefault(why, []).append(what)
    lines = []
    for why, parts in reasons.items():
        saved = sum(seconds.get(what, 0.0) for what in parts)
        lines.append(
            f"Left out: {', '.join(_IN_PLAIN_WORDS.get(what, what) for what in parts)}, because {why}"
            + (f" (saves about {saved:.0f} s)." if saved >= 0.5 else ".")
        )
    return lines
