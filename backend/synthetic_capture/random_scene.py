"""Draws the description of a random scene from a seed. `random_objects` and `random_surroundings` build what it says.

Lengths are in object radii. The description has only plain values, so it can be saved as `scene.json`. What it does not say
(the teeth of a gear, the colors of the room, the places of things) is drawn from its seed when the scene is built.
"""

import math
from collections.abc import Sequence
from dataclasses import asdict, dataclass

import numpy as np

from .substances import Substance

OBJECT_KINDS = ("Suzanne", "vase", "gear", "torus knot", "displaced sphere", "thin shell")
MESH_FILE = "mesh file"
PATTERNS = ("patches", "stripes")
ROUGHNESS = (0.03, 0.7)
HALF_WIDTH = (3.0, 60.0)
INDOOR_HDRIS = ("interior", "studio")
OUTDOOR_HDRIS = ("city", "courtyard", "forest", "night", "sunrise", "sunset")
LIVING_ROOM = "living room"
"""A kind of place that no seed draws: `synthetic.py --photograph room`"""
SUPPORTS = ("none", "table", "plate")
WHOLE_SPHERE, UPPER_HALF, TWO_RINGS = "whole sphere", "upper half", "two rings"
VIEWS = (30, 80)
FIELD_OF_VIEW = (36.0, 48.0)
"""Degrees. The larger the field, the nearer the cameras."""
BRIGHTNESS = (0.26, 0.42)
"""Mean of the sRGB values, 0..1, that the exposure aims at.

The exposure is found on every n-th view alone, and these may all be of one ring (see Photographing.meter in synthetic.py).
So the mean over all photos is only near this value."""
PHOTO_FORMATS = ("EXR half linear", "PNG 8 bits sRGB", "PNG 16 bits sRGB")
PARTS = ("object", "surroundings", "cameras", "test cameras")
METALS = (
    (0.9, 0.62, 0.3),
    (0.92, 0.92, 0.93),
    (0.86, 0.86, 0.88),
    (0.93, 0.55, 0.4),
    (0.62, 0.6, 0.58),
    (0.75, 0.6, 0.25),
    (0.45, 0.4, 0.36),
)
"""Base Color of gold, silver, chrome, copper, steel, brass and gunmetal; each channel is changed by up to a tenth."""


@dataclass(frozen=True)
class Cameras:
    """Where the cameras stand."""

    kind: str
    """WHOLE_SPHERE, UPPER_HALF or TWO_RINGS"""
    views: int
    field_of_view: float
    """degrees"""
    elevations: tuple[float, ...]
    """degrees: the lowest and the highest, or the elevations of the two rings"""


@dataclass(frozen=True)
class Place:
    """What surrounds the object."""

    kind: str
    """'room', 'HDRI' or LIVING_ROOM"""
    half_width: float | None
    """of the room, in object radii; None with an HDRI, which is at infinity"""
    hdri: str | None
    """the name of an HDRI that ships with Blender; None in a room"""
    things: int
    """number of things near the object"""


@dataclass(frozen=True)
class Support:
    """What the object stands on."""

    kind: str
    """one of SUPPORTS"""
    half_width: float
    """in object radii; 0 without support"""
    round: bool
    roughness: float
    pattern: bool
    """whether it is a checker of two colors"""


@dataclass(frozen=True)
class Photography:
    """How the photos are taken and stored."""

    brightness: float
    """mean of the sRGB values, 0..1, that the exposure aims at (see BRIGHTNESS)"""
    auto_exposure: bool
    """whether the exposure varies a little from photo to photo"""
    format: str
    """one of PHOTO_FORMATS"""


@dataclass(frozen=True)
class SceneDescription:
    """A random scene."""

    seed: int
    object: str
    """one of OBJECT_KINDS, or MESH_FILE"""
    mesh: str | None
    """the mesh file's path as it was given; None for other objects"""
    pattern: str
    """'uniform' or one of PATTERNS"""
    substances: tuple[Substance, ...]
    place: Place
    support: Support
    cameras: Cameras
    photography: Photography

    @property
    def summary(self) -> str:
        """The scene in a line, for tables."""
        looks = [
            f"{'metal' if part.metallic else 'paint'} ({', '.join(f'{c:.2f}' for c in part.color)}) of roughness "
            f"{part.roughness:.2f}"
            for part in self.substances
        ]
        place = self.place
        where = f"HDRI {place.hdri}" if place.hdri else f"{place.kind} of {place.half_width:.0f} radii"
        exposure = "auto-exposure" if self.photography.auto_exposure else "one exposure"
        return "; ".join(
            [
                self.object,
                f"{' and '.join(looks)}{'' if self.pattern == 'uniform' else f' in {self.pattern}'}",
                f"{where} with {place.things} things",
                "no support" if self.support.kind == "none" else f"on a {self.support.kind}",
                f"{self.cameras.views} photos, {self.cameras.kind}",
                f"{exposure}, {self.photography.format}",
            ]
        )

    def as_json(self) -> dict:
        """The values for `scene.json`, with the summary first. The mesh file is given by its name, without the path."""
        values = {"summary": self.summary} | asdict(self)
        return values | {"mesh": self.mesh and self.mesh.replace("\\", "/").rpartition("/")[2]}


