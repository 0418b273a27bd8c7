"""Turns many captures into a shelf: their assets, pictures of each, shelf.blend with all of them, and the gallery."""

import argparse
import time
from pathlib import Path

from ..engine.command import EngineError, find_engine_python
from ..engine.commands.batch_process import BatchProcess
from ..engine.commands.gallery_process import GalleryProcess
from ..engine.exit_codes import OBJECTS_FAILED, STOPPED
from ..engine.results.batch_file import BatchFile, BatchObject, read_batch
from ..engine.results.job_files import is_asset
from .configured_python import configured_python
from .stop_requests import StopRequests, say

POLL_S = 0.1
SAY_EVERY_S = 2.0
BLEND_FILE = "shelf.blend"


def reconstruct_shelf(options: argparse.Namespace, stop: StopRequests) -> int:
    """Make the assets of `options.captures` in `options.out`, their pictures, shelf.blend and the gallery.

    Returns the exit code: 0, or OBJECTS_FAILED where some objects failed, in the engine or here. Raises EngineError where
    the engine fails as a whole or a stop is asked for; OSError, ValueError or RuntimeError where shelf.blend or the pages
    cannot be written.
    """
    python = find_engine_python(options.engine_python, configured_python())
    failed = _reconstruct(python, options, stop)
    batch = read_batch(options.out)
    for one in batch.done:
        try:
            _render_missing(one, options, stop)
        except (OSError, ValueError, RuntimeError) as error:
            failed.append(one.name)
            say(f"{one.name}: Blender's part failed: {error}")
    if batch.done:
        _save_shelf(batch)
    _write_gallery(python, options.out)
    say(f"done: {options.out / BLEND_FILE}, {options.out / 'index.html'}")
    if failed:
        say(f"{len(failed)} of {len(batch.objects)} objects failed: {', '.join(failed)}. The same command tries them again.")
    return OBJECTS_FAILED if failed else 0


def _reconstruct(python: str, options: argparse.Namespace, stop: StopRequests) -> list[str]:
    """Run the engine to its end. Returns the names of the objects that failed. Raises EngineError."""
    process = BatchProcess(
        python,
        options.captures,
        options.out,
        preset=options.preset,
        device=options.device,
        seed=options.seed,
        masks=options.masks,
        metal=options.metal,
        turntable=options.turntable,
        faces=options.faces,
        workers=options.workers,
        threads=options.threads,
        all_photos=options.all_photos,
        overwrite=options.overwrite,
    )
    last_said, shown, warned = -SAY_EVERY_S, process.progress, 0
    try:
        while not process.poll():
            if stop.asked.is_set():
                process.stop()
            for warning in process.warnings[warned:]:
                say(f"warning: {warning.message}")
            warned = len(process.warnings)
            if process.progress != shown and time.monotonic() - last_said > SAY_EVERY_S:
                last_said, shown = time.monotonic(), process.progress
                say("  ".join([f"{100 * shown.fraction:3.0f} %", *shown.lines()]))
            time.sleep(POLL_S)
    finally:
        process.close()
    error = process.failed
    if error is None:
        return []
    if error.code != OBJECTS_FAILED:
        raise error
    batch = read_batch(options.out)
    for one in batch.objects:
        if one.message:
            say(f"{one.name}: {one.message}. {one.hint}")
    return [str(name) for name in error.values.get("names") or ()]


def _render_missing(one: BatchObject, options: argparse.Namespace, stop: StopRequests) -> None:
    """Render comparison.png and turntable.png of a finished object, where they are missing or older than the asset."""
    from ..rendering.turntable import FILE as TURNTABLE
    from ..rendering.turntable import render_turntable
    from ..scene_io.image_files import write_png
    from .relit_asset import COMPARISON, Effort, import_for_relighting, write_relit_comparison

    missing = [name for name in (COMPARISON, TURNTABLE) if not _is_newer(one.folder / name, one.folder / "report.json")]
    if not missing:
        return
    effort = Effort(options.relight, options.photos, options.samples, options.seed or 0)
    relit = import_for_relighting(one.folder, one.capture, effort)

    def progress(done: int, total: int) -> None:
        say(f"{one.name}: render {done}/{total}")
        if stop.asked.is_set():
            raise EngineError(STOPPED, "Stopped while rendering; the same command goes on.")

    if TURNTABLE in missing:
        light = (relit.lights or [relit.recovered])[0]
        strip = render_turntable(relit.item, relit.frames, light, seed=effort.seed, progress=progress)
        write_png(one.folder / TURNTABLE, strip)
    if COMPARISON in missing:
        write_relit_comparison(relit, one.folder, effort, progress)


def _is_newer(picture: Path, report: Path) -> bool:
    try:
        return picture.stat().st_mtime >= report.stat().st_mtime
    except OSError:
        return False


def _save_shelf(batch: BatchFile) -> None:
    """Write shelf.blend with the objects that are done, and their catalog beside it."""
    import bpy

    from ..scene_io.world import blender_hdris, build_world
    from ..shelf.bring_in import bring_in
    from ..shelf.catalogs import add_catalogs, catalog_of
    from .blend_file import save_packed

    bpy.ops.wm.read_factory_settings(use_empty=True)
    scene = bpy.context.scene
    scene.render.engine = "CYCLES"
    brought = bring_in(batch, scene)
    for name, reason in brought.refused.items():
        say(f"warning: {name} is not on the shelf: {reason}")
    finished = [one.folder for one in batch.done if is_asset(one.folder)]
    light = next((path for path in (*blender_hdris(), *(f / "environment.exr" for f in finished)) if path.is_file()), None)
    if light is not None:
        scene.world = build_world(light, name="light of the shelf")
    add_catalogs(batch.folder, [catalog_of(batch)])
    save_packed(batch.folder / BLEND_FILE)


def _write_gallery(python: str, folder: Path) -> None:
    process = GalleryProcess(python, folder)
    while not process.poll():
        time.sleep(POLL_S)
    if process.failed is not None:
        raise RuntimeError(str(process.failed))
