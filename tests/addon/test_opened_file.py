"""Work that ends after another .blend file was opened, or after Save As. What answers is played."""

import sys
from pathlib import Path
from types import SimpleNamespace

from PIL import Image

from support.blender_checks import register, rounds
from support.own_process import in_blender

ERROR = "the photos show no object"


def test_bounds_are_placed_in_the_file_that_asked_for_them(package):
    in_blender(check_bounds, package)


def check_bounds(folder):
    import bpy

    addon = register()
    answer = SimpleNamespace(sphere=((0.0, 0.0, 0.0), 1.0), error=None, poll=lambda: True, close=lambda: None)
    addon.tasks.bounds_estimate.CaptureQuery = lambda *_: answer
    estimates = addon.tasks.bounds_estimate.BoundsEstimate

    def ask() -> None:
        bpy.context.scene.nep.capture = str(folder)
        addon.tasks.registry.start(estimates(bpy.context.scene, folder, sys.executable))

    def bounds() -> object:
        rounds(addon, lambda: addon.tasks.registry.running(estimates) is None)
        return addon.scene.object_bounds.bounds_object(bpy.context.scene)

    ask()
    bpy.ops.wm.save_as_mainfile(filepath=str(folder / "saved.blend"))
    assert bounds() is not None, "Save As is no other file"
    bpy.ops.wm.read_factory_settings(use_empty=True)
    ask()
    bpy.ops.wm.read_factory_settings(use_empty=True)
    bpy.context.scene.nep.capture = str(folder)
    assert bounds() is None
    answer.sphere, answer.error = None, ERROR
    ask()
    assert bounds() is None and addon.tasks.registry.find(estimates).error == ERROR
    bpy.ops.wm.read_factory_settings(use_empty=True)
    assert addon.tasks.registry.find(estimates) is None, "an error of the file before"
    ask()
    bpy.ops.wm.read_factory_settings(use_empty=True)
    assert bounds() is None and addon.tasks.registry.find(estimates) is None


def test_bounds_are_placed_after_a_save_in_another_folder(package):
    in_blender(check_bounds_elsewhere, package)


def check_bounds_elsewhere(folder):
    import bpy

    addon = register()
    answer = SimpleNamespace(sphere=((0.0, 0.0, 0.0), 1.0), error=None, poll=lambda: True, close=lambda: None)
    addon.tasks.bounds_estimate.CaptureQuery = lambda *_: answer
    estimates = addon.tasks.bounds_estimate.BoundsEstimate
    for name in ("photos", "other"):
        (folder / name).mkdir()
    bpy.ops.wm.save_as_mainfile(filepath=str(folder / "saved.blend"))
    bpy.context.scene.nep.capture = "//photos"
    capture = addon.folders.resolve_folder("//photos")
    estimate = addon.tasks.registry.start(estimates(bpy.context.scene, capture, sys.executable))
    bpy.ops.wm.save_as_mainfile(filepath=str(folder / "other" / "saved.blend"))
    assert bpy.context.scene.nep.capture == "//../photos"
    rounds(addon, lambda: estimate.ended)
    assert addon.scene.object_bounds.bounds_object(bpy.context.scene) is not None


def test_bounds_count_beside_linked_ones_of_the_same_name(package):
    in_blender(check_linked_bounds, package)


def check_linked_bounds(folder):
    import bpy

    addon = register()
    bounds, file = addon.scene.object_bounds, str(folder / "linked.blend")
    bounds.place_bounds(bpy.context.scene, folder, (0, 0, 0), 1.0)
    bpy.ops.wm.save_as_mainfile(filepath=file)
    bpy.ops.wm.read_factory_settings(use_empty=True)
    with bpy.data.libraries.load(file, link=True) as (there, linked):
        linked.objects = there.objects
    scene = bpy.context.scene
    scene.collection.objects.link(linked.objects[0])
    own = bounds.place_bounds(scene, folder, (5, 0, 0), 1.0)
    assert own.name == linked.objects[0].name and bounds.bounds_object(scene) == own
    assert bounds.place_bounds(scene, folder, (6, 0, 0), 1.0) == own
    assert own.select_get() and bpy.context.view_layer.objects.active == own
    assert "--object-center" in bounds.bounds_arguments(scene)
    scene.collection.objects.unlink(own)
    assert bounds.bounds_object(scene) is None


def test_a_comparison_is_shown_in_the_file_that_asked_for_it(package):
    Image.new("RGB", (16, 8), (200, 100, 50)).save(package / "comparison.png")
    in_blender(check_comparison, package)


def check_comparison(folder):
    import bpy

    addon = register()
    picture = folder / "comparison.png"
    state = {"path": picture, "error": "", "done": 1, "total": 1, "cancelled": False}
    process = SimpleNamespace(**state, poll=lambda: True, close=lambda: None)
    addon.tasks.comparison_render.ComparisonProcess = lambda *_: process

    def shown() -> bool:
        rounds(addon, bpy.ops.nep.render_comparison.poll)
        return addon.scene.comparison_image.comparison_image() is not None

    addon.tasks.comparison_render.start_render([], wait=False)
    bpy.ops.wm.save_as_mainfile(filepath=str(folder / "saved.blend"))
    assert shown() and addon.tasks.comparison_render.last_message() == f"Written: {picture}"
    bpy.ops.wm.read_factory_settings(use_empty=True)
    assert not addon.tasks.comparison_render.last_message(), "a message of the file before"
    addon.tasks.comparison_render.start_render([], wait=False)
    bpy.ops.wm.read_factory_settings(use_empty=True)  # neither of both files has a path
    assert not shown() and not addon.tasks.comparison_render.last_message()


if __name__ == "__main__":
    sys.path.insert(0, str(Path(sys.argv[2]) / "package"))
    globals()[sys.argv[1]](Path(sys.argv[2]))
