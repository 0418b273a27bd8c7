"""The plans of the suite, as data: captures x presets x ablations x number of photos x image size x seeds."""

from __future__ import annotations

import itertools
import math
from collections.abc import Iterable, Sequence
from dataclasses import asdict, dataclass, fields, replace
from pathlib import Path

from benchmarks.suite.harness import with_changes
from blender_nep.presets import EVIDENCE, PRESETS, REFINEMENTS, Preset

WITHOUT_F_E = "no F_e in stage 2"
AS_TAKEN = "exposures as taken"
TURNTABLE_OFF = "turntable off"
AT_WHITE = "no brighter than white"
OF_SOME_CAPTURES = (AS_TAKEN, TURNTABLE_OFF, AT_WHITE)
"""Ablations that change something on some captures only, so that they are in no plan"""


def without_each(part: str, names: Iterable[str]) -> dict[str, dict[str, dict]]:
    """An ablation "without NAME" for each name that the field `without` of a part of the preset may hold."""
    return {f"without {name}": {part: {"without": (name,)}} for name in names}


ABLATIONS: dict[str, dict[str, dict]] = {
    "full": {},
    "w_s as printed": {"fields": {"dynamic_weight": True}},
    "plain NeuS color": {"fields": {"decomposition": False}},
    "environment at infinity": {"environment": {"model": "infinite"}},
    "F_e not first": {"fields": {"background_steps": 0}},
    "no curvature": {"fields": {"curvature": 0.0, "last_curvature": 0.0}},
    "highlights in full": {"fields": {"highlight_threshold": math.inf}},
    "full gradients of F_e": {"fields": {"environment_gradient_scale": 1.0}},
    WITHOUT_F_E: {"material": {}},
    "no cones": {"material": {"use_cones": False}},
    AT_WHITE: {"environment": {"burnt_gain": 1.0}},
    "no camera response": {"material": {"camera_response": False}},
    "no object gains": {"material": {"object_gains": False}},
    "no photographer": {"material": {"photographer": False}},
    "no smooth classes": {"material": {"unclear_classes": float("inf")}},
    "metals of any brightness": {"material": {"metals_are_bright": 0.0}},
    "no unseen light": {"material": {"learn_unseen_light": False}},
    "no indirect light": {"material": {"levels": 0}},
    **{f"N = {n}": {"material": {"levels": n}, "preset": {"skip_needless": False}} for n in (1, 2, 3)},
    AS_TAKEN: {"preset": {"even_exposure": False}},
    TURNTABLE_OFF: {"preset": {"turntable": False}},
    "brightness as taken": {"preset": {"brightness": 0.0}},
    "one material": {"material": {"most_materials": 1, "varied_gain": math.inf}},
    "a palette for all objects": {"material": {"varied_gain": math.inf}},
    **without_each("fields", REFINEMENTS),
    **without_each("material", EVIDENCE),
}
"""Name of an ablation -> the preset fields that it changes. Each refinement of stage 1 and each evidence of stage 2 is one.

In all presets w_s is off, and N is 2 where the scene needs it. The ablations of N turn skip_needless off, because with it
N = 2 and N = 3 would become 1 on most objects. "F_e not first" has no visual hull either, because the hull needs steps of
F_e alone. WITHOUT_F_E changes no field of a preset: step.py gives stage 2 no F_e. All light is then a map at infinity, which
is found by the object's reflections alone (the paper puts an MLP there). AS_TAKEN changes something only where the exposures
of photos differ, AT_WHITE only where photos end at white, and TURNTABLE_OFF only where the object turned: the light turns
with the object then, as for a method that knows no turntables."""


@dataclass(frozen=True)
class Run:
    """One whole job and its scores."""

    capture: Path
    preset: str = "balanced"
    ablation: str = "full"
    geometry: str = "own"
    """own: the job makes its own mesh. true: the materials are learned on the capture's gt_mesh.ply."""
    views: int | None = None
    """How many photos are learned from, spread evenly; None for all."""
    pixels: int | None = None
    """Most pixels of a photo; None for the preset's own number."""
    seed: int = 0

    @property
    def name(self) -> str:
        """The name of this run's files."""
        parts = [self.capture.name, self.preset, self.ablation]
        parts += ["true_mesh"] if self.geometry == "true" else []
        parts += [f"{self.views}_views"] if self.views else []
        parts += [f"{self.pixels}_pixels"] if self.pixels else []
        return "-".join([*parts, f"seed_{self.seed}"]).replace(" ", "_").replace("=", "is")

    @property
    def is_plain(self) -> bool:
        """Whether this is a whole job as a user would run it: no ablation, all photos, its own mesh."""
        return self == Run(self.capture, self.preset, seed=self.seed)

    @property
    def changed_preset(self) -> Preset:
        """The preset with the changes of this run's ablation and number of pixels."""
        changed = with_changes(PRESETS[self.preset], ABLATIONS[self.ablation])
        return replace(changed, max_pixels_per_photo=self.pixels) if self.pixels else changed

    @property
    def same_stage_1(self) -> Run | None:
        """The run without ablation whose stage 1 this run can use too; None where this run needs its own stage 1.

        The fields and the surface can be shared where the ablation changes only stage 2.
        """
        only_materials = {"material"} <= set(ABLATIONS[self.ablation]) <= {"material", "preset"}
        return replace(self, ablation="full") if only_materials else None

    @property
    def without(self) -> tuple[str, ...]:
        """The names that the ablation leaves out; empty where it changes anything else."""
        changes = ABLATIONS[self.ablation].values()
        only_names = all(set(values) == {"without"} for values in changes)
        return tuple(name for values in changes for name in values["without"]) if only_names else ()

    def as_row(self) -> dict:
        """This run for the row's JSON. The capture is given by the name of its folder, without the path."""
        return asdict(self) | {"capture": self.capture.name}

    @classmethod
    def from_json(cls, values: dict) -> Run:
        """The run that `as_json` has turned into `values`."""
        return cls(**values | {"capture": Path(values["capture"])})

    def as_json(self) -> dict:
        """This run for the step's JSON. The capture is given by its path."""
        return asdict(self) | {"capture": str(self.capture)}


CHOICES = tuple(f.name for f in fields(Run) if f.name != "capture")
_PLANNED = tuple(name for name in ABLATIONS if name not in OF_SOME_CAPTURES)
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
    "random": ({"preset": ("preview",), "seed": (0,)},),
    "photographs": ({"preset": ("preview",), "seed": (0,)},),
}
"""Name of a plan -> the values of Run's fields that it combines, each with each.

A field that a plan does not name has Run's default. `roughness` is for the captures that `render` makes. `random` and
`photographs` are for the captures that the commands of these names render. Sweeps and ablations use the preset `preview`. It
takes a third of the time, and the differences that they look for show there too."""


def expand(names: Iterable[str], captures: Sequence[Path], wanted: dict[str, Sequence]) -> list[Run]:
    """The runs of the plans `names`, each once. The runs of the first seed come first.

    `wanted` overrides the values of the plans. The name `all` stands for all plans. Without names, the runs are those of
    `wanted` alone.
    """
    names = list(PLANS) if "all" in names else list(names)
    matrices = [matrix for name in names for matrix in PLANS[name]] or [{}]
    runs = {}
    for matrix in matrices:
        chosen = {key: matrix.get(key, (getattr(Run, key),)) for key in CHOICES} | wanted
        for *values, capture in itertools.product(*(chosen[key] for key in reversed(CHOICES)), captures):
            run = Run(capture, **dict(zip(reversed(CHOICES), values, strict=True)))
            runs[run.name] = run
    return list(runs.values())
