"""Headless Blender: import of an asset and its light, relit comparisons, synthetic captures; and how the engine is run.

The scripts `run.py`, `render_comparison.py` and `synthetic.py` use it, and so does the add-on. It imports bpy, numpy and the
standard library only. Blender's own Python has no torch, so the engine runs in another process (`engine/`).

Conventions: Blender's world axes are the capture's axes (Z up). Cameras look down -z, with x to the right and y up. Images
are numpy arrays whose row 0 is the top row. Radiance is linear Rec.709.
"""
