"""Stage 1, fields learning: the object field F_o and the environment field F_e, rendered together and learned jointly
from the photos alone (Sec. 3.2).

A ray that meets the object's border, the unit sphere, is rendered in three parts: environment before it, object in it,
environment behind it. Masks help where they are given and are never required.
"""

from __future__ import annotations

from dataclasses import dataclass

import torch
from torch.nn import functional

from blender_nep.capture.rays import PixelRays
from blender_nep.errors import LearningError, Stopped
from blender_nep.fields import environment_learning
from blender_nep.fields.environment_field import EnvironmentField
from blender_nep.fields.object_field import Appearance, ObjectField
from blender_nep.fields.optimiser import UniformAdam
from blender_nep.fields.volume_rendering import render_surface, sphere_interval
from blender_nep.metrics import tone_map
from blender_nep.ops import bspline
from blender_nep.presets import Preset
from blender_nep.raytracing import RayTracer
from blender_nep.surface import Surface

PATIENCE = 20
"""Steps in a row that may fail to give a finite loss before learning is given up."""


@dataclass
class Fields:
    """What stage 1 has learned. `object_field` is None when a mesh was given and F_e was learned alone."""

    object_field: ObjectField | None
    environment: EnvironmentField
    report: dict

    def state(self) -> dict:
        """As a dict of tensors and numbers, for the disk."""
        objects = None
        if self.object_field is not None:
            objects = {"levels": len(self.object_field.levels), "weights": self.object_field.state_dict()}
        return {"object": objects, "environment": self.environment.state_dict(), "report": self.report}

    @classmethod
    def from_state(cls, state: dict, preset: Preset, device: torch.device) -> Fields:
        """The inverse of `state`."""
        environment = EnvironmentField(preset.environment).to(device)
        environment.load_state_dict(state["environment"])
        field = None
        if state["object"] is not None:
            field = _object_field(preset, device)
            for _ in range(state["object"]["levels"] - 1):
                field.add_level()
            field.load_state_dict(state["object"]["weights"])
        return cls(field, environment, state["report"])


def _object_field(preset: Preset, device: torch.device) -> ObjectField:
    p = preset.fields
    return ObjectField(p.coarsest_cells, p.initial_radius, p.head_width).to(device)


@dataclass
class Rendering:
    """Rays rendered through both fields: radiance [n, 3], object opacity [n], loss weight [n, 1] (the paper's w_l)."""

    radiance: torch.Tensor
    opacity: torch.Tensor
    weight: torch.Tensor
    eikonal: torch.Tensor
    curvature: torch.Tensor


def dynamic_weight(appearance: Appearance, kind: str, cap: float = 1.5, epsilon: float = 1e-3) -> torch.Tensor:
    """The paper's w_s (eq. 5) [n, 1]: small where the colour differs much from the albedo, as in reflections. Detached:
    else growing |c_o - c_a| would lower the loss.

    `paper`: as printed. `scaled`: the difference in tone-mapped space, relative to the batch's own spread, because as
    printed the weight leaves its cap only where |c_o - c_a| > 0.816. `none`: 1.
    """
    colour, albedo = appearance.colour.detach(), appearance.albedo.detach()
    if kind == "none":
        return torch.ones_like(colour[:, :1])
    if kind == "paper":
        square = ((colour - albedo) ** 2).mean(-1, keepdim=True)
    else:
        square = ((tone_map(colour) - tone_map(albedo)) ** 2).mean(-1, keepdim=True)
        square = square / square.mean().clamp(min=1e-6)
    return (1 / (square + epsilon)).clamp(max=cap)


