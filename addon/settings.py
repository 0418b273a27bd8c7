"""What the artist chooses; saved in the .blend file with the scene."""
import bpy

PRESETS = (("preview", "Preview", "A first look within minutes"),
           ("balanced", "Balanced", "Good quality in reasonable time"),
           ("quality", "Quality", "The best result; needs the most time"))


class NepSettings(bpy.types.PropertyGroup):
    capture: bpy.props.StringProperty(
        name="Capture", description="Folder with transforms.json and the photos of one object", subtype="DIR_PATH")
    output: bpy.props.StringProperty(
        name="Output", description="Folder for the asset; an unfinished run in it can be resumed", subtype="DIR_PATH")
    preset: bpy.props.EnumProperty(
        name="Preset", description="How much time to spend", items=PRESETS, default="balanced")
    use_masks: bpy.props.BoolProperty(
        name="Use Masks", description="Use the capture's object masks where it has them", default=True)
    resume: bpy.props.BoolProperty(
        name="Resume", description="Go on from the checkpoint in the output folder", default=True)
