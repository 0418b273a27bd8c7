"""Material learning (stage 2 of the paper): albedo, roughness and metallic of the surface, by the rendering equation.

The mesh and F_e do not change, so primary hits, visibility and prefiltered light are computed once (`light_gathering`). Then
one material is fitted to all samples, and more are added as long as they explain clearly more (`palette.search`). In
between, the light that the object reflects to itself is computed again with the new materials.
"""

from __future__ import annotations

import time
from collections.abc import Callable
from dataclasses import dataclass, field, replace
from functools import partial
from typing import TYPE_CHECKING

import numpy as np
import torch
from torch import Tensor

from blender_nep.capture.rays.response_curve import ResponseCurve
from blender_nep.errors import LearningError
from blender_nep.geometry.mesh import Surface
from blender_nep.materials.baking import bake, texture_size
from blender_nep.materials.camera_response import found_curve, with_light_itself
from blender_nep.materials.corrections import (
    Correctable,
    CorrectablePalette,
    CorrectableSegments,
    KeptMaterials,
    groups_of_segments,
)
from blender_nep.materials.labels.blending import BlendedPoints
from blender_nep.materials.labels.labeled_points import (
    error_of_neighbors,
    labeled_pixels,
    labeled_samples,
    surfels,
)
from blender_nep.materials.palette.palette import Palette
from blender_nep.materials.palette.photographer import found_strength
from blender_nep.materials.palette.search import PaletteSearch
from blender_nep.materials.photo_gains import gains_of_photos
from blender_nep.materials.samples.light_gathering import Observations, gathered_light
from blender_nep.materials.segments.varied_learning import FoundVaried, VariedLearning
from blender_nep.materials.shown_faces import ShownParts
from blender_nep.materials.training_progress import TrainingProgress
from blender_nep.materials.training_report import MaterialReport
from blender_nep.materials.unseen_light_training import learn_unseen_light, likely_radius
from blender_nep.messages import Message, Part
from blender_nep.shading.incoming_light import IncomingLight
from blender_nep.shading.light_moments import LightMoments
from blender_nep.shading.unseen_light import UnseenLight

if TYPE_CHECKING:
    from blender_nep.fields.environment.field import EnvironmentField
    from blender_nep.presets import MaterialPreset
    from blender_nep.scene.scene import Scene


_TEXELS_OF_VARIED = 2
"""The texels of an object whose materials vary are this many times as narrow as those of another. Its outlines get sharp."""
_FIRST_TRIALS, _LATER_TRIALS = 6, 1
"""How often a roughness is lowered or raised each time that the unseen light is learned: in the first rounds, and later."""


@dataclass
class Materials:
    """Textures over the surface's UVs. Row 0 is the top (v = 1). Linear float32."""

    albedo: np.ndarray
    """[H, W, 3] Principled's Base Color, 0..1"""
    roughness: np.ndarray
    """[H, W] Principled's roughness, 0..1"""
    metallic: np.ndarray
    """[H, W] Principled's metallic, 0..1"""
    confidence: np.ndarray
    """[H, W] 0..1: 1 where the photos decided"""
    unseen: UnseenLight | None = None
    """Light that no photo shows. It takes the place of F_e where F_e has no coverage (`UnseenLight.completed`)."""
    report: dict = field(default_factory=dict)
    """`MaterialReport.as_dict`"""
    kept: KeptMaterials | None = None
    """What a correction by the artist needs"""
    response: ResponseCurve | None = None
    """The camera's response curve, which F_e and the photos still have, and `unseen` has not. None: there is none"""
    object_gain: Tensor | None = None
    """[views]: how much brighter the object is in each photo than in the others. None: it is as bright in all"""


def learn_materials(
    surface: Surface,
    environment: EnvironmentField,
    scene: Scene,
    preset: MaterialPreset,
    *,
    seed: int,
    progress: Callable,
    checkpoint,
) -> Materials:
    """Learn the textures of the surface from the photos of the scene, on its device. Raises LearningError and Stopped.

    LearningError: no photo shows the surface well enough, or the textures are not finite. A resumed run goes on from the
    gathered light if that was saved, and ends with the same textures.
    """
    start = time.monotonic()
    generator = torch.Generator().manual_seed(seed)
    seen = Observations.of(surface, environment, scene, preset, seed)
    report = MaterialReport(samples=len(seen.samples), left_out=seen.samples.skipped)
    steps = TrainingProgress(progress, checkpoint, report.seconds, start)
    steps.phase_ended("select")
    seen = _before_the_camera(seen, scene.expected_response, preset, seed, report)
    steps.phase_ended("response")
    light = gathered_light(seen, preset, generator, steps)
    return _MaterialLearner(seen, light, preset, seed, generator, report, steps).run()


