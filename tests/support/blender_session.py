"""What an artist does with the extension, as a script in one Blender: install, cameras, bounds, job, result, light,
comparison, shelf, remove. Run in a process of its own by addon/test_session.py (the wheel at hand) and blender_matrix.py
(all).

    python tests/support/blender_session.py ARCHIVE CAPTURE ASSET FOLDER      ASSET: finished, of CAPTURE, preset preview

The engine is the Python in NEP_ENGINE_PYTHON. FOLDER is empty and takes what is written.
"""

import importlib
import json
import os
import shutil
import sys
from pathlib import Path

import bpy
import numpy as np
from blender_checks import fails, rounds
from bpy_extras.object_utils import world_to_camera_view
from mathutils import Vector

NAME = "bl_ext.user_default.blender_nep"


def nep():
    return bpy.context.scene.nep


def backend(module: str):
    return importlib.import_module(f"{NAME}.backend.{module}")


def addon(module: str):
    return importlib.import_module(f"{NAME}.addon.{module}")


def check_install(archive: str) -> None:
    bpy.ops.extensions.package_install_files(filepath=archive, repo="user_default", enable_on_install=True)
    assert NAME in bpy.context.preferences.addons, "installed, but not enabled"
    for name in dir(bpy.ops.nep):
        assert getattr(bpy.ops.nep, name).get_rna_type().description not in ("", "(undocumented operator)"), name
    known = set(bpy.types.UILayout.bl_rna.functions["prop"].parameters.keys())
    assert {"placeholder", "icon", "text"} <= known and "progress" in bpy.types.UILayout.bl_rna.functions
    for name in (
        "find_cameras",
        "cancel_find_cameras",
        "improve_cameras",
        "check_photos",
        "cancel_check_photos",
        "show_coverage",
        "clear_cameras",
        "capture_from_scene",
        "propose_bounds",
        "clear_bounds",
        "use_recovered_light",
        "correct_materials",
        "reconstruct_shelf",
        "stop_shelf",
        "bring_in_objects",
        "add_asset_library",
        "open_gallery",
        "cancel_comparison",
        "show_comparison",
    ):
        assert not getattr(bpy.ops.nep, name).poll(), name


def check_cameras(capture: Path) -> None:
    """Points at random project as the pinhole model of transforms.json says; a second load replaces the first."""
    fails(lambda: bpy.ops.nep.load_cameras(), "Choose a capture folder")
    fails(lambda: bpy.ops.nep.load_cameras(capture=str(capture / "none")), "cannot be read")
    nep().capture = str(capture)
    assert bpy.ops.nep.load_cameras() == {"FINISHED"}
    assert bpy.ops.nep.load_cameras() == {"FINISHED"}
    meta = json.loads((capture / "transforms.json").read_text())
    scene, rng = bpy.context.scene, np.random.default_rng(0)
    (collection,) = (c for c in scene.collection.children if c.name.startswith("NeP cameras"))
    cameras = sorted(collection.objects, key=lambda item: item.name)
    assert collection.name == f"NeP cameras: {capture.name}"
    assert len(cameras) == len(meta["frames"]) == len(bpy.data.cameras) == len(bpy.data.images)
    assert not any(image.has_data for image in bpy.data.images), "photos are read when they are looked at"
    assert (scene.render.resolution_x, scene.render.resolution_y) == (meta["w"], meta["h"])
    bpy.context.view_layer.update()
    for camera, frame in zip(cameras, meta["frames"], strict=True):
        image = camera.data.background_images[0].image
        assert os.path.samefile(bpy.path.abspath(image.filepath), capture / frame["file_path"])
        matrix = np.array(frame["transform_matrix"])
        for local in np.c_[rng.uniform(-1, 1, (3, 2)), rng.uniform(-6, -2, 3)]:
            x, y, _ = world_to_camera_view(scene, camera, Vector(matrix[:3, :3] @ local + matrix[:3, 3]))
            expected = (meta["cx"] + meta["fl_x"] * local[0] / -local[2], meta["cy"] - meta["fl_y"] * local[1] / -local[2])
            np.testing.assert_allclose((x * meta["w"], (1 - y) * meta["h"]), expected, atol=2e-3)


