"""Tells whether the object turned while the camera and the surroundings stood still: photos from a turntable.

The cameras of such photos are given relative to the object, so they seem to move around it. The surroundings do not fit
these cameras: they stay at the same pixels. Without the turns of the object, F_e would learn a light that never was. When
the photographer walks around the object, equal pixels show other surroundings.

Two photos of a plain background agree too, and so do two photos of a scene that looks the same from all sides, such as a
floor under a sky. So the agreement at equal places is compared with that at mirrored places. A backdrop of one color, with
smooth shades, counts as plain: the difference of two photos is taken without its smooth part.
"""

from __future__ import annotations

import numpy as np
import torch
from torch import Tensor
from torch.nn import functional

from blender_nep.capture.rays.pixel_rays import PixelRays

PHOTOS = 80
"""At most this many photos, evenly chosen, are compared with each other."""
PLACES = 32
"""Photos are compared at this many rows and columns of places; each is the mean over a part of the photo."""
LEAST_TURN = 20.0
"""Two photos are compared if their cameras are turned by more than this many degrees against each other."""
LEAST_PLACES = 30
"""Two photos are compared if at least this many places show the surroundings in both."""
DARK = 0.1
"""Share of the photos' median brightness that is added before the logarithm, so that noise in the dark counts little."""
MOST_ALIKE = 0.7
"""Of two photos' places, the differences of this share count, the smallest ones. The rest may show what turns with the
object: the plate of the turntable, or a shadow."""
LEAST_TEXTURE = 0.05
"""Mean difference of logarithms at mirrored places from which on a background is not plain. Measured between photos of
rooms: 0.05 to 0.4 for nine of ten pairs."""
SAME = 0.35
"""Two photos show the same at equal places if they differ there by less than this share of their difference at mirrored
places. Measured for each photo's second best partner: median 0.03 to 0.13 where backgrounds were exchanged for a fixed one;
median 0.65 to 0.84, and 0.27 at the least, for a walk around the object."""
PARTNERS = 2
"""A photo's surroundings stand still if it shows the same as this many others. The camera of a turntable may stand at
several heights: then only photos from one height agree."""
MOST_STILL = 0.5
"""Largest share of photos whose surroundings may stand still. Measured: 0 to 0.03 for a walk, 0.88 to 1 for a
turntable, and 0.46 to 0.78 if the sphere fills nearly all of the photos."""


def still_share(rays: PixelRays) -> float | None:
    """Share of the photos whose surroundings stay at the same pixels although their cameras differ, 0 .. 1.

    None: it cannot be told, because the photos are cut-outs, show too little beside the object's sphere, or differ little in
    direction. Takes half a second for 60 photos.
    """
    if len(rays.outside) == 0:
        return None
    chosen = np.unique(np.linspace(0, rays.views - 1, min(rays.views, PHOTOS)).round().astype(int)).tolist()
    side = min(PLACES, *(min(rays.size[view]) for view in chosen))
    places = [_places(rays, view, side) for view in chosen]
    brightness, shown = (torch.stack(part) for part in zip(*places, strict=True))
    if not shown.any():
        return None
    value = (brightness + DARK * brightness[shown].median()).clamp(min=1e-6).log()
    ratio = _ratios(value, shown, _comparable(rays, chosen))
    judged = ((~ratio.isnan()).sum(1) >= PARTNERS).sum()
    still = ((ratio < SAME).sum(1) >= PARTNERS).sum()
    return float(still / judged) if judged else None


def _comparable(rays: PixelRays, chosen: list[int]) -> Tensor:
    """Whether the cameras of two of the chosen photos [n, n] are turned enough against each other."""
    rotation = torch.stack([rays.camera(view)[1] for view in chosen])
    cosine = (torch.einsum("aij,bij->ab", rotation, rotation) - 1) / 2
    return cosine < np.cos(np.radians(LEAST_TURN))


