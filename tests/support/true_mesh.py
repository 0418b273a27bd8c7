"""The true mesh of the small capture as a surface."""

from dataclasses import replace

import pytest

from blender_nep.capture import load_capture
from blender_nep.geometry.mesh import Surface
from blender_nep.presets import preset
from blender_nep.surface import mesh_file
from support.paths import SUZANNE_SMALL


def true_surface() -> Surface:
    """As the engine reads the mesh file, but with a UV map that x and y give: unwrapping would take 1.8 CPU seconds."""
    mesh, settings = SUZANNE_SMALL / "gt_mesh.ply", preset("preview").surface
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(mesh_file, "unwrap", lambda surface, _: replace(surface, uv=0.5 + 0.45 * surface.vertices[:, :2]))
        return mesh_file.load_surface(mesh, load_capture(SUZANNE_SMALL), settings)[0]
