"""Stage 2: albedo, roughness and metallic of the surface from the photos, by the rendering equation over the mesh.

The mesh and F_e stand still, so primary hits, visibility and prefiltered light are computed once (`IncomingLight`). Then
one material is fitted for all, more are added while they explain clearly more (`material_palette`), and what the object
reflects of itself is brought up to date in between.
"""

from __future__ import annotations

import time
from collections.abc import Callable
from dataclasses import dataclass, field
from typing import TYPE_CHECKING

import numpy as np
import torch
from torch import Tensor

from blender_nep.errors import LearningError
from blender_nep.geometry.mesh import Surface
from blender_nep.geometry.ray_tracing import RayTracer
from blender_nep.materials.baking import LabelledPoints, bake, texture_size
from blender_nep.materials.labelled_points import error_of_neighbours, labelled_pixels, labelled_samples, surfels
from blender_nep.materials.palette import Palette
from blender_nep.materials.palette_search import PaletteSearch
from blender_nep.materials.photo_samples import PhotoSamples, select_samples
from blender_nep.materials.unseen_light_training import learn_unseen_light
from blender_nep.messages import Message, Part
from blender_nep.profiling import profiled
from blender_nep.shading.incoming_light import IncomingLight
from blender_nep.shading.plenoptic import PlenopticFunction, TerminalRadiance
from blender_nep.shading.unseen_light import UnseenLight

if TYPE_CHECKING:
    from blender_nep.capture.pixel_rays import PixelRays
    from blender_nep.fields.environment_field import EnvironmentField
    from blender_nep.presets import MaterialPreset


_NO_LIGHT = 0.02
"""Share of the light below which photos show none of it."""


@dataclass
class Materials:
    """Textures over the surface's UVs, row 0 = top (v = 1), linear float32."""

    albedo: np.ndarray
    """[H,W,3] Base Color"""
    roughness: np.ndarray
    """[H,W] Principled's"""
    metallic: np.ndarray
    """[H,W]"""
    confidence: np.ndarray
    """[H,W] 0..1"""
    unseen: UnseenLight | None = None
    """Light that no photo shows, to be added to F_e's where its coverage is missing"""
    report: dict = field(default_factory=dict)


def learn_materials(
    surface: Surface,
    environment: EnvironmentField,
    rays: PixelRays,
    preset: MaterialPreset,
    *,
    seed: int,
    device: torch.device | str,
    progress: Callable,
    checkpoint,
) -> Materials:
    """Textures of the surface. Raises LearningError when no photo shows it; Stopped on request.

    A resumed run goes on from the gathered light where that was saved, and ends with the same textures.
    """
    device = torch.device(device)
    learner = _MaterialLearner(surface, environment, rays, preset, seed, device, progress, checkpoint)
    return learner.run()