class FieldsLearning:
    """The state of stage 1: fields, optimisers, step."""

    def __init__(self, rays: PixelRays, preset: Preset, seed: int, device: torch.device) -> None:
        torch.manual_seed(seed)
        self.rays, self.preset, self.device = rays, preset.fields, device
        self.generator = torch.Generator(device).manual_seed(seed)
        self.environment = EnvironmentField(preset.environment, environment_learning.geometric_mean(rays)).to(device)
        self.object_field = _object_field(preset, device)
        preset = preset.fields
        self.step, self.loss = 0, float("nan")
        self.failed = 0
        heads = [*self.object_field.surface_head.parameters(), *self.object_field.light_head.parameters()]
        self.head_optimiser = torch.optim.Adam(heads, lr=preset.head_rate, betas=(0.9, 0.99), fused=True)
        self._set_levels(preset.first_levels)
        self._refine_environment()

    def _set_levels(self, count: int) -> None:
        while len(self.object_field.levels) < count:
            self.object_field.add_level()
        self.sdf_optimiser = UniformAdam(self.object_field.levels, lr=self.preset.sdf_rate)

    def _refine_environment(self) -> None:
        if self.environment.refine(self.step / self.preset.steps) or self.step == 0:
            self.environment_optimiser = environment_learning.optimiser(self.environment)

    @property
    def sharpness(self) -> float:
        """NeuS sharpness, 1 / unit length, at this step: rises geometrically, then stays."""
        p = self.preset
        rise = min(self.step / (p.sharpness_until * p.steps), 1.0)
        return p.first_sharpness * (p.last_sharpness / p.first_sharpness) ** rise

    def render(self, origins: torch.Tensor, directions: torch.Tensor, half_angle: torch.Tensor,
               generator: torch.Generator | None) -> Rendering:
        """Radiance of rays through both fields. All rays [n, 3] may or may not meet the sphere."""
        p = self.preset
        samples = p.first_samples if self.step < p.coarse_until * p.steps else p.samples
        entry, leave = sphere_interval(origins, directions)
        meets = (leave > entry).nonzero()[:, 0]
        near = torch.full_like(entry, p.near)
        infinity = torch.full_like(entry, torch.inf)
        n = len(entry)
        # front parts of all rays (whole rays for those that miss), then back parts of those that meet the sphere
        part = torch.cat([torch.arange(n, device=self.device), meets])
        start = torch.cat([near, leave[meets]])
        end = torch.cat([torch.where(leave > entry, entry, infinity), infinity[meets]])
        radiance, transmittance = self.environment.render(origins[part], directions[part], start, end,
                                                          half_angle[part], generator)
        front, back = radiance[:n], radiance[n:]
        through = transmittance[:n, None]

        coefficients = self.object_field.coefficients()
        surface = render_surface(coefficients, origins[meets], directions[meets], self.sharpness, samples, generator)
        normal = functional.normalize(surface.gradient, dim=-1, eps=1e-6)
        appearance = self.object_field.appearance(surface.point, normal, directions[meets[surface.ray]])
        opacity = surface.opacity.clamp(max=1)
        inside = back.index_add(0, surface.ray, opacity[:, None] * (appearance.colour - back[surface.ray]))
        total = front.index_add(0, meets, through[meets] * inside)
        ray = meets[surface.ray]
        opacities = torch.zeros(n, device=self.device).index_add(0, ray, opacity)
        w_s = dynamic_weight(appearance, p.dynamic_weight)
        weight = torch.ones(n, 1, device=self.device).index_add(0, ray, opacity.detach()[:, None] * (w_s - 1))
        hessian = bspline.sample(coefficients, surface.point.detach().clamp(-1, 1), hessian=True)[:, 4:]
        bending = (hessian[:, :3] ** 2).sum(1) + 2 * (hessian[:, 3:] ** 2).sum(1)
        return Rendering(total, opacities, weight,
                         ((surface.sdf_gradient.norm(dim=-1) - 1) ** 2).mean() if len(ray) else total.sum() * 0,
                         (bending + 1).sqrt().mean() if len(ray) else total.sum() * 0)

    def learn_step(self) -> float:
        """One optimisation step; returns the loss."""
        p, rays = self.preset, self.rays
        if self.step == int(p.fine_from * p.steps):
            self._set_levels(p.last_levels)
        self._refine_environment()
        pick = [pool[torch.randint(len(pool), (count,), generator=self.generator, device=self.device)]
                for pool, count in ((rays.sphere, p.sphere_rays), (rays.outside, p.outside_rays)) if len(pool)]
        index = torch.cat(pick)
        origins, directions, half_angle = rays.rays(index)
        target = tone_map(rays.radiance[index].float())
        out = self.render(origins, directions, half_angle, self.generator)
        photometric = (out.weight * (tone_map(out.radiance) - target).abs()).mean()
        stiffness = p.curvature * (self.sharpness / p.first_sharpness) ** 0.5
        loss = (photometric + p.eikonal * out.eikonal + stiffness * out.curvature
                + self.environment.regularisation(self.generator))
        if rays.mask is not None and p.mask > 0:
            mask = rays.mask[index].float() / 255
            loss = loss + p.mask * functional.binary_cross_entropy(out.opacity.clamp(1e-4, 1 - 1e-4), mask)
        warm = min(1.0, (self.step + 1) / 50) * 0.1 ** max(0.0, (self.step / p.steps - 0.3) / 0.7)
        # a sharper surface answers to smaller steps
        for group in self.sdf_optimiser.param_groups:
            group["lr"] = p.sdf_rate * warm * (p.first_sharpness / self.sharpness) ** 0.5
        for group in self.head_optimiser.param_groups:
            group["lr"] = p.head_rate * warm
        for group in self.environment_optimiser.param_groups:
            group["lr"] = environment_learning.learning_rate(self.environment.preset, self.step / p.steps)
        optimisers = (self.sdf_optimiser, self.head_optimiser, self.environment_optimiser)
        for optimiser in optimisers:
            optimiser.zero_grad()
        value = float(loss.detach())
        if value == value and abs(value) < 1e6:
            loss.backward()
            for optimiser in optimisers:
                optimiser.step()
            self.failed = 0
        else:
            self.failed += 1
            if self.failed >= PATIENCE:
                raise LearningError(
                    "The photometric loss is not finite.",
                    "Check the photos for extreme values and the object sphere with `blender-nep info`.")
        self.step += 1
        self.loss = float(photometric.detach())
        return self.loss

    @torch.no_grad()
    def evidence(self, pixels: int = 16384) -> float:
        """How much better the object explains the pixels that it covers than F_e alone would, if it were not there: the
        ratio of their mean tone-mapped errors. Near 1: the sphere is empty. 0 where no pixel is covered."""
        pick = torch.randint(len(self.rays.sphere), (pixels,), generator=self.generator, device=self.device)
        index = self.rays.sphere[pick]
        origins, directions, half_angle = self.rays.rays(index)
        surface = render_surface(self.object_field.coefficients(), origins, directions, self.sharpness,
                                 self.preset.samples, None)
        solid = surface.opacity > 0.9
        ray = surface.ray[solid]
        if len(ray) < 0.001 * pixels:
            return 0.0
        normal = functional.normalize(surface.gradient[solid], dim=-1, eps=1e-6)
        colour = self.object_field.appearance(surface.point[solid], normal, directions[ray]).colour
        near = torch.full((len(ray),), self.preset.near, device=self.device)
        behind, _ = self.environment.render(origins[ray], directions[ray], near, torch.full_like(near, torch.inf),
                                            half_angle[ray], None)
        photo = tone_map(self.rays.radiance[index[ray]].float())
        error = (tone_map(colour) - photo).abs().mean().clamp(min=1e-6)
        return float((tone_map(behind) - photo).abs().mean() / error)

    def state(self) -> dict:
        """Everything that a resumed run needs."""
        return {"step": self.step, "loss": self.loss,
                "levels": len(self.object_field.levels), "object": self.object_field.state_dict(),
                "environment": self.environment.state_dict(), "sdf_optimiser": self.sdf_optimiser.state_dict(),
                "head_optimiser": self.head_optimiser.state_dict(),
                "environment_optimiser": self.environment_optimiser.state_dict(),
                "generator": self.generator.get_state()}

    def load(self, state: dict) -> None:
        """Go on from `state`."""
        self.step, self.loss = state["step"], state["loss"]
        self._set_levels(state["levels"])
        self.object_field.load_state_dict(state["object"])
        self.environment.load_state_dict(state["environment"])
        self.environment_optimiser = environment_learning.optimiser(self.environment)
        self.sdf_optimiser.load_state_dict(state["sdf_optimiser"])
        self.head_optimiser.load_state_dict(state["head_optimiser"])
        self.environment_optimiser.load_state_dict(state["environment_optimiser"])
        self.generator.set_state(state["generator"])


