"""The pixels of all photos. Rays in the unit frame are computed from the cameras when they are needed."""

from __future__ import annotations

import math
from collections import deque
from collections.abc import Callable, Iterator
from concurrent.futures import Future, ThreadPoolExecutor
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np
import torch
from torch import Tensor

from blender_nep.capture.cameras.camera import Camera
from blender_nep.capture.cameras.lens import Lenses
from blender_nep.capture.capture import Capture
from blender_nep.capture.description import MINIMUM_VIEWS, MOST_LACKING
from blender_nep.capture.photos.mask_files import MaskMeaning
from blender_nep.capture.rays.downscaling import box, factor_for
from blender_nep.capture.rays.pixel_set import GrowingPixelSet, PixelSet
from blender_nep.capture.rays.pixel_store import PixelMemory
from blender_nep.capture.rays.ray_bundle import RayBundle
from blender_nep.capture.rays.response_curve import ResponseCurve
from blender_nep.capture.rays.rigid_motions import RigidMotions
from blender_nep.capture.rays.vignetting import Vignetting
from blender_nep.errors import BoundsError, CaptureError
from blender_nep.messages import Message
from blender_nep.profiling import profiled

MAXIMUM_RADIANCE = 6e4
"""Larger radiance is clipped to this value: the largest half float is 65504."""

BRIGHTEST_CLIPPED, SATURATED = 1.001, 0.97
"""If no pixel is brighter than `BRIGHTEST_CLIPPED`, the files cannot store more than 1. Then a channel above `SATURATED` may
be clipped: the true radiance is at least that value."""
_BLACK = 1e-6
"""A photo without a brighter value counts as black."""
_STRIP_PIXELS = 1 << 18
"""Pixels that are handled at a time; this many fit into the processor's cache."""
_DECODED_PIXELS = 50_000_000
"""Pixels of all photos that are decoded at the same time. A photo with more pixels is decoded alone."""


