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
from scipy.spatial import cKDTree
from torch import Tensor

from blender_nep.errors import LearningError
from blender_nep.material_palette import Palette, best_of, choose, error, fit_groups, same_material, tone
from blender_nep.material_textures import (
    NEIGHBOURS,
    Evidence,
    bake,
    labels_at,
    neighbours,
    texture_size,
    vote,
    weighted_mean,
)
from blender_nep.photo_samples import PhotoSamples, select_samples
from blender_nep.pixel_votes import Surfels, left_out_error, pixel_costs
from blender_nep.profile import profiled, section
from blender_nep.raytracing import RayTracer
from blender_nep.shading.incoming_light import IncomingLight
from blender_nep.shading.plenoptic import Material, PlenopticFunction, SurfacePoints, TerminalRadiance, reflected
from blender_nep.shading.unseen_light import UnseenLight
from blender_nep.surface import Surface
from blender_nep.unseen_light_learning import learn_unseen_light

if TYPE_CHECKING:
    from blender_nep.capture.rays import PixelRays
    from blender_nep.fields.environment_field import EnvironmentField
    from blender_nep.presets import MaterialPreset


_SHADES = 2.5
"""Albedo that a dielectric may seem to have where F_e is too dark, until shades of one hue are merged."""
_NO_LIGHT = 0.02
"""Share of the light below which photos show none of it."""
_ASKING = "asking again whether it is metal"


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


