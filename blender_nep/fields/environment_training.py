"""Learning F_e alone, from pixels that do not show the object, and what both ways of learning share.

With a given mesh (`--mesh`) `learn_environment` is all of stage 1. Without one, the first steps of `fields.training` are
`learn_step`.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass

import torch

from blender_nep.capture.pixel_rays import PixelRays
from blender_nep.capture.pixel_set import PixelSet
from blender_nep.checkpoints import Checkpoint
from blender_nep.errors import Stopped
from blender_nep.fields.environment_field import EnvironmentField
from blender_nep.fields.non_finite_monitor import NonFiniteMonitor, usable_gradients, usable_loss
from blender_nep.fields.schedule import geometric_decay
from blender_nep.presets import EnvironmentPreset
from blender_nep.profiling import section
from blender_nep.tone_mapping import tone_map


@dataclass(frozen=True)
class EnvironmentReport:
    """How the learning of F_e alone went."""

    steps_not_finite: int = 0
    """Steps that were left out because their loss or gradient was not finite"""

    def as_dict(self) -> dict:
        """For report.json; empty where no step was left out."""
        return {"steps_not_finite": self.steps_not_finite} if self.steps_not_finite else {}


def geometric_mean(rays: PixelRays) -> float:
    """Geometric mean of the photos' radiance, from some 10,000 pixels: where F_e starts."""
    some = rays.photo(torch.arange(0, rays.count, max(1, rays.count // 10_000), device=rays.radiance.device))
    return float(some.clamp(min=1e-3).log().mean().exp())


def learning_rate(preset: EnvironmentPreset, fraction: float) -> float:
    """F_e's learning rate at a fraction of its learning, 0..1: constant, then falling geometrically."""
    return preset.learning_rate * geometric_decay(fraction, preset.rate_decay_from, preset.last_rate)


def set_learning_rate(adam: torch.optim.Optimizer, preset: EnvironmentPreset, fraction: float) -> None:
    """Gives F_e's optimiser the learning rate that is due at a fraction of the learning."""
    for group in adam.param_groups:
        group["lr"] = learning_rate(preset, fraction)


def optimiser(environment: EnvironmentField) -> torch.optim.Optimizer:
    """Adam for the field's present grid."""
    return torch.optim.Adam(environment.parameter_groups(), fused=True)


def freeze(environment: EnvironmentField, rays: PixelRays, background: PixelSet | torch.Tensor, seed: int) -> None:
    """Ends the learning of F_e: measures its coverage by a random part of the background pixels (indices)."""
    generator = torch.Generator(background.device).manual_seed(seed)
    pick = torch.randint(len(background), (environment.preset.coverage_rays,), generator=generator, device=background.device)
    origins, directions, _ = rays.rays(background[pick])
    environment.freeze(origins, directions)


def save_if_due(checkpoint: Checkpoint, state: Callable[[], dict]) -> None:
    """Saves state() where the checkpoint is due. Raises Stopped, after saving, where a stop was asked for."""
    if checkpoint.stopping or checkpoint.due():
        checkpoint.save(state())
        if checkpoint.stopping:
            raise Stopped("Stopped during fields learning; the checkpoint is written.", "Go on with --resume.")


def learn_step(
    environment: EnvironmentField,
    adam: torch.optim.Optimizer,
    rays: PixelRays,
    index: torch.Tensor,
    generator: torch.Generator,
) -> float:
    """One step of F_e alone on the pixels `index`; returns the photometric loss, NaN where it or its gradient is not
    finite: such a step changes nothing."""
    origins, directions, half_angle = rays.rays(index)
    n, near = len(index), torch.full_like(half_angle, environment.preset.camera_near)
    middle = torch.maximum(near, -(origins * directions).sum(-1))
    radiance, transmittance = environment.render(
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
    with section("backward"):
        (photometric + environment.preset.foreground_opacity * (1 - clear).mean()).backward()
    environment.regularise(generator)
    if not usable_gradients([adam]):
        return math.nan
    with section("optimisers"):
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
    """F_e from the pixels `background` (indices) alone. progress(step, steps, loss) is called after every step.

    Raises LearningError when the loss diverges, and Stopped on request, after the checkpoint is written.
    """
    generator = torch.Generator(device).manual_seed(seed)
    environment = EnvironmentField(preset, geometric_mean(rays)).to(device)
    if not environment.known:
        return environment, EnvironmentReport()
    adam, step, monitor = optimiser(environment), 0, NonFiniteMonitor()

    def present_state() -> dict:
        return {
            "step": step,
            "environment": environment.state_dict(),
            "optimiser": adam.state_dict(),
            "generator": generator.get_state(),
            "monitor": monitor.state(),
        }

    state = checkpoint.load()
    if state is not None:
        step = state["step"]
        environment.load_state_dict(state["environment"])
        adam = optimiser(environment)
        adam.load_state_dict(state["optimiser"])
        generator.set_state(state["generator"])
        monitor.load(state["monitor"])
    while step < preset.steps:
        if environment.refine(step / preset.steps):
            adam = optimiser(environment)
        set_learning_rate(adam, preset, step / preset.steps)
        pick = torch.randint(len(background), (preset.rays_per_step,), generator=generator, device=device)
        loss = learn_step(environment, adam, rays, background[pick], generator)
        monitor.record(usable_loss(loss))
        step += 1
        progress(step, preset.steps, loss)
        save_if_due(checkpoint, present_state)
    freeze(environment, rays, background, seed)
    return environment, EnvironmentReport(monitor.left_out)
