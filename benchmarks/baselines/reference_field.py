"""The object field as published: the SDF is an MLP (NeuS, Wang et al. 2021), and autograd gives its normals.

The MLP has eight layers of 256, softplus, six frequencies and weight normalization, and starts as a sphere (Atzmon and
Lipman 2020). The samples of a ray lie all along its part in the object's sphere. Half of them are placed where NeuS's
weights are high. The color is that of our own object field, with larger MLPs. This field takes the place of `ObjectField`
in `learn_fields(..., object_field=...)`.
"""

from __future__ import annotations

import math

import numpy as np
import torch
from torch import Tensor, nn

from blender_nep.fields.object.field import SplineShape, SurfaceColor
from blender_nep.fields.object.volume_rendering import SurfaceSamples, sphere_interval
from blender_nep.ops.object.encodings import positional_encoding
from blender_nep.ops.object.surface_rendering import composite, neus_weights
from blender_nep.optimizers import Adam, Optimizer
from blender_nep.support.plane import Support

OCTAVES = 6
LAYERS, WIDTH = 8, 256
COLOR_LAYERS = 4
CHUNK = 1 << 16
"""Most points that are evaluated at once where nothing is learned."""
NEAR_CELLS = 64
"""Cells a side of the grid on which `near` finds the surface."""
ROUNDS = 4
"""Rounds in which the second half of the samples is placed. Each round has twice the sharpness of the one before."""


