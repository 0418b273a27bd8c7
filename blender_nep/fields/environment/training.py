"""Learns F_e alone, from pixels that do not show the object.

With a given mesh (`--mesh`), `learn_environment` is the whole fields learning. Without one, `fields.training` begins with
steps of F_e alone (`learn_step`); it also uses other functions of this file.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass

import torch

from blender_nep.capture.rays.pixel_rays import PixelRays
from blender_nep.capture.rays.pixel_set import PixelSet, random_places
from blender_nep.checkpoints import Checkpoint
from blender_nep.errors import LearningError
from blender_nep.fields.environment.field import EnvironmentField
from blender_nep.fields.non_finite_monitor import NonFiniteMonitor, usable_gradients, usable_loss
from blender_nep.fields.schedule import geometric_decay
from blender_nep.messages import Message, Part
from blender_nep.optimizers import Adam, Optimizer
from blender_nep.presets import EnvironmentPreset
from blender_nep.profiling import section
from blender_nep.tone_mapping import tone_map


@dataclass(frozen=True)
class EnvironmentReport:
    """The report on the learning of F_e alone."""

    steps_not_finite: int = 0
    """Number of steps that were left out because their loss or gradient was not finite"""

    def as_dict(self) -> dict:
        """The report as plain values, for report.json. It is empty if no step was left out."""
        return {"steps_not_finite": self.steps_not_finite} if self.steps_not_finite else {}


def geometric_mean(rays: PixelRays) -> float:
    """Geometric mean of the photos' radiance over about 10,000 pixels. F_e starts with it."""
    some = rays.photo(torch.arange(0, rays.count, max(1, rays.count // 10_000), device=rays.radiance.device))
    return float(some.clamp(min=1e-3).log().mean().exp())


def learning_rate(preset: EnvironmentPreset, fraction: float) -> float:
    """F_e's learning rate at a fraction of its learning, 0..1: constant, then falling geometrically."""
    return preset.learning_rate * geometric_decay(fraction, preset.rate_decay_from, preset.last_rate)


def set_learning_rate(adam: Optimizer, preset: EnvironmentPreset, fraction: float) -> None:
    """Set the learning rate of F_e's optimizer that is due at a fraction of the learning, 0..1."""
    for group in adam.param_groups:
        group["lr"] = learning_rate(preset, fraction)


def optimizer(environment: EnvironmentField) -> Optimizer:
    """Adam for the field's present grid."""
    return Adam(environment.parameter_groups())


def refine(
    environment: EnvironmentField, rays: PixelRays, background: PixelSet | torch.Tensor, step: int, fraction: float
) -> bool:
    """Bring F_e to what is due after `step` steps: a finer grid, or the decision on its color detail.

    These steps are the `fraction` of its learning, 0..1. `background` are the pixels (indices) whose rays decide. True if
    F_e has new parameters, so that its optimizer must be made again.
    """
    preset, changed = environment.preset, environment.refine(fraction)
    if environment.known and step >= preset.detail_step and not environment.detail_decided:
        pick = torch.arange(0, len(background), max(1, len(background) // preset.detail_rays), device=background.device)
        origins, directions, _ = rays.rays(background[pick]).in_room()
        changed = environment.decide_detail(origins, directions) or changed
    return changed


def skipped_detail(environment: EnvironmentField) -> dict[str, dict]:
    """The report's entry that F_e has no color detail, and why; empty if it has one."""
    if not environment.detail_decided or len(environment.detail):
        return {}
    return {str(Part.COLOR_DETAIL): Message("reason.near_surroundings").state()}


def freeze(environment: EnvironmentField, rays: PixelRays, background: PixelSet | torch.Tensor, seed: int) -> None:
    """End the learning of F_e: measure with random pixels of `background` (indices) what photos show, and what as white."""
    generator = torch.Generator(background.device).manual_seed(seed)
    pick = random_places(environment.preset.coverage_rays, len(background), generator)
    index = background[pick]
    origins, directions, _ = rays.rays(index).in_room()
    environment.freeze(origins, directions, rays.white(index))


def save_if_due(checkpoint: Checkpoint, state: Callable[[], dict]) -> None:
    """Save state() if the checkpoint is due or a stop was asked for. In the latter case, raises Stopped after saving."""
    if checkpoint.stopping or checkpoint.due():
        checkpoint.save(state())
        checkpoint.raise_if_stopped(saves=True)


def learn_step(
    environment: EnvironmentField,
    adam: Optimizer,
    rays: PixelRays,
    index: torch.Tensor,
    generator: torch.Generator,
) -> float:
    """Take one step of F_e alone on the pixels `index` [n] int64, and return the photometric loss.

    If the loss or its gradient is not finite, the step changes nothing and the result is NaN.
    """
    origins, directions, half_angle = rays.rays(index).in_room()
    n, near = len(index), torch.full_like(half_angle, environment.preset.camera_near)
    middle = torch.maximum(near, -(origins * directions).sum(-1))
    radiance, transmittance, distortion = environment.render(
        origins.repeat(2, 1),
        directions.repeat(2, 1),
        torch.cat([near, middle]),
        torch.cat([middle, torch.full_like(near, torch.inf)]),
        half_angle.repeat(2),
        generator,
    )
    radiance, clear = radiance[:n] + transmittance[:n, None] * radiance[n:], transmittance[:n]
    photometric = (tone_map(radiance) - tone_map(rays.photo(index))).abs().mean()
    loss = float(photometric.detach())
    if not usable_loss(loss):
        return math.nan
    adam.zero_grad()
    p = environment.preset
    with section("backward"):
        priors = p.foreground_opacity * (1 - clear).mean() + environment.distortion_cost * distortion.sum() / n
        (photometric + priors).backward()
    environment.regularize(generator)
    if not usable_gradients([adam]):
        return math.nan
    with section("optimizers"):
        adam.step()
    return loss


def learn_environment(
    rays: PixelRays,
    background: PixelSet | torch.Tensor,
    preset: EnvironmentPreset,
    *,
    seed: int,
    device: torch.device,
    progress: Callable[[int, int, float], None],
    checkpoint: Checkpoint,
) -> tuple[EnvironmentField, EnvironmentReport]:
    """Learn F_e from the pixels `background` (indices) only. progress(step, steps, loss) is called after every step.

    Raises LearningError when there are no such pixels, or too many steps are not finite, and Stopped on request, after the
    checkpoint is written.
    """
    generator = torch.Generator(device).manual_seed(seed)
    environment = EnvironmentField(preset, geometric_mean(rays)).to(device)
    if not environment.known:
        return environment, EnvironmentReport()
    if not len(background):
        raise LearningError(
            "The mesh covers all pixels of all photos, so nothing shows the light around the object.",
            "Give --mesh the object alone, without the floor and the walls.",
        )
    adam, step, monitor = optimizer(environment), 0, NonFiniteMonitor()

    def present_state() -> dict:
        return {
            "step": step,
            "environment": environment.state_dict(),
            "optimizer": adam.state(),
            "generator": generator.get_state(),
            "monitor": monitor.state(),
        }

    state = checkpoint.load()
    if state is not None:
        step = state["step"]
        environment.load_state_dict(state["environment"])
        adam = optimizer(environment)
        adam.load(state["optimizer"])
        generator.set_state(state["generator"])
        monitor.load(state["monitor"])
    while step < preset.steps:
        if refine(environment, rays, background, step, step / preset.steps):
            adam = optimizer(environment)
        set_learning_rate(adam, preset, step / preset.steps)
        pick = random_places(preset.rays_per_step, len(background), generator)
        loss = learn_step(environment, adam, rays, background[pick], generator)
        monitor.record(usable_loss(loss))
        step += 1
        progress(step, preset.steps, loss)
        save_if_due(checkpoint, present_state)
    freeze(environment, rays, background, seed)
    return environment, EnvironmentReport(monitor.left_out)
