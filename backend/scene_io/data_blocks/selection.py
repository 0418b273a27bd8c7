"""Keeps the artist's selection while an operator of Blender runs that selects something else."""

from collections.abc import Iterator
from contextlib import contextmanager

import bpy


@contextmanager
def kept_selection() -> Iterator[bpy.types.ViewLayer]:
    """After the `with` block, the context's view layer has the same selected objects and the same active one as before."""
    layer = bpy.context.view_layer
    selected, active = [item.name for item in layer.objects.selected], layer.objects.active
    name = active.name if active is not None else None
    try:
        yield layer
    finally:
        for item in list(layer.objects.selected):
            item.select_set(False, view_layer=layer)
        for item in layer.objects:
            if item.name in selected:
                item.select_set(True, view_layer=layer)
        layer.objects.active = layer.objects.get(name) if name is not None else None
