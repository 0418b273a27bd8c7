"""Where the photos are taken from: some so near that the object fills the photo and is cut by its edge."""

from mathutils import Matrix, Vector

from ..viewpoints import Viewpoint
from .effects import FRAMING, draws
from .settings import first_day

CUT_SHARE = 0.4
"""of the photos that cut the object"""
NEARER, ASIDE = (0.55, 0.75), 0.35
"""The distance of such a camera is multiplied by a number within these limits. It looks past the object's center by up to
so many object radii along each axis, and never higher."""


def arranged(viewpoints: list[Viewpoint], effects: frozenset[str], seed: int) -> list[Viewpoint]:
    """The viewpoints in the order in which the photos are taken, some of them moved.

    Of two days, each has viewpoints of all heights.
    """
    first = first_day(effects, len(viewpoints))
    second = [viewpoint for number, viewpoint in enumerate(viewpoints) if number % 3 == 2][: len(viewpoints) - first]
    moved = [viewpoint for viewpoint in viewpoints if viewpoint not in second] + second
    if FRAMING not in effects:
        return moved
    return [_nearer(viewpoint, number, seed) for number, viewpoint in enumerate(moved)]


def _nearer(viewpoint: Viewpoint, number: int, seed: int) -> Viewpoint:
    rng = draws(seed, FRAMING, number)
    if rng.random() >= CUT_SHARE:
        return viewpoint
    position = viewpoint.matrix.translation * rng.uniform(*NEARER)
    x, y, z = rng.uniform(-ASIDE, ASIDE, 3)
    rotation = (Vector((x, y, -abs(z))) - position).to_track_quat("-Z", "Y").to_matrix().to_4x4()
    return Viewpoint(Matrix.Translation(position) @ rotation)
