"""Turn a capture into a relit asset with one command, headless; or many captures into a shelf of objects.

    blender -b -P backend/run.py -- --capture DIR --out DIR [--preset preview] [--relight 3]
    blender -b -P backend/run.py -- --captures DIR DIR ... --out FOLDER [--preset preview]
    python backend/run.py --capture DIR --out DIR          (with the bpy wheel)

The engine (`python -m blender_nep`, in a Python that has torch) makes the asset folder; then Blender imports it, sets
the recovered light as World, renders comparison.png and saves asset.blend with everything packed, both in the asset
folder. With --captures the engine makes a batch of assets. Blender then renders comparison.png and turntable.png of each,
and writes FOLDER/shelf.blend: all objects in a row, marked as assets, with their catalog beside the file. Then the engine
writes the gallery. The same command goes on with what is left.

SIGTERM or Ctrl-C stops the engine, which writes its checkpoint. The exit code is the engine's, 2 where there is
no engine, or 8 where Blender's part failed (docs/conventions.md#exit-codes).
"""

import argparse
import os
import re
import sys
import threading
from pathlib import Path

if __package__ in (None, ""):
    sys.path.insert(0, str(Path(__file__).resolve().parent.parent))

from backend.arguments import path_argument, script_arguments
from backend.engine.command import LEAST_FACES, EngineError
from backend.engine.exit_codes import BLENDER_FAILED
from backend.engine.timings import EXPECTED_SECONDS
from backend.headless.one_object import reconstruct_object
from backend.headless.shelf import reconstruct_shelf
from backend.headless.stop_requests import StopRequests, say


def parse(arguments: list[str]) -> argparse.Namespace:
    parser = argparse.ArgumentParser(prog="run.py", description=__doc__.split("\n\n")[0])
    what = parser.add_mutually_exclusive_group(required=True)
    what.add_argument("--capture", type=path_argument, help="folder with photos and their cameras")
    what.add_argument(
        "--captures",
        type=path_argument,
        nargs="*",
        metavar="CAPTURES",
        help="Reconstruct Shelf: capture folders, folders that hold captures or photos, or text files with one folder a "
        "line; none: those of the last start",
    )
    parser.add_argument(
        "--out", type=path_argument, required=True, help="asset folder to write; with --captures: folder of the shelf"
    )
    parser.add_argument("--preset", choices=tuple(EXPECTED_SECONDS))
    parser.add_argument("--relight", type=int, default=3, metavar="N", help="HDRIs to show the object under")
    parser.add_argument("--photos", type=int, default=2, metavar="N", help="photos to compare with")
    parser.add_argument("--samples", type=int, default=48, help="Cycles samples a pixel of the comparison")
    parser.add_argument("--engine-python", help="the Python that has blender-nep and torch")
    parser.add_argument("--masks", choices=("use", "object", "background", "usable", "ignore"))
    parser.add_argument(
        "--turntable",
        choices=("auto", "yes", "no"),
        help="whether the object turned while the camera and the light stood still",
    )
    parser.add_argument(
        "--all-photos", action="store_true", help="also learn from photos that were taken in another light than most"
    )
    parser.add_argument("--metal", choices=("auto", "yes", "no"), help="whether it is metal, where photos do not tell")
    parser.add_argument(
        "--faces", type=int, metavar="N", help="largest number of faces of the mesh; the rest is a normal map"
    )
    # Without this, argparse takes -1e-05, which people copy from report.json, for an option.
    parser._negative_number_matcher = re.compile(r"-(\d+\.?\d*|\.\d+)(e[-+]?\d+)?$", re.IGNORECASE)
    parser.add_argument(
        "--object-center", type=float, nargs=3, metavar=("X", "Y", "Z"), help="of the object's sphere; only with --capture"
    )
    parser.add_argument("--object-radius", type=float, metavar="R", help="of the object's sphere; only with --capture")
    parser.add_argument("--threads", type=int, metavar="N", help="of the engine, or of each job of a shelf")
    parser.add_argument("--device", default="auto", choices=("auto", "cpu", "cuda"), help="of the engine")
    parser.add_argument("--mesh", help="learn materials on this mesh, in capture coordinates; only with --capture")
    parser.add_argument(
        "--resume", action="store_true", help="go on from a checkpoint, or from a finished asset; only with --capture"
    )
    parser.add_argument("--overwrite", action="store_true", help="replace an asset or a run in the asset folder")
    parser.add_argument("--workers", type=int, metavar="N", help="jobs at once; only with --captures")
    parser.add_argument("--seed", type=int)
    parser.add_argument("--watch-stdin", action="store_true", help="stop when standard input closes")
    options = parser.parse_args(arguments)
    if options.captures is not None and options.mesh is not None:
        parser.error("--mesh is the mesh of one object: it works only with --capture")
    if options.mesh is not None and options.faces is not None:
        parser.error("--faces does not work with --mesh: the asset has the given mesh")
    if options.faces is not None and options.faces < LEAST_FACES:
        parser.error(f"--faces must be at least {LEAST_FACES}")
    if options.captures is not None and options.resume:
        parser.error("--resume works only with --capture: a shelf always goes on with what is left")
    if (options.object_center is None) != (options.object_radius is None):
        parser.error("--object-center and --object-radius belong together")
    if options.captures is not None and options.object_center is not None:
        parser.error("--object-center is of one object: it works only with --capture")
    if options.capture is not None and options.workers is not None:
        parser.error("--workers works only with --captures")
    return options


def main(arguments: list[str]) -> int:
    options = parse(arguments)
    stop = StopRequests(options.watch_stdin)
    try:
        return reconstruct_object(options, stop) if options.captures is None else reconstruct_shelf(options, stop)
    except EngineError as error:
        say(f"run.py: {error.message}", *(text for text in (error.hint, *error.log.split("\n")) if text))
        return error.code
    except (OSError, ValueError, RuntimeError) as error:
        say(f"run.py: Blender's part failed: {error}")
        return BLENDER_FAILED


if __name__ == "__main__":
    code = main(script_arguments())
    # A thread may still wait for input. The bpy wheel of Blender 4.5 may then never end by itself.
    if threading.active_count() > 1:
        sys.stdout.flush()
        os._exit(code)
    sys.exit(code)
