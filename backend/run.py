"""Turn a capture into a relit asset with one command, headless.

    blender -b -P backend/run.py -- --capture DIR --out DIR [--preset preview] [--relight 3]
    python backend/run.py --capture DIR --out DIR          (with the bpy wheel)

The engine (`python -m blender_nep`, in a Python that has torch) makes the asset folder; then Blender imports it, sets
the recovered light as World, renders comparison.png and saves asset.blend with everything packed, both in the asset
folder. SIGTERM or Ctrl-C stops the engine, which writes its checkpoint. The exit code is the engine's (0 done, 2 wrong
arguments or no engine, 3 capture, 4 bounds, 5 output, 6 learning, 7 stopped), or 8 where Blender's part failed.
"""

import argparse
import os
import signal
import sys
import threading
import time
from pathlib import Path

if __package__ in (None, ""):
    sys.path.insert(0, str(Path(__file__).resolve().parent.parent))

from backend.arguments import script_arguments
from backend.engine.command import EngineError, find_engine_python, reconstruct_arguments
from backend.engine.engine import Engine
from backend.engine.exit_codes import BLENDER_FAILED, STOPPED
from backend.engine.job_files import is_asset
from backend.engine.progress import describe
from backend.engine.timings import EXPECTED_SECONDS
from backend.engine.words import Said

POLL_S = 0.1
SAY_EVERY_S = 2.0


def parse(arguments: list[str]) -> argparse.Namespace:
    parser = argparse.ArgumentParser(prog="run.py", description=__doc__.split("\n\n")[0])
    parser.add_argument("--capture", type=Path, required=True, help="folder with photos and their cameras")
    parser.add_argument("--out", type=Path, required=True, help="asset folder to write")
    parser.add_argument("--preset", choices=tuple(EXPECTED_SECONDS))
    parser.add_argument("--relight", type=int, default=3, metavar="N", help="HDRIs to show the object under")
    parser.add_argument("--photos", type=int, default=2, metavar="N", help="photos to compare with")
    parser.add_argument("--samples", type=int, default=48, help="Cycles samples a pixel of the comparison")
    parser.add_argument("--engine-python", help="the Python that has blender-nep and torch")
    parser.add_argument("--masks", choices=("use", "ignore"))
    parser.add_argument("--metal", choices=("auto", "yes", "no"), help="whether it is metal, where photos do not tell")
    parser.add_argument("--device", default="auto", choices=("auto", "cpu", "cuda"), help="of the engine")
    parser.add_argument("--mesh", help="learn materials on this mesh, in capture coordinates")
    parser.add_argument("--resume", action="store_true", help="go on from a checkpoint, or from a finished asset")
    parser.add_argument("--overwrite", action="store_true", help="replace an asset or a run in the asset folder")
    parser.add_argument("--seed", type=int)
    parser.add_argument("--watch-stdin", action="store_true", help="stop when standard input closes")
    return parser.parse_args(arguments)


def say(text: str) -> None:
    print(text, file=sys.stderr, flush=True)


class StopRequests:
    """Listens for requests to stop this program, and sets `asked` when one comes.

    A request is SIGTERM, SIGINT or, if `watch_stdin` is true, the end of standard input.
    """

    def __init__(self, watch_stdin: bool):
        self.asked = threading.Event()
        self.previous = {number: signal.signal(number, self._on_signal) for number in (signal.SIGTERM, signal.SIGINT)}
        if watch_stdin:
            threading.Thread(target=self._watch, daemon=True).start()

    def _on_signal(self, number: int, frame: object) -> None:
        self.asked.set()

    def _watch(self) -> None:
        while os.read(sys.stdin.fileno(), 4096):
            continue
        self.asked.set()


