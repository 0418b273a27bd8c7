"""The pixels of all photos. Rays in the unit frame are computed from the cameras when they are needed."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np
import torch
from torch import Tensor

from blender_nep.capture.cameras.camera import Camera
from blender_nep.capture.cameras.lens import Lenses
from blender_nep.capture.capture import Capture
from blender_nep.capture.rays.decoded_photos import STRIP_PIXELS, PhotoFacts, decoded, judged
from blender_nep.capture.rays.downscaling import factor_for
from blender_nep.capture.rays.judged_masks import judged_masks, photos_masked_by_alpha, photos_without_masks
from blender_nep.capture.rays.pixel_set import GrowingPixelSet, PixelSet
from blender_nep.capture.rays.pixel_store import PixelMemory
from blender_nep.capture.rays.ray_bundle import RayBundle
from blender_nep.capture.rays.response_curve import ResponseCurve
from blender_nep.capture.rays.rigid_motions import RigidMotions
from blender_nep.capture.rays.vignetting import Vignetting
from blender_nep.errors import BoundsError
from blender_nep.messages import Message
from blender_nep.profiling import profiled

BRIGHTEST_CLIPPED, SATURATED = 1.001, 0.97
"""If no pixel is brighter than `BRIGHTEST_CLIPPED`, the files cannot store more than 1. Then a channel above `SATURATED` may
be clipped: the true radiance is at least that value."""


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

    def burnt_out(self, index: Tensor) -> Tensor:
        """Whether a channel of the pixels index [n] int64 may show less than the true radiance: [n] bool."""
        return self._ends(self.radiance[index].amax(-1))

    def white(self, index: Tensor) -> Tensor:
        """Whether all channels of the pixels index [n] int64 may show less than the true radiance: [n] bool."""
        return self._ends(self.radiance[index].amin(-1))

    def _ends(self, values: Tensor) -> Tensor:
        """Whether the files' values [n] are as large as the files can store, if these store no more than 1: [n] bool."""
        if self.brightest > BRIGHTEST_CLIPPED:
            return torch.zeros_like(values, dtype=torch.bool)
        return values > SATURATED

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
        facts: list[PhotoFacts] = []
        by_alpha = photos_masked_by_alpha(capture) if use_masks else []
        lacking = photos_without_masks(capture, by_alpha) if use_masks else []
        for photo, camera, size in zip(decoded(capture, factors, use_masks), cameras, sizes, strict=True):
            if len(facts) in lacking:  # it is left out, so its alpha says nothing about the other photos
                photo.facts.cut_out = False
                if photo.mask is None:
                    photo.mask, photo.facts.has_mask = np.zeros(len(photo.valid), np.uint8), True
            if len(facts) in by_alpha and photo.mask is not None:  # what was cut away is known from other photos
                photo.valid[photo.mask <= 127], photo.facts.cut_out = False, False
            facts.append(photo.facts)
            stores.append(photo.radiance, photo.valid & camera.shown_pixels(size[1], size[0]), photo.mask)
            progress(len(facts), len(cameras))
        warnings = judged(capture, facts)
        if most < max_pixels_per_photo:
            reduced = {"photos": len(cameras), "pixels": most, "limit": memory.most}
            warnings.append(Message("capture.photos_reduced", reduced))
        cut_out, masks = any(p.cut_out for p in facts), judged_masks(capture, facts, lacking, use_masks)
        warnings += masks.warnings
        if by_alpha:
            names = [capture.views[i].name for i in by_alpha]
            warnings.append(Message("capture.alpha_for_mask", {"count": len(names), "names": names}))
        intrinsics = [(c.fl_x / f, c.fl_y / f, c.cx / f, c.cy / f) for c, f in zip(cameras, factors, strict=True)]
        origins = [(c.position - capture.object_center) / capture.object_radius for c in cameras]

        def tensor(values: object) -> Tensor:
            return torch.tensor(np.array(values), dtype=torch.float32, device=device)

        nothing = PixelSet.of(torch.zeros(0, dtype=torch.int64, device=device))
        radiance, valid, mask = stores.finished()
        for i in masks.unusable:
            valid[offset[i] : offset[i + 1]] = False
        rays = cls(
            radiance=radiance,
            valid=valid,
            mask=mask if masks.usable else None,
            offset=offset,
            size=sizes,
            background=not (cut_out and masks.usable),
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
        for start in range(0, self.count, STRIP_PIXELS):
            index = torch.arange(start, min(start + STRIP_PIXELS, self.count), device=device)
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


def _lenses(cameras: list[Camera], device: torch.device | str) -> Lenses | None:
    """The lenses of the cameras in single precision. None if none of them distorts."""
    if all(camera.lens.is_pinhole for camera in cameras):
        return None
    return Lenses.of([camera.lens for camera in cameras], device, torch.float32)