def learn_materials(surface: Surface, environment: EnvironmentField, rays: PixelRays, preset: MaterialPreset, *,
                    seed: int, device: torch.device | str, progress: Callable, checkpoint) -> Materials:
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
            rays, tracer, surface.normals, count=preset.samples, least_cosine=preset.least_cosine,
            generator=np.random.default_rng(seed))
        self.footprint = self._footprint(rays)
        self.report: dict = {"samples": len(self.samples), "left_out": self.samples.skipped, "seconds": {}}
        self._clock("select")
        self.f_p = PlenopticFunction(
            tracer, surface.normals, environment, TerminalRadiance().to(device), levels=preset.levels,
            diffuse=preset.diffuse_cones, specular=preset.specular_cones, use_cones=preset.use_cones, device=device)
        self.points = self.f_p.points(self.samples.face, self.samples.barycentric, self.samples.view)
        self.target = self.samples.radiance
        self.tree = cKDTree(self.samples.position)
        self.around = neighbours(self.tree, self.samples.position, 2 * NEIGHBOURS)

    def run(self) -> Materials:
        """Light, one material, a palette, its places, textures."""
        preset = self.preset
        self._gather_light()
        n = len(self.samples)
        self.label = torch.zeros(n, dtype=torch.int64, device=self.device)
        self.weight = 0.05 + self.light.coverage[:, : len(preset.ladder) // 2].mean(1)
        if preset.residual and float(self.light.coverage.mean()) < _NO_LIGHT:
            self._begin_with_grey_light()
        self.palette = self._fit(self.label, 1)
        self._reflect_itself()
        self.palette = self._fit(self.label, 1)
        single = self._residual()
        self._grow_palette()
        for k in range(preset.rounds):
            self._find_unseen_light()
            self._grow_palette()
            self._step(75 + 5 * k)
        self._reflect_itself()
        for k in range(preset.rounds):
            self._find_unseen_light()
            self._merge_shades()
            self._drop_superfluous()
            self._assign()
            self._step(85 + 5 * k)
        self._clock("materials")
        wanted = texture_size(self.surface, self.footprint, preset.most_texels)
        size = min(wanted, preset.uniform_texels) if len(self.palette) == 1 else wanted
        self._finish_report(single, size)
        self.palette = self.palette.with_blends()
        self._assign()
        textures = bake(self.surface, self._evidence(), self.palette, size)
        self._clock("textures")
        if size < wanted:
            self._skip("fine textures", "one material explains the photos",
                       self.report["seconds"]["textures"] * ((wanted / size) ** 2 - 1))
        self._step(100)
        if not all(np.isfinite(x).all() for x in textures):
            raise LearningError("material learning diverged: its textures are not finite", "try another --seed")
        return Materials(*textures, self.light.unseen, self.report)

    def _gather_light(self) -> None:
        """The terminal MLP and the prefiltered light: the long part, which a resumed run takes from the checkpoint."""
        saved = self.checkpoint.load() or {}
        if "light" in saved:
            self.f_p.terminal.load_state_dict(saved["terminal"])
            self.light = IncomingLight.restored(self.f_p, self.points, self.preset.ladder, saved["light"])
            self.generator.set_state(saved["generator"])
        else:
            if self.preset.levels > 0:
                self._learn_terminal()
            self.light = IncomingLight.gathered(self.f_p, self.points, self.preset.ladder,
                                                self.preset.irradiance_cones, self.generator,
                                                lambda share: self._step(10 + int(60 * share)))
        self.state = {"terminal": self.f_p.terminal.state_dict(), "light": self.light.state(),
                      "generator": self.generator.get_state()}
        self._step(70)
        self._clock("light")

    def _scan(self, group: Tensor, groups: int, most_diffuse: float = 1.0) -> tuple[Tensor, Tensor]:
        p = self.preset
        return fit_groups(self.light, self.target, self.weight, group, groups, clip=p.clip,
                          least_roughness=p.least_roughness, hypotheses=p.metallic, most_diffuse=most_diffuse)

    def _fit(self, group: Tensor, groups: int, most_diffuse: float = 1.0) -> Palette:
        p = self.preset
        return best_of(*self._scan(group, groups, most_diffuse), p.least_roughness, p.metallic, p.metal_margin)

    def _opposites(self) -> Palette | None:
        """Each material of the palette as it would be if it were metal instead of a dielectric, or the reverse; None where
        it is known what they are."""
        p, opposite = self.preset, self.palette
        if len(p.metallic) == 1:
            return None
        if self.sure_of is not None and torch.equal(self.sure_of, self.palette.metallic):
            before = self.report.get("seconds_saved", {}).get(_ASKING, 0.0)
            self._skip(_ASKING, "the photos have told it clearly", before + self.asking)
            return None
        cost, albedo = self._scan(self.label, len(self.palette))
        for i, metallic in enumerate(p.metallic):
            found = best_of(cost[i:i + 1], albedo[i:i + 1], p.least_roughness, (metallic,), 0.0)
            for k in (self.palette.metallic != metallic).nonzero().squeeze(-1).tolist():
                opposite = opposite.with_one(k, found)
        return opposite

    def _grow_palette(self) -> None:
        """Candidates from small regions of the surface; greedy choice; then every sample takes its best."""
        p = self.preset
        if p.most_materials == 1:
            return
        voxel = np.floor(self.samples.position / p.region).astype(np.int64)
        _, inverse, count = np.unique(voxel, axis=0, return_inverse=True, return_counts=True)
        group, groups = torch.from_numpy(inverse.ravel()).to(self.device), len(count)
        regional = self._fit(group, groups, _SHADES)
        size = torch.zeros(groups, device=self.device).index_add_(0, group, self.weight)
        large = np.flatnonzero(count >= max(20, np.median(count) / 2))
        if len(large) > p.candidates:
            large = large[np.argsort(-count[large])[: p.candidates]]
        candidates = _join(self.palette, regional.pick(large.tolist()))
        cost = torch.stack([self._by_group(self._error(candidates, k), group, groups) for k in range(len(candidates))])
        chosen = choose(cost / size.clamp_min(1e-9), size, p.most_materials, p.gain)
        self._step(75)
        self.palette = candidates.pick(chosen)
        self._assign()
        # A material that hardly any sample takes is an artefact of a badly lit corner.
        for _ in range(2):
            share = torch.bincount(self.label, minlength=len(self.palette)) / len(self.label)
            keep = (share >= p.least_share).nonzero().squeeze(-1).tolist() or [int(share.argmax())]
            self.palette = self.palette.pick(keep)
            self._assign()
            self.palette = self._fit(self.label, len(self.palette), _SHADES)
            self._assign()
        self._merge_shades()
        self._drop_superfluous()

    def _drop_superfluous(self) -> None:
        """Without the materials that explain hardly more than the others and their blends, as soft boundaries do."""
        for k in torch.bincount(self.label, minlength=len(self.palette)).argsort().tolist():
            if len(self.palette) == 1:
                return
            others = self.palette.pick([j for j in range(len(self.palette)) if j != k])
            with_it, without = (self._left_out(palette.with_blends()) for palette in (self.palette, others))
            if without <= (1 + self.preset.gain) * with_it:
                self.palette = others
                self._assign()
                self._drop_superfluous()
                return

    def _merge_shades(self) -> None:
        """Materials of one hue become one: a difference in brightness alone is more likely F_e's than the object's."""
        share = torch.bincount(self.label, minlength=len(self.palette)).float()
        into = same_material(self.palette, share, self.preset.merge_hue, self.preset.merge_roughness)
        kept = sorted(set(into))
        if len(kept) < len(self.palette):
            self.report["merged_shades"] = len(self.palette) - len(kept)
            self.label = torch.tensor([kept.index(k) for k in into], device=self.device)[self.label]
        self.palette = self._fit(self.label, len(kept))

    def _error(self, palette: Palette, k: int) -> Tensor:
        one = torch.tensor([k], device=self.device)
        return error(self.light, self.target, self.weight, palette.at(one), self.preset.clip)

    @profiled("residuals")
    def _costs(self, palette: Palette | None = None) -> Tensor:
        """[n,K]; a blend must be better than a material alone by a margin."""
        palette = self.palette if palette is None else palette
        costs = torch.stack([self._error(palette, k) for k in range(len(palette))], 1)
        return costs * torch.where(palette.blended, 1 + self.preset.blend_margin, 1.0)

    def _left_out(self, palette: Palette) -> float:
        """Mean residual of every sample under the material that its neighbours vote for without it: what a material gains
        by fitting the noise does not count."""
        costs = self._costs(palette).cpu().numpy()
        label = self._smoothed(costs, first=1).argmin(1)
        return float(costs[np.arange(len(label)), label].mean())

    @profiled("votes")
    def _smoothed(self, costs: np.ndarray, first: int = 0) -> np.ndarray:
        """Means over each sample's neighbours from the `first` on (0: itself), near ones counting more."""
        return weighted_mean(costs, *(values[:, first:] for values in self.around))

    def _assign(self) -> None:
        if len(self.palette) == 1:
            self.label.zero_()
            return
        costs = self._costs().cpu().numpy()
        with section("votes"):
            self.label = torch.from_numpy(vote(costs, *self.around)).to(self.device)

    def _residual(self) -> float:
        own = self._costs().gather(1, self.label[:, None])
        self.loss = float(own.sum() / self.weight.sum())
        return self.loss

    def _by_group(self, values: Tensor, group: Tensor, groups: int) -> Tensor:
        return torch.zeros(groups, device=self.device).index_add_(0, group, values)

    def _materials_at(self, points: SurfacePoints) -> Material:
        return self.palette.at(labels_at(self.tree, self.label, points.position))

    def _reflect_itself(self) -> None:
        self.light.update(self._materials_at, self.generator)
        self._residual()

    @profiled("terminal MLP")
    def _learn_terminal(self) -> None:
        """MLP(x, d) from the photos: what they show of the surface is the radiance it sends out."""
        net, p = self.f_p.terminal, self.preset
        with torch.random.fork_rng(devices=[]):
            torch.manual_seed(int(torch.randint(1 << 30, (1,), generator=self.generator)))
            net.load_state_dict(TerminalRadiance().state_dict())
        optimiser = torch.optim.Adam(net.parameters(), 3e-3)
        goal = torch.log1p(4 * self.target)
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
        self._add_unseen_light(2 * float(self.target.mean(-1).median()))
        self.light.add_unseen()

    def _add_unseen_light(self, radiance: float) -> None:
        self.light.unseen = UnseenLight(self.preset.unseen_rows, self.f_p.environment.typical_distance(), self.device)
        self.light.unseen.radiance += radiance
        self.f_p.unseen = self.light.unseen
        self.report["unseen_light_radius"] = round(self.light.unseen.radius, 3)

    def _find_unseen_light(self) -> None:
        """Light that no photo shows, under the present materials; how far away it is, the first time."""
        p, light = self.preset, self.light
        uncovered = float(1 - light.coverage.mean())
        self.report["light_not_in_photos"] = round(uncovered, 4)
        if not p.residual or uncovered < 0.005:
            why = "all light that matters was seen by the photos" if p.residual else "turned off by the preset"
            self._skip("residual", why)
            return
        if light.unseen is None:
            self._add_unseen_light(0.0)
        trials, start = [], time.monotonic()

        def tried() -> None:
            trials.append(time.monotonic())
            self._step(self.done)

        others = self._opposites()
        scan = time.monotonic() - start
        light.unseen, self.palette, margins = learn_unseen_light(
            light, self.palette, others, self.label, self.target, p, self.generator, tried)
        if margins:
            self.report["metal_or_not_margin"] = round(min(margins), 4)
            self.sure_of = self.palette.metallic if min(margins) >= p.sure_margin else None
            self.asking = scan + trials[len(margins)] - trials[0]
        self.f_p.unseen = light.unseen
        light.add_unseen()
        self._residual()
        self.weight = torch.ones_like(self.weight)

    def _evidence(self) -> Evidence:
        """Of far more pixels than the light was gathered for, where the light of those tells that of the others: boundaries
        are then as sharp as the photos."""
        cost = self._costs().cpu().numpy()
        label, photo = self.label.cpu().numpy(), self.samples.photo.cpu().numpy()
        own = cost[np.arange(len(label)), label] / self.weight.cpu().numpy()
        skipped = self.report.setdefault("skipped", {})
        if len(self.palette) == 1:
            skipped["votes of all pixels"] = "one material explains the photos"
        else:
            shown = torch.stack([self._shown(k) for k in range(len(self.palette))], 1).cpu().numpy()
            samples = Surfels(self.samples.position, self._normals_at(self.samples), photo)
            left_out = left_out_error(samples, shown)[np.arange(len(label)), label]
            self.report["neighbours_error"] = round(float(np.median(left_out)), 4)
            if np.median(left_out) <= np.median(own):
                return self._evidence_of_pixels(samples, shown)
            skipped["votes of all pixels"] = "light changes too fast between the samples of a photo"
        return Evidence(self.samples.position, photo, self._smoothed(cost),
                        self.palette.albedo[self.label].cpu().numpy(), own)

    @profiled("votes of all pixels")
    def _evidence_of_pixels(self, samples: Surfels, shown: np.ndarray) -> Evidence:
        p, palette = self.preset, self.palette
        voters = select_samples(self.rays, self.f_p.tracer, self.surface.normals, count=p.voters,
                                least_cosine=p.least_cosine, generator=np.random.default_rng(self.seed))
        pixels = Surfels(voters.position, self._normals_at(voters), voters.photo.cpu().numpy())
        cost = pixel_costs(samples, shown, pixels, tone(voters.radiance).cpu().numpy(), p.clip)
        cost = cost * torch.where(palette.blended, 1 + p.blend_margin, 1.0).cpu().numpy()
        smoothed = weighted_mean(cost, *neighbours(cKDTree(pixels.position), pixels.position, 2 * NEIGHBOURS))
        label = smoothed.argmin(1)
        return Evidence(pixels.position, pixels.photo, smoothed, palette.albedo.cpu().numpy()[label],
                        cost[np.arange(len(cost)), label])

    def _normals_at(self, samples: PhotoSamples) -> np.ndarray:
        return self.f_p.tracer.smooth_normals(self.surface.normals, samples.face, samples.barycentric)

    def _shown(self, k: int) -> Tensor:
        """What each sample would show, tone-mapped, if it were the k-th material [n,3]."""
        material = self.palette.at(torch.full((len(self.samples),), k, device=self.device))
        return tone(reflected(material, self.light.moments(material.roughness), self.light.diffuse, self.light.cos_v))

    def _footprint(self, rays: PixelRays) -> float:
        """Median width of a pixel on the surface, unit frame."""
        first = rays.sphere[:: max(1, len(rays.sphere) // 1000)]
        origin, _, angle = rays.rays(first)
        return float((1.77 * angle * origin.norm(dim=-1)).median())

    def _finish_report(self, single: float, size: int) -> None:
        palette, share = self.palette, torch.bincount(self.label, minlength=len(self.palette)) / len(self.label)
        self.report["materials"] = [
            {"share": round(float(s), 4), "albedo": [round(x, 4) for x in a.tolist()], "roughness": round(float(r), 4),
             "metallic": float(m)}
            for s, a, r, m in zip(share, palette.albedo, palette.roughness, palette.metallic, strict=True)]
        self.report["residual_one_material"], self.report["residual"] = round(single, 5), round(self._residual(), 5)
        self.report["texture_texels"] = size
        self.report["cones_traced"] = self.light.rays
        hits = len(self.light.slot)
        self.report["self_reflection_rays"] = hits
        if hits == 0:
            self._skip("indirect light", "the object cannot see itself")
        if len(palette) == 1:
            self._skip("material boundaries", "one material explains the photos")

    def _skip(self, what: str, why: str, seconds: float | None = None) -> None:
        self.report.setdefault("skipped", {})[what] = why
        if seconds is not None:
            self.report.setdefault("seconds_saved", {})[what] = round(seconds, 2)

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


def _join(a: Palette, b: Palette) -> Palette:
    return Palette(torch.cat([a.albedo, b.albedo]), torch.cat([a.roughness, b.roughness]),
                   torch.cat([a.metallic, b.metallic]))
