"""Makes the mesh: extraction from the SDF, given meshes, UV map, subdivision, normal map.

`extraction.extract_surface` is the entry.
"""
