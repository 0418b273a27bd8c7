"""Makes a World that shines with an equirectangular image.

Blender finds the light of a direction (x, y, z) at u = 0.5 - atan2(y, x) / 2 pi and v = 0.5 + atan2(z, |xy|) / pi, where
v = 1 is the image's top row. `environment.exr` of an asset has the same orientation, so no rotation is needed.
A Mapping node lets the artist turn the light, and the Background node has its strength.
"""

from pathlib import Path

import bpy

from .color_spaces import LINEAR
from .data_blocks.asset_images import shared_image

TURN_NODE, STRENGTH_NODE = "turn", "strength"  # names of the Mapping node and of the Background node
# The order is such that the first few HDRIs differ most from each other.
HDRI_ORDER = ("studio", "forest", "sunset", "interior", "city", "courtyard", "sunrise", "night")


def build_world(path: Path, *, name: str, pack: bool = True) -> bpy.types.World:
    """Make a World that shines with the equirectangular image at `path`, with strength 1.

    Raises OSError where the image cannot be read.
    """
    image = shared_image(path, name, color_space=LINEAR, pack=pack)
    world = bpy.data.worlds.new(name)
    if not world.use_nodes:
        world.use_nodes = True
    nodes, links = world.node_tree.nodes, world.node_tree.links
    nodes.clear()
    texture = nodes.new("ShaderNodeTexEnvironment")
    texture.image = image
    texture.location = (-320, 0)
    turn = nodes.new("ShaderNodeMapping")
    turn.name, turn.label, turn.location = TURN_NODE, "turn the light", (-540, 0)
    directions = nodes.new("ShaderNodeTexCoord")
    directions.location = (-740, 0)
    background = nodes.new("ShaderNodeBackground")
    background.name, background.label = STRENGTH_NODE, "strength"
    output = nodes.new("ShaderNodeOutputWorld")
    output.location = (220, 0)
    links.new(directions.outputs["Generated"], turn.inputs["Vector"])
    links.new(turn.outputs["Vector"], texture.inputs["Vector"])
    links.new(texture.outputs["Color"], background.inputs["Color"])
    links.new(background.outputs["Background"], output.inputs["Surface"])
    world.use_fake_user = True  # keeps the World in the file while the scene uses another one
    return world


def renew_world(world: bpy.types.World, path: Path, *, pack: bool = True) -> bool:
    """Let a World of `build_world` shine with the image as it is now. False where the artist has removed its image node.

    Raises OSError where the image cannot be read.
    """
    nodes = world.node_tree.nodes if world.node_tree is not None else ()
    texture = next((node for node in nodes if node.type == "TEX_ENVIRONMENT"), None)
    if texture is None:
        return False
    before, texture.image = texture.image, shared_image(path, world.name, color_space=LINEAR, pack=pack)
    if before is not None and before != texture.image and not before.users:
        name = before.name
        bpy.data.images.remove(before)
        texture.image.name = name
    return True


def turn_input(world: bpy.types.World) -> bpy.types.NodeSocket | None:
    """The input with the angles [3] by which the World's light is turned; None where the artist has removed its node."""
    return _input(world, TURN_NODE, "Rotation")


def strength_input(world: bpy.types.World) -> bpy.types.NodeSocket | None:
    """The input with the strength of the World's light; None where the artist has removed its node."""
    return _input(world, STRENGTH_NODE, "Strength")


def _input(world: bpy.types.World, node: str, socket: str) -> bpy.types.NodeSocket | None:
    found = world.node_tree.nodes.get(node) if world.node_tree is not None else None
    return found.inputs.get(socket) if found is not None else None


def blender_hdris() -> list[Path]:
    """The HDRI files that ship with Blender (CC0), in HDRI_ORDER; an empty list where a distribution left them out."""
    folder = bpy.utils.system_resource("DATAFILES", path="studiolights/world")
    if not folder:
        return []
    found = [path for path in Path(folder).iterdir() if path.suffix in (".exr", ".hdr")]
    rank = {name: place for place, name in enumerate(HDRI_ORDER)}
    return sorted(found, key=lambda path: (rank.get(path.stem, len(rank)), path.stem))
