"""Stages that learn nothing and always give a gray ball, for the tests of the job around them."""

from __future__ import annotations

from types import SimpleNamespace

import numpy as np
import torch
import trimesh

from blender_nep.errors import LearningError
from blender_nep.geometry.mesh import Surface
from blender_nep.job.stages import FieldsStage, MaterialsStage, Stages, SurfaceResult, SurfaceStage
from blender_nep.materials.training import Materials
from blender_nep.messages import Message, Part
from support.captures import RADIUS

WHY = Message("reason.one_material")
"""The reason that stage 1 reports for what it leaves out."""


class BallFields(FieldsStage):
    """Stage 1; a test may replace `learn_fields` of the stages."""

    def __init__(self, ball: BallStages) -> None:
        self.ball = ball

    def run(self, given, progress, checkpoint):
        return self.ball.learn_fields(given, progress, checkpoint)

    def pack(self, result):
        return {"report": result.report}

    def unpack(self, state, given):
        return SimpleNamespace(object_field="ball", environment=GrayLight(), support=None, report=state["report"])


class BallSurface(SurfaceStage):
    """The ball as a mesh."""

    def __init__(self, ball: BallStages) -> None:
        self.ball = ball

    def run(self, given, progress, checkpoint):
        if given.mesh is not None:
            return SurfaceResult(ball_surface())
        self.ball.entered.append("surface")
        if given.object_field != "ball":
            raise LearningError("no surface")
        return SurfaceResult(ball_surface(), {"faces": 80})


class BallMaterials(MaterialsStage):
    """Stage 2; a test may replace `learn_materials` of the stages."""

    def __init__(self, ball: BallStages) -> None:
        self.ball = ball

    def run(self, given, progress, checkpoint):
        return self.ball.learn_materials(given, progress, checkpoint)


class BallStages(Stages):
    """Stages that count steps instead of learning, and give a gray ball."""

    def __init__(self, steps: int = 5, on_step=None, fail: Exception | None = None) -> None:
        super().__init__(BallFields(self), BallSurface(self), BallMaterials(self))
        self.steps, self.on_step, self.fail = steps, on_step, fail
        self.entered: list[str] = []
        self.started_at: dict[str, int] = {}

    def _loop(self, stage, progress, checkpoint) -> int:
        self.entered.append(stage)
        state = checkpoint.load() or {"step": 0}
        self.started_at[stage] = state["step"]
        for step in range(state["step"], self.steps):
            if self.on_step is not None:
                self.on_step(stage, step)
            if checkpoint.due():
                checkpoint.save({"step": step, "array": np.arange(3), "tensor": torch.ones(2)})
            progress(step + 1, self.steps, 1.0 / (step + 1))
        return self.steps

    def learn_fields(self, given, progress, checkpoint):
        self._loop("fields_learning", progress, checkpoint)
        if self.fail is not None:
            raise self.fail
        report = {"loss": 0.1, "skipped": {str(Part.VOTES): WHY.state()}}
        return SimpleNamespace(object_field="ball", environment=GrayLight(), support=None, report=report)

    def learn_materials(self, given, progress, checkpoint):
        self._loop("material_learning", progress, checkpoint)
        return Materials(**ball_textures(), report={"texels": 64})


class GrayLight:
    """A uniform environment."""

    coverage = 1.0
    known = True
    preset = SimpleNamespace(camera_near=0.1)

    def query_cone(self, origins, directions, half_angle):
        return torch.full_like(origins, 0.5), torch.full_like(origins[:, 0], self.coverage)

    def render(self, origins, directions, t_near, t_far, half_angle):
        return SimpleNamespace(radiance=torch.full_like(origins, 0.5))

    def equirect(self, height):
        return torch.full((height, 2 * height, 3), 0.5), torch.full((height, 2 * height), self.coverage)


def ball_surface(subdivisions: int = 2) -> Surface:
    """A ball of radius 0.5 / RADIUS in the unit frame, with UVs that its x and y give."""
    mesh = trimesh.creation.icosphere(subdivisions, 0.5 / RADIUS)
    unit = np.asarray(mesh.vertices) / (0.5 / RADIUS)
    uv = 0.5 + 0.4 * unit[:, :2]
    return Surface(np.asarray(mesh.vertices), np.asarray(mesh.faces, np.int64), unit, uv)


def ball_textures() -> dict[str, np.ndarray]:
    """Textures 16 x 16 that change from row to row and column to column."""
    ramp = np.linspace(0, 1, 16, dtype=np.float32)
    albedo = np.stack(np.broadcast_arrays(ramp[:, None], ramp[None, :], np.float32(0.25)), -1).astype(np.float32)
    flat = np.ones((16, 16), np.float32)
    return {"albedo": albedo, "roughness": flat * ramp[:, None], "metallic": flat * ramp, "confidence": flat}
