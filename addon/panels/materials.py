"""The sub-panel of the imported result's materials: what was learned, what the artist corrects, and how that ended."""

import bpy
from bpy.app.translations import pgettext_iface

from ..folders import resolve_folder
from ..properties import NepMaterial, NepSettings
from ..scene.imported_materials import applied_correction, applied_corrections, chosen_corrections
from ..scene.imported_result import result_object
from ..tasks import registry
from ..tasks.material_correction import NOT_IN_FILE, MaterialCorrection
from ..wrapped_text import draw_wrapped
from .failure import draw_failure
from .subpanels import SubPanel, draw_relink
from .swatches import swatch_icon

CORRECTED = "GREASEPENCIL"  # the icon beside a value that the artist corrects
MOST_ROWS = 12
NO_MATERIALS = (
    "This result does not name its materials, because an older version of the engine has made it. "
    "Reconstruct again to correct them."
)
NO_OBJECT = "The object is not in the scene any more. Import Result brings it back, with the corrections."
NOW_METAL = "Now: roughness {roughness:.2f}, metal"
NOW_NOT_METAL = "Now: roughness {roughness:.2f}, not metal"
LEARNED_METAL = "Learned: roughness {roughness:.2f}, metal"
LEARNED_NOT_METAL = "Learned: roughness {roughness:.2f}, not metal"


class NEP_UL_materials(bpy.types.UIList):
    """One row a material: color and share, roughness, metal or not. An icon marks what the artist corrects."""

    bl_idname = "NEP_UL_materials"

    def draw_item(
        self,
        context: bpy.types.Context,
        layout: bpy.types.UILayout,
        data: NepSettings,
        item: NepMaterial,
        icon: int,
        active_data: NepSettings,
    ) -> None:
        share, roughness, metal = _columns(layout)
        percent = f"{100 * item.share:.0f}" if item.share >= 0.005 else "< 1"
        share.label(text=f"{percent} %", icon_value=swatch_icon(item.albedo))
        shown = item.new_roughness if item.set_roughness else item.roughness
        roughness.label(text=f"{shown:.2f}", icon=CORRECTED if item.set_roughness else "NONE")
        corrected = item.metal != "AS_LEARNED"
        is_metal = item.metal == "METAL" if corrected else item.is_metal
        metal.label(text="Yes" if is_metal else "No", icon=CORRECTED if corrected else "NONE")


def _columns(layout: bpy.types.UILayout) -> tuple[bpy.types.UILayout, bpy.types.UILayout, bpy.types.UILayout]:
    """Three columns, which are wide enough for their texts in the narrowest sidebar."""
    split = layout.split(factor=0.36)
    first = split.row()
    rest = split.split(factor=0.55)
    return first, rest.row(), rest.row()


class NEP_PT_materials(SubPanel, bpy.types.Panel):
    bl_label = "Correct Materials"
    bl_idname = "NEP_PT_materials"
    bl_options = {"DEFAULT_CLOSED"}
    bl_order = 3

    def draw(self, context: bpy.types.Context) -> None:
        layout, settings = self.layout, context.scene.nep
        if not settings.materials:
            text = NO_MATERIALS if settings.asset else "Import a result first: its materials are listed here."
            draw_wrapped(layout, context, pgettext_iface(text), "INFO")
            return
        draw_relink(layout, context)
        if result_object(context.scene) is None:
            draw_wrapped(layout, context, pgettext_iface(NO_OBJECT), "INFO")
        column, running = layout.column(), registry.running(MaterialCorrection)
        column.enabled = running is None
        for heading, text in zip(_columns(column), ("Share", "Roughness", "Metal"), strict=True):
            heading.label(text=text)
        rows = min(len(settings.materials), MOST_ROWS)
        column.template_list(
            NEP_UL_materials.bl_idname, "", settings, "materials", settings, "material_index", rows=rows, maxrows=MOST_ROWS
        )
        _draw_correction(column, context, settings)
        if running is not None:
            _draw_progress(layout, running)
        else:
            _draw_buttons(layout, settings)
            _draw_end(layout, context)


def _draw_correction(layout: bpy.types.UILayout, context: bpy.types.Context, settings: NepSettings) -> None:
    """What the artist corrects of the material that is chosen in the list."""
    item = settings.materials[min(settings.material_index, len(settings.materials) - 1)]
    column = layout.column()
    column.use_property_split = True
    column.use_property_decorate = False
    column.prop(item, "metal")
    row = column.row(heading="Roughness")
    row.prop(item, "set_roughness", text="")
    value = row.row()
    value.enabled = item.set_roughness
    value.prop(item, "new_roughness", text="", slider=True)
    learned = pgettext_iface(LEARNED_METAL if item.learned_is_metal else LEARNED_NOT_METAL)
    draw_wrapped(layout, context, learned.format(roughness=item.learned_roughness))
    if applied_correction(item):
        now = pgettext_iface(NOW_METAL if item.is_metal else NOW_NOT_METAL)
        draw_wrapped(layout, context, now.format(roughness=item.roughness))


def _draw_buttons(layout: bpy.types.UILayout, settings: NepSettings) -> None:
    chosen, applied = chosen_corrections(settings), applied_corrections(settings)
    row = layout.row(align=True)
    apply = row.row(align=True)
    apply.enabled = chosen != applied
    apply.operator("nep.correct_materials", icon="CHECKMARK")
    reset = row.row(align=True)
    reset.enabled = bool(chosen or applied)
    reset.operator("nep.correct_materials", text="Reset", icon="LOOP_BACK").reset = True
    if chosen != applied:  # below the buttons: a button must not move under the mouse
        layout.label(text="Not applied yet", icon="INFO")


def _draw_progress(layout: bpy.types.UILayout, correction: MaterialCorrection) -> None:
    progress = correction.process.progress
    layout.progress(factor=progress.fraction, text=f"{100 * progress.fraction:.0f} %")
    column = layout.column(align=True)
    for line in progress.lines(pgettext_iface):
        column.label(text=line)


def _draw_end(layout: bpy.types.UILayout, context: bpy.types.Context) -> None:
    asset = resolve_folder(context.scene.nep.asset)
    correction = registry.ended(MaterialCorrection, asset) if asset is not None else None
    if correction is None:
        return
    if correction.failed is not None:
        draw_failure(layout, context, correction.failed)
        return
    for warning in correction.process.warnings[-2:]:
        draw_wrapped(layout, context, warning.words(pgettext_iface), "INFO")
    if not correction.is_seen:
        draw_wrapped(layout, context, pgettext_iface(NOT_IN_FILE), "INFO")


CLASSES = (NEP_UL_materials, NEP_PT_materials)
