"""Corrections by an artist: some materials get another class (metal or dielectric) or another roughness.

The light stays as it was found, so a correction takes seconds. What the artist does not name stays as it was learned. The
albedo of a corrected material is fitted again, because it depends on both.

An object with a palette has one entry for each material. An object whose materials vary from place to place has hundreds of
segments, so its segments are put into groups of similar materials, and each group is one entry.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING, Any, Protocol

import numpy as np
import torch
from scipy.cluster.hierarchy import fcluster, linkage
from torch import Tensor

from blender_nep.color import linear_to_srgb
from blender_nep.geometry.mesh import Surface
from blender_nep.materials.baking import LabeledPoints, bake
from blender_nep.materials.fitting import between, fit_groups, place_in_scan, place_of_least, roughness_at
from blender_nep.materials.labels.blending import BlendedPoints
from blender_nep.materials.palette.palette import Palette
from blender_nep.materials.segments.segments import Segments
from blender_nep.materials.segments.varied_materials import PlacedPixels, VariedMaterials, fit_segments, varied_points
from blender_nep.materials.shown_faces import ShownParts
from blender_nep.safety.arrays import check_array
from blender_nep.shading.light_moments import LightMoments

if TYPE_CHECKING:
    from blender_nep.presets import MaterialPreset

MOST_GROUPS = 6
"""Largest number of groups of segments in each class. More would make the artist's list too long."""
_MOST_TEXELS = 1 << 14
"""Of a side of a texture, in a file"""
_SAME_COLOR = 0.12
"""Segments of one group differ by about this much in their sRGB albedo (0..1, Euclidean)."""


@dataclass(frozen=True)
class Correction:
    """What an artist says of one material. None: as it was learned."""

    metallic: float | None = None
    """0 or 1"""
    roughness: float | None = None
    """Principled's roughness, 0..1"""


@dataclass(frozen=True)
class ListedMaterial:
    """One entry of the list that an artist sees."""

    share: float
    """Share of the points of the surface that show it, 0..1; a blend of two counts for both"""
    albedo: tuple[float, float, float]
    """Linear, 0..1"""
    roughness: float
    metallic: float

    def to_dict(self, learned: ListedMaterial) -> dict[str, Any]:
        """The entry for report.json; `learned` is the entry without corrections."""
        return {
            "share": round(self.share, 4),
            "albedo": [round(x, 4) for x in self.albedo],
            "roughness": round(self.roughness, 4),
            "metallic": self.metallic,
            "learned": {"roughness": round(learned.roughness, 4), "metallic": learned.metallic},
        }


class Correctable(Protocol):
    """Materials that can be corrected, and the points of the surface that show them."""

    light: LightMoments

    def corrected(self, corrections: Mapping[int, Correction], preset: MaterialPreset) -> Any:
        """The same with these corrections, {number of the entry: correction}."""
        ...

    def listed(self) -> list[ListedMaterial]:
        """The entries, in the order of their numbers."""
        ...

    def labeled(self, preset: MaterialPreset) -> LabeledPoints:
        """The points of the surface with their materials."""
        ...

    def state(self) -> dict:
        """All of it as a dict of tensors and arrays."""
        ...


@dataclass
class CorrectablePalette:
    """A palette of K materials without blends."""

    light: LightMoments
    target: Tensor
    """[n, 3] linear radiance of the photo samples"""
    label: Tensor
    """[n] int64, the material that a sample shows alone; -1 for a blend, and for a sample that no fit uses"""
    palette: Palette
    points: BlendedPoints

    def corrected(self, corrections: Mapping[int, Correction], preset: MaterialPreset) -> CorrectablePalette:
        palette = self.palette
        for k, correction in corrections.items():
            palette = palette.with_one(k, self._fitted(k, correction, preset))
        return replace(self, palette=palette)

    def _fitted(self, k: int, correction: Correction, preset: MaterialPreset) -> Palette:
        """This palette, in which material k obeys the correction.

        A material that no sample shows alone keeps its albedo, and its roughness where the correction gives none.
        """
        metallic = float(self.palette.metallic[k]) if correction.metallic is None else correction.metallic
        values = Palette(self.palette.albedo.clone(), self.palette.roughness.clone(), self.palette.metallic.clone())
        values.metallic[k] = metallic
        if correction.roughness is not None:
            values.roughness[k] = correction.roughness
        if not bool((self.label == k).any()):
            return values
        cost, albedo = fit_groups(
            self.light,
            self.target,
            torch.ones_like(self.light.cos_v),
            torch.where(self.label == k, 0, -1),
            1,
            least_roughness=preset.least_roughness,
            clip=preset.clip,
            hypotheses=(metallic,),
        )
        place = place_of_least(cost[0])
        if correction.roughness is not None or metallic == float(self.palette.metallic[k]):
            place = place_in_scan(values.roughness[k].reshape(1).to(cost), preset.least_roughness)
        if correction.roughness is None:
            values.roughness[k] = roughness_at(place, preset.least_roughness)[0]
        values.albedo[k] = between(albedo[0], place)[0].clamp(0, 1)
        return values

    def listed(self) -> list[ListedMaterial]:
        p, points = self.palette, self.points
        mass = np.bincount(points.first, 1 - points.share, len(p)) + np.bincount(points.second, points.share, len(p))
        values = zip(
            (mass / max(mass.sum(), 1)).tolist(), p.albedo.tolist(), p.roughness.tolist(), p.metallic.tolist(), strict=True
        )
        return [ListedMaterial(share, (a[0], a[1], a[2]), rough, metal) for share, a, rough, metal in values]

    def labeled(self, preset: MaterialPreset) -> LabeledPoints:
        return self.points.labeled(self.palette)

    def state(self) -> dict:
        own = {"target": self.target, "label": self.label, "points": vars(self.points)}
        palette = {name: getattr(self.palette, name) for name in _MATERIAL}
        return {**own, "light": self.light.moments_state(), "palette": palette}

    @classmethod
    def from_state(cls, state: dict) -> CorrectablePalette:
        """The inverse of `state`."""
        light, palette = LightMoments(**state["light"]), Palette(**state["palette"])
        found = cls(light, state["target"], state["label"], palette, BlendedPoints(**state["points"]))
        samples, last = light.check(), _check_palette(palette) - 1
        check_array("target", found.target, (samples, 3))
        check_array("label", found.label, (samples,), low=-1, high=last)
        points = vars(found.points)
        count = check_array("position", points["position"], (None, 3))
        check_array("normal", points["normal"], (count, 3))
        for name in ("photo", "residual", "share"):
            check_array(name, points[name], (count,))
        for name in ("first", "second"):
            check_array(name, points[name], (count,), low=0, high=last)
        return found


