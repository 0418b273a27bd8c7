"""The images of assets in the .blend file, and what tells which asset an image, a mesh, a material or a World comes from."""

import os
from dataclasses import dataclass
from pathlib import Path

import bpy

from ..color_spaces import set_color_space
from ..image_files import open_image, relative_path


@dataclass(frozen=True)
class Texture:
    """A texture of an asset.

    `socket`: the input of the Principled BSDF, empty for a texture that is not connected. `is_color`: whether the texture's
    PNG file is sRGB-encoded. `label`: the text on the image node.
    """

    name: str
    socket: str
    is_color: bool
    label: str


# The name of a texture, of its image node and of an attribute of the mesh. Their value is 1 where the photos decided the
# material.
CONFIDENCE = "confidence"
FILE_OF_TEXTURE = "nep_file"  # an image's property: the absolute path of the asset's file that it shows
STATE_OF_FILE = "nep_file_state"  # an image's property: time and size of that file when it was read
ASSET_KEY = "nep_asset"  # property of a mesh, a material and a World: the absolute path of the asset
NORMAL_MAP = Texture("normal", "Normal", False, "normal map")  # only assets with few faces have it
TEXTURES = (
    Texture("albedo", "Base Color", True, "albedo"),
    Texture("roughness", "Roughness", False, "roughness"),
    Texture("metallic", "Metallic", False, "metallic"),
    Texture(CONFIDENCE, "", False, "confidence (not connected)"),
)


def load_image(path: Path, *, color_space: str, pack: bool) -> bpy.types.Image:
    """Load an image file as a data-block. Raises OSError where Blender cannot read the file.

    With `pack` the image is stored in the .blend. It refers to its file, by a relative path if the .blend is saved.
    """
    image = open_image(path)
    if not image.size[0]:  # Blender reads the pixels only when asked, and does not report a damaged file
        bpy.data.images.remove(image)
        raise OSError(f"Blender cannot read the image {path}")
    set_color_space(image, color_space)
    if bpy.data.is_saved:
        image.filepath = relative_path(path)
    if pack:
        image.pack()
    return image


def shared_image(path: Path, name: str, *, color_space: str, pack: bool) -> bpy.types.Image:
    """The image of the .blend that shows this file as it is now, or else a new one, as `load_image` makes it.

    Raises OSError where Blender cannot read the file.
    """
    for image in bpy.data.images:
        known = str(image.get(FILE_OF_TEXTURE, ""))
        if known and _path_key(known) == _path_key(path) and bool(image.packed_file) == pack and _shows_file(image, path):
            return image
    image = load_image(path, color_space=color_space, pack=pack)
    image.name = name
    image[FILE_OF_TEXTURE], image[STATE_OF_FILE] = os.path.abspath(path), _state_of_file(path)
    return image


def _shows_file(image: bpy.types.Image, path: Path) -> bool:
    """Whether the image has the pixels that the file has now. It has not after the artist has painted on it."""
    if image.library is not None or image.is_dirty or image.get(STATE_OF_FILE) != _state_of_file(path):
        return False
    return image.packed_file is None or image.packed_file.size == os.path.getsize(path)


def _state_of_file(path: Path | str) -> str:
    try:
        state = os.stat(path)
    except OSError:
        return ""
    return f"{state.st_mtime_ns} {state.st_size}"


def reload_textures(folder: Path) -> int:
    """Read the textures of an asset from their files again, in every image of the .blend that was loaded from them.

    The data-blocks stay, and so does all that uses them. A packed image is packed again. An image whose file is gone keeps
    its pixels. Returns the number of images that were read.

    An image also knows its file by the property FILE_OF_TEXTURE. The reason: Blender makes the paths of images relative when
    it saves, and a .blend with packed images may be moved.
    """
    every, ends = (*TEXTURES, NORMAL_MAP), (".png", ".exr")
    files = {_path_key(folder / "textures" / (texture.name + end)) for texture in every for end in ends}
    count = 0
    for image in bpy.data.images:
        path = bpy.path.abspath(image.filepath, library=image.library)
        known = str(image.get(FILE_OF_TEXTURE, ""))
        if _path_key(path) not in files and known and _path_key(known) in files and image.library is None:
            path = image.filepath = known
        if image.source == "FILE" and _path_key(path) in files and os.path.isfile(path):
            _read_again(image, path)
            if known:
                image[STATE_OF_FILE] = _state_of_file(path)
            count += 1
    return count


def _read_again(image: bpy.types.Image, path: Path | str) -> None:
    """Read the pixels of an image from `path`, which is its own path. What was painted on it is gone."""
    if image.is_dirty:
        image.reload()  # else `pack` would pack what was painted
    if image.packed_file is not None and image.library is None and os.access(path, os.R_OK):
        image.pack()  # Blender's `reload` packs the file from which the image was packed before: it may lie elsewhere now
    image.reload()
    image.update_tag()  # viewports that render show the new pixels


def move_images(old: Path, new: Path) -> None:
    """Let the images of the asset `old` show the files of the asset `new`, which is the same one under another name.

    The images are read again, and packed ones are packed again: the asset may have been corrected since. An image on which
    the artist has painted keeps its pixels. Meshes, materials and Worlds are marked with the new folder.
    """
    for kind in (bpy.data.meshes, bpy.data.materials, bpy.data.worlds):
        for block in kind:
            if block.library is None and ASSET_KEY in block and _path_key(block[ASSET_KEY]) == _path_key(old):
                block[ASSET_KEY] = os.path.abspath(new)
    for image in bpy.data.images:
        known = str(image.get(FILE_OF_TEXTURE, ""))
        if image.library is None and known and _path_key(known).startswith(_path_key(old) + os.sep):
            path = Path(new) / os.path.relpath(known, old)
            if path.is_file():
                image.filepath_raw = relative_path(path) if bpy.data.is_saved else str(path)  # `filepath` would read it
                image[FILE_OF_TEXTURE] = os.path.abspath(path)
                if not _is_painted(image):
                    _read_again(image, path)
                    image[STATE_OF_FILE] = _state_of_file(path)


def _is_painted(image: bpy.types.Image) -> bool:
    """Whether the image has other pixels than the file had when it was read."""
    size = str(image.get(STATE_OF_FILE, "")).split(" ")[-1]
    return image.is_dirty or (image.packed_file is not None and str(image.packed_file.size) != size)


def remove_leftovers(folder: Path) -> None:
    """Remove meshes, materials and outdated images of this asset that nothing uses: their objects were deleted.

    Else they would keep their names until the file is saved, and the new ones would get numbers.
    """
    key = _path_key(folder)
    for kind in (bpy.data.meshes, bpy.data.materials):
        bpy.data.batch_remove([block for block in kind if not block.users and _path_key(block.get(ASSET_KEY, "")) == key])
    unused = [image for image in bpy.data.images if not image.users and image.get(FILE_OF_TEXTURE)]
    ours = [image for image in unused if _path_key(image[FILE_OF_TEXTURE]).startswith(key + os.sep)]
    bpy.data.batch_remove([image for image in ours if not _shows_file(image, Path(image[FILE_OF_TEXTURE]))])


def _path_key(path: Path | str) -> str:
    """One string for all ways to write the path of the same file."""
    return os.path.normcase(os.path.abspath(path))
