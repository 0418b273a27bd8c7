"""The stages of a job as objects. Each has a name, its expected seconds, and `run`; `run` gets all that the stage needs.

The results of the three long stages are kept on the disk: `pack` makes a plain dict of a result, and `unpack` is its
inverse. The libraries of a stage are imported when the stage is entered, so that `blender-nep info` and the first error
messages do not wait for them.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field
from pathlib import Path
from typing import TYPE_CHECKING, Any, Protocol, TypeVar

import numpy as np

from blender_nep.job.stage_names import StageName
from blender_nep.profiling import section
from blender_nep.safety.arrays import check_array

if TYPE_CHECKING:
    from blender_nep.asset.export import Placement
    from blender_nep.asset.preview import PreviewView
    from blender_nep.capture import Capture
    from blender_nep.checkpoints import Checkpoint
    from blender_nep.fields.environment.field import EnvironmentField
    from blender_nep.fields.object.field import ObjectField
    from blender_nep.fields.training import Fields, FieldsLearning
    from blender_nep.geometry.mesh import Surface
    from blender_nep.materials.training import Materials
    from blender_nep.presets import MaterialPreset, Preset, SurfacePreset
    from blender_nep.scene.scene import Scene
    from blender_nep.support.plane import Support
    from blender_nep.surface.normal_map import LeanMesh

Given = TypeVar("Given", contravariant=True)
Result = TypeVar("Result")

CAPTURE_SECONDS, ASSET_SECONDS = 5.0, 10.0
"""First guesses of the seconds of the short stages. Those of the long stages are in the preset."""


class Progress(Protocol):
    """A stage calls this after every step. Raises Stopped if a stop was asked for, after the checkpoint is written."""

    def __call__(self, step: int, steps: int, loss: float | None = None, **extra: Any) -> None: ...


class Stage(Protocol[Given, Result]):
    """A stage whose result is kept on the disk."""

    name: StageName

    def expected_seconds(self, preset: Preset) -> float:
        """A first guess of the seconds that the stage takes."""
        ...

    def run(self, given: Given, progress: Progress, checkpoint: Checkpoint) -> Result:
        """Do the work, or go on from the checkpoint. Raises NepError and its subclasses."""
        ...

    def pack(self, result: Result) -> dict:
        """The result as a dict of tensors, arrays, numbers and strings."""
        ...

    def unpack(self, state: dict, given: Given) -> Result:
        """The inverse of `pack`."""
        ...


@dataclass(frozen=True)
class FieldsInput:
    """The input of fields learning."""

    scene: Scene
    preset: Preset
    seed: int
    surface: Surface | None = None
    """A given mesh. With it, only F_e is learned."""
    watch: Callable[[FieldsLearning], None] | None = None
    """Called after every step. It must not change the learning."""


class FieldsStage:
    """Fields learning (stage 1 of the paper): learns F_o and F_e."""

    name = StageName.FIELDS_LEARNING

    def expected_seconds(self, preset: Preset) -> float:
        return preset.fields_seconds

    def run(self, given: FieldsInput, progress: Progress, checkpoint: Checkpoint) -> Fields:
        from blender_nep.fields.training import learn_fields

        return learn_fields(
            given.scene,
            given.preset,
            seed=given.seed,
            progress=progress,
            checkpoint=checkpoint,
            surface=given.surface,
            watch=given.watch,
        )

    def pack(self, result: Fields) -> dict:
        return result.state()

    def unpack(self, state: dict, given: FieldsInput) -> Fields:
        from blender_nep.fields.fields import Fields

        return Fields.from_state(state, given.preset, given.scene.device)


@dataclass(frozen=True)
class SurfaceInput:
    """The input of the surface stage: the file of a given mesh, or else the object field."""

    scene: Scene
    capture: Capture
    preset: SurfacePreset
    mesh: Path | None = None
    object_field: ObjectField | None = None


@dataclass(frozen=True)
class SurfaceResult:
    """The mesh, and a report on how it was made."""

    surface: Surface
    """The mesh on which materials are learned"""
    report: dict = field(default_factory=dict)
    lean: LeanMesh | None = None
    """The mesh of the asset, if it is to have fewer faces"""
    support: Support | None = None
    """The plane on which the object stands and at which the mesh is cut; None without one"""

    @property
    def of_asset(self) -> Surface:
        """The mesh of the asset. It has the UV map of `surface`."""
        return self.surface if self.lean is None else self.lean.surface

    @property
    def textures(self) -> dict[str, np.ndarray]:
        """The textures that belong to the shape of the asset's mesh: the normal map, if there is one."""
        from blender_nep.asset.export import NORMAL_MAP

        return {} if self.lean is None else {NORMAL_MAP: self.lean.normal_map}


class SurfaceStage:
    """Makes the mesh: extracts it from the object field, or reads the mesh that was given (--mesh)."""

    name = StageName.SURFACE

    def expected_seconds(self, preset: Preset) -> float:
        return preset.surface_seconds

    def run(self, given: SurfaceInput, progress: Progress, checkpoint: Checkpoint) -> SurfaceResult:
        if given.mesh is not None:
            from blender_nep.surface.mesh_file import load_surface

            return SurfaceResult(*load_surface(given.mesh, given.capture, given.preset))
        from blender_nep.surface.extraction import extract_surface

        assert given.object_field is not None, "a stage 1 without a given mesh learns the object field"
        return SurfaceResult(*extract_surface(given.object_field, given.preset, given.scene.support))

    def pack(self, result: SurfaceResult) -> dict:
        lean = None
        if result.lean is not None:
            lean = {"arrays": vars(result.lean.surface), "normal_map": result.lean.normal_map}
        support = None if result.support is None else result.support.state()
        return {"arrays": vars(result.surface), "report": result.report, "lean": lean, "support": support}

    def unpack(self, state: dict, given: SurfaceInput) -> SurfaceResult:
        return surface_result(state)


