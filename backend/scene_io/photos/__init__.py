"""What Blender must know of photo files: their formats and sizes."""
