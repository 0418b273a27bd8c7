"""The add-on without a job, in Blender without a screen: previews, lines of the panel, registration."""

import os
import sys
from pathlib import Path

import numpy as np

from support.blender_checks import Drawn, register, rounds
from support.own_process import in_blender

# scripts and key maps of artists name them: none may be renamed
OPERATORS = {
    "reconstruct",
    "cancel",
    "open_log",
    "import_result",
    "use_recovered_light",
    "show_lit",
    "dismiss",
    "relink_result",
} | {
    *("export_result", "open_result_folder", "choose_folder"),
    *(
        "find_cameras",
        "find_cameras_of_video",
        "cancel_find_cameras",
        "improve_cameras",
        "check_photos",
        "cancel_check_photos",
        "show_coverage",
        "load_cameras",
        "clear_cameras",
        "capture_from_scene",
        "propose_bounds",
        "clear_bounds",
    ),
    *("correct_materials", "render_comparison", "cancel_comparison", "show_comparison"),
    *("add_shelf_captures", "remove_shelf_captures", "reconstruct_shelf", "stop_shelf", "bring_in_objects"),
    *("add_asset_library", "open_gallery"),
    *("check_engine", "install_engine", "cancel_install", "open_preferences"),
}


def test_damaged_previews_change_nothing(package):
    in_blender(check_damaged_previews, package)


def check_damaged_previews(folder):
    import bpy

    addon, scene, file = register(), bpy.context.scene, folder / "mesh.npz"
    corners, faces = np.eye(3, dtype=np.float32), np.array([[0, 1, 2]])
    np.savez(file, vertices=corners, faces=np.concatenate([faces, faces, faces * 0]))
    addon.scene.live_preview.show_mesh(scene, "job", file)
    mesh = bpy.data.objects["NeP preview"].data
    assert len(mesh.vertices) == 3 and len(mesh.polygons) == 1, "no triangle with a vertex twice"
    for bad in (
        {"faces": np.array([[0, 1, 3]])},  # Blender ends where it draws it
        {"faces": np.array([[0, 1, -1]])},
        {"faces": np.array([[0, 1, 2**32]])},
        {"faces": faces.astype(float)},
        {"faces": faces.ravel()},
        {"vertices": corners[:, :2]},
        {"vertices": corners * np.nan},
        {"vertices": np.array({})},
    ):
        np.savez(file, **{"vertices": corners * 2, "faces": faces} | bad)
        addon.scene.live_preview.show_mesh(scene, "job", file)
        assert len(mesh.polygons) == 1 and mesh.vertices[0].co.x == 1, bad
    for bad in (b"", b"PK", b"\x93NUMPY\1\0", b"\x93NUMPY\1\0\x10\0" + b"(" * 16):
        file.write_bytes(bad)
        addon.scene.live_preview.show_mesh(scene, "job", file)
        assert mesh.vertices[0].co.x == 1, bad
    if hasattr(os, "mkfifo"):
        file.unlink()
        os.mkfifo(file)  # Blender waited for it for ever
        addon.scene.live_preview.show_mesh(scene, "job", file)
        file.unlink()
    addon.scene.live_preview.MOST_BYTES = 10
    np.savez(file, vertices=corners * 2, faces=faces)
    addon.scene.live_preview.show_mesh(scene, "job", file)
    assert mesh.vertices[0].co.x == 1


def test_a_preview_that_is_edited_stays_until_then(package):
    in_blender(check_edited_preview, package)


def check_edited_preview(folder):
    """Blender ends at an undo after a mesh was removed in Edit Mode, and refuses to replace one there."""
    import bpy

    addon, scene, file = register(), bpy.context.scene, folder / "mesh.npz"
    np.savez(file, vertices=np.eye(3, dtype=np.float32), faces=np.array([[0, 1, 2]]))
    addon.scene.live_preview.show_mesh(scene, "job", file)
    preview = bpy.data.objects["NeP preview"]
    preview.hide_select = False
    bpy.context.view_layer.objects.active = preview
    bpy.ops.object.mode_set(mode="EDIT")
    addon.scene.live_preview.show_mesh(scene, "job", file)
    addon.tasks.running_jobs.on_undone()
    assert addon.tasks.clock.tick() is not None and preview.mode == "EDIT"
    bpy.ops.object.mode_set(mode="OBJECT")
    rounds(addon, lambda: "NeP preview" not in bpy.data.objects)


