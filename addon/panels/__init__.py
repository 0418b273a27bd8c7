"""The panels of the sidebar (3D viewport, tab NeP). They draw; what their buttons do is in operators/."""

from . import materials, reconstruct, shelf, subpanels

CLASSES = (reconstruct.NEP_PT_reconstruct, *subpanels.CLASSES, *materials.CLASSES, *shelf.CLASSES)
