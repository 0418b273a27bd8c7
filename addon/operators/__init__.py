"""The operators: what the buttons of the panels do, and the commands of scripts (`bpy.ops.nep.…`)."""

from . import (
    bounds,
    camera_search,
    cameras,
    comparison,
    engine,
    exchange,
    materials,
    photo_check,
    reconstruct,
    result,
    shelf,
    video,
)

CLASSES = (
    *reconstruct.CLASSES,
    *engine.CLASSES,
    *cameras.CLASSES,
    *camera_search.CLASSES,
    *video.CLASSES,
    *bounds.CLASSES,
    *photo_check.CLASSES,
    *result.CLASSES,
    *exchange.CLASSES,
    *materials.CLASSES,
    *comparison.CLASSES,
    *shelf.CLASSES,
)