@dataclass
class PixelRays:
    """The pixels of all views in one list: view v has the indices offset[v] to offset[v + 1] - 1, row by row."""

    radiance: Tensor
    """[N, 3] float32 or float16, linear, finite, 0 .. 6e4; 0 where not valid."""
    valid: Tensor
    """[N] bool: the photo's radiance can be used here. False where it is not finite, at the edges of cut-outs, in black
    photos, and where masks say what may be used and are black."""
    mask: Tensor | None
    """[N] uint8: coverage by the object, 0..255. None: there are no masks, or they are not used."""
    offset: list[int]
    size: list[tuple[int, int]]
    """(H, W) of each view, after downscaling."""
    background: bool
    """False for cut-outs: where alpha is 0, the radiance is 0, and the surroundings are not known."""
    warnings: list[Message]
    sphere: PixelSet
    """[M]: indices of the valid pixels whose rays meet the unit sphere."""
    outside: PixelSet
    """[K]: indices of the other valid pixels. Empty for cut-outs."""
    _start: Tensor
    _width: Tensor
    _intrinsics: Tensor
    _rotation: Tensor
    _origin: Tensor
    _lenses: Lenses | None = None
    """The lens of each view. None: no camera has distortion."""
    gain: Tensor | None = None
    """[views, 3]: how much brighter each photo was taken than the average. None: all photos have one exposure."""
    vignetting: Vignetting | None = None
    """How much darker photos are towards their corners. None: they are not, or nobody can tell."""
    exposure: float = 1.0
    """`photo` multiplies the radiance by this, so that the method sees all captures about equally bright."""
    curve_of_files: ResponseCurve | None = None
    """The camera's response curve in the files' own values, where white is 1. `photo` undoes it before exposures are evened
    out. None: the files' values are taken as they are."""
    response: ResponseCurve | None = None
    """The camera's response curve in evened photos, which `photo` undoes last. None: photos are taken as they are."""
    object_gain: Tensor | None = None
    """[views]: how much brighter the object was in each photo than in the others, beside the exposures. `photo` divides by
    it in the end. None: it was as bright in all."""
    turntable: RigidMotions | None = None
    """[views] motions from the object's unit frame to the room's, if the object turned while the camera and the light stood
    still. The first is the identity. None: the object stood still."""

    @property
    def count(self) -> int:
        """Number of pixels N."""
        return self.offset[-1]

    @cached_property
    def brightest(self) -> float:
        """Largest radiance of all pixels. It is computed once."""
        return float(self.radiance.max())

    @property
    def views(self) -> int:
        """Number of photos."""
        return len(self.size)

    def photo(self, index: Tensor) -> Tensor:
        """The radiance [n, 3] float32 of the pixels index [n] int64, as if all photos had one exposure, times `exposure`.

        It is without vignetting.
        """
        radiance = self.in_files(index) * self.exposure
        if self.vignetting is not None:
            radiance = radiance / self.vignetting.at(self.from_middle(index))[:, None]
        if self.gain is not None:
            radiance = radiance / self.gain[self.view_of(index)]
        if self.response is not None:
            radiance = self.response.light(radiance)
        return radiance if self.object_gain is None else radiance / self.object_gain[self.view_of(index)][:, None]

    def in_files(self, index: Tensor) -> Tensor:
        """The radiance [..., 3] float32 of the pixels index [...] int64 as their files have it, without `curve_of_files`."""
        radiance = self.radiance[index].float()
        return radiance if self.curve_of_files is None else self.curve_of_files.light(radiance)

    def as_in_files(self, radiance: Tensor) -> Tensor:
        """What files of the photos' usual exposure show of `radiance` [..., 3], which is as `photo` gives it."""
        if self.curve_of_files is None:
            return radiance
        return self.curve_of_files.photo(radiance / self.exposure) * self.exposure

    def with_curve_of_files(self, curve: ResponseCurve | None) -> PixelRays:
        """The same pixels, with this response curve in the files' own values."""
        return self._still_knowing_the_brightest(replace(self, curve_of_files=curve))

    def with_gain(self, gain: Tensor | None, vignetting: Vignetting | None = None) -> PixelRays:
        """The same pixels, with these gains [views, 3] of the photos and this vignetting."""
        return self._still_knowing_the_brightest(replace(self, gain=gain, vignetting=vignetting))

    def with_exposure(self, exposure: float) -> PixelRays:
        """The same pixels, with this exposure."""
        return self._still_knowing_the_brightest(replace(self, exposure=exposure))

    def with_response(self, response: ResponseCurve | None) -> PixelRays:
        """The same pixels, as light before this response curve."""
        return self._still_knowing_the_brightest(replace(self, response=response))

    def with_object_gain(self, gain: Tensor | None) -> PixelRays:
        """The same pixels, with these gains [views] of the object."""
        return self._still_knowing_the_brightest(replace(self, object_gain=gain))

    def with_turntable(self, turntable: RigidMotions | None) -> PixelRays:
        """The same pixels, with these motions [views] of the object."""
        return self._still_knowing_the_brightest(replace(self, turntable=turntable))

    def _still_knowing_the_brightest(self, rays: PixelRays) -> PixelRays:
        if "brightest" in vars(self):  # all pixels need not be searched again
            rays.brightest = self.brightest
        return rays

    def view_of(self, index: Tensor) -> Tensor:
        """The view [n] int64 of each pixel index [n]."""
        return torch.searchsorted(self._start, index.contiguous(), right=True) - 1

    def rays(self, index: Tensor) -> RayBundle:
        """The rays of the pixels index [n] int64.

        A half angle h (radians) belongs to the cone that has the pixel's solid angle Omega = 2 pi (1 - cos h). A pixel
        at an angle c from the optical axis has Omega = cos(c)^3 / (fl_x fl_y), divided by the area that the lens makes of an
        area there.
        """
        view = self.view_of(index)
        local = index - self._start[view]
        width = self._width[view]
        row = torch.div(local, width, rounding_mode="floor")
        fl_x, fl_y, cx, cy = self._intrinsics[view].unbind(-1)
        x = ((local - row * width).float() + 0.5 - cx) / fl_x
        y = (cy - row.float() - 0.5) / fl_y
        if self._lenses is None:
            cosine = torch.rsqrt(x * x + y * y + 1)
            camera = torch.stack([x * cosine, y * cosine, -cosine], -1)
            omega = cosine**3 / (fl_x * fl_y)
        else:
            seen, density, _ = self._lenses.at(view).directions(x, -y)
            camera = seen * seen.new_tensor([1.0, -1.0, -1.0])
            omega = density / (fl_x * fl_y)
        direction = torch.einsum("nij,nj->ni", self._rotation[view], camera)
        half_angle = 2 * torch.asin(torch.sqrt(omega / (4 * math.pi)))
        return RayBundle(self._origin[view], direction, half_angle, self.motion_in(view))

    def motion_in(self, view: Tensor) -> RigidMotions | None:
        """How the object stood in the photos view [n] int64: n motions to the room; None if it always stood still."""
        return None if self.turntable is None else self.turntable[view]

    def from_middle(self, index: Tensor) -> Tensor:
        """Squared distance [n] of the pixels index [n] int64 from the middle of their photo, in half diagonals: 0 .. 1."""
        view = self.view_of(index)
        local, width = index - self._start[view], self._width[view]
        height = torch.diff(self._start, append=self._start.new_tensor([self.count]))[view] // width
        row = torch.div(local, width, rounding_mode="floor")
        x, y = 2 * (local - row * width) + 1 - width, 2 * row + 1 - height
        return (x * x + y * y).float() / (width * width + height * height).float()

    def camera(self, view: int) -> tuple[Tensor, Tensor]:
        """Position [3] (unit frame) and camera-to-world rotation [3, 3] of a view."""
        return self._origin[view], self._rotation[view]

    def cameras(self) -> tuple[Tensor, Tensor]:
        """Positions [views, 3] (unit frame) and camera-to-world rotations [views, 3, 3] of all views."""
        return self._origin, self._rotation

    def project(self, view: int, points: Tensor) -> tuple[Tensor, Tensor]:
        """Image coordinates [n, 2] of points [n, 3] (unit frame) in a view, and whether they lie in front of it [n] bool.

        Image coordinates go from -1 to 1 across the photo, x to the right and y downwards. A point that the lens cannot show
        counts as not in front.
        """
        fl_x, fl_y, cx, cy = self._intrinsics[view]
        height, width = self.size[view]
        local = (points - self._origin[view]) @ self._rotation[view]
        depth = -local[:, 2]
        safe = depth.clamp(min=1e-6)
        ahead = depth > 1e-3
        if self._lenses is None:
            x, y = local[:, 0] / safe * fl_x + cx, cy - local[:, 1] / safe * fl_y
        else:
            u, v, shown = self._lenses.at(view).places(local * local.new_tensor([1.0, -1.0, -1.0]))
            x, y, ahead = u * fl_x + cx, v * fl_y + cy, ahead & shown
        return torch.stack([2 * x / width - 1, 2 * y / height - 1], -1), ahead

    @classmethod
    def from_capture(
        cls,
        capture: Capture,
        max_pixels_per_photo: int,
        use_masks: bool,
        device: torch.device | str = "cpu",
        *,
        memory: PixelMemory | None = None,
        progress: Callable[[int, int], None] = lambda done, all_of_them: None,
    ) -> PixelRays:
        """Load all photos. Each is box-filtered in linear space by the smallest integer factor that meets the pixel budget.

        progress(photos read, all photos) is called after each photo and may raise. Raises CaptureError (a photo cannot be
        read or is all NaN, all photos are black, or all masks are empty), BoundsError (no ray meets the sphere; or, with
        masks, in most views no object pixel's ray meets it) and OutputError (no room in the folder of `memory`).
        """
        memory = memory or PixelMemory()
        cameras = [v.camera for v in capture.views]
        most = min(max_pixels_per_photo, max(1, memory.most // len(cameras)))
        factors = [factor_for(c.height, c.width, most) for c in cameras]
        sizes = [(c.height // f, c.width // f) for c, f in zip(cameras, factors, strict=True)]
        offset = np.concatenate([[0], np.cumsum([h * w for h, w in sizes])]).tolist()
        stores = memory.stores(offset[-1], use_masks, device)
        facts: list[_Facts] = []
        lacking = _lacking(capture) if use_masks else []
        for photo, camera, size in zip(_loaded(capture, factors, use_masks), cameras, sizes, strict=True):
            if len(facts) in lacking and photo.mask is None:
                photo.mask, photo.facts.has_mask = np.zeros(len(photo.valid), np.uint8), True
            facts.append(photo.facts)
            stores.append(photo.radiance, photo.valid & camera.shown_pixels(size[1], size[0]), photo.mask)
            progress(len(facts), len(cameras))
        warnings = _judge(capture, facts)
        if most < max_pixels_per_photo:
            reduced = {"photos": len(cameras), "pixels": most, "limit": memory.most}
            warnings.append(Message("capture.photos_reduced", reduced))
        cut_out = any(p.cut_out for p in facts)
        masked = use_masks and all(p.has_mask for p in facts)
        if use_masks and not masked and any(p.has_mask for p in facts):
            missing = [v.name for v, p in zip(capture.views, facts, strict=True) if not p.has_mask]
            warnings.append(Message("capture.masks_missing", {"count": len(missing), "names": missing}))
        if cut_out and not masked:
            warnings.append(Message("capture.cut_outs_need_masks"))
        if masked and not any(p.covered for p in facts):
            raise CaptureError(
                "the masks are empty: no pixel belongs to the object",
                "Check mask_path and the masks' polarity (white is object), or the photos' alpha (0 is not the object).",
            )
        if lacking:
            names = [capture.views[i].name for i in lacking]
            warnings.append(Message("capture.masks_lacking", {"count": len(names), "names": names}))
        unknown = [i for i, p in enumerate(facts) if masked and not p.covered and _sees_center(capture, cameras[i])]
        full = _full(facts) if masked and not cut_out else []
        if full:
            names = [capture.views[i].name for i in full]
            warnings.append(Message("capture.masks_full", {"count": len(full), "names": names}))
        empty = [i for i in unknown if i not in lacking]
        if empty:
            names = [capture.views[i].name for i in empty]
            warnings.append(Message("capture.masks_empty", {"count": len(empty), "names": names}))
        intrinsics = [(c.fl_x / f, c.fl_y / f, c.cx / f, c.cy / f) for c, f in zip(cameras, factors, strict=True)]
        origins = [(c.position - capture.object_center) / capture.object_radius for c in cameras]

        def tensor(values: object) -> Tensor:
            return torch.tensor(np.array(values), dtype=torch.float32, device=device)

        nothing = PixelSet.of(torch.zeros(0, dtype=torch.int64, device=device))
        radiance, valid, mask = stores.finished()
        for i in {*unknown, *lacking, *full}:  # where the object is in such a photo is not known
            valid[offset[i] : offset[i + 1]] = False
        rays = cls(
            radiance=radiance,
            valid=valid,
            mask=mask if masked else None,
            offset=offset,
            size=sizes,
            background=not (cut_out and masked),
            warnings=warnings,
            sphere=nothing,
            outside=nothing,
            _start=torch.tensor(offset[:-1], device=device),
            _width=torch.tensor([w for _, w in sizes], device=device),
            _intrinsics=tensor(intrinsics),
            _rotation=tensor([c.camera_to_world[:3, :3] for c in cameras]),
            _origin=tensor(origins),
            _lenses=_lenses(cameras, device),
        )
        rays._split()
        return rays

    @profiled("rays that meet the sphere")
    def _split(self) -> None:
        """Set `sphere` and `outside`: valid pixels whose rays meet the unit sphere, and the others. Raises BoundsError."""
        device = self._start.device
        sphere, outside, seeing, showing = GrowingPixelSet(device), GrowingPixelSet(device), set(), set()
        for start in range(0, self.count, _STRIP_PIXELS):
            index = torch.arange(start, min(start + _STRIP_PIXELS, self.count), device=device)
            origin, direction, _ = self.rays(index)
            along = -(origin * direction).sum(-1)
            hits = (along > 0) & ((origin + along[:, None] * direction).square().sum(-1) < 1)
            valid = self.valid[start : start + len(index)]
            met = valid & hits
            sphere.add(PixelSet.where(met, start))
            if self.background:
                outside.add(PixelSet.where(valid & ~hits, start))
            if self.mask is not None:
                shown = met & (self.mask[start : start + len(index)] > 127)
                seeing.update(self.view_of(index[met]).unique().tolist())
                showing.update(self.view_of(index[shown]).unique().tolist())
        self.sphere, self.outside = sphere.finished(), outside.finished()
        hint = "Set object_center and object_radius in transforms.json, so that the sphere holds the object."
        if len(self.sphere) == 0:
            raise BoundsError("no photo sees the object's sphere", hint)
        # If the object is in the sphere, nearly all views of the sphere show object pixels in it. If the object stands
        # beside the sphere, only the views along the line through both do.
        if len(showing) < 0.5 * len(seeing):
            raise BoundsError(
                f"the object's sphere contains nothing: in {len(seeing) - len(showing)} of {len(seeing)} photos of it, "
                "no masked pixel's ray meets it",
                hint,
            )


@dataclass
class _Facts:
    repaired: dict[str, int]
    """Numbers of pixels in the file that are not finite ("bad"), that have a negative channel ("negative"), and that have a
    channel above MAXIMUM_RADIANCE ("blinding")"""
    empty: bool
    """No pixel is left that can be used, and some pixels are not finite."""
    brightest: float
    cut_out: bool
    has_mask: bool
    covered: float
    """The part of the photo that the mask shows as the object, 0 .. 1"""


@dataclass
class _Photo:
    radiance: np.ndarray
    """[h * w, 3] float32, linear, downscaled"""
    valid: np.ndarray
    """[h * w] bool"""
    mask: np.ndarray | None
    """[h * w] uint8"""
    facts: _Facts


def _lenses(cameras: list[Camera], device: torch.device | str) -> Lenses | None:
    """The lenses of the cameras in single precision. None if none of them distorts."""
    if all(camera.lens.is_pinhole for camera in cameras):
        return None
    return Lenses.of([camera.lens for camera in cameras], device, torch.float32)


def _loaded(capture: Capture, factors: list[int], use_masks: bool) -> Iterator[_Photo]:
    """The photos in their order. As many are decoded at the same time as `_DECODED_PIXELS` allows."""
    largest = max(v.camera.height * v.camera.width for v in capture.views)
    workers = max(1, min(torch.get_num_threads(), _DECODED_PIXELS // largest))
    with ThreadPoolExecutor(workers) as pool:
        ahead: deque = deque()
        try:
            for i, factor in enumerate(factors):
                ahead.append(pool.submit(_load, capture, i, factor, use_masks))
                if len(ahead) > 2 * workers:
                    yield _wait(ahead.popleft())
            while ahead:
                yield _wait(ahead.popleft())
        finally:
            for waiting in ahead:
                waiting.cancel()


@profiled("decode photos")
def _wait(future: Future) -> _Photo:
    return future.result()


def _load(capture: Capture, i: int, factor: int, use_masks: bool) -> _Photo:
    """Photo `i`, made linear and downscaled by `factor`, strip by strip."""
    photo = capture.open_photo(i)
    has_alpha = photo.has_alpha  # looks at every pixel
    cut_out = has_alpha and photo.least_alpha() < 0.5
    coverage = capture.open_mask(i) if use_masks else None
    usable = capture.open_usable(i) if use_masks else None
    height, width = photo.size
    rows = factor * max(1, _STRIP_PIXELS // (factor * width))
    strips, repaired, brightest = [], dict.fromkeys(("bad", "negative", "blinding"), 0), 0.0
    for start in range(0, height, rows):
        raw, alpha = photo.rows(start, start + rows)
        if photo.is_float:
            finite = np.isfinite(raw).all(-1)
            repaired["bad"] += int((~finite).sum())
            repaired["negative"] += int((finite & (raw < 0).any(-1)).sum())
            repaired["blinding"] += int((finite & (raw > MAXIMUM_RADIANCE).any(-1)).sum())
            radiance = np.clip(raw, 0, MAXIMUM_RADIANCE)
            radiance[~finite] = 0
        else:
            finite, radiance = np.ones(raw.shape[:2], bool), raw
        brightest = max(brightest, float(radiance.max(initial=0.0)))
        if cut_out and alpha is not None:
            # At the edge of a cut-out, a pixel mixes the object with surroundings that were removed: its radiance is
            # neither the object's nor the surroundings'.
            finite &= (alpha > 0.98) | (alpha < 0.02)
            radiance[alpha < 0.02] = 0
        if usable is not None:
            finite &= usable.rows(start, start + rows) > 0.5
        if finite.all():
            radiance = box(radiance, factor)
            valid = np.ones(radiance.shape[:2], bool)
        else:
            weight = box(finite.astype(np.float32)[..., None], factor)
            radiance = box(radiance * finite[..., None], factor) / np.maximum(weight, 1e-6)
            valid = weight[..., 0] >= 0.5
            radiance[~valid] = 0
        mask = coverage.rows(start, start + rows) if coverage is not None else alpha if has_alpha else None
        if not use_masks or mask is None:
            mask = None
        else:
            mask = np.round(255 * box(mask[..., None], factor)[..., 0]).astype(np.uint8).ravel()
        strips.append((radiance.reshape(-1, 3), valid.ravel(), mask))
    radiance, valid = (np.concatenate([s[k] for s in strips]) for k in (0, 1))
    mask = None if strips[0][2] is None else np.concatenate([s[2] for s in strips])
    facts = _Facts(
        repaired,
        bool(repaired["bad"]) and not valid.any(),
        brightest,
        cut_out,
        mask is not None,
        0.0 if mask is None else float((mask > 127).mean()),
    )
    if brightest <= _BLACK:
        valid[:] = False
    return _Photo(radiance, valid, mask, facts)


def _full(facts: list[_Facts]) -> list[int]:
    """The photos whose masks are white everywhere, if those of others show an object: what made the masks failed there."""
    full = [i for i, p in enumerate(facts) if p.covered >= 0.999]
    others = [p.covered for p in facts if p.covered < 0.999]
    return full if 2 * len(full) <= len(facts) and len(others) >= MINIMUM_VIEWS and np.median(others) < 0.5 else []


def _lacking(capture: Capture) -> list[int]:
    """The photos that have no mask file, if nearly all others have one. Many such photos would be too many to leave out."""
    if capture.mask_reading.meaning not in (MaskMeaning.OBJECT, MaskMeaning.BACKGROUND):
        return []
    without = [i for i, view in enumerate(capture.views) if view.mask_path is None]
    enough = len(without) <= MOST_LACKING * len(capture.views) and len(capture.views) - len(without) >= MINIMUM_VIEWS
    return without if enough else []


def _sees_center(capture: Capture, camera: Camera) -> bool:
    """Whether the middle of the object's sphere lies in the camera's picture."""
    return bool(camera.side_distances(capture.object_center).min() > 0)


def _judge(capture: Capture, photos: list[_Facts]) -> list[Message]:
    """Warnings about the pixels. Raises CaptureError for a photo without finite pixels, or when every photo is black."""
    names = [v.image_path.name for v in capture.views]
    warnings: list[Message] = []
    for name, photo in zip(names, photos, strict=True):
        if photo.empty:
            raise CaptureError(
                f"{name} holds no finite pixel (all NaN or Inf)",
                "Render or export it again, or take its frame out of transforms.json.",
            )
    for kind in ("bad", "negative", "blinding"):
        found = [(n, p.repaired[kind]) for n, p in zip(names, photos, strict=True) if p.repaired[kind]]
        if found:
            warnings.append(_repair(kind, sum(count for _, count in found), [n for n, _ in found]))
    black = [n for n, p in zip(names, photos, strict=True) if p.brightest <= _BLACK]
    if len(black) == len(photos):
        raise CaptureError("all photos are black", "Check the exposure, and that the files hold color in R, G, B.")
    if black:
        warnings.append(Message("capture.photos_black", {"count": len(black), "names": black}))
    return warnings


def _repair(kind: str, pixels: int, names: list[str]) -> Message:
    """The warning for one kind of `_Facts.repaired`: the number of pixels, and the names of the photos that have them."""
    if kind == "bad":
        return Message("capture.pixels_not_finite", {"pixels": pixels, "photos": len(names), "names": names})
    if kind == "negative":
        return Message("capture.pixels_negative", {"pixels": pixels, "photos": len(names), "names": names})
    limit = MAXIMUM_RADIANCE
    return Message("capture.pixels_too_bright", {"pixels": pixels, "photos": len(names), "names": names, "limit": limit})
