"""The folded parts of the sidebar panel: cameras and bounds, result and light, relit comparison."""

import bpy

from . import bounds, comparison, comparison_picture, result
from .messages import say


class SubPanel:
    """What the sub-panels share."""

    bl_space_type = "VIEW_3D"
    bl_region_type = "UI"
    bl_category = "NeP"
    bl_parent_id = "NEP_PT_reconstruct"


class NEP_PT_cameras_and_bounds(SubPanel, bpy.types.Panel):
    bl_label = "Cameras and Bounds"
    bl_idname = "NEP_PT_cameras_and_bounds"
    bl_order = 1

    def draw(self, context):
        column = self.layout.column(align=True)
        row = column.row(align=True)
        row.operator("nep.load_cameras", icon="CAMERA_DATA")
        row.operator("nep.clear_cameras", text="", icon="X")
        column.operator("nep.capture_from_scene", icon="SCENE_DATA")
        column = self.layout.column(align=True)
        row = column.row(align=True)
        row.operator("nep.propose_bounds", icon="MESH_UVSPHERE")
        row.operator("nep.clear_bounds", text="", icon="X")
        if bounds.query is not None:
            column.label(text="Looking for the object...", icon="TIME")
        elif bounds.bounds_object(context.scene) is None:
            column.label(text="Bounds: found automatically")
        else:
            say(column, context, "Move and scale the sphere: the whole object inside, no camera inside")
            say(column, context, bounds.bounds_remark(context.scene), "ERROR")
        say(column, context, bounds.last_message, "ERROR")


class NEP_PT_result_and_light(SubPanel, bpy.types.Panel):
    bl_label = "Result and Light"
    bl_idname = "NEP_PT_result_and_light"
    bl_options = {"DEFAULT_CLOSED"}
    bl_order = 2

    def draw(self, context):
        layout, settings = self.layout, context.scene.nep
        row = layout.row(align=True)
        row.label(text="Images")
        row.prop(settings, "images", expand=True)
        column = layout.column(align=True)
        column.operator("nep.use_recovered_light", icon="WORLD", depress=result.light_is_used(context.scene))
        if settings.recovered_world is not None:
            column.prop(settings, "recovered_world", text="")


class NEP_PT_relit_comparison(SubPanel, bpy.types.Panel):
    bl_label = "Relit Comparison"
    bl_idname = "NEP_PT_relit_comparison"
    bl_options = {"DEFAULT_CLOSED"}
    bl_order = 3

    def draw(self, context):
        layout, settings, task = self.layout, context.scene.nep, comparison.task
        column = layout.column()
        column.enabled = task is None
        column.label(text="Show the object under:")
        column.grid_flow(row_major=True, columns=2, align=True).prop(settings, "comparison_lights")
        column.prop(settings, "comparison_light_file", text="", placeholder="Another light (.hdr, .exr)")
        numbers = column.column(align=True)
        for name in ("comparison_photos", "comparison_turntable", "comparison_samples"):
            numbers.prop(settings, name)
        if task is None:
            layout.operator("nep.render_comparison", icon="RENDER_STILL")
        else:
            process = task.process
            text = "Stopping" if process.cancelled else f"Picture {process.done} of {process.total}"
            if not process.total:
                text = "Starting a second Blender"
            layout.progress(factor=process.done / max(process.total, 1), text=text)
            layout.operator("nep.cancel_comparison", icon="CANCEL")
        say(layout, context, comparison.last_message)
        if comparison_picture.picture() is not None:
            layout.operator("nep.show_comparison", icon="IMAGE_DATA")


CLASSES = (NEP_PT_cameras_and_bounds, NEP_PT_result_and_light, NEP_PT_relit_comparison)