@dataclass
class CorrectableSegments:
    """The materials of K segments in G groups."""

    light: LightMoments
    target: Tensor
    """[n, 3] linear radiance of the photo samples"""
    varied: VariedMaterials
    group: np.ndarray
    """[K] int, the group of each segment; group 0 is the largest"""
    pixels: PlacedPixels

    def corrected(self, corrections: Mapping[int, Correction], preset: MaterialPreset) -> CorrectableSegments:
        learned = self.varied.palette
        wanted = [corrections.get(int(g), Correction()) for g in self.group]
        metallic, roughness = (
            torch.tensor([torch.nan if value is None else value for value in values]).to(learned.metallic)
            for values in ([c.metallic for c in wanted], [c.roughness for c in wanted])
        )
        other, exact = ~metallic.isnan() & (metallic != learned.metallic), ~roughness.isnan()
        changed, palette = other | exact, learned
        if bool(changed.any()):
            label = torch.from_numpy(self.varied.segments.label).to(learned.metallic.device)
            classes = torch.where(other, metallic, learned.metallic)
            fitted = fit_segments(
                self.light, self.target, label, self.varied.segments, preset, classes, roughness, self.varied.shift
            )
            palette = Palette(
                torch.where(changed[:, None], fitted.albedo, learned.albedo),
                torch.where(changed, fitted.roughness, learned.roughness),
                classes,
            )
        return replace(self, varied=replace(self.varied, palette=palette, exact=exact.cpu().numpy(), learned=learned))

    def listed(self) -> list[ListedMaterial]:
        p, count = self.varied.palette, np.bincount(self.varied.segments.label, minlength=len(self.group)).astype(np.float64)
        values = torch.cat([p.albedo.clamp(0, 1), p.roughness[:, None], p.metallic[:, None]], 1).cpu().numpy()
        found = []
        for group in range(int(self.group.max()) + 1):
            own = np.flatnonzero(self.group == group)
            red, green, blue, roughness, metallic = np.average(values[own], 0, np.maximum(count[own], 1e-9)).tolist()
            found.append(ListedMaterial(count[own].sum() / count.sum(), (red, green, blue), roughness, round(metallic)))
        return found

    def labeled(self, preset: MaterialPreset) -> LabeledPoints:
        return varied_points(self.varied, self.light, self.pixels, preset)

    def state(self) -> dict:
        palette = {name: getattr(self.varied.palette, name) for name in _MATERIAL}
        own = {"target": self.target, "group": self.group, "palette": palette, "segments": vars(self.varied.segments)}
        return {**own, "shift": self.varied.shift, "light": self.light.moments_state(), "pixels": vars(self.pixels)}

    @classmethod
    def from_state(cls, state: dict) -> CorrectableSegments:
        """The inverse of `state`."""
        shift = float(state.get("shift", 0.0))  # older jobs of this format have none
        if not math.isfinite(shift):
            raise ValueError(f"dielectrics are moved by {shift} places")
        varied = VariedMaterials(Segments(**state["segments"]), Palette(**state["palette"]), shift)
        light, pixels = LightMoments(**state["light"]), PlacedPixels(**state["pixels"])
        samples, segments = light.check(), _check_palette(varied.palette)
        check_array("target", state["target"], (samples, 3))
        check_array("center", varied.segments.center, (segments, 7))
        check_array("label", varied.segments.label, (samples,), low=0, high=segments - 1)
        check_array("group", state["group"], (segments,), low=0, high=segments - 1)
        count = check_array("position", pixels.position, (None, 3))
        check_array("normal", pixels.normal, (count, 3))
        check_array("photo", pixels.photo, (count,))
        check_array("radiance", pixels.radiance, (count, 3))
        check_array("sample", pixels.sample, (count, None), low=0, high=samples - 1)
        check_array("share", pixels.share, pixels.sample.shape)
        return cls(light, state["target"], varied, state["group"], pixels)


