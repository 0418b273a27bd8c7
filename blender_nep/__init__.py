"""Inverse rendering of glossy objects: photos to a relightable mesh (NeP, CVPR 2024)."""

__version__ = "0.1.0"
