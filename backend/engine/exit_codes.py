"""The exit codes that the code in Blender uses: some of the engine's codes, and one of its own.

The engine's codes are defined in blender_nep/errors.py, which Blender's Python does not import. A test compares both files.
"""

NO_ENGINE = 2
"""No Python with the engine was found. The engine itself uses this code for wrong arguments."""
OUTPUT_FAILED = 5
STOPPED = 7
"""The engine was stopped on request, and has written its checkpoint."""
BLENDER_FAILED = 8
"""The engine made the asset, but Blender's part after it failed. The engine does not use this code."""
OBJECTS_FAILED = 9
"""A batch has come to its end, but some of its objects failed."""
