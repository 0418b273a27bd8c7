"""Subdivides the unwrapped mesh where the surface bends, and puts the new vertices on the SDF's zero level.

Face normals of a decimated mesh are off by as much as the surface turns within a face. A finer mesh is cheap to make, but
slow to unwrap. So the coarse mesh is unwrapped, and its edges are halved afterwards: the UV map is linear in each face, so
that it stays the same map.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np
import torch

from blender_nep.geometry.mesh import Surface, normalized
from blender_nep.profiling import profiled
from blender_nep.support.in_mesh import MARGIN

if TYPE_CHECKING:
    from blender_nep.fields.object.field import ObjectField
    from blender_nep.presets import SurfacePreset
    from blender_nep.support.plane import Support

_NEWTON_STEPS = 3
_LEAST_SLOPE = 0.2
"""Smallest gradient of the SDF with which Newton's method divides."""
_LONGEST_MOVE = 0.3
"""A new vertex may move from the middle of its edge by at most this share of the edge's length. The next sheet of a thin
body lies farther away."""
_STILL_OFF = 0.03
"""A moved vertex must be nearer to the surface than this share of the edge's length."""
_LEAST_COSINE = 0.5
"""Smallest cosine between the SDF's normal at a new vertex and the mean normal of the edge's ends."""
_RIM = 0.01
"""So near to the sphere's border, in object radii, the surface may be the cap at which it was cut."""


@profiled("subdivision")
def subdivide(
    surface: Surface, field: ObjectField, preset: SurfacePreset, border: float, support: Support | None = None
) -> Surface:
    """Halve the edges of an unwrapped surface until each bends less than `preset.chord_error`, or there are `preset.faces`.

    An edge's chord error is length * angle / 4: the height of an arc over its chord, if the normal turns by `angle` radians
    from the middle to an end. If the faces do not suffice, edges with the largest errors go first. Where the mesh is not the
    SDF's zero level, because it was cut at the sphere's `border` or at the `support` plane, it stays as it is.
    """
    cuts = _Cuts(border, support)
    surface = _settled(surface, field, 2 / (preset.grid - 1), cuts)
    while True:
        edges = _Edges(surface)
        middles = _middles(edges, field, cuts)
        chosen = _chosen(edges, middles.chord_error, preset.chord_error, preset.faces - len(surface.faces))
        if not chosen.any():
            return surface
        surface = _halved(surface, edges, middles, chosen)


@dataclass(frozen=True)
class _Cuts:
    """Where the mesh was cut, so that it need not be the SDF's zero level."""

    border: float
    """Radius at which the mesh was capped"""
    support: Support | None

    def away_from(self, points: np.ndarray) -> np.ndarray:
        """Whether points [n, 3] are away from the cuts: [n] bool."""
        away = np.linalg.norm(points, axis=1) < self.border - _RIM
        return away if self.support is None else away & (self.support.distance(points) > MARGIN)


def _settled(surface: Surface, field: ObjectField, cell: float, cuts: _Cuts) -> Surface:
    """The surface with its vertices on the zero level. The decimation has moved them off it by less than a `cell`."""
    moved, normals, off = _on_zero_level(field, surface.vertices)
    settled = (np.linalg.norm(moved - surface.vertices, axis=1) < cell) & (off < _STILL_OFF * cell)
    settled &= (normals * surface.normals).sum(1) > _LEAST_COSINE
    settled &= cuts.away_from(surface.vertices) & cuts.away_from(moved)
    vertices = np.where(settled[:, None], moved, surface.vertices)
    return Surface(vertices, surface.faces, np.where(settled[:, None], normals, surface.normals), surface.uv)


