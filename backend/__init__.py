"""Headless Blender work: synthetic captures, import of an asset, its World, relit comparisons.

Shared by the scripts `run.py` and `synthetic.py` and by the add-on. Imports bpy, numpy and the standard library only:
Blender's own Python has no torch, so the engine is another process (`engine.py`).

Conventions: Blender's world axes are the capture's axes (Z up); cameras look down -z, x right, y up; images are numpy
arrays whose row 0 is the top row; radiance is linear Rec.709.
"""
