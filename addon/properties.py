"""What the artist chooses: one group of properties, `scene.nep`, which each scene saves in the .blend file."""

import bpy

from . import face_limit, folder_changes

PATH_OPTIONS = {"ANIMATABLE"} | ({"PATH_SUPPORTS_BLEND_RELATIVE"} if bpy.app.version >= (4, 5, 0) else set())
"""Of paths that may begin with `//`. Blender 5 draws them in red without the second option; 4.2 does not know it."""
PRESETS = (
    ("preview", "Preview", "A first look within minutes"),
    ("balanced", "Balanced", "Good quality in reasonable time"),
    ("quality", "Quality", "The best result; needs the most time"),
)
DEVICES = (
    ("auto", "Automatic", "The graphics card where the engine can use it, else the processor"),
    ("cpu", "CPU", "The processor"),
    ("cuda", "CUDA", "An NVIDIA graphics card; the engine needs a CUDA build of torch"),
)
FEATURES = (  # the names are those of the engine's option --features
    ("everywhere", "Everywhere", "In the whole photos; masks are not used"),
    ("object", "On the Object", "Only on the object: for an object that turned on a turntable"),
    ("surroundings", "In Its Surroundings", "Only beside the object: for mirrors, whose reflections mislead"),
)
METAL = (
    ("auto", "From the Photos", "Decided by what explains the photos better"),
    ("yes", "Metal", "All of the object is metal"),
    ("no", "Not Metal", "Paint, plastic, glaze, stone: no part of the object is metal"),
)
TURNTABLE = (  # the names are those of the engine's option --turntable
    ("auto", "Automatic", "As the capture says, or as the photos show; a plain backdrop shows nothing"),
    ("yes", "Yes", "The object turned while the camera and the light stood still"),
    ("no", "No", "The object stood still while the camera moved"),
)
CLOSINGS = (
    ("STOP", "Stop and Keep the Checkpoint", "The job ends with Blender; Resume goes on from its checkpoint"),
    ("KEEP", "Keep Going", "The job goes on; it is found again when this file is opened"),
)
LIGHTS = tuple(
    (name, name.title(), f"Blender's own HDRI '{name}'")
    for name in ("studio", "forest", "sunset", "interior", "city", "courtyard", "sunrise", "night")
)


METAL_CORRECTIONS = (
    ("AS_LEARNED", "As Learned", "What the photos said"),
    ("METAL", "Metal", "This material is metal"),
    ("NOT_METAL", "Not Metal", "This material is paint, plastic, glaze or stone"),
)


class NepMaterial(bpy.types.PropertyGroup):
    """A material of the imported result, and its correction (imported_materials.py)."""

    share: bpy.props.FloatProperty(name="Share", description="Part of the surface that has this material", min=0, max=1)
    albedo: bpy.props.FloatVectorProperty(
        name="Color", description="Base Color in the textures", subtype="COLOR", size=3, min=0, max=1
    )
    roughness: bpy.props.FloatProperty(name="Present Roughness", description="Roughness in the textures", min=0, max=1)
    is_metal: bpy.props.BoolProperty(name="Is Metal", description="Whether it is metal in the textures")
    learned_roughness: bpy.props.FloatProperty(name="Learned Roughness", description="What the photos said", min=0, max=1)
    learned_is_metal: bpy.props.BoolProperty(name="Learned as Metal", description="What the photos said")
    metal: bpy.props.EnumProperty(
        name="Metal",
        description="Whether this material is metal, where you know it better than the photos show it",
        items=METAL_CORRECTIONS,
    )
    set_roughness: bpy.props.BoolProperty(
        name="Set Roughness", description="Give this material a roughness of your own; off: as learned from the photos"
    )
    new_roughness: bpy.props.FloatProperty(
        name="Roughness", description="The roughness that this material gets", min=0, max=1, subtype="FACTOR", precision=2
    )
    applied_metal: bpy.props.EnumProperty(
        name="Applied Metal", description="The correction in the textures", items=METAL_CORRECTIONS, options={"HIDDEN"}
    )
    applied_roughness: bpy.props.FloatProperty(
        name="Applied Roughness",
        description="The correction in the textures; -1: none",
        default=-1,
        min=-1,
        max=1,
        options={"HIDDEN"},
    )


class NepShelfFolder(bpy.types.PropertyGroup):
    """A folder with captures of a shelf."""

    path: bpy.props.StringProperty(
        name="Captures",
        description="A capture, or a folder that holds captures or folders with photos",
        subtype="DIR_PATH",
        options=PATH_OPTIONS,
    )