class _Edges:
    """The edges of a surface. Both sides of a UV seam are one edge, so that no crack opens there."""

    def __init__(self, surface: Surface) -> None:
        self.place = np.unique(surface.vertices, axis=0, return_inverse=True)[1].ravel()
        sides = np.sort(surface.faces[:, [[0, 1], [1, 2], [2, 0]]].reshape(-1, 2), axis=1)
        first_side, of_face = _pairs(sides, len(surface.vertices))
        self.sides = sides[first_side]
        """[S, 2] vertices of the sides: one side for an edge inside a chart, two for an edge at a seam"""
        self.of_face = of_face.reshape(-1, 3)
        """[F, 3] sides of each face, between its corners 0-1, 1-2 and 2-0"""
        places = np.sort(self.place[self.sides], axis=1)
        first, self.edge = _pairs(places, len(surface.vertices))
        """[S] index of each side's edge"""
        ends = self.sides[first]
        # the same sum must come out on both sides of a seam, whatever the order of the vertices
        ends = np.take_along_axis(ends, np.argsort(self.place[ends], axis=1), axis=1)
        self.ends = surface.vertices[ends]
        """[E, 2, 3] positions of the ends of each edge"""
        self.end_normals = surface.normals[ends]
        """[E, 2, 3]"""
        lengths = np.linalg.norm(self.ends[:, 0] - self.ends[:, 1], axis=1)[self.edge[self.of_face]]
        longest = np.take_along_axis(self.of_face, lengths.argmax(1, keepdims=True), axis=1)
        self.longest_of_face = self.edge[longest.ravel()]
        """[F] the longest edge of each face"""

    def with_longest(self, chosen: np.ndarray) -> np.ndarray:
        """The chosen edges [E] bool, and the longest edge of each face that has a chosen edge (Rivara 1984).

        Without the longest edges, faces would become thinner from round to round, and the rounds might never end.
        """
        while True:
            longest = self.longest_of_face[chosen[self.edge[self.of_face]].any(1)]
            if chosen[longest].all():
                return chosen
            chosen = chosen.copy()
            chosen[longest] = True


def _pairs(pairs: np.ndarray, count: int) -> tuple[np.ndarray, np.ndarray]:
    """The first index [D] of each different pair, and for each of the pairs [n, 2] its number [n] among these, 0..D - 1.

    The pairs hold whole numbers below `count`. np.unique sorts one number much faster than a row.
    """
    _, first, number = np.unique(pairs[:, 0] * count + pairs[:, 1], return_index=True, return_inverse=True)
    return first, number.ravel()


def _chosen(edges: _Edges, error: np.ndarray, tolerance: float, faces: int) -> np.ndarray:
    """The edges [E] bool to be halved: those with errors above the tolerance; if they add more than `faces`, the worst."""
    order = np.argsort(-error, kind="stable")
    fit, too_many = 0, int((error > tolerance).sum()) + 1
    best = np.zeros(len(error), bool)
    count = too_many - 1
    while too_many - fit > 1:
        chosen = np.zeros(len(error), bool)
        chosen[order[:count]] = True
        chosen = edges.with_longest(chosen)
        if 2 * chosen.sum() <= faces:  # halving an edge adds one face on each of its sides
            fit, best = count, chosen
        else:
            too_many = count
        count = (fit + too_many) // 2
    return best


@dataclass(frozen=True)
class _Middles:
    """The vertices that would halve the edges."""

    vertices: np.ndarray
    """[E, 3]"""
    normals: np.ndarray
    """[E, 3]"""
    chord_error: np.ndarray
    """[E], in object radii; 0 where the mesh is not the zero level of the SDF"""


def _middles(edges: _Edges, field: ObjectField, cuts: _Cuts) -> _Middles:
    middle = edges.ends.mean(1)
    length = np.linalg.norm(edges.ends[:, 0] - edges.ends[:, 1], axis=1)
    mean_normal = normalized(edges.end_normals.sum(1))
    moved, normal, off = _on_zero_level(field, middle)
    on_surface = (np.linalg.norm(moved - middle, axis=1) < _LONGEST_MOVE * length) & (off < _STILL_OFF * length)
    on_surface &= (normal * mean_normal).sum(1) > _LEAST_COSINE
    for points in (moved, *edges.ends.swapaxes(0, 1)):
        on_surface &= cuts.away_from(points)
    cosine = (edges.end_normals * normal[:, None]).sum(-1).min(1)
    angle = np.arccos(cosine.clip(-1, 1))
    vertices = np.where(on_surface[:, None], moved, middle)
    normals = np.where(on_surface[:, None], normal, mean_normal)
    return _Middles(vertices, normals, np.where(on_surface, length * angle / 4, 0.0))


