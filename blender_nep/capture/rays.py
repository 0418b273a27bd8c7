"""Every pixel of every photo as a ray in the unit frame, made on demand from the cameras."""

from __future__ import annotations

import math
import os
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass

import numpy as np
import torch
from torch import Tensor

from blender_nep.capture.bounds import shortened
from blender_nep.capture.capture import Capture
from blender_nep.errors import BoundsError, CaptureError

MAXIMUM_RADIANCE = 6e4
"""Brighter values are clipped: the largest half float is 65504."""

_FLOAT32_PIXELS = 32_000_000
"""Up to this many pixels radiance is kept in float32 (384 MB), beyond it in half precision."""


@dataclass
class PixelRays:
    """Pixels of all views, flat: view v owns offset[v]:offset[v + 1], row by row."""

    radiance: Tensor
    """[N, 3] float32 or float16, linear, finite, 0 .. 6e4; 0 where not valid."""
    valid: Tensor
    """[N] bool: the photo holds a finite radiance here."""
    mask: Tensor | None
    """[N] uint8, coverage by the object 0..255, or None."""
    offset: list[int]
    size: list[tuple[int, int]]
    """(H, W) of each view, after downscaling."""
    background: bool
    """False for cut-outs (alpha): where the mask is 0 the radiance is 0 and the surroundings are not known."""
    warnings: list[str]
    sphere: Tensor
    """[M] int64: indices of valid pixels whose ray meets the unit sphere."""
    outside: Tensor
    """[K] int64: indices of the other valid pixels. Empty for cut-outs."""
    _start: Tensor
    _width: Tensor
    _intrinsics: Tensor
    _rotation: Tensor
    _origin: Tensor

    @property
    def count(self) -> int:
        """Number of pixels N."""
        return self.offset[-1]

    @property
    def views(self) -> int:
        """Number of photos."""
        return len(self.size)

    def view_of(self, index: Tensor) -> Tensor:
        """The view [n] int64 of each pixel index [n]."""
        return torch.searchsorted(self._start, index.contiguous(), right=True) - 1

    def rays(self, index: Tensor) -> tuple[Tensor, Tensor, Tensor]:
        """Origins [n, 3], unit directions [n, 3] (unit frame) and half angles [n] of pixels index [n] int64.

        The half angle (radians) is that of the cone with the pixel's solid angle, Omega = 2 pi (1 - cos h), where a
        pixel (fl_x, fl_y) at an angle c from the axis subtends Omega = cos(c)^3 / (fl_x fl_y).
        """
        view = self.view_of(index)
        local = index - self._start[view]
        width = self._width[view]
        row = torch.div(local, width, rounding_mode="floor")
        fl_x, fl_y, cx, cy = self._intrinsics[view].unbind(-1)
        x = ((local - row * width).float() + 0.5 - cx) / fl_x
        y = (cy - row.float() - 0.5) / fl_y
        cosine = torch.rsqrt(x * x + y * y + 1)
        camera = torch.stack([x * cosine, y * cosine, -cosine], -1)
        direction = torch.einsum("nij,nj->ni", self._rotation[view], camera)
        omega = cosine**3 / (fl_x * fl_y)
        return self._origin[view], direction, 2 * torch.asin(torch.sqrt(omega / (4 * math.pi)))

    def project(self, view: int, points: Tensor) -> tuple[Tensor, Tensor]:
        """Where a view sees points [n, 3] (unit frame): image coordinates [n, 2], each in -1..1 across the photo, x to
        the right and y downwards, and whether they lie ahead of the camera [n] bool."""
        fl_x, fl_y, cx, cy = self._intrinsics[view]
        height, width = self.size[view]
        local = (points - self._origin[view]) @ self._rotation[view]
        depth = -local[:, 2]
        safe = depth.clamp(min=1e-6)
        x, y = local[:, 0] / safe * fl_x + cx, cy - local[:, 1] / safe * fl_y
        return torch.stack([2 * x / width - 1, 2 * y / height - 1], -1), depth > 1e-3

    @classmethod
    def from_capture(
        cls, capture: Capture, max_pixels_per_photo: int, use_masks: bool, device: torch.device | str = "cpu"
    ) -> PixelRays:
        """Load all photos, box-filtered in linear space by the smallest integer factor that meets the pixel budget.

        Raises CaptureError (unreadable, all NaN, all black) and BoundsError (no ray meets the sphere; with masks: in
        most views no pixel of the object does).
        """
        with ThreadPoolExecutor(os.cpu_count()) as pool:
            photos = list(
                pool.map(lambda i: _load(capture, i, max_pixels_per_photo, use_masks), range(len(capture.views)))
            )
        warnings = _judge(capture, photos)
        cut_out = any(p.cut_out for p in photos)
        masked = use_masks and all(p.mask is not None for p in photos)
        if use_masks and not masked and any(p.mask is not None for p in photos):
            missing = [v.name for v, p in zip(capture.views, photos, strict=True) if p.mask is None]
            warnings.append(f"masks are not used: {len(missing)} photos have none ({shortened(missing)})")
        if cut_out and not masked:
            warnings.append("the photos are cut-outs (alpha) and their surroundings are black; results need the masks")
        if masked and not any((p.mask > 127).any() for p in photos):
            raise CaptureError(
                "the masks are empty: no pixel belongs to the object",
                "Check mask_path and the masks' polarity (white is object).",
            )

        sizes = [p.valid.shape for p in photos]
        offset = np.concatenate([[0], np.cumsum([h * w for h, w in sizes])]).tolist()
        kind = np.float32 if offset[-1] <= _FLOAT32_PIXELS else np.float16
        radiance = np.concatenate([p.radiance.reshape(-1, 3).astype(kind) for p in photos])
        mask = torch.from_numpy(np.concatenate([p.mask.ravel() for p in photos])).to(device) if masked else None
        cameras = [v.camera for v in capture.views]
        intrinsics = [
            (c.fl_x / p.factor, c.fl_y / p.factor, c.cx / p.factor, c.cy / p.factor)
            for c, p in zip(cameras, photos, strict=True)
        ]
        origins = [(c.position - capture.object_center) / capture.object_radius for c in cameras]

        def tensor(values: object) -> Tensor:
            return torch.tensor(np.array(values), dtype=torch.float32, device=device)

        nothing = torch.zeros(0, dtype=torch.int64, device=device)
        rays = cls(
            radiance=torch.from_numpy(radiance).to(device),
            valid=torch.from_numpy(np.concatenate([p.valid.ravel() for p in photos])).to(device),
            mask=mask,
            offset=offset,
            size=[(int(h), int(w)) for h, w in sizes],
            background=not (cut_out and masked),
            warnings=warnings,
            sphere=nothing,
            outside=nothing,
            _start=torch.tensor(offset[:-1], device=device),
            _width=torch.tensor([w for _, w in sizes], device=device),
            _intrinsics=tensor(intrinsics),
            _rotation=tensor([c.camera_to_world[:3, :3] for c in cameras]),
            _origin=tensor(origins),
        )
        rays._split()
        return rays

    def _split(self) -> None:
        """Which valid pixels' rays meet the unit sphere, and which do not."""
        hits = torch.zeros(self.count, dtype=torch.bool, device=self.valid.device)
        for start in range(0, self.count, 1 << 20):
            index = torch.arange(start, min(start + (1 << 20), self.count), device=hits.device)
            origin, direction, _ = self.rays(index)
            along = -(origin * direction).sum(-1)
            hits[index] = (along > 0) & ((origin + along[:, None] * direction).square().sum(-1) < 1)
        self.sphere = torch.nonzero(self.valid & hits).squeeze(-1)
        self.outside = torch.nonzero(self.valid & ~hits).squeeze(-1)
        if not self.background:
            self.outside = self.outside[:0]
        hint = "Set object_center and object_radius in transforms.json, so that the sphere holds the object."
        if len(self.sphere) == 0:
            raise BoundsError("no photo sees the object's sphere", hint)
        if self.mask is not None:
            # An object in the sphere shows in nearly all views of it; one beside it only where it stands in line.
            showing = self.sphere[self.mask[self.sphere] > 127]
            seeing, shown = (len(torch.unique(self.view_of(index))) for index in (self.sphere, showing))
            if shown < 0.5 * seeing:
                raise BoundsError(
                    f"the object's sphere contains nothing: in {seeing - shown} of {seeing} photos of it, "
                    "no masked pixel's ray meets it",
                    hint,
                )