def test_a_picture_is_shown_in_two_halves(package):
    in_blender(check_halves, package)


def check_halves(folder):
    from PIL import Image

    addon = register()
    pair = Image.new("RGB", (64, 32), (255, 0, 0))
    pair.paste((0, 255, 0), (32, 0, 64, 32))
    pair.save(folder / "pair.png")
    preview = addon.halved_pictures
    for _ in range(2):  # the second takes the place of the first
        preview.load_picture("job", folder / "pair.png")
    assert preview.picture_halves("another job") == []
    photo, learned = preview.picture_halves("job")
    for half, color in ((photo, [1, 0, 0, 1]), (learned, [0, 1, 0, 1])):
        assert tuple(half.image_size) == (32, 32)
        pixels = np.array(half.image_pixels_float).reshape(-1, 4)
        np.testing.assert_allclose(pixels, np.tile(color, (32 * 32, 1)), atol=0.01)
    preview.remove_picture("job")
    assert preview.picture_halves("job") == []


def test_lines_of_the_panel_fit(package):
    in_blender(check_wrapping, package)


def check_wrapping(folder):
    from nep_addon.addon.wrapped_text import wrap

    text = "The engine's Python /a/very/long/path/that/is/longer/than/a/line lacks torch.\nInstall it."
    lines = wrap(text, 20)
    assert max(map(len, lines)) <= 20 and len(lines) > 3 and lines[-1] == "Install it." and "lacks torch." in " ".join(lines)
    assert "".join(lines).replace(" ", "") == text.replace(" ", "").replace("\n", "")
    assert wrap("", 20) == []
    check_narrow_sidebar()


def check_narrow_sidebar():
    """In any width, a button has a text that fits, as long as one does; the names of settings come above their fields."""
    from types import SimpleNamespace

    import blf
    import bpy

    addon, real = register(), bpy.context.preferences
    styles = {"system": SimpleNamespace(ui_scale=1.0), "ui_styles": real.ui_styles}
    texts = "Reconstruct Glossy Object", "Reconstruct", "Go"
    shown = []
    for width in (600, 200, 120):
        context = SimpleNamespace(region=SimpleNamespace(width=width), preferences=SimpleNamespace(**styles))
        shown.append(addon.wrapped_text.fitting(context, *texts))
        assert shown[-1] == "Go" or blf.dimensions(0, shown[-1])[0] < width - 64
        layout = Drawn()
        addon.wrapped_text.draw_setting(layout, context, bpy.context.scene.nep, "preset")
        addon.wrapped_text.draw_setting(layout, context, bpy.context.scene.nep, "use_masks")
        assert ("Preset" in layout.log) == (width < 264), "above its field"
    assert shown == list(texts), shown
    context = SimpleNamespace(region=SimpleNamespace(width=300), preferences=SimpleNamespace(**styles))
    for texts in (["Starting"], ["Finding the cameras", "Looked at the surroundings: 64 %, which stand still", "5 s left"]):
        layout = Drawn()
        addon.wrapped_text.draw_steady(layout, context, texts)
        assert len(layout.log) == addon.wrapped_text.STEADY_LINES, "what is below does not move"


def test_registering_twice_leaves_nothing_and_warns_of_nothing(package):
    assert in_blender(check_registration, package).strip() == ""


def check_registration(folder):
    import bpy

    def handlers() -> list[str]:
        lists = (getattr(bpy.app.handlers, event) for event, _ in addon.HANDLERS)
        return [function.__name__ for found in lists for function in found if "nep_addon" in function.__module__]

    def operators() -> set[str]:
        return {name for name in dir(bpy.ops.nep) if not name.startswith("_")}

    import nep_addon
    from nep_addon import addon

    for _ in range(2):
        nep_addon.register()
        assert operators() == OPERATORS and hasattr(bpy.types, "NEP_PT_reconstruct")
        assert sorted(set(handlers())) == ["on_file_loaded", "on_file_saved", "on_save_begins", "on_save_ended", "on_undone"]
        bpy.context.scene.nep.output = str(folder / "out")
        nep_addon.unregister()
        assert not operators() and not handlers()
        assert not hasattr(bpy.types.Scene, "nep") and not hasattr(bpy.types, "NEP_PT_reconstruct")


if __name__ == "__main__":
    sys.path.insert(0, str(Path(sys.argv[2]) / "package"))
    globals()[sys.argv[1]](Path(sys.argv[2]))