def check_capture_from_scene(capture: Path, folder: Path) -> None:
    """The loaded cameras make the same capture again; what cannot be used is refused in words."""
    made = folder / "from scene"
    assert bpy.ops.nep.capture_from_scene(directory=str(made)) == {"FINISHED"} and nep().capture == str(made)
    before, after = (json.loads((f / "transforms.json").read_text()) for f in (capture, made))
    for old, new in zip(before["frames"], after["frames"], strict=True):
        np.testing.assert_allclose(new["transform_matrix"], old["transform_matrix"], atol=1e-5)
        assert os.path.samefile(made / new["file_path"], capture / old["file_path"])
        for key in ("w", "h", "fl_x", "fl_y", "cx", "cy"):
            np.testing.assert_allclose(new[key], before[key], rtol=1e-5)
    camera = bpy.data.objects["000"]
    camera.data.type = "PANO"
    fails(lambda: bpy.ops.nep.capture_from_scene(directory=str(folder / "no")), "000 is a panoramic camera")
    camera.data.type = "PERSP"
    image = camera.data.background_images[0].image
    path, image.filepath = image.filepath, str(folder / "gone.exr")
    fails(lambda: bpy.ops.nep.capture_from_scene(directory=str(folder / "no")), "gone.exr is missing")
    image.filepath = path
    fails(lambda: bpy.ops.nep.capture_from_scene(directory=str(capture)), "already holds a capture")
    fails(lambda: bpy.ops.nep.capture_from_scene(), "Save the .blend file first")
    assert not (folder / "no").exists()
    assert bpy.ops.nep.clear_cameras() == {"FINISHED"}
    assert not bpy.data.cameras and not bpy.data.images and not bpy.ops.nep.capture_from_scene.poll()


def check_camera_search(capture: Path, folder: Path) -> None:
    """Photos without cameras are refused with what to do. The engine looks for cameras, and says why there are none."""
    photos = folder / "photos"
    shutil.copytree(capture / "images", photos)
    nep().capture, nep().output = str(photos), str(folder / "never")
    for refused in (bpy.ops.nep.reconstruct, bpy.ops.nep.load_cameras, bpy.ops.nep.propose_bounds):
        fails(refused, "press Find Cameras first")
    fails(bpy.ops.nep.find_cameras, "share too few points")
    assert bpy.ops.nep.find_cameras.poll() and not bpy.ops.nep.cancel_find_cameras.poll()
    assert not (photos / "transforms.json").exists() and not (folder / "never").exists()
    nep().capture, nep().output = str(capture), ""


def check_bounds(capture: Path, from_scene: Path) -> None:
    """The capture's own sphere; the engine's estimate where it has none; what an artist does to it reaches the engine."""

    def told() -> list[float]:
        given = addon("scene.object_bounds").bounds_arguments(bpy.context.scene)
        assert (given[0], given[4]) == ("--object-center", "--object-radius") and len(given) == 6
        assert not any("e" in number for number in (*given[1:4], given[5])), given
        return [float(number) for number in (*given[1:4], given[5])]

    meta = json.loads((capture / "transforms.json").read_text())
    own = [*meta["object_center"], meta["object_radius"]]
    assert addon("scene.object_bounds").bounds_arguments(bpy.context.scene) == []
    nep().capture = str(capture)
    assert bpy.ops.nep.propose_bounds() == {"FINISHED"}
    np.testing.assert_allclose(told(), own, atol=1e-6)
    item = nep().bounds
    assert item.name == f"NeP bounds: {capture.name}" and item.empty_display_type == "SPHERE"
    item.location, item.scale = (-1e-5, 2.5, -3), (-0.5, 0.25, 0.25)
    np.testing.assert_allclose(told(), [-1e-5, 2.5, -3, 0.5], rtol=1e-6)
    assert "longest axis" in addon("scene.object_bounds").bounds_warning(bpy.context.scene)

    nep().capture = str(from_scene)  # no masks, no sphere: estimated from the cameras alone
    assert bpy.ops.nep.propose_bounds() == {"FINISHED"} and nep().bounds == item
    center, radius = np.array(told()[:3]), told()[3]
    assert np.linalg.norm(center - own[:3]) < 0.3 * own[3] and 0.6 * own[3] < radius < 2 * own[3]
    nep().capture = str(from_scene / "none")
    fails(lambda: bpy.ops.nep.propose_bounds(), "cannot be read")
    assert (
        bpy.ops.nep.clear_bounds() == {"FINISHED"} and addon("scene.object_bounds").bounds_arguments(bpy.context.scene) == []
    )
    nep().capture = str(capture)