_MATERIAL = ("albedo", "roughness", "metallic")


def _check_palette(palette: Palette) -> int:
    """The number of materials. Raises ValueError unless the arrays fit each other."""
    count = check_array("roughness", palette.roughness, (None,), low=0.0, high=1.0)
    check_array("albedo", palette.albedo, (count, 3))
    check_array("metallic", palette.metallic, (count,), low=0.0, high=1.0)
    return count


@dataclass
class KeptMaterials:
    """All that a correction needs. It is kept on the disk when materials are learned."""

    materials: Correctable
    texels: int
    """Side of the textures"""
    shown: ShownParts
    """Which parts of the faces the photos show"""

    def state(self) -> dict:
        """All of it as a dict of tensors, arrays and numbers."""
        kind = next(name for name, cls in _KINDS.items() if isinstance(self.materials, cls))
        return {"kind": kind, "materials": self.materials.state(), "texels": self.texels, "shown": self.shown._asdict()}

    @classmethod
    def from_state(cls, state: dict) -> KeptMaterials:
        """The inverse of `state`, on the CPU. Raises ValueError and other errors where that is damaged."""
        texels, shown = state["texels"], ShownParts(**state["shown"])
        if not isinstance(texels, int) or not 0 < texels <= _MOST_TEXELS:
            raise ValueError(f"textures of {texels} texels a side")
        check_array("edge_parts", shown.edge_parts, (None,), low=1, high=_MOST_TEXELS)
        check_array("shown", shown.shown, (int((shown.edge_parts**2).sum()),))
        return cls(_KINDS[state["kind"]].from_state(state["materials"]), texels, shown)

    def check(self, surface: Surface) -> None:
        """Raises ValueError unless this was kept for that surface."""
        check_array("edge_parts", self.shown.edge_parts, (len(surface.faces),))

    @property
    def irradiance_known(self) -> bool:
        """Whether the job has gathered the light of the hemisphere. It has not where it was told that all is metal."""
        return bool(self.materials.light.diffuse.any())

    def listed(self) -> list[dict[str, Any]]:
        """The materials as they were learned, for report.json."""
        return [entry.to_dict(entry) for entry in self.materials.listed()]

    def bake(
        self, surface: Surface, corrections: Mapping[int, Correction], preset: MaterialPreset
    ) -> tuple[tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray], list[dict[str, Any]]]:
        """The textures with these corrections, as `baking.bake` gives them, and the materials for report.json.

        The light of a matte object was gathered in wide lobes alone, so no narrower ones are tried.
        """
        narrowest = float(self.materials.light.roughness_levels[0])
        preset = replace(preset, least_roughness=max(preset.least_roughness, narrowest))
        corrected = self.materials.corrected(corrections, preset)
        entries = zip(corrected.listed(), self.materials.listed(), strict=True)
        textures = bake(surface, corrected.labeled(preset), self.texels, self.shown)
        return textures, [now.to_dict(learned) for now, learned in entries]


_KINDS: dict[str, type[CorrectablePalette] | type[CorrectableSegments]] = {
    "palette": CorrectablePalette,
    "segments": CorrectableSegments,
}


def groups_of_segments(varied: VariedMaterials) -> np.ndarray:
    """The group [K] int of each segment: segments of one class with similar albedos. Group 0 has the most samples."""
    palette, count = varied.palette, np.bincount(varied.segments.label, minlength=len(varied.segments))
    color = linear_to_srgb(palette.albedo.clamp(0, 1).cpu().numpy())
    metallic = palette.metallic.cpu().numpy()
    group, groups = np.zeros(len(color), np.int64), 0
    for value in np.unique(metallic):
        own = np.flatnonzero(metallic == value)
        found = np.zeros(len(own), np.int64)
        if len(own) > 1:
            tree = linkage(color[own], "average")
            found = fcluster(tree, _SAME_COLOR, "distance") - 1
            if found.max() >= MOST_GROUPS:
                found = fcluster(tree, MOST_GROUPS, "maxclust") - 1
        group[own] = groups + found
        groups += int(found.max()) + 1
    size = np.bincount(group, weights=count, minlength=groups)
    rank = np.empty(groups, np.int64)
    rank[np.argsort(-size, kind="stable")] = np.arange(groups)
    return rank[group]
