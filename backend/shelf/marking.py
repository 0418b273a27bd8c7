"""Marks an object as an asset of the Asset Browser, with a picture and with words."""

from pathlib import Path

import bpy
import numpy as np

from ..engine.results.asset_description import TAGS, describe_asset
from ..rendering.turntable import FILE as TURNTABLE
from ..scene_io.image_files import load_pixels
from .catalogs import Catalog

PREVIEW = "preview.png"
"""Of the engine: a photo at the left, the asset in the same view at the right"""


def mark_as_asset(item: bpy.types.Object, asset: Path, catalog: Catalog, preset: str = "") -> None:
    """Mark the object that was imported from the folder `asset`, with all that the Asset Browser shows of it.

    An object that is an asset already keeps the artist's own tags and author. Where the folder has no picture, Blender is
    asked to render one, which it does only if it has a window.
    """
    item.asset_mark()
    about = item.asset_data
    for tag in [tag for tag in about.tags if tag.name in TAGS]:
        about.tags.remove(tag)
    about.catalog_id = catalog.identifier
    about.description, tags = describe_asset(asset, preset)
    for tag in tags:
        about.tags.new(tag, skip_if_exists=True)
    picture = picture_of(asset)
    if picture is None:
        if not bpy.app.background:
            item.asset_generate_preview()
        return
    set_preview(item, picture)


def set_preview(item: bpy.types.ID, picture: np.ndarray) -> None:
    """Show the picture [H,W,4] as the data-block's preview. Its row 0 is the top row, and its values are sRGB-encoded."""
    preview = item.preview_ensure()
    preview.image_size = picture.shape[1], picture.shape[0]
    preview.image_pixels_float.foreach_set(np.ascontiguousarray(picture[::-1], np.float32).ravel())


def picture_of(asset: Path) -> np.ndarray | None:
    """A square picture [S,S,4] of the asset in the folder, as `load_pixels` gives it; None where there is none.

    It is the first frame of the turntable, or else the asset's half of the engine's preview picture.
    """
    for name, last in ((TURNTABLE, False), (PREVIEW, True)):
        path = asset / name
        if not path.is_file():
            continue
        try:
            pixels = load_pixels(path)
        except OSError:
            continue  # damaged: the other picture may be whole
        half = pixels[:, pixels.shape[1] // 2 :] if last else pixels
        side = min(half.shape[:2])
        top, left = (half.shape[0] - side) // 2, (half.shape[1] - side) // 2 if last else 0
        return half[top : top + side, left : left + side]
    return None
