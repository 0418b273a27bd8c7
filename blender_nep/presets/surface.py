"""The settings of the mesh and its UV atlas."""

from __future__ import annotations

from dataclasses import dataclass


@dataclass(frozen=True)
class SurfacePreset:
    """Settings of the surface stage."""

    grid: int = 224
    """Marching-cubes samples along each side of [-1, 1]^3."""
    unwrapped_faces: int = 12_000
    """Largest number of faces, about, after decimation, when the UV atlas is made. xatlas takes about 3 s for 20,000 faces
    and 14 s for 60,000."""
    faces: int = 120_000
    """Largest number of faces of the mesh, after its edges are halved where the surface bends."""
    relief_faces: int = 300_000
    """The same where the SDF has relief that is finer than its grid."""
    chord_error: float = 1.5e-4
    """Edges that are farther from the surface than this, in object radii, are halved (`surface.subdivision`)."""
    asset_faces: int = 0
    """Largest number of faces of the asset's mesh (--faces). If it is smaller than `faces`, the asset gets a normal map that
    carries the difference. 0: the asset has the mesh on which materials are learned."""
    normal_texels: int = 2048
    """Side of the normal map in texels."""
    atlas_texels: int = 1024
    """Side of the UV atlas in texels while it is packed; `padding_texels` are such texels."""
    padding_texels: int = 3
    """Free texels of the atlas between charts. Textures of half its side, or less, have less than two texels there."""
