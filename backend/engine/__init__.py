"""Starts the engine in another Python, follows it, reads what it wrote, and installs it. Nothing here imports bpy."""