def _before_the_camera(
    seen: Observations, expected: float | None, preset: MaterialPreset, seed: int, report: MaterialReport
) -> Observations:
    """The observations without the camera's response curve, if there is one. The report tells what was found."""
    part = str(Part.CAMERA_RESPONSE)
    if seen.rays.curve_of_files is not None:
        report.skipped[part] = Message("reason.curve_told").state()
        return seen
    if not preset.camera_response or expected is None:
        why = Message("reason.linear_photos") if preset.camera_response else Message("reason.preset")
        report.skipped[part] = why.state()
        return seen
    curve, tried = found_curve(seen, expected, preset, seed)
    if tried is not None:
        report.response_errors = tried.rounded()
    if curve is None:
        why = Message("reason.light_not_shown") if tried is None else Message("reason.no_tone_curve")
        report.skipped[part] = why.state()
        return seen
    report.response = {name: round(value, 4) for name, value in curve.state().items()}
    return with_light_itself(seen, curve)


class _MaterialLearner:
    """Finds the palette under the light that is known so far, and the unseen light with that palette, in turns."""

    def __init__(
        self,
        seen: Observations,
        light: IncomingLight,
        preset: MaterialPreset,
        seed: int,
        generator: torch.Generator,
        report: MaterialReport,
        progress: TrainingProgress,
    ) -> None:
        """Fit one material to all samples. `run` does the rest."""
        self.seen, self.preset, self.seed = seen, preset, seed
        self.generator, self.report, self.progress = generator, report, progress
        self.known_metallic: Tensor | None = None
        """[K] metallic of the palette's materials. None if the photos have not decided it clearly."""
        self.trial_seconds = 0.0
        """Seconds that the last trial of every material as the other class (metal or dielectric) took"""
        self.unseen_learned = False
        """Whether the unseen light is more than what F_e holds where no photo looks"""
        lit = light.with_unseen(self._first_unseen_light(light.in_photos))
        self.search = PaletteSearch.of(seen.samples, lit, preset, seen.device)
        """The samples, under the known and the unseen light that go with the materials found so far"""
        self.found = self.search.one()
        """The palette, and the material of every sample"""

    def run(self) -> Materials:
        """Learn the palette, label the points of the surface, and bake the textures. Raises LearningError and Stopped."""
        single = self._learn_palette()
        seen, shares = self.seen, self.found.shares().tolist()
        self.found = self.search.blended(self.found)
        self._finish_report(single, shares)
        learning = VariedLearning(seen, self.preset, self.seed, self.generator, self.report, self.progress)
        varied = learning.found(self.search, self.found, self.unseen_learned)
        self.search = self.search if varied is None else varied.search
        self.progress.phase_ended("materials")
        uniform = len(self.found.palette) == 1 and varied is None
        finer = 1 if varied is None else _TEXELS_OF_VARIED
        wanted = texture_size(seen.surface, seen.footprint / finer, finer * self.preset.most_texels)
        self.report.texture_texels = size = min(wanted, self.preset.uniform_texels) if uniform else wanted
        shown = ShownParts.of(seen.surface, seen.f_p.tracer, seen.rays)
        kept = KeptMaterials(self._correctable(varied), size, shown)
        points = kept.materials.labeled(self.preset)
        albedo, roughness, metallic, confidence = bake(seen.surface, points, size, shown)
        self.progress.phase_ended("textures")
        if uniform:
            self._skip(Part.MATERIAL_BOUNDARIES, Message("reason.one_material"))
        if size < wanted:
            self._skip(
                Part.FINE_TEXTURES,
                Message("reason.one_material"),
                self.report.seconds["textures"] * ((wanted / size) ** 2 - 1),
            )
        self.progress.step(100)
        if not all(np.isfinite(x).all() for x in (albedo, roughness, metallic, confidence)):
            message = "material learning diverged: its textures are not finite"
            raise LearningError(message, "Try another --seed.", "learning.diverged")
        report = self.report.as_dict()
        response = seen.rays.response
        gain = seen.rays.object_gain
        return Materials(albedo, roughness, metallic, confidence, self.light.unseen, report, kept, response, gain)

    def _learn_palette(self) -> float:
        """Fit one material, then learn the palette and the unseen light in turns. Returns the residual with one material."""
        preset = self.preset
        self._reflect_itself()
        self.found = self.search.one()
        single = self._residual()
        self._find_photographer()
        self._grow_palette()
        for k in range(preset.rounds):
            self._find_unseen_light()
            if self._turned:  # photos showed hardly any of the light that the object has reflected to itself so far
                self._reflect_itself()
            self._find_photographer()
            self._grow_palette()
            self.progress.step(75 + 5 * k)
        self._reflect_itself()
        for k in range(preset.rounds):
            self._find_unseen_light(by_hue=True)
            merged = self.search.with_shades_merged(self.found, by_hue=True)
            fewer = self.search.without_superfluous(merged)
            self.found = self.search.assigned(fewer, fewer.palette)
            self.progress.step(85 + 5 * k)
        return single

    def _even_out_object(self) -> None:
        """Find how much brighter the object is in some photos than in others, and divide by it."""
        if not self.preset.object_gains:
            self._skip(Part.OBJECT_GAINS, Message("reason.preset"))
            return
        if self._turned:  # most of the light is not known before the object's reflections have told it
            self._skip(Part.OBJECT_GAINS, Message("reason.object_turned"))
            return
        search, rays = self.search, self.seen.rays
        region, predicted = search.of_regions()
        gain = gains_of_photos(search.samples, predicted, region, search.weight, rays.views)
        if gain is None:
            if rays.object_gain is None:
                self._skip(Part.OBJECT_GAINS, Message("reason.equally_bright"))
            return
        self.report.skipped.pop(str(Part.OBJECT_GAINS), None)
        whole = gain if rays.object_gain is None else rays.object_gain * gain
        self.report.object_gains = whole.cpu().numpy().round(3).tolist()
        radiance = search.samples.radiance / gain[search.samples.photo][:, None]
        samples = replace(search.samples, radiance=radiance)
        self.seen = replace(self.seen, samples=samples, rays=rays.with_object_gain(whole))
        self.search = replace(search, samples=samples)

    def _find_photographer(self) -> None:
        """Find how much light the person who takes the photos takes, and take it away."""
        if not self.preset.photographer:
            self._skip(Part.PHOTOGRAPHER, Message("reason.preset"))
            return
        if self._turned:  # what stands still beside a turntable is a part of its light
            self._skip(Part.PHOTOGRAPHER, Message("reason.object_turned"))
            return
        if not self.light.in_photos:
            self._skip(Part.PHOTOGRAPHER, Message("reason.light_not_shown"))
            return
        strength, errors = found_strength(self.search.samples, self.light, self.preset)
        if not errors:
            self._skip(Part.PHOTOGRAPHER, Message("reason.too_few_photos"))
            return
        self.report.photographer_errors = errors
        self.report.photographer = round(strength, 4)
        if strength:
            self.report.skipped.pop(str(Part.PHOTOGRAPHER), None)
        else:
            self._skip(Part.PHOTOGRAPHER, Message("reason.no_photographer"))
        if strength != self.light.photographer:
            self.search = self.search.under(self.light.behind(strength - self.light.photographer))
            self.known_metallic = None  # it was decided in another light

    def _grow_palette(self) -> None:
        self._even_out_object()
        self.found = self.search.grown(self.found, lambda: self.progress.step(75))

    def _metallic_swapped(self) -> Palette | None:
        """The palette with metals and dielectrics swapped. None where the preset or the photos have decided the class."""
        if len(self.preset.metallic) == 1:
            return None
        if self.known_metallic is not None and torch.equal(self.known_metallic, self.found.palette.metallic):
            before = self.report.seconds_saved.get(Part.METAL_AGAIN, 0.0)
            self._skip(Part.METAL_AGAIN, Message("reason.metal_known"), before + self.trial_seconds)
            return None
        return self.search.metallic_swapped(self.found)

    def _residual(self) -> float:
        self.progress.loss = self.search.residual(self.found)
        return self.progress.loss

    def _reflect_itself(self) -> None:
        self.search = self.search.under(self.light.updated(self.search.materials_at(self.found), self.generator))
        self._residual()

    @property
    def _turned(self) -> bool:
        """Whether the object turned while the light stood still."""
        return self.seen.points.motion is not None

    @property
    def light(self) -> IncomingLight:
        """The known and the unseen light, with the materials found so far."""
        return self.search.light

    def _first_unseen_light(self, in_photos: bool) -> UnseenLight:
        """The unseen light to begin with; in_photos: whether the photos show any light.

        It is gray if they show none (cut-outs), because without light all materials look alike. It is gray, too, if the
        object turned: what is behind the object in its photos says little of the light from all other sides.
        """
        environment, rows = self.seen.f_p.environment, self.preset.unseen_rows
        if in_photos or not self.preset.learn_unseen_light:
            unseen = UnseenLight.expected_beside(environment, rows)
            return unseen.grayed() if self._turned and self.preset.learn_unseen_light else unseen
        gray = 2 * float(self.seen.samples.radiance.mean(-1).median())
        return UnseenLight.uniform(rows, environment.typical_distance(), self.seen.device, gray)

    def _find_unseen_light(self, by_hue: bool = False) -> None:
        """Learn the light that no photo shows, and improve the palette with it.

        With `by_hue`, what the hues of each material say counts for its class, metals are as bright as is likely, and a
        roughness goes one step at most. The fits of the palette, which follow, took longer walks back.
        """
        # Which class a material has must be clear before a metal's brightness is.
        p = self.preset if by_hue else replace(self.preset, metals_are_bright=0.0)
        light, found = self.light, self.found
        uncovered = float(1 - light.coverage.mean())
        self.report.light_not_in_photos = round(uncovered, 4)
        if not p.learn_unseen_light or uncovered < 0.005:
            self._skip(Part.UNSEEN_LIGHT, Message("reason.light_seen") if p.learn_unseen_light else Message("reason.preset"))
            return
        assert light.unseen is not None  # it was added before the first fit
        radius, trials = light.unseen.radius, list[float]()

        def tried() -> None:
            trials.append(time.monotonic())
            self.progress.step(self.progress.done)

        if self._turned and not by_hue:  # the palette was fitted in a better light than the last time
            radius = likely_radius(light, found.palette, found.label_of_fits, self.search.target, p, self.generator, tried)
            light = light.with_unseen(replace(light.unseen, radius=radius))
            self.search = self.search.under(light)
            trials.clear()
        self.unseen_learned = True
        self.report.unseen_light_radius = round(radius, 3)
        start = time.monotonic()
        others = self._metallic_swapped()
        scan = time.monotonic() - start
        said = self.search.class_said(found) if by_hue else torch.zeros_like(found.palette.metallic)
        most_trials = _LATER_TRIALS if by_hue else _FIRST_TRIALS
        unseen, palette, margins = learn_unseen_light(
            light,
            found.palette,
            others,
            found.label_of_fits,
            self.search.target,
            said,
            most_trials,
            p,
            self.generator,
            tried,
        )
        self.found = replace(found, palette=palette)
        if margins:
            self.report.metal_or_not_margin = round(min(margins), 4)
            self.known_metallic = palette.metallic if min(margins) >= p.sure_margin else None
            self.trial_seconds = scan + trials[len(margins)] - trials[0]
        self.search = self.search.under(light.with_unseen(unseen))
        self._residual()
        self.search = self.search.evenly_weighted()

    def _correctable(self, varied: FoundVaried | None) -> Correctable:
        """The materials, and the points of the surface that show them: label pixels, or only the photo samples.

        They are label pixels if the light of the samples predicts the light of label pixels.
        """
        search, found = self.search, self.found
        tracer, normals, rays = self.seen.f_p.tracer, self.seen.surface.normals, self.seen.rays
        of_samples = labeled_samples(search, found)
        if len(found.palette) == 1 and varied is None:
            self._skip(Part.VOTES, Message("reason.one_material"))
            return self._correctable_palette(of_samples)
        samples, shown = surfels(self.seen.samples, tracer, normals), search.shown(found.palette)
        error = error_of_neighbors(found, samples, shown)
        self.report.neighbors_error = round(error, 4)
        predicted = error <= np.median(of_samples.residual)
        if not predicted:
            self._skip(Part.VOTES, Message("reason.light_changes_fast"))
        if varied is not None:
            lit, groups = varied.lit, groups_of_segments(varied.materials)
            pixels = varied.placed(self.seen, predicted)
            return CorrectableSegments(lit.light, lit.samples.radiance, varied.materials, groups, pixels)
        if predicted:
            points = labeled_pixels(
                found.palette, self.preset, samples, shown, rays, tracer, normals, self.seed, partial(search.excluded, found)
            )
            return self._correctable_palette(points)
        return self._correctable_palette(of_samples)

    def _correctable_palette(self, points: BlendedPoints) -> CorrectablePalette:
        found, count = self.found, len(self.found.palette) - self.found.palette.blends
        label = torch.where(found.label < count, found.label_of_fits, -1)
        palette = found.palette.pick(list(range(count)))
        return CorrectablePalette(LightMoments(**self.light.moments_state()), self.search.target, label, palette, points)

    def _finish_report(self, single: float, shares: list[float]) -> None:
        """Report what was learned; shares [K] are those of the palette's materials before they were blended."""
        report, palette = self.report, self.found.palette
        report.merged_shades = self.found.merged
        report.add_materials(palette.pick(list(range(len(shares)))), shares)
        report.evidence = self.found.account.report()
        report.residual_one_material, report.residual = round(single, 5), round(self._residual(), 5)
        report.cones_traced = self.light.traced.rays
        report.self_reflection_rays = hits = len(self.light.traced.hit_index)
        if hits == 0:
            self._skip(Part.INDIRECT_LIGHT, Message("reason.no_self_reflection"))

    def _skip(self, what: Part, why: Message, seconds: float | None = None) -> None:
        self.report.skipped[str(what)] = why.state()
        if seconds is not None:
            self.report.seconds_saved[str(what)] = round(seconds, 2)
