"""The gallery of a batch: pages to look at its objects, which a browser opens without a server and without a network.

`write_gallery` writes them. docs/gallery.md shows them.
"""

from blender_nep.gallery.gallery import write_gallery

__all__ = ["write_gallery"]