def _on_zero_level(field: ObjectField, points: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Points [n, 3] moved onto the SDF's zero level by Newton's method, with unit normals [n, 3] and |SDF| [n] there."""
    moved = points
    sdf, gradient = _sdf(field, moved)
    for _ in range(_NEWTON_STEPS):
        slope = np.maximum((gradient**2).sum(1), _LEAST_SLOPE**2)
        moved = moved - (sdf / slope)[:, None] * gradient
        sdf, gradient = _sdf(field, moved)
    return moved, normalized(gradient), np.abs(sdf)


def _sdf(field: ObjectField, points: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """The SDF [n] and its gradient [n, 3] at points [n, 3]; float64."""
    device = next(field.parameters()).device
    sdf, gradient = field.sdf_and_gradient(torch.as_tensor(points, dtype=torch.float32, device=device))
    return sdf.double().cpu().numpy(), gradient.double().cpu().numpy()


def _halved(surface: Surface, edges: _Edges, middles: _Middles, chosen: np.ndarray) -> Surface:
    """The surface with the chosen edges [E] halved. Faces are split into two, three or four."""
    sides = np.flatnonzero(chosen[edges.edge])
    new = np.full(len(edges.edge), -1)
    new[sides] = len(surface.vertices) + np.arange(len(sides))
    edge = edges.edge[sides]
    vertices = np.concatenate([surface.vertices, middles.vertices[edge]])
    normals = np.concatenate([surface.normals, middles.normals[edge]])
    uv = np.concatenate([surface.atlas, surface.atlas[edges.sides[sides]].mean(1)])
    return Surface(vertices, _split(surface.faces, new[edges.of_face], vertices), normals, uv)


def _split(faces: np.ndarray, middle: np.ndarray, vertices: np.ndarray) -> np.ndarray:
    """Split faces [F, 3] at the middles [F, 3] of their sides 0-1, 1-2 and 2-0; -1: not halved. Returns new faces [G, 3]."""
    halved = (middle >= 0).sum(1)
    parts = [faces[halved == 0]]
    # each face is turned so that its sides a-b, b-c, c-a have their middles in the order that the case needs
    a, b, c, ab, _, _ = _turned(faces, middle, halved == 1, (middle >= 0).argmax(1))
    parts += [_faces(a, ab, c), _faces(ab, b, c)]
    a, b, c, _, bc, ca = _turned(faces, middle, halved == 2, (middle < 0).argmax(1))
    parts.append(_faces(bc, c, ca))
    # the quadrangle a, b, bc, ca is split along its shorter diagonal
    to_bc = np.linalg.norm(vertices[a] - vertices[bc], axis=1) < np.linalg.norm(vertices[b] - vertices[ca], axis=1)
    parts += [_faces(a, b, np.where(to_bc, bc, ca)), _faces(np.where(to_bc, a, b), bc, ca)]
    a, b, c, ab, bc, ca = _turned(faces, middle, halved == 3, np.zeros(len(faces), np.int64))
    parts += [_faces(a, ab, ca), _faces(ab, b, bc), _faces(ca, bc, c), _faces(ab, bc, ca)]
    return np.concatenate(parts)


def _turned(faces: np.ndarray, middle: np.ndarray, which: np.ndarray, first: np.ndarray) -> list[np.ndarray]:
    """Corners a, b, c and middles ab, bc, ca of the faces `which`, turned so that their side `first` [F] is a-b."""
    turn = (first[which, None] + np.arange(3)) % 3
    corners, middles = (np.take_along_axis(x[which], turn, axis=1) for x in (faces, middle))
    return [*corners.T, *middles.T]


def _faces(*corners: np.ndarray) -> np.ndarray:
    return np.stack(corners, axis=1)
