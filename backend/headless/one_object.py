"""Turns one capture into a relit asset and asset.blend."""

import argparse
import time

from ..engine.command import EngineError, find_engine_python, reconstruct_arguments, sphere_arguments
from ..engine.engine import Engine
from ..engine.exit_codes import STOPPED
from ..engine.progress import describe
from ..engine.results.job_files import is_asset
from ..engine.words import EngineMessage
from .configured_python import configured_python
from .stop_requests import StopRequests, say

POLL_S = 0.1
SAY_EVERY_S = 2.0


def reconstruct_object(options: argparse.Namespace, stop: StopRequests) -> int:
    """Make the asset of `options.capture` in `options.out`, with comparison.png and asset.blend. Returns the exit code, 0.

    Raises EngineError where the engine fails or a stop is asked for; OSError, ValueError or RuntimeError where Blender's
    part fails.
    """
    if options.resume and is_asset(options.out):
        say(f"{options.out} holds a finished asset: going on with Blender's part")
    else:
        _reconstruct(options, stop)
    _blender_work(options, stop)
    say(f"done: {options.out / 'asset.blend'}, {options.out / 'comparison.png'}")
    return 0


def _reconstruct(options: argparse.Namespace, stop: StopRequests) -> None:
    """Run the engine to its end. Raises EngineError where the engine fails or is stopped."""
    python = find_engine_python(options.engine_python, configured_python())
    sphere = () if options.object_center is None else tuple(sphere_arguments(options.object_center, options.object_radius))
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
            turntable=options.turntable,
            faces=options.faces,
            mesh=options.mesh,
            threads=options.threads,
            all_photos=options.all_photos,
            resume=options.resume,
            overwrite=options.overwrite,
            more=sphere,
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
                    lines = [EngineMessage.of(line).message for line in event["lines"]]
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


def _blender_work(options: argparse.Namespace, stop: StopRequests) -> None:
    """Import the asset, save asset.blend and render comparison.png."""
    import bpy

    from ..rendering.relight import add_camera
    from .blend_file import save_packed
    from .relit_asset import Effort, import_for_relighting, write_relit_comparison

    effort = Effort(options.relight, options.photos, options.samples, options.seed or 0)
    relit = import_for_relighting(options.out, options.capture, effort)

    def progress(done: int, total: int) -> None:
        say(f"comparison: render {done}/{total}")
        if stop.asked.is_set():
            raise EngineError(STOPPED, "Stopped while rendering the comparison; the asset is complete.")

    scene, frames = bpy.context.scene, relit.compared
    for frame in frames:
        camera = add_camera(frame, scene, name=frame.path.stem)
        scene.camera = scene.camera or camera
    scene.render.resolution_x, scene.render.resolution_y = frames[0].width, frames[0].height
    save_packed(options.out / "asset.blend")  # first: whatever becomes of the comparison, the asset can be opened
    write_relit_comparison(relit, options.out, effort, progress)
