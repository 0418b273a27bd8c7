"""Everything that runs in Blender's Python without a window.

The package imports an asset and its light, renders relit comparisons, renders synthetic captures, and starts the engine.
The scripts `run.py`, `render_comparison.py` and `synthetic.py` use this package, and so does the add-on. The package imports
only bpy, numpy and the standard library. Blender's own Python has no torch, so the engine runs in another process
(`engine/`).

docs/conventions.md has the conventions of axes, cameras, images and radiance.
"""
