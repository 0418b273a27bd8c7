"""Whether the materials of an object vary from place to place, and if so, which materials its segments have."""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING

import numpy as np
import torch
from torch import Tensor

from blender_nep.materials.baking import Places
from blender_nep.materials.evidence.decision import shift_of_dielectrics
from blender_nep.materials.evidence.residual import Residual
from blender_nep.materials.labels.labeled_points import select_label_pixels, surfels
from blender_nep.materials.samples.light_gathering import with_more_samples
from blender_nep.materials.segments.varied_materials import (
    PlacedPixels,
    VariedMaterials,
    classes_of_segments,
    fit_segments,
    gain_of_segments,
    gain_of_unseen_light,
    segments_of,
)
from blender_nep.messages import Message, Part

if TYPE_CHECKING:
    from blender_nep.materials.palette.search import FoundPalette, PaletteSearch
    from blender_nep.materials.samples.light_gathering import LitSamples, Observations
    from blender_nep.materials.samples.photo_samples import PhotoSamples
    from blender_nep.materials.segments.segments import Segments
    from blender_nep.materials.training_progress import TrainingProgress
    from blender_nep.materials.training_report import MaterialReport
    from blender_nep.presets import MaterialPreset

PIXELS_OF_VARIED = 3
"""An object whose materials vary gets this many times the preset's label pixels. They make its outlines sharp."""


@dataclass(frozen=True)
class FoundVaried:
    """Materials that vary, and what was learned with them."""

    materials: VariedMaterials
    lit: LitSamples
    """The photo samples to which the materials were fitted, more than the palette had, with their light"""
    label_pixels: PhotoSamples
    """The label pixels that colored the segments"""
    search: PaletteSearch
    """The palette's search, under an unseen light of another brightness if there is one"""

    def placed(self, seen: Observations, predicted: bool) -> PlacedPixels:
        """The pixels that show which material lies where.

        They are the label pixels if the light of the samples predicts theirs (`predicted`), else the samples.
        """
        tracer, normals = seen.f_p.tracer, seen.surface.normals
        chosen = self.label_pixels if predicted else self.lit.samples
        near = surfels(self.lit.samples, tracer, normals)
        return PlacedPixels.of(surfels(chosen, tracer, normals), chosen.radiance, near, seen.footprint)


@dataclass
class VariedLearning:
    """Learns materials that vary where these explain held-out photos much better than a palette of few does."""

    seen: Observations
    preset: MaterialPreset
    seed: int
    generator: torch.Generator
    report: MaterialReport
    """It gets the gain, the segments, and why no materials vary"""
    progress: TrainingProgress

    def found(self, search: PaletteSearch, palette: FoundPalette, unseen_learned: bool) -> FoundVaried | None:
        """Materials that vary, or None. The unseen light gets another brightness if it was learned (`unseen_learned`)."""
        p = self.preset
        if math.isinf(p.varied_gain) or Residual.name in p.without:  # nothing else tells the materials of segments
            self._skip(Message("reason.preset"))
            return None
        segments = segments_of(self.seen.samples, self.seed)
        gain = gain_of_segments(search, palette, segments)
        metal, least = None, p.varied_gain
        if gain < p.varied_gain:
            # Segments that explain hardly more tell no class. Whole materials and edges of color tell it better.
            metal = search.metal_by_colors(palette.palette)
            if metal is not None:
                least = p.varied_gain_of_both
                likely = classes_of_segments(metal, segments).to(self.seen.device)
                gain = gain_of_segments(search, palette, segments, likely, palette_sees_all=False)
            elif bool((palette.palette.metallic > 0.5).all()):  # tarnish makes a metal vary
                metal, least = np.ones(len(palette.label), bool), p.varied_gain_of_metal
                gain = gain_of_segments(search, palette, segments, torch.ones(len(segments), device=self.seen.device))
        self.report.varied_gain = round(gain, 4)
        if gain < least:
            self._skip(Message("reason.palette_explains"))
            return None
        lit = with_more_samples(
            self.seen,
            search.light,
            search.materials_at(palette),
            p,
            self.seed,
            self.generator,
            lambda _: self.progress.step(self.progress.done),
        )
        pixels = self._label_pixels()
        segments = segments_of(lit.samples, self.seed, pixels)
        label = torch.from_numpy(segments.label).to(self.seen.device)
        classes = None if metal is None else self._classes(search, metal, lit, segments)
        if search.light.unseen is not None and unseen_learned:
            gain = gain_of_unseen_light(lit, label, segments, p, classes)
            self.report.unseen_light_gain = round(gain, 3)
            search = search.under(search.light.with_unseen(search.light.unseen.scaled(gain)))
            lit = lit.with_unseen(gain)
        self.report.samples = len(lit.samples)
        of_palette = palette.palette.roughness, palette.palette.metallic
        shift = shift_of_dielectrics(palette.account, *of_palette, palette.shares().tolist(), p)
        fitted = fit_segments(lit.light, lit.samples.radiance, label, segments, p, classes, shift=shift)
        self.report.tell_segments(fitted)
        return FoundVaried(VariedMaterials(segments, fitted, shift), lit, pixels, search)

    def _label_pixels(self) -> PhotoSamples:
        seen, preset = self.seen, replace(self.preset, label_pixels=PIXELS_OF_VARIED * self.preset.label_pixels)
        return select_label_pixels(seen.rays, seen.f_p.tracer, seen.surface.normals, preset, self.seed)

    def _classes(self, search: PaletteSearch, metal: np.ndarray, lit: LitSamples, segments: Segments) -> Tensor:
        """The metallic value [K] of each segment; metal [n] bool: which photo samples of the palette lie on metal."""
        position, normal, _ = surfels(lit.samples, self.seen.f_p.tracer, self.seen.surface.normals)
        classes = classes_of_segments(search.metal_at(metal, Places(position, normal)), segments)
        return classes.to(self.seen.device)

    def _skip(self, why: Message) -> None:
        self.report.skipped[str(Part.VARIED_MATERIALS)] = why.state()
