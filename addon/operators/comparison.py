"""The operators of the relit comparison: render it, cancel the render, show the picture."""

import os
from functools import partial
from pathlib import Path

import bpy

from ...backend.plain_files import is_on_other_computer, read_json
from ...backend.scene_io.asset_import import check_asset
from ..editors import fit_image, open_editor
from ..folders import SAVE_FILE_FIRST, resolve_folder
from ..properties import LIGHTS
from ..scene.comparison_image import comparison_image
from ..tasks import clock, registry
from ..tasks.comparison_render import ComparisonRender, start_render


class NEP_OT_render_comparison(bpy.types.Operator):
    bl_idname = "nep.render_comparison"
    bl_label = "Render Relit Comparison"
    bl_description = (
        "Render the photo beside the object under the recovered light and under other lights, in the "
        "background; your scene is not touched. The picture is comparison.png in the asset folder"
    )

    asset: bpy.props.StringProperty(
        name="Asset", description="Asset folder; empty: the scene's result", options={"SKIP_SAVE"}
    )
    capture: bpy.props.StringProperty(
        name="Capture", description="Folder with the photos; empty: the asset's", options={"SKIP_SAVE"}
    )
    output: bpy.props.StringProperty(
        name="Output", description="PNG to write; empty: comparison.png in the asset folder", options={"SKIP_SAVE"}
    )
    lights: bpy.props.EnumProperty(
        name="Lights",
        description="Lights that come with Blender; where not given: the scene's setting",
        items=LIGHTS,
        options={"ENUM_FLAG", "SKIP_SAVE"},
    )
    light_file: bpy.props.StringProperty(
        name="Light File", description="Another .hdr or .exr; empty: the scene's setting", options={"SKIP_SAVE"}
    )
    photos: bpy.props.IntProperty(name="Photos", description="0: the scene's setting", min=0, options={"SKIP_SAVE"})
    turntable: bpy.props.IntProperty(
        name="Turntable",
        description="Views around the object; -1: the scene's setting",
        default=-1,
        min=-1,
        options={"SKIP_SAVE"},
    )
    samples: bpy.props.IntProperty(name="Samples", description="0: the scene's setting", min=0, options={"SKIP_SAVE"})

    @classmethod
    def poll(cls, context: bpy.types.Context) -> bool:
        if registry.running(ComparisonRender) is not None:
            cls.poll_message_set("A comparison is being rendered")
            return False
        return True

    def invoke(self, context: bpy.types.Context, event: bpy.types.Event) -> set[str]:
        return self._render(context, wait=bpy.app.background)

    def execute(self, context: bpy.types.Context) -> set[str]:
        return self._render(context, wait=True)

    def _render(self, context: bpy.types.Context, wait: bool) -> set[str]:
        try:
            render = start_render(self._arguments(context.scene), wait=wait)
        except (OSError, ValueError) as error:
            registry.keep(ComparisonRender(None, str(error)))
            self.report({"ERROR"}, str(error))
            return {"CANCELLED"}
        if not wait:
            return {"FINISHED"}
        if render.process.path is None:
            self.report({"ERROR"}, render.message)
            return {"CANCELLED"}
        self.report({"INFO"}, render.message)
        return {"FINISHED"}

    def _arguments(self, scene: bpy.types.Scene) -> list[str]:
        """The arguments of backend/render_comparison.py. ValueError or OSError, with a message, where one is missing."""
        settings = scene.nep
        asset_setting = self.asset or settings.asset or settings.output
        if not asset_setting:
            raise ValueError("Import a result first, or choose the output folder of a reconstruction")
        asset = _folder_of(asset_setting)
        check_asset(asset)
        capture_setting = self.capture or capture_of_asset(asset) or settings.capture
        if not capture_setting:
            raise ValueError("Choose the capture folder: the comparison shows its photos")
        numbers = {
            "--photos": self.photos or settings.comparison_photos,
            "--samples": self.samples or settings.comparison_samples,
            "--turntable": settings.comparison_turntable if self.turntable < 0 else self.turntable,
        }
        arguments = ["--asset", str(asset), "--capture", str(_folder_of(capture_setting))]
        for option, number in numbers.items():
            arguments += [option, str(number)]
        lights = self.lights if self.properties.is_property_set("lights") else settings.comparison_lights
        for name, *_ in LIGHTS:
            if name in lights:
                arguments += ["--light", name]
        light_file = self.light_file or settings.comparison_light_file
        if light_file:
            path = Path(bpy.path.abspath(light_file)).absolute()  # the second Blender has another current folder
            if not os.path.isfile(path):
                raise ValueError(f"There is no light file {path}. Choose an .hdr or .exr, or none")
            arguments += ["--light-file", str(path)]
        if self.output:
            arguments += ["--out", str(Path(bpy.path.abspath(self.output)).absolute())]
        return arguments


def capture_of_asset(asset: Path) -> str:
    """The folder of the capture that an asset was made of, according to the asset's report.

    An empty string where the report does not say it, or where the folder is gone.
    """
    try:
        folder = read_json(asset / "report.json")["capture"]["folder"]
    except (OSError, ValueError, KeyError, TypeError):
        return ""
    known = isinstance(folder, str) and not is_on_other_computer(folder, asset)
    return folder if known and os.path.isdir(folder) else ""


def _folder_of(setting: str) -> Path:
    """The absolute path of the folder in a setting that is not empty.

    ValueError where it is relative to a file that is not saved yet.
    """
    folder = resolve_folder(setting)
    if folder is None:
        raise ValueError(SAVE_FILE_FIRST)
    return folder.absolute()


class NEP_OT_cancel_comparison(bpy.types.Operator):
    bl_idname = "nep.cancel_comparison"
    bl_label = "Cancel"
    bl_description = "Stop rendering the comparison; a picture that was there before is kept"

    @classmethod
    def poll(cls, context: bpy.types.Context) -> bool:
        render = registry.running(ComparisonRender)
        if render is None or render.process.cancelled:
            cls.poll_message_set("No comparison is being rendered" if render is None else "Already stopping")
            return False
        return True

    def execute(self, context: bpy.types.Context) -> set[str]:
        registry.running(ComparisonRender).process.cancel()
        return {"FINISHED"}


class NEP_OT_show_comparison(bpy.types.Operator):
    bl_idname = "nep.show_comparison"
    bl_label = "Show Picture"
    bl_description = "Show the comparison in an Image Editor: one that is open, or a window of its own"

    @classmethod
    def poll(cls, context: bpy.types.Context) -> bool:
        if comparison_image() is None:
            cls.poll_message_set("Render a comparison first")
            return False
        return True

    def execute(self, context: bpy.types.Context) -> set[str]:
        if not bpy.app.background:
            open_editor(context, "IMAGE_EDITOR").image = comparison_image()
            clock.call_until_false(
                partial(fit_image, comparison_image().name)
            )  # one period later: a new window has no size yet
        return {"FINISHED"}


CLASSES = (NEP_OT_render_comparison, NEP_OT_cancel_comparison, NEP_OT_show_comparison)
