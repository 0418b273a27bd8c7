"""An imported result in the artist's scene: what it changes there, and what it gives back. One session."""

import shutil
import sys
from pathlib import Path

import numpy as np
from PIL import Image

from support import correcting_engine
from support.blender_checks import drawn_by, fails, register, told_in
from support.own_process import in_blender


def test_a_result_in_the_artists_scene(package):
    correcting_engine.make_asset(package / "asset")
    in_blender(check_results, package)


def check_results(folder):
    import bpy

    addon = register()
    for check in (check_lit_view, check_tidy_imports, check_states, check_relink, check_export):
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
        assert area.spaces.active.local_view is not None, "the object is seen alone"
        assert max(item.dimensions) / 2 < space.region_3d.view_distance < 20 * max(item.dimensions)
        assert bpy.ops.nep.show_lit() == {"FINISHED"}
        assert area.spaces.active.local_view is None
        assert tuple(space.region_3d.view_location) == (50, 50, 50), "and the view"
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


def check_tidy_imports(bpy, addon, folder):
    """Objects share images and World; names are the object's; selection and collections are the artist's."""
    scene, layer = bpy.context.scene, bpy.context.view_layer
    mine = bpy.data.objects.new("mine", None)
    scene.collection.objects.link(mine)
    mine.select_set(True)
    layer.objects.active = mine
    collection = bpy.data.collections.new("active")
    scene.collection.children.link(collection)
    layer.active_layer_collection = layer.layer_collection.children["active"]
    names = ["asset albedo", "asset confidence", "asset light", "asset metallic", "asset roughness"]
    for _ in range(3):
        assert bpy.ops.nep.import_result(folder=str(folder / "asset")) == {"FINISHED"}
        assert sorted(image.name for image in bpy.data.images) == names and bpy.data.worlds.keys() == ["asset light"]
        assert list(layer.objects.selected) == [layer.objects.active] == [mine]
    assert collection.objects.keys() == ["asset", "asset.001", "asset.002"]
    scene.nep.recovered_world.node_tree.nodes["turn"].inputs["Rotation"].default_value[2] = 1.5
    for item in list(collection.objects):
        bpy.data.objects.remove(item)
    assert bpy.ops.nep.import_result(folder=str(folder / "asset")) == {"FINISHED"}
    (item,) = collection.objects
    assert item.name == item.data.name == item.data.materials[0].name == "asset"
    assert sorted(image.name for image in bpy.data.images) == names
    assert scene.nep.recovered_world.node_tree.nodes["turn"].inputs["Rotation"].default_value[2] == 1.5

    texture = bpy.data.images["asset roughness"]
    texture.pixels[0] = 0.9  # the artist paints: a new object gets the file's pixels
    assert texture.is_dirty
    assert bpy.ops.nep.import_result(folder=str(folder / "asset")) == {"FINISHED"}
    fresh = collection.objects["asset.001"].data.materials[0].node_tree.nodes["roughness"].image
    assert fresh is not texture and fresh.name == "asset.001 roughness" and fresh.pixels[0] < 0.6
    shutil.copytree(folder / "asset", folder / "another")  # the same name of a file in another folder
    assert bpy.ops.nep.import_result(folder=str(folder / "another")) == {"FINISHED"}
    assert bpy.data.images["another albedo"].filepath.endswith("albedo.png") and "another light" in bpy.data.worlds


def check_states(bpy, addon, folder):
    """The panels say what is true, also after the artist has deleted the object."""
    scene, found = bpy.context.scene, addon.scene.imported_result
    scene.nep.output = str(folder / "asset")
    assert found.has_new_result(scene) and found.result_object(scene) is None
    assert bpy.ops.nep.import_result() == {"FINISHED"}
    assert not found.has_new_result(scene) and found.result_object(scene).name == "asset"
    bpy.data.objects.remove(found.result_object(scene))
    assert found.has_new_result(scene) and found.result_object(scene) is None
    assert "nep.import_result" in drawn_by(bpy, addon.panels.reconstruct.NEP_PT_reconstruct)
    assert "not in the scene any more" in " ".join(drawn_by(bpy, addon.panels.materials.NEP_PT_materials))


