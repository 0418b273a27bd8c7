"""Exit codes of the engine that Blender's side gives or understands, and its own.

The engine's codes are defined in blender_nep/errors.py, which Blender's Python does not import. A test compares the two.
"""

NO_ENGINE = 2
"""There is no engine to start. The engine itself uses this code for wrong arguments."""
OUTPUT_FAILED = 5
STOPPED = 7
"""Stopped on request, with the checkpoint written."""
BLENDER_FAILED = 8
"""Blender's part failed after the engine's. The engine does not use this code."""
