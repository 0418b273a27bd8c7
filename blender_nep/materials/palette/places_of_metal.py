"""Decides which places of the surface are metal where a palette has metals and dielectrics.

The residuals of single places say it badly in photos: where the known light is too bright, a dark paint explains a metal
best, and a uniform metal gets blotches of paint. But a thing of one material hardly changes its color, and where metal ends
the color changes. So the advantage of the metals over the dielectrics is smoothed over the surface, up to edges of color.
The smooth advantage is the minimum of a data term and of a Dirichlet term on the graph of neighbors, as in random walker
segmentation with priors (Grady 2005).
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy import sparse
from scipy.sparse.linalg import cg
from scipy.spatial import cKDTree

from blender_nep.materials.baking import Places, neighbors, on_same_side
from blender_nep.materials.place_colors import features_of_color
from blender_nep.profiling import profiled

_NEIGHBORS = 12
"""Neighbors of a sample in the graph"""
_AROUND = 4
"""Samples around another place that tell whether it is metal"""
_TOLERANCE = 1e-3
"""Relative error of the solution; only its sign counts."""


@dataclass(frozen=True, eq=False)
class PlacesOfMetal:
    """The graph of neighboring samples."""

    _laplacian: sparse.csr_matrix
    """[n, n]"""
    _index: np.ndarray
    """[n, k] the neighbors of each sample"""
    _places: Places
    """Where the samples are"""
    _tree: cKDTree
    """Their positions"""

    @classmethod
    def of(cls, places: Places, tree: cKDTree, color: np.ndarray, index: np.ndarray) -> PlacesOfMetal:
        """The graph of n samples at their `places`, whose positions are in `tree`.

        color [n, 3] is the median log radiance there (`place_colors`).
        index [n, m] are the neighbors of each sample, of which the nearest ones count. They may hold the sample itself.
        """
        index, count = index[:, : _NEIGHBORS + 1], len(index)
        feature = features_of_color(color)
        away = ((feature[index] - feature[:, None]) ** 2).sum(-1)
        weight = np.exp(-0.5 * away) * (np.einsum("nkc,nc->nk", places.normal[index], places.normal) > 0)
        rows = np.repeat(np.arange(count), index.shape[1])
        one_way = sparse.csr_matrix((weight.ravel(), (rows, index.ravel())), shape=(count, count))
        both = 0.5 * (one_way + one_way.T)
        both.setdiag(0)
        return cls(sparse.diags(np.asarray(both.sum(1)).ravel()) - both, index, places, tree)

    @profiled("places of metal")
    def decide(self, advantage: np.ndarray, smoothness: float) -> np.ndarray:
        """Whether each place is metal [n] bool.

        advantage [n]: how much less a metal leaves unexplained than a dielectric does. `smoothness` is the weight of the
        differences between neighbors of one color.
        """
        system = sparse.eye(len(advantage)) + smoothness * self._laplacian
        smooth, _ = cg(system, advantage.astype(np.float64), rtol=_TOLERANCE)
        return smooth > 0

    def at_boundaries(self, metal: np.ndarray) -> np.ndarray:
        """Which places [n] bool have neighbors of both kinds."""
        return _mixed(metal[self._index])

    def around(self, metal: np.ndarray, at: Places) -> tuple[np.ndarray, np.ndarray]:
        """Whether each of m other places is metal [m] bool, and which lie at boundaries [m] bool, by `metal` [n]."""
        _, near = on_same_side(neighbors(self._tree, at.position, _AROUND), at, self._places, enough=1)
        return metal[near[:, 0]], self.at_boundaries(metal)[near[:, 0]] | _mixed(metal[near])


def _mixed(values: np.ndarray) -> np.ndarray:
    """Which rows of values [m, k] bool have both True and False: [m] bool."""
    return values.any(1) & ~values.all(1)


def advantage_of_metal(cost: np.ndarray, metallic: np.ndarray, unclear: float) -> np.ndarray | None:
    """How much less the best metal leaves unexplained than the best dielectric does, [n].

    cost [n, K] is that of K materials, metallic [K] theirs. None if all are of one class, or if the photos tell the classes
    apart: if the mean residual is below `unclear` times the mean difference of the residuals of both classes.
    """
    metal = metallic > 0.5
    if metal.all() or not metal.any():
        return None
    of_dielectric, of_metal = cost[:, ~metal].min(1), cost[:, metal].min(1)
    advantage = of_dielectric - of_metal
    clear = np.minimum(of_dielectric, of_metal).mean() < unclear * np.abs(advantage).mean()
    return None if clear else advantage


def not_there(metallic: np.ndarray, metal: np.ndarray, boundary: np.ndarray) -> np.ndarray:
    """Which of K materials m places cannot have [m, K] bool, if `metal` [m] says where the surface is metal.

    metallic [K] are the materials'. All are possible at a `boundary` [m], and mixtures of both classes there only.
    """
    mixed = (metallic > 0.01) & (metallic < 0.99)
    return (mixed | ((metallic > 0.5) != metal[:, None])) & ~boundary[:, None]
