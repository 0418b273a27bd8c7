"""An asset in a Blender with a studio's own color management, whose color spaces have other names, or none that fits."""

import sys
from pathlib import Path

import numpy as np
import pytest

from support.blender_checks import with_small_light_map
from support.own_process import in_blender

CONFIGURATION = """ocio_profile_version: 2
roles:
  scene_linear: {linear}
  default: {texture}
  default_byte: {texture}
  default_float: {linear}
  color_picking: {texture}
  data: Utility - Raw
displays:
  Screen:
    - !<View> {{name: Raw, colorspace: Utility - Raw}}
active_displays: [Screen]
active_views: [Raw]
colorspaces:
  - !<ColorSpace> {{name: Utility - Raw, isdata: true}}
  - !<ColorSpace> {{name: {linear}, encoding: scene-linear}}
  - !<ColorSpace>
    name: {texture}
    to_scene_reference: !<ExponentWithLinearTransform> {{gamma: 2.4, offset: 0.055}}
"""


@pytest.mark.parametrize(
    ("texture", "linear"),
    [("Utility - sRGB - Texture", "Utility - Linear - sRGB"), ("our screens", "our light")],
)
def test_an_asset_in_a_studios_color_management(asset, monkeypatch, texture, linear):
    (asset / "config.ocio").write_text(CONFIGURATION.format(texture=texture, linear=linear))
    monkeypatch.setenv("OCIO", str(asset / "config.ocio"))
    in_blender(check_asset_and_render, asset, texture, linear)


def check_asset_and_render(asset, texture, linear):
    import bpy

    from backend.rendering.relight import RelitScene
    from backend.scene_io.asset_import import import_asset
    from backend.scene_io.capture_files import Frame
    from backend.scene_io.color_spaces import is_linear
    from backend.scene_io.world import build_world

    bpy.ops.wm.read_factory_settings(use_empty=True)
    item = import_asset(Path(asset), bpy.context.scene.collection)
    nodes = item.data.materials[0].node_tree.nodes
    albedo, roughness = (nodes[name].image for name in ("albedo", "roughness"))
    assert albedo.colorspace_settings.name == texture and not is_linear(albedo)
    assert roughness.colorspace_settings.is_data and is_linear(roughness)
    world = with_small_light_map(build_world(Path(asset) / "environment.exr", name="light"))
    (light,) = (node.image for node in world.node_tree.nodes if node.type == "TEX_ENVIRONMENT")
    assert light.colorspace_settings.name == linear
    with RelitScene(bpy.data.objects.new("nothing", None), 8, 8, samples=1) as relit:
        seen = relit.render(Frame(Path("none"), 8, 8, 8.0, 8.0, 4.0, 4.0, np.eye(4), "linear"), world)
    np.testing.assert_allclose(seen.mean((0, 1)), 0.5, rtol=0.05)  # one sample, denoised


def test_renderings_keep_the_primaries_of_the_light_in_a_studio(asset, monkeypatch):
    """The configuration works with the primaries of ACEScg. The matrix is that from Rec.709 to them."""
    configuration = CONFIGURATION.format(texture="sRGB - Texture", linear="ACEScg")
    configuration += """
  - !<ColorSpace>
    name: Linear Rec.709 (sRGB)
    encoding: scene-linear
    to_scene_reference: !<MatrixTransform> {matrix: [0.6131, 0.3395, 0.0474, 0, 0.0702, 0.9164, 0.0134, 0,
      0.0206, 0.1096, 0.8698, 0, 0, 0, 0, 1]}
"""
    (asset / "config.ocio").write_text(configuration)
    monkeypatch.setenv("OCIO", str(asset / "config.ocio"))
    in_blender(check_primaries, asset)


def check_primaries(asset):
    import bpy

    from backend.rendering.relight import RelitScene
    from backend.scene_io.capture_files import Frame
    from backend.scene_io.world import build_world
    from support.captures import write_exr

    bpy.ops.wm.read_factory_settings(use_empty=True)
    write_exr(Path(asset) / "red.exr", np.tile([1.0, 0.1, 0.1], (4, 8, 1)))
    world = with_small_light_map(build_world(Path(asset) / "red.exr", name="light"))
    with RelitScene(bpy.data.objects.new("nothing", None), 8, 8, samples=1) as relit:
        seen = relit.render(Frame(Path("none"), 8, 8, 8.0, 8.0, 4.0, 4.0, np.eye(4), "linear"), world)
    np.testing.assert_allclose(seen.mean((0, 1)), [1.0, 0.1, 0.1], rtol=0.02)


if __name__ == "__main__":
    globals()[sys.argv[1]](*sys.argv[2:])