def details(seed: int, part: str) -> np.random.Generator:
    """The random numbers for what the description of the scene `seed` leaves open in one of PARTS."""
    return np.random.default_rng((seed, 1 + PARTS.index(part)))


def draw_scene(seed: int, meshes: Sequence[str] = ()) -> SceneDescription:
    """The random scene of a seed, which is a whole number from 0 on.

    Each file of `meshes` is as likely as each of OBJECT_KINDS.
    """
    rng = np.random.default_rng(seed)
    number = _dealt(seed, len(OBJECT_KINDS) + len(meshes), salt=1)
    kind = (*OBJECT_KINDS, *[MESH_FILE] * len(meshes))[number]
    mesh = meshes[number - len(OBJECT_KINDS)] if kind == MESH_FILE else None
    substances = tuple(_substance(rng) for _ in range(int(rng.integers(1, 3))))
    pattern = "uniform" if len(substances) == 1 else str(rng.choice(PATTERNS))
    place = _place(rng, ("room", "HDRI")[_dealt(seed, 2, salt=2)])
    support = _support(rng, SUPPORTS[_dealt(seed, len(SUPPORTS), salt=3)], place)
    cameras = _cameras(rng, support, place)
    photography = Photography(
        brightness=_rounded(rng.uniform(*BRIGHTNESS)),
        auto_exposure=bool(rng.random() < 0.35),
        format=str(rng.choice(PHOTO_FORMATS)),
    )
    return SceneDescription(seed, kind, mesh, pattern, substances, place, support, cameras, photography)


def _dealt(seed: int, count: int, salt: int) -> int:
    """A number below `count` for a seed.

    Each `count` odd seeds that follow each other from 1 on get all the numbers, in random order, and so do the even seeds
    from 2 on. So a dozen scenes has all kinds of objects.
    """
    block, place = divmod((seed - 1 + 2 * count) // 2, count)
    return int(np.random.default_rng((salt, seed % 2, block)).permutation(count)[place])


def _rounded(value: float) -> float:
    return round(float(value), 4)


def _log_uniform(rng: np.random.Generator, low: float, high: float) -> float:
    return min(max(_rounded(math.exp(rng.uniform(math.log(low), math.log(high)))), low), high)


def _substance(rng: np.random.Generator) -> Substance:
    metallic = float(rng.random() < 0.5)
    if metallic:
        color = np.clip(np.array(METALS[rng.integers(len(METALS))]) * rng.uniform(0.9, 1.1, 3), 0, 0.95)
    else:
        color = rng.uniform(0.03, 0.8, 3)
    return Substance(tuple(map(_rounded, color)), _log_uniform(rng, *ROUGHNESS), metallic)


def _place(rng: np.random.Generator, kind: str) -> Place:
    things = int(rng.integers(2, 6) if rng.random() < 0.5 else rng.integers(9, 17))
    if kind == "room":
        return Place(kind, _log_uniform(rng, *HALF_WIDTH), None, things)
    names = INDOOR_HDRIS if rng.random() < 0.4 else OUTDOOR_HDRIS
    return Place(kind, None, str(rng.choice(names)), things)


def _support(rng: np.random.Generator, kind: str, place: Place) -> Support:
    if kind == "none":
        return Support(kind, 0.0, False, 0.0, False)
    half_width = rng.uniform(0.8, 1.5) if kind == "plate" else rng.uniform(1.6, 5.0)
    if place.half_width:
        half_width = min(half_width, 0.75 * place.half_width)
    return Support(
        kind,
        _rounded(half_width),
        bool(kind == "plate" or rng.random() < 0.4),
        _log_uniform(rng, 0.1, 0.8),
        bool(rng.random() < 0.5),
    )


def _cameras(rng: np.random.Generator, support: Support, place: Place) -> Cameras:
    kinds = (WHOLE_SPHERE, UPPER_HALF, TWO_RINGS) if support.kind == "none" else (UPPER_HALF, TWO_RINGS)
    kind = str(rng.choice(kinds))
    views = int(rng.integers(VIEWS[0], VIEWS[1] + 1))
    # In a narrow room only a wide field of view lets the cameras stand near enough.
    narrow = place.half_width is not None and place.half_width < 5
    field_of_view = FIELD_OF_VIEW[1] if narrow else _rounded(rng.uniform(*FIELD_OF_VIEW))
    if kind == WHOLE_SPHERE:
        elevations = (-65.0, 75.0)
    elif kind == UPPER_HALF:
        elevations = (12.0, 75.0)
    else:
        elevations = (_rounded(rng.uniform(12, 25)), _rounded(rng.uniform(40, 58)))
    return Cameras(kind, views, field_of_view, elevations)
