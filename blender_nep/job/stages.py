"""The long stages of a job behind one name each, and their results as plain dicts for the disk.

Imported when a stage is entered: `blender-nep info` and the first error messages do not wait for them.
"""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Any

import torch

if TYPE_CHECKING:
    from blender_nep.capture import Capture, PixelRays
    from blender_nep.fields.training import Fields
    from blender_nep.geometry.mesh import Surface
    from blender_nep.materials.training import Materials
    from blender_nep.presets import Preset, SurfacePreset


class Stages:
    """What a job calls; a test may put its own in place."""

    def learn_fields(self, rays: PixelRays, preset: Preset, **keywords: Any) -> Fields:
        """Stage 1; with surface=... F_e alone."""
        from blender_nep.fields.training import learn_fields

        return learn_fields(rays, preset, **keywords)

    def pack_fields(self, fields: Fields) -> dict:
        """Fields as a dict of tensors and numbers."""
        return fields.state()

    def unpack_fields(self, state: dict, preset: Preset, device: torch.device) -> Fields:
        """The inverse of pack_fields."""
        from blender_nep.fields.training import Fields

        return Fields.from_state(state, preset, device)

    def load_surface(self, mesh: Path, capture: Capture, preset: SurfacePreset) -> Surface:
        """The mesh of --mesh."""
        from blender_nep.surface.mesh_file import load_surface

        return load_surface(mesh, capture, preset)

    def extract_surface(self, object_field: Any, preset: SurfacePreset) -> tuple[Surface, dict]:
        """The mesh of the object field."""
        from blender_nep.surface.extraction import extract_surface

        return extract_surface(object_field, preset)

    def pack_surface(self, result: tuple[Surface, dict]) -> dict:
        """A surface and its report as a dict."""
        surface, report = result
        arrays = {k: getattr(surface, k) for k in ("vertices", "faces", "normals", "uv")}
        return {"arrays": arrays, "report": report}

    def unpack_surface(self, state: dict) -> tuple[Surface, dict]:
        """The inverse of pack_surface."""
        from blender_nep.geometry.mesh import Surface

        return Surface(**state["arrays"]), state["report"]

    def learn_materials(self, surface: Surface, environment: Any, rays: PixelRays, preset: Any, **keywords: Any) -> Any:
        """Stage 2."""
        from blender_nep.materials.training import learn_materials

        return learn_materials(surface, environment, rays, preset, **keywords)

    def pack_materials(self, materials: Materials) -> dict:
        """Textures and report as a dict."""
        textures = {k: getattr(materials, k) for k in ("albedo", "roughness", "metallic", "confidence")}
        unseen = materials.unseen.state() if materials.unseen is not None else None
        return {"textures": textures, "unseen": unseen, "report": materials.report}

    def unpack_materials(self, state: dict) -> Materials:
        """The inverse of pack_materials."""
        from blender_nep.materials.training import Materials
        from blender_nep.shading.unseen_light import UnseenLight

        unseen = UnseenLight.from_state(state["unseen"]) if state["unseen"] is not None else None
        return Materials(**state["textures"], unseen=unseen, report=state["report"])

    def write_asset(self, *arguments: Any) -> None:
        """The asset folder."""
        from blender_nep.asset.export import write_asset

        write_asset(*arguments)
