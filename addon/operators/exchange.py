"""The operators between Blender and other programs: export the object, open the result's folder, take a folder in."""

import os
from collections.abc import Iterator
from functools import partial
from pathlib import Path
from typing import NamedTuple

import bpy

from ...backend.engine.results.job_files import is_asset
from ...backend.scene_io.data_blocks.selection import kept_selection
from ...backend.scene_io.image_files import fresh_partial
from ..capture_folder import look_into
from ..folders import SAVE_FILE_FIRST, resolve_folder
from ..scene.imported_result import result_object
from ..tasks import clock

SIDEBAR_TAB, MOST_TRIES = "NeP", 20  # tries of a clock period each
NOTHING_IN_IT = "{folder} holds neither photos nor a finished result. Choose the folder of the photos"


class Exporter(NamedTuple):
    """One of Blender's own exporters: its operator, the ending of its files, and what it is called with."""

    module: str
    operator: str
    ending: str
    options: dict[str, object]


EXPORTERS = {
    "GLTF": Exporter("export_scene", "gltf", ".glb", {"export_format": "GLB", "use_selection": True}),
    "FBX": Exporter("export_scene", "fbx", ".fbx", {"use_selection": True, "path_mode": "COPY", "embed_textures": True}),
    "USD": Exporter("wm", "usd_export", ".usdz", {"selected_objects_only": True}),
}
FORMATS = (
    ("GLTF", "glTF", "A .glb file, for web pages, game engines and viewers; textures inside"),
    ("FBX", "FBX", "An .fbx file, for game engines and other 3D programs; textures inside"),
    ("USD", "USD", "A .usdz file, for film pipelines and Apple's viewers; textures inside"),
)


def has_exporter(name: str) -> bool:
    """Whether this Blender has the exporter: some are built without USD, and glTF and FBX are add-ons."""
    exporter = EXPORTERS[name]
    return exporter.operator in dir(getattr(bpy.ops, exporter.module))


class NEP_OT_export_result(bpy.types.Operator):
    bl_idname = "nep.export_result"
    bl_label = "Export"
    bl_description = "Write the object with its textures into one file, by Blender's own exporter"

    format: bpy.props.EnumProperty(name="Format", description="Format of the file", items=FORMATS, options={"SKIP_SAVE"})
    filepath: bpy.props.StringProperty(name="File", subtype="FILE_PATH", options={"SKIP_SAVE"})
    filter_glob: bpy.props.StringProperty(default="*.glb;*.fbx;*.usdz", options={"HIDDEN", "SKIP_SAVE"})
    check_existing: bpy.props.BoolProperty(default=True, options={"HIDDEN", "SKIP_SAVE"})

    @classmethod
    def description(cls, context: bpy.types.Context, properties: bpy.types.OperatorProperties) -> str:
        return next(text for name, _, text in FORMATS if name == properties.format)

    @classmethod
    def poll(cls, context: bpy.types.Context) -> bool:
        if context.mode != "OBJECT" or result_object(context.scene) is None:
            cls.poll_message_set("Leave Edit Mode first" if context.mode != "OBJECT" else "Import a result first")
            return False
        return True

    def invoke(self, context: bpy.types.Context, event: bpy.types.Event) -> set[str]:
        if not self.filepath:
            folder = resolve_folder(context.scene.nep.asset) or Path(bpy.path.abspath("//") or os.path.expanduser("~"))
            name = bpy.path.clean_name(result_object(context.scene).name)
            self.filepath = str(folder.parent / name) + EXPORTERS[self.format].ending
        context.window_manager.fileselect_add(self)
        return {"RUNNING_MODAL"}

    def execute(self, context: bpy.types.Context) -> set[str]:
        exporter, item = EXPORTERS[self.format], result_object(context.scene)
        if not has_exporter(self.format):
            self.report(
                {"ERROR"}, "This Blender has no such exporter. Enable it in the preferences, or choose another format"
            )
            return {"CANCELLED"}
        if not self.filepath:
            self.report({"ERROR"}, "Choose a file to write")
            return {"CANCELLED"}
        if item.name not in context.view_layer.objects or not item.visible_get():
            self.report({"ERROR"}, f"{item.name} is hidden: show it, then export it")
            return {"CANCELLED"}
        path = Path(bpy.path.ensure_ext(bpy.path.abspath(self.filepath), exporter.ending))
        try:
            _export(exporter, item, path)
        except (RuntimeError, OSError) as error:
            self.report({"ERROR"}, f"{path} cannot be written: {str(error).strip()}")
            return {"CANCELLED"}
        self.report({"INFO"}, f"Written: {path}")
        return {"FINISHED"}


def _export(exporter: Exporter, item: bpy.types.Object, path: Path) -> None:
    """Write the object alone. A file that is there is replaced when the new one is whole. RuntimeError or OSError."""
    partial = fresh_partial(path, "partial_" + path.name)
    try:
        with kept_selection() as layer:
            for other in list(layer.objects.selected):
                other.select_set(False, view_layer=layer)
            was_locked, item.hide_select = item.hide_select, False
            item.select_set(True, view_layer=layer)
            layer.objects.active = item
            try:
                getattr(getattr(bpy.ops, exporter.module), exporter.operator)(filepath=str(partial), **exporter.options)
            finally:
                item.hide_select = was_locked
        os.replace(partial, path)
    finally:
        partial.unlink(missing_ok=True)