def check_relink(bpy, addon, folder):
    """A result that was renamed is found again, and its corrections go on; another result is refused."""
    scene, settings = bpy.context.scene, bpy.context.scene.nep
    panels = addon.panels.materials.NEP_PT_materials, addon.panels.subpanels.NEP_PT_result_and_light

    def offers() -> list[bool]:
        return ["nep.relink_result" in drawn_by(bpy, panel) for panel in panels]

    for images in ("PACKED", "RELATIVE"):
        settings.images, settings.output = images, str(folder / "asset")
        assert bpy.ops.nep.import_result() == {"FINISHED"}
        item = addon.scene.imported_result.result_object(scene)
        settings.materials[0].metal = "METAL"  # chosen, and not applied yet
        assert offers() == [False, False]
        (folder / "asset").rename(folder / "renamed")
        assert offers() == [True, True]
        fails(lambda: bpy.ops.nep.relink_result(directory=str(folder)), "no finished result")
        correcting_engine.write_report(folder / "another", correcting_engine.MATERIALS[:1])
        fails(lambda: bpy.ops.nep.relink_result(directory=str(folder / "another")), "holds another result")
        assert offers() == [True, True]
        assert bpy.ops.nep.relink_result(directory=str(folder / "renamed") + "/") == {"FINISHED"}
        assert offers() == [False, False] and settings.materials[0].metal == "METAL"
        assert addon.scene.imported_result.result_object(scene) is item
        assert addon.folders.resolve_folder(settings.output) == folder / "renamed"
        image = item.data.materials[0].node_tree.nodes["albedo"].image
        assert Path(image.filepath) == folder / "renamed" / "textures" / "albedo.png" and image.pixels[0] > 0
        check_pixels_after_relink(bpy, addon, item, folder)
        bpy.ops.wm.read_factory_settings(use_empty=True)
        scene, settings = bpy.context.scene, bpy.context.scene.nep


def check_pixels_after_relink(bpy, addon, item, folder):
    """Images show the files of the folder's new place: after a correction there, and if the next place has others."""
    nodes = item.data.materials[0].node_tree.nodes
    texture, metallic = nodes["roughness"].image, nodes["metallic"].image
    whole = [(folder / "renamed" / "textures" / f"{name}.png").read_bytes() for name in ("roughness", "metallic")]
    write_gray(folder / "renamed", "roughness", 120)
    assert addon.scene.imported_materials.reload_result(folder / "renamed") >= 4
    assert round(255 * texture.pixels[0]) == 120
    metallic.pixels = [0.1] * len(metallic.pixels)
    (folder / "renamed").rename(folder / "asset")
    write_gray(folder / "asset", "roughness", 200)
    write_gray(folder / "asset", "metallic", 200)
    assert bpy.ops.nep.relink_result(directory=str(folder / "asset")) == {"FINISHED"}
    assert round(255 * texture.pixels[0]) == 200, "it was corrected before the new place was known"
    assert abs(metallic.pixels[0] - 0.1) < 0.01 and metallic.is_dirty, "the artist has painted on it"
    if texture.packed_file is not None:
        assert texture.packed_file.data == (folder / "asset" / "textures" / "roughness.png").read_bytes()
    for name, content in zip(("roughness", "metallic"), whole, strict=True):
        (folder / "asset" / "textures" / f"{name}.png").write_bytes(content)


def write_gray(asset, texture, value):
    Image.fromarray(np.full((8, 8, 3), value, np.uint8)).save(asset / "textures" / f"{texture}.png")


def check_export(bpy, addon, folder):
    """Each of Blender's exporters that is there writes the object alone, with its textures; the selection stays."""
    scene, exchange = bpy.context.scene, addon.operators.exchange
    assert not bpy.ops.nep.export_result.poll() and not bpy.ops.nep.open_result_folder.poll()
    bpy.ops.mesh.primitive_cube_add()
    cube = bpy.context.object
    assert bpy.ops.nep.import_result(folder=str(folder / "asset")) == {"FINISHED"} and bpy.ops.nep.open_result_folder.poll()
    texts = drawn_by(bpy, addon.panels.subpanels.NEP_PT_result_and_light)
    for name, exporter in exchange.EXPORTERS.items():
        assert (texts.count("nep.export_result") == 3) or not exchange.has_exporter(name)
        if exchange.has_exporter(name):
            (folder / f"pot{exporter.ending}").write_bytes(b"an earlier one")
            assert bpy.ops.nep.export_result(format=name, filepath=str(folder / "pot")) == {"FINISHED"}
            assert (folder / f"pot{exporter.ending}").stat().st_size > 1000
            assert list(bpy.context.selected_objects) == [cube] == [bpy.context.view_layer.objects.active]
    assert not list(folder.glob("partial_*"))
    fails(lambda: bpy.ops.nep.export_result(format="GLTF", filepath=str(folder / "pot.fbx" / "pot")), "cannot be written")
    addon.scene.imported_result.result_object(scene).hide_set(True)
    fails(lambda: bpy.ops.nep.export_result(format="GLTF", filepath=str(folder / "pot")), "is hidden")
    bpy.ops.wm.read_factory_settings(use_empty=True)
    bpy.ops.import_scene.gltf(filepath=str(folder / "pot.glb"))
    (item,) = [item for item in bpy.data.objects if item.type == "MESH"]
    principled = next(node for node in item.data.materials[0].node_tree.nodes if node.type == "BSDF_PRINCIPLED")
    assert all(principled.inputs[name].is_linked for name in ("Base Color", "Roughness", "Metallic"))


if __name__ == "__main__":
    sys.path.insert(0, str(Path(sys.argv[2]) / "package"))
    globals()[sys.argv[1]](Path(sys.argv[2]))
