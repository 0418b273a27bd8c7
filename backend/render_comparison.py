"""Render the comparison picture of a finished asset in a separate Blender process.

    blender -b --factory-startup --python-exit-code 1 -P backend/render_comparison.py -- --asset DIR --capture DIR ...
    python backend/render_comparison.py --asset DIR --capture DIR ...          (with the bpy wheel)

The script prints JSON lines on standard output: {"event": "progress", "done": 1, "total": 4}, then
{"event": "done", "path": ...} or {"event": "error", "message": ...}. When its standard input is closed, the script ends at
once. The picture is written under a temporary name and then renamed, so there is never half a picture. The exit code is 0
(done), 7 (standard input was closed), 8 (the picture could not be made) or 2 (wrong arguments).
"""

import argparse
import json
import os
import sys
import threading
from pathlib import Path

if __package__ in (None, ""):
    sys.path.insert(0, str(Path(__file__).resolve().parent.parent))

import bpy

from backend.arguments import path_argument, script_arguments
from backend.engine.exit_codes import BLENDER_FAILED, STOPPED
from backend.rendering.comparison import compare, write_comparison
from backend.scene_io.capture_files import read_frames_of, spread_frames, with_exposures
from backend.scene_io.result import import_result
from backend.scene_io.world import blender_hdris, build_world


def parse(arguments: list[str]) -> argparse.Namespace:
    parser = argparse.ArgumentParser(prog="render_comparison.py", description=__doc__.split("\n\n")[0])
    parser.add_argument("--asset", type=path_argument, required=True, help="asset folder")
    parser.add_argument("--capture", type=path_argument, required=True, help="the folder with the photos")
    parser.add_argument("--out", type=path_argument, help="the PNG (comparison.png in the asset folder)")
    parser.add_argument("--photos", type=int, default=2, metavar="N", help="photos to compare with")
    parser.add_argument("--light", action="append", default=[], metavar="NAME", help="one of Blender's own HDRIs")
    parser.add_argument("--light-file", type=path_argument, help="another equirectangular .hdr or .exr")
    parser.add_argument("--turntable", type=int, default=0, metavar="N", help="views around the object, in a strip")
    parser.add_argument("--samples", type=int, default=48, help="Cycles samples a pixel")
    parser.add_argument("--seed", type=int, default=0)
    return parser.parse_args(arguments)


def say(event: str, **values: object) -> None:
    print(json.dumps({"event": event, **values}), flush=True)


def end_with_parent() -> None:
    """End this process as soon as its standard input is closed.

    Standard input closes when the Blender that wants the picture cancels the render, or ends.
    """

    def watch() -> None:
        while os.read(sys.stdin.fileno(), 4096):
            continue
        os._exit(STOPPED)

    threading.Thread(target=watch, daemon=True).start()


def light_files(options: argparse.Namespace) -> list[Path]:
    """The HDRI files that the options choose. Raises ValueError where this Blender does not ship one of them."""
    shipped = {path.stem: path for path in blender_hdris()}
    missing = [name for name in options.light if name not in shipped]
    if missing:
        raise ValueError(
            f"this Blender ships no light {', '.join(missing)}. Choose others"
            + (f": {', '.join(shipped)}" if shipped else ", or a file: it ships none")
        )
    return [shipped[name] for name in options.light] + ([options.light_file] if options.light_file else [])


def main(arguments: list[str]) -> int:
    options = parse(arguments)
    end_with_parent()
    try:
        frames = with_exposures(read_frames_of(options.capture, options.asset), options.asset)
        path = options.out or options.asset / "comparison.png"
        if any(path.resolve() == frame.path.resolve() for frame in frames):
            raise ValueError(f"{path} is a photo of the capture: choose another --out")
        frames = spread_frames(frames, max(options.photos, 1))
        bpy.ops.wm.read_factory_settings(use_empty=True)
        item, recovered = import_result(options.asset, bpy.context.scene.collection)
        worlds = [build_world(path, name=path.stem) for path in light_files(options)]
        sheet, _ = compare(
            item,
            frames,
            recovered,
            worlds,
            samples=options.samples,
            seed=options.seed,
            turntable=options.turntable,
            progress=lambda done, total: say("progress", done=done, total=total),
        )
        write_comparison(path, sheet)
    except (OSError, ValueError, RuntimeError) as error:
        say("error", message=str(error))
        return BLENDER_FAILED
    say("done", path=str(path))
    return 0


if __name__ == "__main__":
    code = main(script_arguments())
    sys.stdout.flush()
    # The watching thread may still wait for input. The bpy wheel of Blender 4.5 would then never end by itself.
    os._exit(code)