def surface_result(state: dict) -> SurfaceResult:
    """The result of the surface stage from its packed form. Raises ValueError and other errors where that is damaged."""
    from blender_nep.geometry.mesh import Surface
    from blender_nep.support.plane import Support
    from blender_nep.surface.normal_map import LeanMesh

    lean, support = state["lean"], state["support"]
    if lean is not None:
        lean = LeanMesh(Surface(**lean["arrays"]), lean["normal_map"])
        check_array("the normal map", lean.normal_map, (len(lean.normal_map), len(lean.normal_map), 3))
        lean.surface.check()
    plane = None if support is None else Support.from_state(support)
    surface = Surface(**state["arrays"])
    surface.check()
    return SurfaceResult(surface, state["report"], lean, plane)


@dataclass(frozen=True)
class MaterialsInput:
    """The input of material learning."""

    surface: Surface
    environment: EnvironmentField
    scene: Scene
    preset: MaterialPreset
    seed: int


class MaterialsStage:
    """Material learning (stage 2 of the paper): makes the textures."""

    name = StageName.MATERIAL_LEARNING

    def expected_seconds(self, preset: Preset) -> float:
        return preset.material_seconds

    def run(self, given: MaterialsInput, progress: Progress, checkpoint: Checkpoint) -> Materials:
        from blender_nep.materials.training import learn_materials

        return learn_materials(
            given.surface,
            given.environment,
            given.scene,
            given.preset,
            seed=given.seed,
            progress=progress,
            checkpoint=checkpoint,
        )

    def pack(self, result: Materials) -> dict:
        from blender_nep.asset.export import TEXTURES

        textures = {name: getattr(result, name) for name in TEXTURES}
        unseen = result.unseen.state() if result.unseen is not None else None
        kept = result.kept.state() if result.kept is not None else None
        response = result.response.state() if result.response is not None else None
        return {
            "textures": textures,
            "unseen": unseen,
            "report": result.report,
            "kept": kept,
            "response": response,
            "object_gain": result.object_gain,
        }

    def unpack(self, state: dict, given: MaterialsInput) -> Materials:
        import torch

        from blender_nep.capture.rays.response_curve import ResponseCurve
        from blender_nep.materials.corrections import KeptMaterials
        from blender_nep.materials.training import Materials
        from blender_nep.shading.unseen_light import UnseenLight

        side = len(state["textures"]["albedo"])
        for name, values in state["textures"].items():
            check_array(name, values, (side, side, 3) if name == "albedo" else (side, side))
        kept = KeptMaterials.from_state(state["kept"]) if state["kept"] is not None else None
        unseen = UnseenLight.from_state(state["unseen"]) if state["unseen"] is not None else None
        response = ResponseCurve.from_state(state["response"]) if state["response"] is not None else None
        gain = state["object_gain"]
        if gain is not None:
            check_array("object_gain", gain, (given.scene.rays.views,), low=1e-6)
            gain = torch.as_tensor(gain, device=given.scene.device)
        return Materials(
            **state["textures"], unseen=unseen, report=state["report"], kept=kept, response=response, object_gain=gain
        )


@dataclass(frozen=True)
class AssetInput:
    """All that is written as the asset."""

    folder: Path
    scene: Scene
    capture: Capture
    place: Placement
    surface: SurfaceResult
    materials: Materials
    light: np.ndarray
    """[H, 2H, 3] radiance of the environment map, as bright as the engine sees it"""
    view: PreviewView
    """The view of the preview picture"""
    report: Callable[[], dict]
    """Gives the content of report.json. It is called last, when everything else is on the disk."""


class AssetStage:
    """Writes the asset folder. The asset is its result, so that there is nothing to pack."""

    name = StageName.ASSET

    def run(self, given: AssetInput) -> None:
        """Write all files. Raises OutputError."""
        from blender_nep.asset.cameras_file import cameras_content
        from blender_nep.asset.export import TEXTURES, write_asset

        textures = {name: np.asarray(getattr(given.materials, name), np.float32) for name in TEXTURES}
        with section("preview picture"):
            picture = given.view.render(given.surface.surface, textures, given.light)
        mesh = given.place.mesh(given.surface.of_asset, textures | given.surface.textures)
        cameras = cameras_content(given.capture, given.folder)
        write_asset(given.folder, mesh, picture, given.light / given.scene.rays.exposure, cameras, given.report)


@dataclass
class Stages:
    """The stages that a job runs after it has read the photos. A test or a benchmark may replace some of them."""

    fields: Stage[FieldsInput, Fields] = field(default_factory=FieldsStage)
    surface: Stage[SurfaceInput, SurfaceResult] = field(default_factory=SurfaceStage)
    materials: Stage[MaterialsInput, Materials] = field(default_factory=MaterialsStage)
    asset: AssetStage = field(default_factory=AssetStage)

    def expected_seconds(self, preset: Preset) -> dict[StageName, float]:
        """A first guess of the seconds of every stage of a job."""
        long = {stage.name: stage.expected_seconds(preset) for stage in (self.fields, self.surface, self.materials)}
        return {StageName.CAPTURE: CAPTURE_SECONDS, **long, StageName.ASSET: ASSET_SECONDS}
