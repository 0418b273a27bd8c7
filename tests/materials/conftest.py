"""The unwrapped ball of `support.lit_ball`."""

import numpy as np
import pytest
import trimesh

from blender_nep.geometry.mesh import Surface
from blender_nep.presets import SurfacePreset
from blender_nep.surface.unwrap import unwrap
from support.lit_ball import RADIUS


@pytest.fixture(scope="module")
def ball():
    mesh = trimesh.creation.icosphere(subdivisions=4, radius=RADIUS)
    vertices, faces = np.asarray(mesh.vertices), np.asarray(mesh.faces)
    return unwrap(Surface(vertices, faces, vertices / RADIUS), SurfacePreset(atlas_texels=256))