def check_job(capture: Path, asset: Path) -> None:
    """The engine ends a job that is complete; with other bounds it refuses. The result is in place."""
    nep().capture, nep().output, nep().preset = str(capture), str(asset), "preview"
    assert bpy.ops.nep.reconstruct(resume=True) == {"FINISHED"}
    item = addon("scene.imported_result").result_object(bpy.context.scene)
    assert item.name == asset.name and nep().recovered_world.name == f"{asset.name} light"
    check_object(item, asset)
    bpy.ops.nep.propose_bounds()
    nep().bounds.location.x += 0.25
    fails(lambda: bpy.ops.nep.reconstruct(resume=True), "object bounds")
    assert bpy.ops.nep.clear_bounds() == {"FINISHED"}


def check_object(item, asset: Path) -> None:
    lines = (asset / "mesh.obj").read_text().splitlines()
    vertices = np.array([line.split()[1:4] for line in lines if line.startswith("v ")], float)
    world = np.array([item.matrix_world @ vertex.co for vertex in item.data.vertices])
    np.testing.assert_allclose(world, vertices, atol=1e-5)
    mesh = item.data
    assert all(polygon.use_smooth for polygon in mesh.polygons) and len(mesh.uv_layers) == 1
    normals = np.array([line.split()[1:4] for line in lines if line.startswith("vn ")], float)
    if len(normals):
        given = normals[[loop.vertex_index for loop in mesh.loops]]  # one index for vertex and normal in the file
        shown = np.array([normal.vector for normal in mesh.corner_normals])
        cosine = (given * shown).sum(1) / np.linalg.norm(given, axis=1)
        assert np.percentile(cosine, 1) > 0.9999, "the mesh is shaded with its own normals"
    principled = next(node for node in mesh.materials[0].node_tree.nodes if node.type == "BSDF_PRINCIPLED")
    for socket, name, space in (
        ("Base Color", "albedo", "sRGB"),
        ("Roughness", "roughness", "Non-Color"),
        ("Metallic", "metallic", "Non-Color"),
    ):
        (link,) = principled.inputs[socket].links
        assert link.from_node.name == name and link.from_node.image.colorspace_settings.name == space
        assert link.from_node.image.packed_file
    confidence = mesh.materials[0].node_tree.nodes["confidence"]
    assert "not connected" in confidence.label and not confidence.outputs["Color"].links
    values = np.array([point.value for point in mesh.attributes["confidence"].data])
    assert len(values) == len(mesh.vertices) and 0 <= values.min() <= values.max() <= 1 and values.max() > 0.5


def check_import(asset: Path, folder: Path) -> None:
    """Images by path; a second import beside the first; a damaged asset leaves nothing behind."""
    bpy.ops.wm.save_as_mainfile(filepath=str(folder / "artist.blend"))
    nep().images = "RELATIVE"
    assert bpy.ops.nep.import_result(folder=str(asset)) == {"FINISHED"}
    item = addon("scene.imported_result").result_object(bpy.context.scene)
    assert item.name == f"{asset.name}.001" and nep().recovered_world.name == f"{asset.name} light"
    image = item.data.materials[0].node_tree.nodes["albedo"].image
    assert image.filepath.startswith("//") and not image.packed_file
    damaged = folder / "damaged"
    shutil.copytree(asset, damaged)
    counts = [
        len(kind) for kind in (bpy.data.objects, bpy.data.meshes, bpy.data.materials, bpy.data.images, bpy.data.worlds)
    ]
    for spoil, message in (
        (lambda: (damaged / "environment.exr").write_bytes(b"torn"), "environment.exr"),
        (lambda: (damaged / "textures" / "metallic.png").write_bytes(b"torn"), "metallic.png"),
        (lambda: [path.unlink() for path in (damaged / "textures").glob("metallic.*")], "incomplete"),
        (lambda: (damaged / "mesh.obj").unlink(), "no mesh.obj"),
        (lambda: shutil.rmtree(damaged), "there is no folder"),
    ):
        spoil()
        fails(lambda: bpy.ops.nep.import_result(folder=str(damaged)), message)
        assert counts == [
            len(kind) for kind in (bpy.data.objects, bpy.data.meshes, bpy.data.materials, bpy.data.images, bpy.data.worlds)
        ]


def check_light() -> None:
    scene = bpy.context.scene
    own = scene.world = bpy.data.worlds.new("own")
    for before in (own, None):
        scene.world = before
        assert bpy.ops.nep.use_recovered_light() == {"FINISHED"} and scene.world == nep().recovered_world
        assert bpy.ops.nep.use_recovered_light() == {"FINISHED"} and scene.world == before