@dataclass
class _Photo:
    radiance: np.ndarray
    valid: np.ndarray
    mask: np.ndarray | None
    factor: int
    bad: int
    negative: int
    blinding: int
    """Pixels that are not finite, have a negative channel, or one above MAXIMUM_RADIANCE."""
    brightest: float
    cut_out: bool


def _load(capture: Capture, i: int, most: int, use_masks: bool) -> _Photo:
    raw, alpha = capture.load_photo(i)
    finite = np.isfinite(raw).all(-1)
    bad = int((~finite).sum())
    negative, blinding = (int((finite & out).sum()) for out in ((raw < 0).any(-1), (raw > MAXIMUM_RADIANCE).any(-1)))
    radiance = np.clip(raw, 0, MAXIMUM_RADIANCE).astype(np.float32)
    radiance[~finite] = 0
    brightest = float(radiance.max(initial=0.0))
    mask = capture.load_mask(i) if use_masks and capture.views[i].mask_path else alpha if use_masks else None
    cut_out = alpha is not None and alpha.min() < 0.5
    if cut_out:
        # An edge pixel mixes the object with surroundings that are not there: its radiance is of neither.
        finite &= (alpha > 0.98) | (alpha < 0.02)
        radiance[alpha < 0.02] = 0
    height, width = finite.shape
    factor = max(1, math.ceil(math.sqrt(height * width / most) - 1e-9))
    while factor > 1 and min(height, width) < factor:
        factor -= 1
    weight = _box(finite.astype(np.float32)[..., None], factor)
    radiance = _box(radiance * finite[..., None], factor) / np.maximum(weight, 1e-6)
    valid = weight[..., 0] >= 0.5
    radiance[~valid] = 0
    coverage = None if mask is None else np.round(255 * _box(mask[..., None], factor)[..., 0]).astype(np.uint8)
    return _Photo(radiance, valid, coverage, factor, bad, negative, blinding, brightest, cut_out)


