"""Writes the asset: mesh files, textures, glTF, light, cameras, and the preview picture."""