def check_comparison(asset: Path, folder: Path) -> None:
    """A picture with all its parts, made without touching the file; none, and words, where something is missing."""
    scenes, objects = len(bpy.data.scenes), len(bpy.data.objects)
    fails(lambda: bpy.ops.nep.render_comparison(asset=str(folder / "none")), "there is no folder")
    fails(lambda: bpy.ops.nep.render_comparison(light_file=str(folder / "none.hdr")), "no light file")
    fails(lambda: bpy.ops.nep.render_comparison(capture=str(folder)), "transforms.json")
    picture = folder / "sheet.png"
    assert bpy.ops.nep.render_comparison(
        asset=str(asset),
        output=str(picture),
        lights={"studio"},
        light_file=str(asset / "environment.exr"),
        photos=1,
        turntable=4,
        samples=2,
    ) == {"FINISHED"}
    image = bpy.data.images["NeP comparison"]
    width, height = image.size
    assert width == 6 + 4 * 326 and 58 + 326 + 34 + 200 < height  # 4 columns, one row, a strip of 4
    pixels = np.empty(width * height * 4, np.float32)
    image.pixels.foreach_get(pixels)
    tiles = pixels.reshape(height, width, 4)[::-1, :, :3]
    for row, column in [(58, 6 + 326 * n) for n in range(4)] + [(58 + 326 + 34, 6 + 326 * n) for n in range(4)]:
        assert tiles[row : row + 300, column : column + 300].std() > 0.02, (row, column)
    assert tiles[58 + 326 : 58 + 326 + 34].max() > 0.8, "the strip has a title"
    assert (scenes, objects) == (len(bpy.data.scenes), len(bpy.data.objects)) and bpy.ops.nep.render_comparison.poll()

    never = ["--asset", str(asset), "--capture", nep().capture, "--out", str(folder / "never.png"), "--samples", "100000"]
    addon("tasks.comparison_render").start_render(never, wait=False)
    assert not bpy.ops.nep.render_comparison.poll() and bpy.ops.nep.cancel_comparison() == {"FINISHED"}
    rounds(importlib.import_module(f"{NAME}.addon"), bpy.ops.nep.render_comparison.poll)
    assert bpy.ops.nep.show_comparison.poll()
    assert addon("tasks.comparison_render").last_message() == "Cancelled" and not (folder / "never.png").exists()


def check_shelf(asset: Path, folder: Path) -> None:
    """The object of a batch becomes an asset with a picture, once, and its folder an asset library."""
    shelf = folder / "shelf"
    shutil.copytree(asset, shelf / "thing")
    backend("scene_io.image_files").write_png(shelf / "thing" / "turntable.png", np.full((16, 128, 3), 99, np.uint8))
    told = {"name": "thing", "capture": nep().capture, "state": "done", "fraction": 1}
    (shelf / "batch.json").write_text(json.dumps({"format": 1, "started": "", "preset": "preview", "objects": [told]}))
    nep().shelf_output = str(shelf)
    for _ in range(2):
        assert bpy.ops.nep.bring_in_objects() == {"FINISHED"}
    (item,) = (item for item in bpy.context.scene.objects if item.asset_data)
    assert item.name == "thing" and tuple(item.preview.image_size) == (16, 16) and item.asset_data.description
    bpy.context.view_layer.update()
    assert abs(min((item.matrix_world @ vertex.co).z for vertex in item.data.vertices)) < 1e-4
    item["made for"] = bpy.data.scenes.new("never shown")  # it is written, too
    assert bpy.ops.nep.add_asset_library() == {"FINISHED"}
    assert item.asset_data.catalog_id in (shelf / "blender_assets.cats.txt").read_text()
    with bpy.data.libraries.load(str(shelf / "shelf.blend"), assets_only=True) as (there, _):
        assert there.objects == ["thing"]


def check_removal() -> None:
    bpy.ops.preferences.addon_disable(module=NAME)
    assert not hasattr(bpy.types.Scene, "nep") and not hasattr(bpy.types, "NEP_PT_relit_comparison")
    bpy.ops.preferences.addon_enable(module=NAME)
    assert hasattr(bpy.types, "NEP_PT_relit_comparison")


def main(archive: str, *folders: str) -> None:
    capture, asset, folder = (Path(path).resolve() for path in folders)
    bpy.ops.wm.read_factory_settings(use_empty=True)
    check_install(archive)
    check_cameras(capture)
    check_capture_from_scene(capture, folder)
    check_camera_search(capture, folder)
    check_bounds(capture, folder / "from scene")
    check_job(capture, asset)
    check_import(asset, folder)
    check_light()
    check_comparison(asset, folder)
    check_shelf(asset, folder)
    check_removal()
    print(f"all of it works in Blender {bpy.app.version_string}")


if __name__ == "__main__":
    main(*sys.argv[1:])