class _MaterialLearner:
    def __init__(self, surface, environment, rays, preset, seed, device, progress, checkpoint):
        self.surface, self.preset, self.device, self.rays, self.seed = surface, preset, device, rays, seed
        self.progress, self.checkpoint = progress, checkpoint
        self.generator = torch.Generator().manual_seed(seed)
        self.steps, self.done, self.loss, self.start = 100, 0, float("nan"), time.monotonic()
        self.state: dict = {}
        self.sure_of: Tensor | None = None
        """[K] metallic of the palette's materials, where the photos have told it clearly"""
        self.asking = 0.0
        """Seconds that it took to ask, the last time"""
        tracer = RayTracer(surface.vertices, surface.faces)
        self.samples: PhotoSamples = select_samples(
            rays,
            tracer,
            surface.normals,
            count=preset.samples,
            least_cosine=preset.least_cosine,
            generator=np.random.default_rng(seed),
        )
        self.footprint = self._footprint(rays)
        self.report: dict = {"samples": len(self.samples), "left_out": self.samples.skipped, "seconds": {}}
        self._clock("select")
        self.f_p = PlenopticFunction(
            tracer,
            surface.normals,
            environment,
            TerminalRadiance().to(device),
            levels=preset.levels,
            diffuse=preset.diffuse_cones,
            specular=preset.specular_cones,
            use_cones=preset.use_cones,
            device=device,
        )
        self.points = self.f_p.points(self.samples.face, self.samples.barycentric, self.samples.view)

    def run(self) -> Materials:
        """Light, one material, a palette, its places, textures."""
        preset = self.preset
        self._gather_light()
        search = self.search = PaletteSearch(self.samples, self.light, preset, self.device)
        if preset.residual and float(self.light.coverage.mean()) < _NO_LIGHT:
            self._begin_with_grey_light()
        search.fit_one()
        self._reflect_itself()
        search.fit_one()
        single = self._residual()
        self._grow_palette()
        for k in range(preset.rounds):
            self._find_unseen_light()
            self._grow_palette()
            self._step(75 + 5 * k)
        self._reflect_itself()
        for k in range(preset.rounds):
            self._find_unseen_light()
            search.merge_shades()
            search.drop_superfluous()
            search.assign()
            self._step(85 + 5 * k)
        self._clock("materials")
        wanted = texture_size(self.surface, self.footprint, preset.most_texels)
        size = min(wanted, preset.uniform_texels) if len(search.palette) == 1 else wanted
        self._finish_report(single, size)
        search.palette = search.palette.with_blends()
        search.assign()
        textures = bake(self.surface, self._evidence(), search.palette, size)
        self._clock("textures")
        if size < wanted:
            self._skip(
                Part.FINE_TEXTURES,
                Message("reason.one_material"),
                self.report["seconds"]["textures"] * ((wanted / size) ** 2 - 1),
            )
        self._step(100)
        if not all(np.isfinite(x).all() for x in textures):
            message = "material learning diverged: its textures are not finite"
            raise LearningError(message, "try another --seed", "learning.diverged")
        return Materials(*textures, self.light.unseen, self.report)

    def _gather_light(self) -> None:
        """The terminal MLP and the prefiltered light: the long part, which a resumed run takes from the checkpoint."""
        saved = self.checkpoint.load() or {}
        if "light" in saved:
            self.f_p.terminal.load_state_dict(saved["terminal"])
            self.light = IncomingLight.restored(self.f_p, self.points, self.preset.roughness_levels, saved["light"])
            self.generator.set_state(saved["generator"])
        else:
            if self.preset.levels > 0:
                self._learn_terminal()
            self.light = IncomingLight.gathered(
                self.f_p,
                self.points,
                self.preset.roughness_levels,
                self.preset.irradiance_cones,
                self.generator,
                lambda share: self._step(10 + int(60 * share)),
            )
        self.state = {
            "terminal": self.f_p.terminal.state_dict(),
            "light": self.light.state(),
            "generator": self.generator.get_state(),
        }
        self._step(70)
        self._clock("light")

    def _grow_palette(self) -> None:
        self.search.grow(lambda: self._step(75))

    def _metallic_swapped(self) -> Palette | None:
        """The palette's materials the other way round (metal or not); None where it is known what they are."""
        if len(self.preset.metallic) == 1:
            return None
        if self.sure_of is not None and torch.equal(self.sure_of, self.search.palette.metallic):
            before = self.report.get("seconds_saved", {}).get(Part.METAL_AGAIN, 0.0)
            self._skip(Part.METAL_AGAIN, Message("reason.metal_known"), before + self.asking)
            return None
        return self.search.metallic_swapped()

    def _residual(self) -> float:
        self.loss = self.search.residual()
        return self.loss

    def _reflect_itself(self) -> None:
        self.light.update(self.search.materials_at, self.generator)
        self._residual()

    @profiled("terminal MLP")
    def _learn_terminal(self) -> None:
        """MLP(x, d) from the photos: what they show of the surface is the radiance it sends out."""
        net, p = self.f_p.terminal, self.preset
        with torch.random.fork_rng(devices=[]):
            torch.manual_seed(int(torch.randint(1 << 30, (1,), generator=self.generator)))
            net.load_state_dict(TerminalRadiance().state_dict())
        optimiser = torch.optim.Adam(net.parameters(), 3e-3)
        goal = torch.log1p(4 * self.samples.radiance)
        for k in range(p.terminal_steps):
            batch = torch.randint(len(goal), (4096,), generator=self.generator).to(self.device)
            loss = (net.log_radiance(self.points[batch]) - goal[batch]).abs().mean()
            optimiser.zero_grad()
            loss.backward()
            optimiser.step()
            if k % 20 == 0:
                self.loss = loss.item()
                self._step(int(10 * k / p.terminal_steps))
        self._clock("terminal")

    def _begin_with_grey_light(self) -> None:
        """The photos are cut-outs: in no light at all every material is as good as another."""
        self._add_unseen_light(2 * float(self.samples.radiance.mean(-1).median()))
        self.light.add_unseen()

    def _add_unseen_light(self, radiance: float) -> None:
        self.light.unseen = UnseenLight(self.preset.unseen_rows, self.f_p.environment.typical_distance(), self.device)
        self.light.unseen.radiance += radiance
        self.f_p.unseen = self.light.unseen
        self.report["unseen_light_radius"] = round(self.light.unseen.radius, 3)

    def _find_unseen_light(self) -> None:
        """Light that no photo shows, under the present materials; how far away it is, the first time."""
        p, light, search = self.preset, self.light, self.search
        uncovered = float(1 - light.coverage.mean())
        self.report["light_not_in_photos"] = round(uncovered, 4)
        if not p.residual or uncovered < 0.005:
            self._skip(Part.RESIDUAL, Message("reason.light_seen") if p.residual else Message("reason.preset"))
            return
        if light.unseen is None:
            self._add_unseen_light(0.0)
        trials, start = [], time.monotonic()

        def tried() -> None:
            trials.append(time.monotonic())
            self._step(self.done)

        others = self._metallic_swapped()
        scan = time.monotonic() - start
        light.unseen, search.palette, margins = learn_unseen_light(
            light, search.palette, others, search.label, search.target, p, self.generator, tried
        )
        if margins:
            self.report["metal_or_not_margin"] = round(min(margins), 4)
            self.sure_of = search.palette.metallic if min(margins) >= p.sure_margin else None
            self.asking = scan + trials[len(margins)] - trials[0]
        self.f_p.unseen = light.unseen
        light.add_unseen()
        self._residual()
        search.weight = torch.ones_like(search.weight)

    def _evidence(self) -> LabelledPoints:
        """Of all pixels, if the light of the samples tells that of the others."""
        search, tracer, normals = self.search, self.f_p.tracer, self.surface.normals
        of_samples = labelled_samples(search)
        if len(search.palette) == 1:
            self._skip(Part.VOTES, Message("reason.one_material"))
            return of_samples
        samples, shown = surfels(self.samples, tracer, normals), search.shown()
        error = error_of_neighbours(search, samples, shown)
        self.report["neighbours_error"] = round(error, 4)
        if error <= np.median(of_samples.residual):
            return labelled_pixels(search, samples, shown, self.rays, tracer, normals, self.seed)
        self._skip(Part.VOTES, Message("reason.light_changes_fast"))
        return of_samples

    def _footprint(self, rays: PixelRays) -> float:
        """Median width of a pixel on the surface, unit frame."""
        first = rays.sphere[:: max(1, len(rays.sphere) // 1000)]
        origin, _, angle = rays.rays(first)
        return float((1.77 * angle * origin.norm(dim=-1)).median())

    def _finish_report(self, single: float, size: int) -> None:
        palette, share = self.search.palette, self.search.shares()
        if self.search.merged:
            self.report["merged_shades"] = self.search.merged
        self.report["materials"] = [
            {
                "share": round(float(s), 4),
                "albedo": [round(x, 4) for x in a.tolist()],
                "roughness": round(float(r), 4),
                "metallic": float(m),
            }
            for s, a, r, m in zip(share, palette.albedo, palette.roughness, palette.metallic, strict=True)
        ]
        self.report["residual_one_material"], self.report["residual"] = round(single, 5), round(self._residual(), 5)
        self.report["texture_texels"] = size
        self.report["cones_traced"] = self.light.rays
        hits = len(self.light.hit_index)
        self.report["self_reflection_rays"] = hits
        if hits == 0:
            self._skip(Part.INDIRECT_LIGHT, Message("reason.no_self_reflection"))
        if len(palette) == 1:
            self._skip(Part.MATERIAL_BOUNDARIES, Message("reason.one_material"))

    def _skip(self, what: Part, why: Message, seconds: float | None = None) -> None:
        self.report.setdefault("skipped", {})[str(what)] = why.state()
        if seconds is not None:
            self.report.setdefault("seconds_saved", {})[str(what)] = round(seconds, 2)

    def _step(self, step: int) -> None:
        self.done = step
        # Before the light is gathered there is nothing worth keeping; a resumed job repeats what follows it.
        if self.checkpoint.due():
            self.checkpoint.save(self.state)
        self.progress(step, self.steps, self.loss)

    def _clock(self, name: str) -> None:
        now = time.monotonic()
        self.report["seconds"][name] = round(now - self.start, 2)
        self.start = now
