"""The sidebar panel."""
import bpy

from . import reconstruct

LINE = 36  # letters of a message in one row of a narrow sidebar


class NEP_PT_reconstruct(bpy.types.Panel):
    bl_label = "Reconstruct Glossy Object"
    bl_idname = "NEP_PT_reconstruct"
    bl_space_type = "VIEW_3D"
    bl_region_type = "UI"
    bl_category = "NeP"

    def draw(self, context):
        layout, settings, job = self.layout, context.scene.nep, reconstruct.job
        layout.use_property_split = True
        layout.use_property_decorate = False
        column = layout.column()
        column.enabled = job is None
        for name in ("capture", "output", "preset", "use_masks", "resume"):
            column.prop(settings, name)
        if job is None:
            row = layout.row()
            row.scale_y = 1.4
            row.operator("nep.reconstruct", icon="PLAY")
        else:
            layout.progress(factor=job.fraction, text=f"{100 * job.fraction:.0f} %")
            for line in _wrapped(job.status):
                layout.label(text=line)
            layout.operator("nep.cancel", icon="CANCEL")
        for line in _wrapped(reconstruct.last_message):
            layout.label(text=line)


def _wrapped(text: str) -> list[str]:
    lines = []
    for paragraph in text.splitlines():
        line = ""
        for word in paragraph.split():
            if line and len(line) + 1 + len(word) > LINE:
                lines.append(line)
                line = word
            else:
                line = f"{line} {word}".strip()
        lines.append(line)
    return lines