def _places(rays: PixelRays, view: int, side: int) -> tuple[Tensor, Tensor]:
    """Mean brightness [side, side] of the parts of a photo, and whether the part shows the surroundings [side, side]."""
    height, width = rays.size[view]
    start, end = rays.offset[view : view + 2]
    step = max(1, min(height, width) // (3 * side))
    brightness = rays.radiance[start:end].view(height, width, 3)[::step, ::step].float().mean(-1)
    valid = rays.valid[start:end].view(height, width)[::step, ::step].float()
    mean, used = functional.adaptive_avg_pool2d(torch.stack([brightness, valid])[None], (side, side))[0]
    middle = (torch.arange(side, device=mean.device) + 0.5) / side
    row, column = (middle * height).long(), (middle * width).long()
    origin, direction, _ = rays.rays((start + row[:, None] * width + column).flatten())
    along = -(origin * direction).sum(-1)
    beside = (along <= 0) | ((origin + along[:, None] * direction).square().sum(-1) >= 1)
    return mean, beside.view(side, side) & (used > 0.99)


def _ratios(value: Tensor, shown: Tensor, comparable: Tensor) -> Tensor:
    """For each two photos, their difference at equal places divided by that at mirrored places, [n, n].

    `value` [n, side, side]: the photos' logarithms; `shown` [n, side, side] bool: where they count; `comparable` [n, n]
    bool. NaN where two photos cannot be compared, infinite where their background is plain.
    """
    smooth = _smooth_functions(value.shape[-1]).to(value)
    ratio = torch.full(comparable.shape, torch.nan, device=value.device)
    for one in range(len(value) - 1):
        others = one + 1 + comparable[one, one + 1 :].nonzero()[:, 0]
        if not len(others):
            continue
        at_equal, *at_mirrored = (
            _difference(value[one], shown[one], value[others].flip(axes), shown[others].flip(axes), smooth)
            for axes in ((), (1,), (2,), (1, 2))
        )
        expected = torch.stack(at_mirrored).amin(0)  # NaN if one of them is
        found = torch.where(expected < LEAST_TEXTURE, torch.inf, at_equal / expected)
        ratio[one, others] = ratio[others, one] = found
    return ratio


def _difference(one: Tensor, shown: Tensor, others: Tensor, others_shown: Tensor, smooth: Tensor) -> Tensor:
    """Mean absolute difference [m] of a photo from others without its smooth part; NaN if too few places show both.

    `one`, `shown` [side, side]; `others`, `others_shown` [m, side, side]; `smooth` [places, k]: functions of the place. The
    smooth part of a difference, and with it the photos' exposures, is fitted by least squares.
    """
    both = (shown & others_shown).flatten(1).to(one)
    difference = (one - others).flatten(1) * both
    count, terms = both.sum(1), smooth.shape[1]
    products = (smooth[:, :, None] * smooth[:, None, :]).flatten(1)
    matrix = (both @ products).view(-1, terms, terms) + 1e-3 * torch.eye(terms, device=one.device)
    fitted = torch.linalg.solve(matrix, (difference @ smooth)[..., None])[..., 0] @ smooth.T
    sizes = torch.where(both > 0, (difference - fitted).abs(), torch.inf).sort(1).values
    counted = torch.arange(sizes.shape[1], device=one.device) < MOST_ALIKE * count[:, None]
    mean = torch.where(counted, sizes, 0).sum(1) / counted.sum(1)
    return torch.where(count >= LEAST_PLACES, mean, torch.nan)


def _smooth_functions(side: int) -> Tensor:
    """The values [side * side, 6] of 1, x, y, x^2, x y and y^2 at the places of a photo, with x and y in -1 .. 1."""
    y, x = torch.meshgrid(*2 * [torch.linspace(-1, 1, side)], indexing="ij")
    return torch.stack([torch.ones_like(x), x, y, x * x, x * y, y * y], -1).flatten(0, 1)