class NepSettings(bpy.types.PropertyGroup):
    capture: bpy.props.StringProperty(
        name="Capture",
        description="Folder with the photos of one object. Their cameras are there, too (transforms.json, or a "
        "project of COLMAP, Metashape or RealityScan), or Find Cameras finds them",
        subtype="DIR_PATH",
        options=PATH_OPTIONS,
        update=folder_changes.notify_capture,
    )
    output: bpy.props.StringProperty(
        name="Output",
        description="Folder for the result; a job in it is found again when this file is opened",
        subtype="DIR_PATH",
        options=PATH_OPTIONS,
        update=folder_changes.notify_output,
    )
    default_output: bpy.props.StringProperty(
        name="Default Output",
        description="The folder that was proposed for the result, beside the capture",
        subtype="DIR_PATH",
        options=PATH_OPTIONS | {"HIDDEN"},
    )
    preset: bpy.props.EnumProperty(name="Preset", description="How much time to spend", items=PRESETS, default="balanced")
    use_masks: bpy.props.BoolProperty(
        name="Use Masks", description="Use the capture's object masks where it has them", default=True
    )
    all_photos: bpy.props.BoolProperty(
        name="Use All Photos",
        description="Learn also from photos that were taken in another light than most, such as in the evening",
        default=False,
    )
    features: bpy.props.EnumProperty(
        name="Features",
        description="Where in the photos Find Cameras looks for details; the masks say where the object is",
        items=FEATURES,
        default="everywhere",
    )
    device: bpy.props.EnumProperty(name="Device", description="What to compute on", items=DEVICES, default="auto")
    metal: bpy.props.EnumProperty(
        name="Whole Object",
        description="Whether all of the object is metal, where you know it and the photos do not tell",
        items=METAL,
        default="auto",
    )
    turntable: bpy.props.EnumProperty(
        name="On a Turntable",
        description="Whether the object turned on a turntable while the camera and the light stood still",
        items=TURNTABLE,
        default="auto",
    )
    faces: bpy.props.IntProperty(
        name="Faces",
        description="Largest number of faces of the mesh; a normal map carries the shape that so few faces lack. "
        "0: as many as the preset makes, without a normal map. Not used with a known mesh",
        min=0,
        max=1_000_000,
        update=face_limit.keep_enough_faces,
    )
    closing: bpy.props.EnumProperty(
        name="When Blender Closes", description="What happens to a running job", items=CLOSINGS, default="STOP"
    )
    use_preview: bpy.props.BoolProperty(
        name="Live Preview",
        description="Show the mesh, and a photo beside its re-rendering, while they are learned",
        default=True,
    )
    seed: bpy.props.IntProperty(
        name="Seed", description="The same seed gives the same result; try another where a result is bad", min=0
    )
    threads: bpy.props.IntProperty(name="Threads", description="Processor threads to use; 0: all of them", min=0, max=1024)
    mesh: bpy.props.StringProperty(
        name="Known Mesh",
        subtype="FILE_PATH",
        options=PATH_OPTIONS,
        description="Mesh file of the object in the capture's coordinates: only its materials are learned",
    )
    imported_job: bpy.props.StringProperty(
        name="Imported Job", description="The job whose result is in this scene", options={"HIDDEN"}
    )
    bounds: bpy.props.PointerProperty(
        name="Object Bounds", description="The sphere that holds the object", type=bpy.types.Object
    )
    images: bpy.props.EnumProperty(
        name="Images",
        description="Where the textures of an imported result are",
        default="PACKED",
        items=(
            ("PACKED", "Packed", "Inside the .blend file"),
            ("RELATIVE", "Relative", "In the asset folder, by a path relative to the saved .blend file"),
        ),
    )
    asset: bpy.props.StringProperty(
        name="Asset", description="The result that was imported last", subtype="DIR_PATH", options=PATH_OPTIONS
    )
    materials: bpy.props.CollectionProperty(
        name="Materials", description="The materials of the imported result", type=NepMaterial
    )
    material_index: bpy.props.IntProperty(
        name="Active Material", description="The material whose correction the panel shows", min=0
    )
    recovered_world: bpy.props.PointerProperty(
        name="Recovered Light", description="The World that was recovered from the photos", type=bpy.types.World
    )
    own_world: bpy.props.PointerProperty(
        name="Own World", description="The World to return to from the recovered light", type=bpy.types.World
    )
    shelf_captures: bpy.props.CollectionProperty(
        name="Captures of the Shelf", description="Folders with captures", type=NepShelfFolder
    )
    shelf_output: bpy.props.StringProperty(
        name="Results",
        description="Folder for the results of many objects; also a folder that another program is filling",
        subtype="DIR_PATH",
        options=PATH_OPTIONS,
    )
    comparison_lights: bpy.props.EnumProperty(
        name="Lights",
        description="Lights that come with Blender; any number of them",
        items=LIGHTS,
        options={"ENUM_FLAG"},
        default={"studio", "forest", "sunset"},
    )
    comparison_light_file: bpy.props.StringProperty(
        name="Light File",
        description="Another light: an equirectangular .hdr or .exr file",
        subtype="FILE_PATH",
        options=PATH_OPTIONS,
    )
    comparison_photos: bpy.props.IntProperty(
        name="Photos", description="Photos to compare with, one row each", default=2, min=1, soft_max=6
    )
    comparison_turntable: bpy.props.IntProperty(
        name="Turntable Views",
        description="Views around the object in a strip below; 0 for none",
        default=0,
        min=0,
        soft_max=12,
        max=36,
    )
    comparison_samples: bpy.props.IntProperty(
        name="Samples",
        description="Cycles samples a pixel: more take longer and are cleaner",
        default=48,
        min=1,
        soft_max=512,
    )
