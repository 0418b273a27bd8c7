"""The sub-panels of the sidebar panel: cameras and bounds, result and light, relit comparison."""

import bpy
from bpy.app.translations import pgettext_iface

from ...backend.scene_io.world import strength_input, turn_input
from ..engine_errors import error_text
from ..folders import resolve_folder
from ..operators.exchange import FORMATS, has_exporter
from ..scene import lit_view
from ..scene.comparison_image import comparison_image
from ..scene.imported_result import is_lit, is_recovered_light_used, is_result_gone, result_object
from ..scene.object_bounds import bounds_object, bounds_warning
from ..tasks import registry
from ..tasks.bounds_estimate import BoundsEstimate
from ..tasks.comparison_render import ComparisonRender, last_message
from ..wrapped_text import NARROW, draw_wrapped, fitting, panel_width
from .camera_search import draw_find_again
from .photo_check import draw_photo_check

BESIDE_X = 1.25  # the width of a line, relative to a button that has one with an X beside it
GONE = "The folder {name} of the result was renamed, moved or removed"


class SubPanel:
    """Where the sub-panels are: inside NEP_PT_reconstruct."""

    bl_space_type = "VIEW_3D"
    bl_region_type = "UI"
    bl_category = "NeP"
    bl_parent_id = "NEP_PT_reconstruct"


class NEP_PT_cameras_and_bounds(SubPanel, bpy.types.Panel):
    bl_label = "Cameras and Bounds"
    bl_idname = "NEP_PT_cameras_and_bounds"
    bl_order = 1

    def draw(self, context: bpy.types.Context) -> None:
        column = self.layout.column(align=True)
        row = column.row(align=True)
        text = fitting(context, "Load Cameras", "Cameras", parts=BESIDE_X)
        row.operator("nep.load_cameras", text=text, icon="CAMERA_DATA")
        row.operator("nep.clear_cameras", text="", icon="X")
        text = fitting(context, "Capture from This Scene", "From This Scene", "From Scene")
        column.operator("nep.capture_from_scene", text=text, icon="SCENE_DATA")
        draw_find_again(column, context)
        column = self.layout.column(align=True)
        row = column.row(align=True)
        text = fitting(context, "Propose Bounds", "Bounds", parts=BESIDE_X)
        row.operator("nep.propose_bounds", text=text, icon="MESH_UVSPHERE")
        row.operator("nep.clear_bounds", text="", icon="X")
        estimate = registry.find(BoundsEstimate)
        if estimate is not None and not estimate.ended:
            column.label(text="Looking for the object...", icon="TIME")
        elif bounds_object(context.scene) is None:
            draw_wrapped(column, context, "Bounds: found automatically")
        else:
            draw_wrapped(
                column,
                context,
                "Move (G) and scale (S) the sphere: the whole object inside, no camera inside. Look from two sides",
            )
            draw_wrapped(column, context, bounds_warning(context.scene), "ERROR")
        if estimate is not None and estimate.ended and estimate.error is not None:
            draw_wrapped(column, context, error_text(estimate.error), "ERROR")
        draw_photo_check(self.layout.column(), context)


class NEP_PT_result_and_light(SubPanel, bpy.types.Panel):
    bl_label = "Result and Light"
    bl_idname = "NEP_PT_result_and_light"
    bl_options = {"DEFAULT_CLOSED"}
    bl_order = 2

    def draw(self, context: bpy.types.Context) -> None:
        layout, settings = self.layout, context.scene.nep
        draw_relink(layout, context)
        layout.label(text="Images")
        layout.row(align=True).prop(settings, "images", expand=True)
        column = layout.column(align=True)
        lit = is_lit(context.scene, lit_view.viewport(context))
        column.operator("nep.show_lit", icon="SHADING_RENDERED", depress=lit)
        text = fitting(context, "Use Recovered Light", "Recovered Light", "Light")
        column.operator("nep.use_recovered_light", text=text, icon="WORLD", depress=is_recovered_light_used(context.scene))
        world = settings.recovered_world
        if world is not None:
            column.prop(settings, "recovered_world", text="")
            turn, strength = turn_input(world), strength_input(world)
            column = layout.column(align=True)
            if turn is not None:
                column.prop(turn, "default_value", index=2, text="Turn")
            if strength is not None:
                column.prop(strength, "default_value", text="Strength")
        layout.operator("nep.open_result_folder", icon="FILE_FOLDER")
        if result_object(context.scene) is not None:
            layout.label(text="Export")
            row = layout.row(align=True)
            for name, title, _ in FORMATS:
                if has_exporter(name):
                    row.operator("nep.export_result", text=title).format = name


def draw_relink(layout: bpy.types.UILayout, context: bpy.types.Context) -> None:
    """Where the folder of the imported result is gone: its name, and the button that asks where it is now."""
    settings = context.scene.nep
    if is_result_gone(settings):
        text = pgettext_iface(GONE).format(name=resolve_folder(settings.asset).name)
        draw_wrapped(layout, context, text, "ERROR")
        layout.operator("nep.relink_result", icon="FILE_FOLDER")


class NEP_PT_relit_comparison(SubPanel, bpy.types.Panel):
    bl_label = "Relit Comparison"
    bl_idname = "NEP_PT_relit_comparison"
    bl_options = {"DEFAULT_CLOSED"}
    bl_order = 4

    def draw(self, context: bpy.types.Context) -> None:
        layout, settings, render = self.layout, context.scene.nep, registry.running(ComparisonRender)
        column = layout.column()
        column.enabled = render is None
        column.label(text="Show the object under:")
        columns = 2 if panel_width(context) >= NARROW else 1
        column.grid_flow(row_major=True, columns=columns, align=True).prop(settings, "comparison_lights")
        column.prop(settings, "comparison_light_file", text="", placeholder="Another light (.hdr, .exr)")
        numbers = column.column(align=True)
        for name in ("comparison_photos", "comparison_turntable", "comparison_samples"):
            numbers.prop(settings, name)
        if render is None:
            text = fitting(context, "Render Relit Comparison", "Render Comparison", "Render")
            layout.operator("nep.render_comparison", text=text, icon="RENDER_STILL")
        else:
            process = render.process
            text = "Stopping" if process.cancelled else f"Picture {process.done} of {process.total}"
            if not process.total:
                text = "Starting a second Blender"
            layout.progress(factor=process.done / max(process.total, 1), text=text)
            layout.operator("nep.cancel_comparison", icon="CANCEL")
        draw_wrapped(layout, context, last_message())
        if comparison_image() is not None:
            layout.operator("nep.show_comparison", icon="IMAGE_DATA")


CLASSES = (NEP_PT_cameras_and_bounds, NEP_PT_result_and_light, NEP_PT_relit_comparison)
