"""Cameras: how they project, their lenses, and which way is up."""