class NEP_OT_open_result_folder(bpy.types.Operator):
    bl_idname = "nep.open_result_folder"
    bl_label = "Open Folder"
    bl_description = "Show the folder of the result in the system's file browser"

    @classmethod
    def poll(cls, context: bpy.types.Context) -> bool:
        if _result_folder(context.scene) is None:
            cls.poll_message_set("There is no folder of a result yet")
            return False
        return True

    def execute(self, context: bpy.types.Context) -> set[str]:
        return set(bpy.ops.wm.path_open(filepath=str(_result_folder(context.scene))))


def _result_folder(scene: bpy.types.Scene) -> Path | None:
    """The folder of the imported result, or else the output folder; None where neither is there."""
    folders = (resolve_folder(setting) for setting in (scene.nep.asset, scene.nep.output))
    return next((folder for folder in folders if folder is not None and folder.is_dir()), None)


class NEP_OT_choose_folder(bpy.types.Operator):
    bl_idname = "nep.choose_folder"
    bl_label = "Choose Photos"
    bl_description = (
        "Choose the folder with the photos of an object, to reconstruct it in the sidebar (tab NeP). "
        "The folder of a finished result is imported"
    )
    bl_options = {"UNDO"}  # otherwise the next undo takes the choice back, too

    directory: bpy.props.StringProperty(name="Folder", subtype="DIR_PATH", options={"SKIP_SAVE"})
    filepath: bpy.props.StringProperty(  # what Blender sets where a file is dropped
        name="File", description="A file of that folder", subtype="FILE_PATH", options={"SKIP_SAVE", "HIDDEN"}
    )
    files: bpy.props.CollectionProperty(  # Blender warns where an operator with `directory` lacks it
        type=bpy.types.OperatorFileListElement, options={"SKIP_SAVE", "HIDDEN"}
    )
    filter_folder: bpy.props.BoolProperty(default=True, options={"HIDDEN", "SKIP_SAVE"})
    filter_image: bpy.props.BoolProperty(default=True, options={"HIDDEN", "SKIP_SAVE"})

    def invoke(self, context: bpy.types.Context, event: bpy.types.Event) -> set[str]:
        if self.directory or self.filepath:
            return self.execute(context)
        context.window_manager.fileselect_add(self)
        return {"RUNNING_MODAL"}

    def execute(self, context: bpy.types.Context) -> set[str]:
        folder = resolve_folder(self.directory or self.filepath)
        if folder is None:
            self.report({"ERROR"}, SAVE_FILE_FIRST if self.directory or self.filepath else "Choose a folder")
            return {"CANCELLED"}
        folder = folder if folder.is_dir() else folder.parent
        if is_asset(folder):
            return set(bpy.ops.nep.import_result("EXEC_DEFAULT", True, folder=str(folder)))
        holds = look_into(folder)
        if not (holds.photos or holds.videos or holds.has_cameras):
            self.report({"ERROR"}, NOTHING_IN_IT.format(folder=folder))
            return {"CANCELLED"}
        context.scene.nep.capture = str(folder)
        _show_sidebar(context)
        return {"FINISHED"}


def _show_sidebar(context: bpy.types.Context) -> None:
    """Open the sidebar of the viewports in this window, at the tab of the add-on."""
    for area in context.screen.areas if context.screen is not None else ():
        if area.type == "VIEW_3D":
            area.spaces.active.show_region_ui = True
    clock.call_until_false(partial(_choose_tab, iter(range(MOST_TRIES))))


def _choose_tab(tries: Iterator[int]) -> bool:
    """Choose the tab in all sidebars that are open. Returns whether to try again: a new one has no tabs yet."""
    left = False
    for window in bpy.context.window_manager.windows:
        for area in window.screen.areas:
            for region in area.regions if area.type == "VIEW_3D" and area.spaces.active.show_region_ui else ():
                if region.type == "UI":
                    try:
                        region.active_panel_category = SIDEBAR_TAB
                    except (AttributeError, TypeError):
                        left = True
                    region.tag_redraw()
    return left and next(tries, None) is not None


class NEP_FH_capture(bpy.types.FileHandler):
    """Blender offers files by their endings, and folders have none: transforms.json or report.json stands for its folder."""

    bl_idname = "NEP_FH_capture"
    bl_label = "Photos or Result of a Glossy Object"
    bl_import_operator = "nep.choose_folder"
    bl_file_extensions = ".json"

    @classmethod
    def poll_drop(cls, context: bpy.types.Context) -> bool:
        return context.area is not None and context.area.type == "VIEW_3D"


CLASSES = (NEP_OT_export_result, NEP_OT_open_result_folder, NEP_OT_choose_folder, NEP_FH_capture)