def _box(pixels: np.ndarray, factor: int) -> np.ndarray:
    """Mean over factor x factor pixels of [H, W, C]; a remainder at the right and at the bottom is left out."""
    if factor == 1:
        return pixels
    height, width = pixels.shape[0] // factor, pixels.shape[1] // factor
    total = np.zeros((height, width, pixels.shape[2]), np.float32)
    for i in range(factor):  # strided sums: ten times faster than a mean over two axes of a reshaped view
        for j in range(factor):
            total += pixels[i : height * factor : factor, j : width * factor : factor]
    return total / factor**2


def _judge(capture: Capture, photos: list[_Photo]) -> list[str]:
    """Warnings about the pixels. Raises CaptureError for a photo of NaN, or when every photo is black."""
    names = [v.image_path.name for v in capture.views]
    warnings = []
    for name, photo in zip(names, photos, strict=True):
        if photo.bad and not photo.valid.any():
            raise CaptureError(
                f"{name} holds no finite pixel (all NaN or Inf)",
                "Render or export it again, or take its frame out of transforms.json.",
            )
    for kind, what in (("bad", "NaN or Inf and are left out"), ("negative", "negative and are taken as 0"),
                       ("blinding", f"brighter than {MAXIMUM_RADIANCE:.0f} and are taken as that")):
        found = [(n, getattr(p, kind)) for n, p in zip(names, photos, strict=True) if getattr(p, kind)]
        if found:
            warnings.append(f"{sum(count for _, count in found)} pixels in {len(found)} photos are {what}: "
                            + shortened([n for n, _ in found]))
    black = [n for n, p in zip(names, photos, strict=True) if p.brightest <= 1e-6]
    if len(black) == len(photos):
        raise CaptureError("all photos are black", "Check the exposure, and that the files hold colour in R, G, B.")
    for name, photo in zip(names, photos, strict=True):
        if name in black:
            photo.valid[:] = False
    if black:
        warnings.append(f"{len(black)} photos are black and are left out: {shortened(black)}")
    return warnings