def learn_fields(rays: PixelRays, preset: Preset, *, seed: int, device: torch.device, progress, checkpoint,
                 surface: Surface | None = None) -> Fields:
    """Learns F_o and F_e from the photos (Sec. 3.2). With `surface` (a known mesh in the unit frame) F_e alone, from the
    pixels whose rays miss the mesh.

    progress(step, steps, loss) is called after every step; checkpoint is asked whether to save or stop.
    Raises LearningError when the loss diverges and Stopped on request.
    """
    if surface is not None:
        background = _pixels_beside(surface, rays)
        environment = environment_learning.learn_environment(rays, background, preset.environment, seed=seed, device=device,
                                        progress=progress, checkpoint=checkpoint)
        return Fields(None, environment, {"skipped": {"object field": "a mesh was given"}})
    learning = FieldsLearning(rays, preset, seed, device)
    state = checkpoint.load()
    if state is not None:
        learning.load(state)
    steps = preset.fields.steps
    while learning.step < steps:
        loss = learning.learn_step()
        progress(learning.step, steps, loss)
        if checkpoint.stopping or checkpoint.due():
            checkpoint.save(learning.state())
            if checkpoint.stopping:
                raise Stopped("Stopped during fields learning; the checkpoint is written.", "Go on with --resume.")
    evidence = learning.evidence()
    if evidence < preset.fields.least_evidence:
        raise LearningError(
            f"The object's sphere seems to contain nothing: the surroundings explain its pixels almost as well as an object"
            f" does (ratio {evidence:.2f}, needed {preset.fields.least_evidence}).",
            "Set object_center and object_radius in transforms.json so that the sphere holds the object closely.")
    environment_learning.freeze(learning.environment, rays, rays.outside if len(rays.outside) else rays.sphere, seed)
    return Fields(learning.object_field, learning.environment, {"steps": steps, "loss": learning.loss,
                                                                   "evidence": round(evidence, 3)})


def _pixels_beside(surface: Surface, rays: PixelRays, chunk: int = 1 << 18) -> torch.Tensor:
    """Indices of the valid pixels whose rays miss the mesh."""
    tracer = RayTracer(surface.vertices, surface.faces)
    beside = [rays.outside]
    for index in rays.sphere.split(chunk):
        origins, directions, _ = rays.rays(index)
        hit = tracer.occluded(origins.cpu().numpy(), directions.cpu().numpy())
        beside.append(index[torch.from_numpy(~hit).to(index.device)])
    return torch.cat(beside)
