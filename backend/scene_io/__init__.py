"""Between files and the Blender scene: assets, cameras, photos, light, and captures made from a scene."""
