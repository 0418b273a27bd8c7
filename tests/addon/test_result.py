"""An imported result in the artist's scene: what it changes there, and what it gives back. One session."""

import sys
from pathlib import Path

from support import correcting_engine
from support.blender_checks import drawn_by, register, told_in
from support.own_process import in_blender


def test_a_result_in_the_artists_scene(package):
    correcting_engine.make_asset(package / "asset")
    in_blender(check_results, package)


def check_results(folder):
    import bpy

    addon = register()
    for check in (check_lit_view,):
        with told_in(check.__name__):
            bpy.ops.wm.read_factory_settings(use_empty=True)
            check(bpy, addon, folder)


def check_lit_view(bpy, addon, folder):
    """The light, the lamps and the shading of the viewport come, and all of it goes."""
    scene, view = bpy.context.scene, addon.scene.lit_view
    lamps = [bpy.data.objects.new(name, bpy.data.lights.new(name, "SUN")) for name in ("on", "off", "hidden")]
    for lamp in lamps:
        scene.collection.objects.link(lamp)
    lamps[1].hide_viewport = lamps[1].hide_render = lamps[2].hide_viewport = True
    hidden = [(lamp.hide_viewport, lamp.hide_render) for lamp in lamps]
    own = scene.world = bpy.data.worlds.new("own")
    assert not bpy.ops.nep.show_lit.poll()
    assert bpy.ops.nep.import_result(folder=str(folder / "asset")) == {"FINISHED"}
    screen, area = view.viewport(bpy.context)
    space = area.spaces.active
    space.region_3d.view_location = (50, 50, 50)
    for kind in ("SOLID", "MATERIAL", "RENDERED"):
        space.shading.type, space.shading.use_scene_world, space.shading.use_scene_world_render = kind, False, False
        assert bpy.ops.nep.show_lit() == {"FINISHED"}
        assert scene.world == scene.nep.recovered_world and all(lamp.hide_render and lamp.hide_viewport for lamp in lamps)
        assert space.shading.type == ("RENDERED" if kind == "RENDERED" else "MATERIAL")
        assert space.shading.use_scene_world_render if kind == "RENDERED" else space.shading.use_scene_world
        item = addon.scene.imported_result.result_object(scene)
        middle = sum((vertex.co for vertex in item.data.vertices), space.region_3d.view_location * 0) / len(
            item.data.vertices
        )
        assert (space.region_3d.view_location - middle).length < max(item.dimensions)
        assert max(item.dimensions) / 2 < space.region_3d.view_distance < 20 * max(item.dimensions)
        assert bpy.ops.nep.show_lit() == {"FINISHED"}
        assert scene.world == own and [(lamp.hide_viewport, lamp.hide_render) for lamp in lamps] == hidden
        assert space.shading.type == kind and not space.shading.use_scene_world and not space.shading.use_scene_world_render
        assert not screen.keys() and not any(lamp.keys() for lamp in lamps)
    bpy.ops.nep.show_lit()
    bpy.ops.nep.use_recovered_light()  # the other button goes back, too
    assert scene.world == own and not lamps[0].hide_render and space.shading.type == "RENDERED"
    texts = drawn_by(bpy, addon.panels.subpanels.NEP_PT_result_and_light)
    assert texts.index("nep.show_lit") < texts.index("Turn") < texts.index("Strength")
    world = scene.nep.recovered_world
    from nep_addon.backend.scene_io.world import strength_input, turn_input

    assert turn_input(world).links == () or not turn_input(world).links
    world.node_tree.nodes.remove(world.node_tree.nodes["turn"])
    assert turn_input(world) is None and strength_input(world).default_value == 1


if __name__ == "__main__":
    sys.path.insert(0, str(Path(sys.argv[2]) / "package"))
    globals()[sys.argv[1]](Path(sys.argv[2]))
