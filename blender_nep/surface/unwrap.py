"""Makes the UV atlas of a mesh with xatlas."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np
import xatlas

from blender_nep.geometry.mesh import Surface
from blender_nep.profiling import profiled

if TYPE_CHECKING:
    from blender_nep.presets import SurfacePreset


@profiled("UV atlas")
def unwrap(surface: Surface, preset: SurfacePreset) -> Surface:
    """The same surface with a UV atlas. Vertices are duplicated along its seams."""
    atlas = xatlas.Atlas()
    atlas.add_mesh(surface.vertices.astype(np.float32), surface.faces.astype(np.uint32))
    charts = xatlas.ChartOptions()
    charts.max_iterations = 1
    pack = xatlas.PackOptions()
    pack.resolution, pack.padding = preset.atlas_texels, preset.padding_texels
    pack.bruteForce, pack.create_image = False, False
    atlas.generate(charts, pack)
    source, faces, uv = atlas[0]
    # The atlas is not always square. Both axes get the same scale, so that texels are square on the surface.
    uv = uv * np.array([atlas.width, atlas.height]) / max(atlas.width, atlas.height)
    source = source.astype(np.int64)
    return Surface(surface.vertices[source], faces.astype(np.int64), surface.normals[source], uv.astype(np.float64))
