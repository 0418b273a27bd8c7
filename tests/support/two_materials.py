"""Stages that learn nothing and give a ball of two materials, and keep what a correction of them needs."""

from __future__ import annotations

import numpy as np
import torch

from blender_nep.materials.corrections import CorrectablePalette, KeptMaterials
from blender_nep.materials.labels.blending import BlendedPoints
from blender_nep.materials.palette.palette import Palette
from blender_nep.materials.shown_faces import ShownParts
from blender_nep.materials.training import Materials
from blender_nep.shading.light_moments import LightMoments
from support.ball_stages import BallStages, ball_surface


def two_materials() -> KeptMaterials:
    """A metal on the lower half of the ball and paint on the upper half, in gray light."""
    surface = ball_surface()
    n = len(surface.vertices)
    upper = surface.normals[:, 2] > 0
    full = torch.ones(n, 4, 1, 3)
    levels = torch.tensor([0.05, 0.2, 0.5, 1.0])
    light = LightMoments(
        torch.cat([full, 0.1 * full, 0.05 * full], 2), torch.ones(n, 3), torch.ones(n, 4), torch.full((n,), 0.8), levels
    )
    palette = Palette(torch.tensor([[0.9, 0.7, 0.3], [0.5, 0.1, 0.1]]), torch.tensor([0.2, 0.5]), torch.tensor([1.0, 0.0]))
    label = torch.from_numpy(upper.astype(np.int64))
    points = BlendedPoints(
        surface.vertices,
        surface.normals,
        np.arange(n) % 5,
        np.zeros(n),
        label.numpy(),
        label.numpy(),
        np.zeros(n, np.float32),
    )
    target = palette.albedo[label]
    materials = CorrectablePalette(light, target, label, palette, points)
    return KeptMaterials(materials, 32, ShownParts(np.ones(len(surface.faces), np.int64), np.ones(len(surface.faces), bool)))


class KeepingStages(BallStages):
    """A job that learns two materials, and keeps what a correction needs."""

    def learn_materials(self, given, progress, checkpoint):
        kept = two_materials()
        textures, _ = kept.bake(ball_surface(), {}, given.preset)
        return Materials(*textures, report={}, kept=kept)
