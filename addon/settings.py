"""What the artist chooses; saved in the .blend file with the scene."""
import bpy

PRESETS = (("preview", "Preview", "A first look within minutes"),
           ("balanced", "Balanced", "Good quality in reasonable time"),
           ("quality", "Quality", "The best result; needs the most time"))

LIGHTS = tuple((name, name.title(), f"Blender's own HDRI '{name}'") for name in (
    "studio", "forest", "sunset", "interior", "city", "courtyard", "sunrise", "night"))


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
    bounds: bpy.props.PointerProperty(
        name="Object Bounds", description="The sphere that holds the object", type=bpy.types.Object)
    images: bpy.props.EnumProperty(
        name="Images", description="Where the textures of an imported result are", default="PACKED",
        items=(("PACKED", "Packed", "Inside the .blend file"),
               ("RELATIVE", "Relative", "In the asset folder, by a path relative to the saved .blend file")))
    asset: bpy.props.StringProperty(
        name="Asset", description="The result that was imported last", subtype="DIR_PATH")
    recovered_world: bpy.props.PointerProperty(
        name="Recovered Light", description="The World that was recovered from the photos", type=bpy.types.World)
    own_world: bpy.props.PointerProperty(
        name="Own World", description="The World to return to from the recovered light", type=bpy.types.World)
    comparison_lights: bpy.props.EnumProperty(
        name="Lights", description="Lights that come with Blender; any number of them", items=LIGHTS,
        options={"ENUM_FLAG"}, default={"studio", "forest", "sunset"})
    comparison_light_file: bpy.props.StringProperty(
        name="Light File", description="Another light: an equirectangular .hdr or .exr file", subtype="FILE_PATH")
    comparison_photos: bpy.props.IntProperty(
        name="Photos", description="Photos to compare with, one row each", default=2, min=1, soft_max=6)
    comparison_turntable: bpy.props.IntProperty(
        name="Turntable Views", description="Views around the object in a strip below; 0 for none", default=0, min=0,
        soft_max=12, max=36)
    comparison_samples: bpy.props.IntProperty(
        name="Samples", description="Cycles samples a pixel: more take longer and are cleaner", default=48, min=1,
        soft_max=512)