def reconstruct(options: argparse.Namespace, stop: StopRequests) -> None:
    """Run the engine to its end. Raises EngineError where the engine fails or is stopped."""
    python = find_engine_python(options.engine_python, configured_python())
    engine = Engine.start(
        python,
        reconstruct_arguments(
            options.capture,
            options.out,
            preset=options.preset,
            device=options.device,
            seed=options.seed,
            masks=options.masks,
            metal=options.metal,
            mesh=options.mesh,
            resume=options.resume,
            overwrite=options.overwrite,
        ),
    )
    last_said, scene = -SAY_EVERY_S, []
    try:
        ended = False
        while not ended:
            if stop.asked.is_set():
                engine.request_stop()
            events, ended = engine.poll()
            for event in events:
                if event["event"] == "progress" and time.monotonic() - last_said < SAY_EVERY_S:
                    continue
                if event["event"] in ("progress", "warning"):
                    last_said = time.monotonic()
                    say(describe(event))
                elif event["event"] == "scene":  # each scene event repeats the lines of the scene events before it
                    lines = [Said.of(line).message for line in event["lines"]]
                    for line in lines:
                        if line not in scene:
                            say(line)
                    scene = lines
            if not ended:
                time.sleep(POLL_S)
        failed = engine.outcome()
    finally:
        engine.close()
    if failed:
        raise failed


def configured_python() -> str:
    """The engine's Python from the add-on's preferences; empty where the add-on is not enabled in this Blender."""
    import bpy

    for name, addon in bpy.context.preferences.addons.items():
        if name.rpartition(".")[2] == "blender_nep":
            return getattr(addon.preferences, "engine_python", "")
    return ""


def blender_work(options: argparse.Namespace, stop: StopRequests) -> None:
    """Import the asset, render comparison.png and save asset.blend.

    Raises OSError, ValueError or RuntimeError where one of these fails, and EngineError where a stop is asked for.
    """
    import bpy

    from backend.rendering.comparison import compare, write_comparison
    from backend.rendering.relight import add_camera
    from backend.scene_io.asset_import import import_asset
    from backend.scene_io.capture_files import read_frames_of, spread_frames, with_exposures
    from backend.scene_io.world import blender_hdris, build_world

    frames = with_exposures(read_frames_of(options.capture, options.out), options.out)
    frames = spread_frames(frames, options.photos)
    bpy.ops.wm.read_factory_settings(use_empty=True)
    scene = bpy.context.scene
    scene.render.engine = "CYCLES"
    scene.view_settings.view_transform = "Standard"
    item = import_asset(options.out, scene.collection)
    recovered = build_world(options.out / "environment.exr", name="recovered light")
    scene.world = recovered
    hdris = blender_hdris()[: options.relight]
    if len(hdris) < options.relight:
        say(f"warning: this Blender ships {len(hdris)} HDRIs; {options.relight} were asked for")
    worlds = [build_world(path, name=path.stem) for path in hdris]

    def progress(done: int, total: int) -> None:
        say(f"comparison: render {done}/{total}")
        if stop.asked.is_set():
            raise EngineError(STOPPED, "Stopped while rendering the comparison; the asset is complete.")

    sheet, _ = compare(item, frames, recovered, worlds, samples=options.samples, seed=options.seed or 0, progress=progress)
    write_comparison(options.out / "comparison.png", sheet)
    for frame in frames:
        camera = add_camera(frame, scene, name=frame.path.stem)
        scene.camera = scene.camera or camera
    scene.render.resolution_x, scene.render.resolution_y = frames[0].width, frames[0].height
    save_packed(options.out / "asset.blend")


def save_packed(path: Path) -> None:
    """Save the .blend with every image inside. The file is written under a temporary name and then renamed."""
    import bpy

    bpy.ops.file.pack_all()
    partial = path.with_name("partial_" + path.name)
    bpy.ops.wm.save_as_mainfile(filepath=str(partial.resolve()), copy=True, compress=True)
    os.replace(partial, path)


def main(arguments: list[str]) -> int:
    options = parse(arguments)
    stop = StopRequests(options.watch_stdin)
    try:
        if options.resume and is_asset(options.out):
            say(f"{options.out} holds a finished asset: going on with Blender's part")
        else:
            reconstruct(options, stop)
        blender_work(options, stop)
    except EngineError as error:
        say(f"run.py: {error}")
        return error.code
    except (OSError, ValueError, RuntimeError) as error:
        say(f"run.py: Blender's part failed: {error}")
        return BLENDER_FAILED
    say(f"done: {options.out / 'asset.blend'}, {options.out / 'comparison.png'}")
    return 0


if __name__ == "__main__":
    code = main(script_arguments())
    # A thread may still wait for input. The bpy wheel of Blender 4.5 may then never end by itself.
    if threading.active_count() > 1:
        sys.stdout.flush()
        os._exit(code)
    sys.exit(code)