class ReferenceField(SurfaceColor):
    """The object field F_o over the unit sphere, with an MLP for its SDF."""

    level_count = 1
    """The MLP has no levels of resolution, so it counts as one that is never refined."""
    cell = 2 / NEAR_CELLS
    """Width, in the unit frame, of the cells on which `near` finds the surface."""

    def __init__(self, initial_radius: float, decomposed: bool = True, width: int = WIDTH, layers: int = LAYERS) -> None:
        super().__init__(width, decomposed, COLOR_LAYERS)
        inputs, self.skip = 3 + 6 * OCTAVES, layers // 2  # the layer in the middle gets the encoding again, as in NeuS
        sizes = [inputs, *[width] * layers]
        self.layers = nn.ModuleList()
        for k in range(layers):
            outputs = sizes[k + 1] - (inputs if k + 1 == self.skip else 0)
            layer = nn.Linear(sizes[k], outputs)
            nn.init.zeros_(layer.bias)
            nn.init.normal_(layer.weight, 0, math.sqrt(2 / outputs))
            with torch.no_grad():  # the SDF of a sphere needs no frequencies, so their weights start at 0
                if k == 0:
                    layer.weight[:, 3:] = 0
                elif k == self.skip:
                    layer.weight[:, -(inputs - 3) :] = 0
            self.layers.append(nn.utils.parametrizations.weight_norm(layer))
        last = nn.Linear(width, 1)
        nn.init.normal_(last.weight, math.sqrt(math.pi / width), 1e-4)
        nn.init.constant_(last.bias, -initial_radius)
        self.layers.append(nn.utils.parametrizations.weight_norm(last))
        self.activation = nn.Softplus(beta=100)

    support: Support | None = None
    """The plane on which the object stands; None as long as none is known"""

    def stand_on(self, support: Support | None) -> None:
        """Let the object end at this plane: see `ObjectField.stand_on`."""
        self.support = support

    fine: None = None
    """An MLP has no finer level."""

    def add_levels(self, count: int) -> None:
        """Do nothing: the MLP has no levels."""

    def structure(self) -> dict:
        """Nothing that `grow` must know."""
        return {}

    def grow(self, structure: dict) -> None:
        """Do nothing: all fields of this kind have the same parameters."""

    def interval(self, origins: Tensor, directions: Tensor) -> tuple[Tensor, Tensor, Tensor]:
        """Where rays [n, 3] can meet the object: see `SplineShape.interval`."""
        return SplineShape(self.layers[-1].bias, self.support).interval(origins, directions)

    def shape(self) -> ReferenceField:
        """The SDF as it is now: this field itself."""
        return self

    def shape_optimizer(self, rate: float, betas: tuple[float, float]) -> Optimizer:
        """Adam for the parameters of the SDF's MLP, which has no levels."""
        return Adam(self.layers.parameters(), lr=rate, betas=betas)

    def values(self, points: Tensor) -> Tensor:
        """Signed distances [n] at points [n, 3]. They are differentiable."""
        encoded = positional_encoding(points, OCTAVES, "torch")  # the gradients are differentiated again
        x = encoded
        for k, layer in enumerate(self.layers[:-1]):
            if k == self.skip:
                x = torch.cat([x, encoded], -1) / math.sqrt(2)
            x = self.activation(layer(x))
        return self.layers[-1](x)[:, 0]

    def values_and_gradients(self, points: Tensor) -> tuple[Tensor, Tensor]:
        """(signed distances [n], their gradients [n, 3]) at points [n, 3].

        Both are differentiable where gradients are enabled.
        """
        learning = torch.is_grad_enabled()
        with torch.enable_grad():
            points = points.detach().requires_grad_()
            values = self.values(points)
            (gradients,) = torch.autograd.grad(values.sum(), points, create_graph=learning)
        return (values, gradients) if learning else (values.detach(), gradients)

    @torch.no_grad()
    def sdf(self, points: Tensor) -> Tensor:
        """Signed distances [n] at points [n, 3]. They are negative inside."""
        return torch.cat([self.values(part) for part in points.split(CHUNK)])

    @torch.no_grad()
    def normal(self, points: Tensor) -> Tensor:
        """Outward unit normals [n, 3] at points [n, 3]."""
        gradients = torch.cat([self.values_and_gradients(part)[1] for part in points.split(CHUNK)])
        return nn.functional.normalize(gradients, dim=-1)

    @torch.no_grad()
    def sdf_and_gradient(self, points: Tensor) -> tuple[Tensor, Tensor]:
        """Signed distances [n], negative inside, and their gradients [n, 3] at points [n, 3]."""
        parts = [self.values_and_gradients(part) for part in points.split(CHUNK)]
        return torch.cat([values for values, _ in parts]), torch.cat([gradients for _, gradients in parts])

    def sdf_grid(self, n: int) -> np.ndarray:
        """The SDF on n^3 points that span [-1, 1]^3: float32, index order x, y, z."""
        return self._grid(torch.linspace(-1, 1, n)).cpu().numpy()

    def _grid(self, axis: Tensor) -> Tensor:
        axis = axis.to(self.layers[-1].bias)
        points = torch.stack(torch.meshgrid(axis, axis, axis, indexing="ij"), -1).reshape(-1, 3)
        return self.sdf(points).reshape(len(axis), len(axis), len(axis))

    def near(self, origins: Tensor, directions: Tensor, band: float) -> Tensor:
        """Whether rays [n, 3] come nearer to the surface than `band`: [n] bool. The SDF is taken from a grid."""
        centers = torch.arange(-1 - 0.5 * self.cell, 1 + self.cell, self.cell)
        return SplineShape(self._grid(centers)).near(origins, directions, band)

    def render(
        self, origins: Tensor, directions: Tensor, sharpness: float, samples: int, generator: torch.Generator | None
    ) -> SurfaceSamples:
        """Composite the surface along rays [n, 3] that meet the sphere, with `samples` samples a ray.

        Every ray is in the result.
        """
        if torch.is_grad_enabled():
            return self._render(origins, directions, sharpness, samples, generator)
        most = max(1, CHUNK // samples)
        parts = [
            self._render(o, d, sharpness, samples, generator)
            for o, d in zip(origins.split(most), directions.split(most), strict=True)
        ]
        joined = {
            name: torch.cat([getattr(part, name) for part in parts])
            for name in ("opacity", "point", "gradient", "eikonal", "depth")
        }
        return SurfaceSamples(ray=torch.arange(len(origins), device=origins.device), **joined)

    def _render(
        self, origins: Tensor, directions: Tensor, sharpness: float, samples: int, generator: torch.Generator | None
    ) -> SurfaceSamples:
        t = self._place(origins, directions, samples, generator)
        points = origins[:, None] + t[..., None] * directions[:, None]
        values, gradients = self.values_and_gradients(points.reshape(-1, 3))
        values, gradients = values.reshape(t.shape), gradients.reshape(*t.shape, 3)
        found = composite(torch.cat([values[..., None], gradients], -1), t, sharpness)
        point = origins + found.depth[:, None] * directions
        every = torch.arange(len(t), device=t.device)
        return SurfaceSamples(every, found.opacity, point, found.gradient, found.eikonal, found.depth)

    @torch.no_grad()
    def _place(self, origins: Tensor, directions: Tensor, samples: int, generator: torch.Generator | None) -> Tensor:
        """Distances [n, samples] of the samples along the rays, in rising order.

        Half of them are spread evenly. The others are placed in rounds, by the weights of the samples before them.
        """
        entry, leave = sphere_interval(origins, directions)
        even = samples // 2

        def uniform(count: int) -> Tensor:
            """A random number in each of `count` strata of 0..1: [n, count]. Without a generator, the strata's middles."""
            shape = (len(origins), count)
            jitter = (
                torch.full(shape, 0.5, device=origins.device)
                if generator is None
                else torch.rand(shape, generator=generator, device=origins.device)
            )
            return (torch.arange(count, device=origins.device) + jitter) / count

        def at(t: Tensor) -> Tensor:
            return self.sdf((origins[:, None] + t[..., None] * directions[:, None]).reshape(-1, 3)).reshape(t.shape)

        t = entry[:, None] + (leave - entry)[:, None] * uniform(even)
        values = at(t)
        rest = samples - even
        for k in range(ROUNDS):
            count = rest // ROUNDS + (k < rest % ROUNDS)
            if not count:
                continue
            weights = neus_weights(values, 64.0 * 2**k) + 1e-5
            cumulative = nn.functional.pad((weights / weights.sum(1, keepdim=True)).cumsum(1), (1, 0))
            u = uniform(count)
            above = torch.searchsorted(cumulative, u, right=True).clamp(1, cumulative.shape[1] - 1)
            low, high = cumulative.gather(1, above - 1), cumulative.gather(1, above)
            part = (u - low) / (high - low).clamp(min=1e-8)
            start, end = t.gather(1, above - 1), t.gather(1, above)
            new = start + part.clamp(0, 1) * (end - start)
            t, order = torch.cat([t, new], 1).sort(1)
            values = torch.cat([values, at(new)], 1).gather(1, order)
        return t
