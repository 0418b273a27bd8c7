"""The operators: what the buttons of the panels do, and the commands of scripts (`bpy.ops.nep.…`)."""

from . import bounds, cameras, comparison, engine, reconstruct, result

CLASSES = (
    *reconstruct.CLASSES,
    *engine.CLASSES,
    *cameras.CLASSES,
    *bounds.CLASSES,
    *result.CLASSES,
    *comparison.CLASSES,
)
