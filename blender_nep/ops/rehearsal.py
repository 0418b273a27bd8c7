"""Calls the kernels of a job once, on tiny input, so that Numba compiles them and keeps them on the disk.

    python -m blender_nep.ops.rehearsal [PART PARTS]

Compiling takes longer than a whole `preview` job on one core. Numba would do it kernel by kernel while a job waits. So the
installation runs this program, and a job whose kernels are not on the disk runs it beside itself (`job.kernels`). PART of
PARTS, counted from 0, compiles every PARTS-th kernel: so several cores share the work. Kernels that few jobs need are left
out. A kernel is compiled for the types of its arguments; so the input has the types and the memory layout that jobs have.
"""

from __future__ import annotations

import sys
from collections.abc import Callable

import numpy as np
import torch

from blender_nep.ops.environment.cones import Levels, accumulate_coverage, composite_cones
from blender_nep.ops.environment.rendering import EnvironmentVolume, render_environment
from blender_nep.ops.environment.samples import Medium, RaySamples, sample_rays
from blender_nep.ops.environment.segments import RaySegments
from blender_nep.ops.environment.smoothness import add_total_variation_gradient
from blender_nep.ops.environment.weights import from_weights, weights_from_center
from blender_nep.ops.materials.cone_transport import collect, send
from blender_nep.ops.materials.lobe_sums import add_to_lobes
from blender_nep.ops.materials.material_fit import FitHypotheses, FitRoughness, FitSamples, fit_albedos
from blender_nep.ops.object import bspline
from blender_nep.ops.object.bspline_march import march
from blender_nep.ops.object.encodings import integrated_directional_encoding, positional_encoding
from blender_nep.ops.object.surface_rendering import composite, place_samples
from blender_nep.ops.object.touched import touched_mean_square

_RADIUS = 4.0
"""Contraction radius of the tiny F_e."""


def _volume() -> torch.Tensor:
    """A tiny F_e [3, 4, 8, 4]."""
    return torch.zeros(3, 4, 8, 4)


def _segments() -> RaySegments:
    """Two rays from the center to infinity."""
    directions = torch.tensor([[1.0, 0.0, 0.0], [0.0, 1.0, 0.0]])
    return RaySegments(torch.zeros(2, 3), directions, torch.ones(2), torch.full((2,), torch.inf))


def _environment() -> None:
    raw, volume = _volume().requires_grad_(), EnvironmentVolume(_RADIUS, 1.0, 0.5)
    radiance, *_ = render_environment(raw, torch.zeros(0, 0, 3), _segments(), volume)
    radiance.sum().backward()


def _variation() -> None:
    grid = _volume()
    add_total_variation_gradient(grid, (1.0,) * 4, 0.1, torch.zeros_like(grid))


def _sampled_spline() -> None:
    coefficients = torch.zeros(6, 6, 6, requires_grad=True)
    bspline.Spline(coefficients).sample(torch.zeros(2, 3)).sum().backward()


def _refined_spline() -> None:
    bspline.refine(torch.zeros(4, 4, 4, requires_grad=True), torch.zeros(6, 6, 6)).sum().backward()


def _march() -> None:
    _, directions, near, _ = _segments()
    march(torch.ones(6, 6, 6), -directions, directions, near, near + 1, 0.1, 0.1)


def _placed() -> None:
    place_samples(torch.zeros(2, 4, 2), torch.ones(2, dtype=torch.int32), 4, torch.zeros(2))


def _composited() -> None:
    field = torch.zeros(2, 5, 4, requires_grad=True)
    composite(field, torch.zeros(2, 5), 1.0).opacity.sum().backward()


def _positions() -> None:
    positional_encoding(torch.zeros(2, 3, requires_grad=True), 1).sum().backward()


def _directions() -> None:
    direction, roughness = torch.ones(2, 3, requires_grad=True), torch.ones(2, 1, requires_grad=True)
    integrated_directional_encoding(direction, roughness).sum().backward()


def _touched() -> None:
    touched_mean_square(torch.ones(2, 2))


def _coverage() -> None:
    samples = sample_rays(_segments(), _RADIUS, 0.5, None)
    arrays = RaySamples(*(part.contiguous().numpy() for part in samples))  # type: ignore[arg-type]  # arrays, for Numba
    medium = Medium(_RADIUS, 1.0, 0.0, 0.0, 0.0)
    accumulate_coverage(_volume().numpy(), arrays, medium, np.zeros((3, 4, 8), np.float32))


def _prefiltered() -> np.ndarray:
    """The weights of the tiny F_e [8, 16, 3, 5], of which the cones make levels."""
    return from_weights(weights_from_center(_volume(), torch.ones(3, 4, 8), 1.0, 0.5, 8))


def _cones() -> None:
    level = np.zeros((8, 16, 3, 5), np.float32)
    levels, shells = (Levels.joined([level, level]), [0.1, 0.2]), torch.tensor([1.0, 2.0, 4.0])
    origins, directions, near, _ = _segments()
    known = torch.ones(3, dtype=torch.bool)
    detail = np.ones((16, 32, 3), np.float32)
    composite_cones(*levels, 1, detail, shells, known, torch.zeros(3), origins, directions, near, 0.1 * near)


def _lobes() -> None:
    starts, one = np.array([0, 1]), np.ones((1, 3), np.float32)
    add_to_lobes(starts, one, one[:, :2].copy(), one, one.copy(), np.zeros((1, 2, 3, 3), np.float32))


def _transport() -> tuple[np.ndarray, ...]:
    """starts, texel, weight, response of one cone."""
    return np.array([0, 1]), np.zeros((1, 4), np.int32), np.ones((1, 4), np.float32), np.ones((1, 2, 3), np.float32)


def _sent() -> None:
    send(*_transport(), np.ones((1, 3), np.float32), np.zeros((1, 2, 3), np.float32))


def _collected() -> None:
    starts, *cones = _transport()
    gradient, parts = np.ones((1, 2, 3), np.float32), np.zeros((1, 1, 3), np.float32)
    collect(starts, np.array([0, 1]), *cones, gradient, parts)


def _fits() -> None:
    one, three = np.ones((2, 1), np.float32), np.ones((2, 3), np.float32)
    samples = FitSamples(np.ones((2, 2, 3, 3), np.float32), three, three, three, one[:, 0].copy(), one, one, one)
    zero = np.zeros(1, np.float32)
    scan, hypotheses = FitRoughness(np.zeros(1, np.int64), zero, zero + 1), FitHypotheses(zero, zero + 1)
    cost, albedo = np.zeros((1, 1, 1), np.float32), np.zeros((1, 1, 1, 3), np.float32)
    fit_albedos(np.array([0, 2]), samples, scan, hypotheses, 0.25, 1, cost, albedo)


KERNELS: tuple[Callable[[], object], ...] = (
    _march,
    _refined_spline,
    _sampled_spline,
    _directions,
    _composited,
    _positions,
    _placed,
    _touched,
    _prefiltered,
    _cones,
    _coverage,
    _fits,
    _sent,
    _collected,
    _lobes,
    _environment,
    _variation,
)
"""Each calls some kernels. They are in the order in which a job needs them. Only the first ones that it needs, those of the
steps of F_e alone, come last: a job that begins compiles these itself."""


def rehearse(part: int = 0, parts: int = 1) -> None:
    """Compile every `parts`-th kernel, from number `part` on, or load it if it is compiled."""
    for call in KERNELS[part::parts]:
        call()


def main(arguments: list[str]) -> int:
    """The program."""
    torch.set_num_threads(1)
    rehearse(*(int(argument) for argument in arguments))
    return 0


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
