"""What is run: captures x presets x ablations x number of photos x image size x seeds, as data."""

from __future__ import annotations

import itertools
import math
from collections.abc import Iterable, Sequence
from dataclasses import asdict, dataclass, fields, replace
from pathlib import Path

from benchmarks.suite.harness import with_changes
from blender_nep.presets import PRESETS, Preset

WITHOUT_F_E = "no F_e in stage 2"
AS_TAKEN = "exposures as taken"
ABLATIONS: dict[str, dict[str, dict]] = {
    "full": {},
    "w_s as printed": {"fields": {"dynamic_weight": "paper"}},
    "w_s scaled": {"fields": {"dynamic_weight": "scaled"}},
    "plain NeuS color": {"fields": {"decomposition": False}},
    "environment at infinity": {"environment": {"model": "infinite"}},
    "no visual hull": {"fields": {"least_contrast": math.inf}},
    "F_e not first": {"fields": {"background_steps": 0}},
    "no curvature": {"fields": {"curvature": 0.0, "last_curvature": 0.0}},
    "highlights in full": {"fields": {"highlight_threshold": math.inf}},
    "full gradients of F_e": {"fields": {"environment_gradient_scale": 1.0}},
    WITHOUT_F_E: {"material": {}},
    "no cones": {"material": {"use_cones": False}},
    "no residual": {"material": {"residual": False}},
    "no indirect light": {"material": {"levels": 0}},
    **{f"N = {n}": {"material": {"levels": n}, "preset": {"skip_needless": False}} for n in (1, 2, 3)},
    AS_TAKEN: {"preset": {"even_exposure": False}},
    "one material": {"material": {"most_materials": 1}},
}
"""Preset fields that differ from the preset's own. w_s is off and N is 2 in all presets, where the scene needs it: with
skip_needless N = 2 and 3 would be 1 on most objects. Without steps of F_e alone there is no hull either. WITHOUT_F_E is no
preset's field: all light is a map at infinity, found by the object's reflections alone (the paper puts an MLP there).
AS_TAKEN changes something where photos' exposures differ, and stands in no plan."""


@dataclass(frozen=True)
class Run:
    """One whole job and its scores."""

    capture: Path
    preset: str = "balanced"
    ablation: str = "full"
    geometry: str = "own"
    """own, or true: the materials are learned on the capture's gt_mesh.ply."""
    views: int | None = None
    """Photos learned from, spread evenly; None: all."""
    pixels: int | None = None
    """Most pixels of a photo; None: the preset's."""
    seed: int = 0

    @property
    def name(self) -> str:
        """Of its files."""
        parts = [self.capture.name, self.preset, self.ablation]
        parts += ["true_mesh"] if self.geometry == "true" else []
        parts += [f"{self.views}_views"] if self.views else []
        parts += [f"{self.pixels}_pixels"] if self.pixels else []
        return "-".join([*parts, f"seed_{self.seed}"]).replace(" ", "_").replace("=", "is")

    @property
    def is_plain(self) -> bool:
        """A whole job as a user would run it: no ablation, all photos, its own mesh."""
        return self == Run(self.capture, self.preset, seed=self.seed)

    @property
    def changed_preset(self) -> Preset:
        """The preset as this run wants it."""
        changed = with_changes(PRESETS[self.preset], ABLATIONS[self.ablation])
        return replace(changed, max_pixels_per_photo=self.pixels) if self.pixels else changed

    @property
    def same_stage_1(self) -> Run | None:
        """The run without ablation, if only stage 2 differs: its fields and its surface serve here too."""
        only_materials = {"material"} <= set(ABLATIONS[self.ablation]) <= {"material", "preset"}
        return replace(self, ablation="full") if only_materials else None

    def as_row(self) -> dict:
        """For JSON; the capture by its folder's name alone."""
        return asdict(self) | {"capture": self.capture.name}

    @classmethod
    def from_json(cls, values: dict) -> Run:
        """The inverse of `as_json`."""
        return cls(**values | {"capture": Path(values["capture"])})

    def as_json(self) -> dict:
        """With the capture's path."""
        return asdict(self) | {"capture": str(self.capture)}


CHOICES = tuple(f.name for f in fields(Run) if f.name != "capture")
_PLANNED = tuple(name for name in ABLATIONS if name != AS_TAKEN)
_STAGE_2 = tuple(name for name in _PLANNED if set(ABLATIONS[name]) <= {"material", "environment", "preset"})

PLANS: dict[str, tuple[dict[str, Sequence], ...]] = {
    "presets": ({"preset": ("preview", "balanced", "quality"), "seed": (0, 1, 2)},),
    "ablations": ({"preset": ("preview",), "ablation": _PLANNED, "seed": (0, 1, 2)},),
    "views": ({"preset": ("preview",), "views": (8, 16, 32, None), "seed": (0,)},),
    "pixels": ({"preset": ("preview",), "pixels": (2_500, 10_000, None, 160_000), "seed": (0,)},),
    "true_mesh": (
        {"preset": ("preview",), "geometry": ("true",), "ablation": _STAGE_2, "seed": (0,)},
        {"preset": ("balanced",), "geometry": ("true",), "seed": (0,)},
    ),
    "roughness": ({"preset": ("preview",), "seed": (0,)},),
}
"""Name -> what it crosses; what is not named stands at Run's default. `roughness` is for the captures of `render`. Sweeps
and ablations at `preview`: a third of the time, and what they tell apart is there too."""


def expand(names: Iterable[str], captures: Sequence[Path], wanted: dict[str, Sequence]) -> list[Run]:
    """The runs of some plans, each once, cheap seeds first; `wanted` overrides what the plans say. `all` is every plan,
    and none of them what is wanted alone."""
    names = list(PLANS) if "all" in names else list(names)
    matrices = [matrix for name in names for matrix in PLANS[name]] or [{}]
    runs = {}
    for matrix in matrices:
        chosen = {key: matrix.get(key, (getattr(Run, key),)) for key in CHOICES} | wanted
        for *values, capture in itertools.product(*(chosen[key] for key in reversed(CHOICES)), captures):
            run = Run(capture, **dict(zip(reversed(CHOICES), values, strict=True)))
            runs[run.name] = run
    return list(runs.values())
