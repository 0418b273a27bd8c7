"""The relit comparison: rendered by a second Blender from the asset folder, shown as an image in this one."""

import json
from pathlib import Path

import bpy

from ..backend.rendering.comparison_process import ComparisonProcess
from ..backend.scene_io.asset_import import check_asset
from . import clock
from .comparison_picture import show_image
from .settings import LIGHTS, NOT_SAVED
from .settings import folder as folder_of

task = None  # the ComparisonTask under way
last_message = ""  # how the last one ended


class ComparisonTask:
    """The render on its way to an image of the file that was open when it began."""

    def __init__(self, arguments: list[str]):
        self.process = ComparisonProcess(arguments)
        self.poll, self.close = self.process.poll, self.process.close
        self._file = bpy.data.filepath

    def shown(self) -> tuple:
        """What the panel tells of it."""
        return self.process.done, self.process.total, self.process.cancelled

    def finish(self) -> None:
        global task, last_message
        task = None
        self.process.close()
        if self.process.path is None:
            last_message = self.process.error
            return
        last_message = f"Written: {self.process.path}"
        if bpy.data.filepath == self._file:  # else another file is open now
            show_image(self.process.path)


def capture_of(asset: Path) -> str:
    """The capture that an asset was made of, as its report says; '' where it does not, or where it is gone."""
    try:
        folder = json.loads((asset / "report.json").read_text(encoding="utf-8"))["capture"]["folder"]
    except (OSError, ValueError, KeyError, TypeError):
        return ""
    return folder if Path(folder).is_dir() else ""


def _folder(path: str) -> Path:
    """ValueError where it is relative to a file that is not saved yet."""
    found = folder_of(path)
    if found is None:
        raise ValueError(NOT_SAVED)
    return found


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
        description="Of Blender's own; those of the scene where not given",
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
    def poll(cls, context):
        if task is not None:
            cls.poll_message_set("A comparison is being rendered")
            return False
        return True

    def invoke(self, context, event):
        return self._render(context, wait=bpy.app.background)

    def execute(self, context):
        return self._render(context, wait=True)

    def _render(self, context, wait: bool):
        global task, last_message
        last_message = ""
        try:
            task = ComparisonTask(self._arguments(context.scene.nep))
        except (OSError, ValueError) as error:
            last_message = str(error)
            self.report({"ERROR"}, last_message)
            return {"CANCELLED"}
        process = task.process
        clock.look_after(task, wait=wait)
        if not wait:
            return {"FINISHED"}
        if process.path is None:
            self.report({"ERROR"}, last_message)
            return {"CANCELLED"}
        self.report({"INFO"}, last_message)
        return {"FINISHED"}

    def _arguments(self, settings) -> list[str]:
        """The script's. ValueError or OSError in words where something is missing."""
        chosen = self.asset or settings.asset or settings.output
        if not chosen:
            raise ValueError("Import a result first, or choose the output folder of a reconstruction")
        asset = _folder(chosen)
        check_asset(asset)
        capture = self.capture or capture_of(asset) or settings.capture
        if not capture:
            raise ValueError("Choose the capture folder: the comparison shows its photos")
        arguments = [
            "--asset",
            str(asset),
            "--capture",
            str(_folder(capture)),
            "--photos",
            str(self.photos or settings.comparison_photos),
            "--samples",
            str(self.samples or settings.comparison_samples),
            "--turntable",
            str(settings.comparison_turntable if self.turntable < 0 else self.turntable),
        ]
        lights = self.lights if self.properties.is_property_set("lights") else settings.comparison_lights
        for name, *_ in LIGHTS:
            if name in lights:
                arguments += ["--light", name]
        light_file = self.light_file or settings.comparison_light_file
        if light_file:
            path = Path(bpy.path.abspath(light_file))
            if not path.is_file():
                raise ValueError(f"There is no light file {path}. Choose an .hdr or .exr, or none")
            arguments += ["--light-file", str(path)]
        if self.output:
            arguments += ["--out", bpy.path.abspath(self.output)]
        return arguments


class NEP_OT_cancel_comparison(bpy.types.Operator):
    bl_idname = "nep.cancel_comparison"
    bl_label = "Cancel"
    bl_description = "Stop rendering the comparison; a picture that was there before is kept"

    @classmethod
    def poll(cls, context):
        if task is None or task.process.cancelled:
            cls.poll_message_set("No comparison is being rendered" if task is None else "Already stopping")
            return False
        return True

    def execute(self, context):
        task.process.cancel()
        return {"FINISHED"}


def end_render() -> None:
    """Forget the render under way, if any."""
    global task, last_message
    if task is not None:
        task.close()
    task, last_message = None, ""


CLASSES = (NEP_OT_render_comparison, NEP_OT_cancel_comparison)
