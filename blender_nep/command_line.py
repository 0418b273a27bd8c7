"""The arguments of the command line, and what its help says."""

from __future__ import annotations

import argparse
import math
import re
from collections.abc import Callable
from pathlib import Path
from typing import NoReturn

from blender_nep import __version__
from blender_nep.safety.printed_text import one_line

LEAST_FACES = 2000
"""Smallest --faces. With fewer, the mesh is no longer near enough to the surface for a normal map."""

MASKS = ("use", "object", "background", "usable", "ignore")
"""The values of --masks"""

EXIT_CODES = """\
exit codes:
  0  done
  1  unexpected: a bug, or out of memory (the traceback is in log.txt, if the command writes one)
  2  wrong arguments, an asset or files of others that are already there, or a resume with other settings
  3  the capture cannot be read or is not usable (a missing image, an empty folder, too few photos, NaN, sizes)
  4  the object's sphere cannot be right (a camera inside it, nothing in it, no photo sees it)
  5  the asset cannot be written (disk full, permissions, not a folder)
  6  learning failed (no surface was found, or it diverged)
  7  stopped on request; where a checkpoint is written, go on with --resume
  9  batch: some objects failed; the table and batch.json say why

Events for programs are JSON lines on standard output (none when that is a terminal); text for people is on stderr.
"""


FRAMES, MOST_FRAMES = 80, 250
"""--frames: how many frames of a video become photos, usually and at most"""


class _Parser(argparse.ArgumentParser):
    """A parser whose errors are one line, whatever the arguments are: a shell's `*` gives names that strangers chose."""

    def error(self, message: str) -> NoReturn:
        """Say the message, and end with exit code 2."""
        super().error(one_line(message))


MOST_THREADS = 1024
"""Libraries end the process where they are asked for a hundred million."""


def parser() -> argparse.ArgumentParser:
    """The parser of the command line's arguments."""
    top = _Parser(
        prog="blender-nep",
        description="Photos of a glossy object to a relightable mesh (NeP, CVPR 2024).",
        epilog=EXIT_CODES,
        formatter_class=argparse.RawDescriptionHelpFormatter,
    )
    top.add_argument("--version", action="version", version=f"blender-nep {__version__}")
    commands = top.add_subparsers(
        dest="command", required=True, metavar="{info,cameras,reconstruct,batch,materials,gallery}"
    )
    for add in (_add_info, _add_cameras, _add_reconstruct, _add_batch, _add_materials, _add_gallery):
        add(commands)
    return top


def sphere(options: argparse.Namespace) -> tuple[tuple[float, float, float], float] | None:
    """Center and radius of the object's sphere in capture coordinates, as the user gave them. None: not given."""
    if options.object_center is None:
        return None
    x, y, z = options.object_center
    return (x, y, z), options.object_radius


def _add_info(commands: argparse._SubParsersAction) -> None:
    info = _command_with_exit_codes(commands, "info", "say what a capture holds and what looks wrong")
    _add_capture(info)
    info.add_argument("--json", action="store_true", help="as one JSON object")
    _add_masks(info)
    _add_turntable(info)
    _add_sphere(info)
    info.add_argument(
        "--picture",
        type=_path,
        metavar="FILE.png",
        help="draw from which directions photos were taken, and where they are missing",
    )


def _add_masks(command: argparse.ArgumentParser) -> None:
    command.add_argument(
        "--masks",
        choices=MASKS,
        default="use",
        help="masks help, none are needed. use: what white in them means is recognized; object, background, usable: white "
        "is the object, its surroundings, or all that may be used (%(default)s)",
    )


def _add_turntable(command: argparse.ArgumentParser) -> None:
    command.add_argument(
        "--turntable",
        choices=("auto", "yes", "no"),
        default="auto",
        help="whether the object turned while the camera and the light stood still. auto: as the capture says, or as the "
        "photos show (%(default)s)",
    )


def _add_cameras(commands: argparse._SubParsersAction) -> None:
    find = _command_with_exit_codes(commands, "cameras", "find the cameras of photos, so that they become a capture")
    find.add_argument("photos", type=_path, metavar="PHOTOS", help="folder with photos, or a video")
    find.add_argument(
        "--out",
        type=_path,
        metavar="CAPTURE",
        help="folder of the capture (the folder of the photos; for film.mp4, the folder film beside it)",
    )
    find.add_argument(
        "--frames",
        type=_at_least(3, MOST_FRAMES),
        default=FRAMES,
        metavar="N",
        help=f"of a video: take at most so many frames, at most {MOST_FRAMES} (%(default)s)",
    )
    find.add_argument(
        "--features",
        choices=("everywhere", "object", "surroundings"),
        default="everywhere",
        help="where to look for points, if PHOTOS/masks shows the object: on a turntable, only on the object (%(default)s)",
    )
    _add_turntable(find)
    find.add_argument(
        "--improve", action="store_true", help="PHOTOS has cameras: improve them by the photos, in the same frame"
    )
    find.add_argument("--overwrite", action="store_true", help="replace cameras that are there")
    find.add_argument("--threads", type=_at_least(1, MOST_THREADS), metavar="N", help="CPU threads (all cores)")
    _add_watch_stdin(find)


def _add_reconstruct(commands: argparse._SubParsersAction) -> None:
    run = _command_with_exit_codes(commands, "reconstruct", "make an asset of a capture")
    _add_capture(run)
    run.add_argument("--out", type=_path, required=True, metavar="ASSET", help="folder of the asset")
    _add_preset(run)
    run.add_argument("--device", choices=("auto", "cpu", "cuda"), default="auto", help="(%(default)s)")
    run.add_argument("--seed", type=_seed, default=0, metavar="N", help="the same seed gives the same asset (%(default)s)")
    _add_masks(run)
    _add_turntable(run)
    _add_all_photos(run)
    run.add_argument("--mesh", type=_path, metavar="FILE", help="learn materials on this mesh (capture coordinates)")
    _add_sphere(run)
    run.add_argument(
        "--metal",
        choices=("auto", "yes", "no"),
        default="auto",
        help="whether the object is metal, where photos alone cannot tell (%(default)s)",
    )
    _add_faces(run)
    run.add_argument(
        "--hold-out",
        type=_at_least(2),
        metavar="N",
        help="do not learn from every N-th photo, and say how well the asset explains these (none)",
    )
    run.add_argument("--resume", action="store_true", help="go on with the run in ASSET that was stopped or killed")
    run.add_argument("--overwrite", action="store_true", help="replace an asset or a run in ASSET")
    run.add_argument("--clean", action="store_true", help="remove the checkpoints when the asset is written")
    run.add_argument("--threads", type=_at_least(1, MOST_THREADS), metavar="N", help="CPU threads (all cores)")
    run.add_argument(
        "--job-files",
        action="store_true",
        help="keep ASSET/job, by which other programs follow this run, find it again and stop it",
    )
    preview = "show in ASSET/job what has been learned so far (not with --mesh)"
    run.add_argument("--preview", action="store_true", help=preview)
    run.add_argument(
        "--profile",
        action="store_true",
        help="say where the time went: a table on stderr and in report.json, and ASSET/profile.json for speedscope.app",
    )
    _add_watch_stdin(run)


def _add_batch(commands: argparse._SubParsersAction) -> None:
    batch = _command_with_exit_codes(commands, "batch", "make assets of many captures")
    batch.add_argument(
        "captures",
        type=_path,
        nargs="*",
        metavar="CAPTURES",
        help="capture folders, folders that hold captures or photos, or text files with one folder a line; none: those of "
        "the last start",
    )
    batch.add_argument("--out", type=_path, required=True, metavar="FOLDER", help="folder of the assets and of batch.json")
    _add_preset(batch)
    _add_masks(batch)
    _add_turntable(batch)
    _add_all_photos(batch)
    batch.add_argument("--metal", choices=("auto", "yes", "no"), default="auto", help="(%(default)s)")
    _add_faces(batch)
    batch.add_argument("--seed", type=_seed, default=0, metavar="N", help="(%(default)s)")
    batch.add_argument("--device", choices=("auto", "cpu", "cuda"), default="auto", help="(%(default)s)")
    batch.add_argument("--clean", action="store_true", help="remove the checkpoints of finished objects")
    batch.add_argument("--overwrite", action="store_true", help="start the named objects again, or all if none is named")
    batch.add_argument(
        "--workers", type=_at_least(1, MOST_THREADS), metavar="N", help="jobs at once (as many as there are cores)"
    )
    batch.add_argument(
        "--threads", type=_at_least(1, MOST_THREADS), metavar="N", help="CPU threads of each job (the cores are divided)"
    )
    batch.add_argument("--memory", type=_positive, metavar="MB", help="memory of all jobs together (what is free)")
    batch.add_argument("--ray", metavar="ADDRESS", help="run the jobs on this Ray cluster; auto: the one of this machine")
    batch.add_argument("--ship", action="store_true", help="with --ray: the nodes do not share the disk")
    _add_watch_stdin(batch)


def _add_materials(commands: argparse._SubParsersAction) -> None:
    change = _command_with_exit_codes(commands, "materials", "list the materials of an asset, or correct them")
    change.add_argument("asset", type=_path, metavar="ASSET", help="folder of the asset")
    what = change.add_mutually_exclusive_group()
    what.add_argument(
        "--set",
        type=_correction,
        action="append",
        metavar="NUMBER:WHAT=VALUE",
        help="2:metallic=1 or 2:roughness=0.3; all other materials become as they were learned; may be repeated",
    )
    what.add_argument("--reset", action="store_true", help="make all materials as they were learned")


def _add_gallery(commands: argparse._SubParsersAction) -> None:
    pages = _command_with_exit_codes(commands, "gallery", "write the pages of a batch anew: FOLDER/index.html")
    pages.add_argument("folder", type=_path, metavar="FOLDER", help="folder of a batch")


def _command_with_exit_codes(commands: argparse._SubParsersAction, name: str, text: str) -> argparse.ArgumentParser:
    """Add a command whose help ends with the exit codes."""
    return commands.add_parser(name, help=text, epilog=EXIT_CODES, formatter_class=argparse.RawDescriptionHelpFormatter)


def _add_preset(command: argparse.ArgumentParser) -> None:
    command.add_argument(
        "--preset",
        choices=("preview", "balanced", "quality"),
        default="balanced",
        help="time against error (%(default)s)",
    )


def _add_all_photos(command: argparse.ArgumentParser) -> None:
    command.add_argument(
        "--all-photos", action="store_true", help="also learn from photos that were taken in another light than most"
    )


def _add_watch_stdin(command: argparse.ArgumentParser) -> None:
    command.add_argument(
        "--watch-stdin", action="store_true", help='stop at {"cmd": "stop"} on standard input, or when it is closed'
    )


def _add_capture(command: argparse.ArgumentParser) -> None:
    command.add_argument(
        "capture",
        type=_path,
        metavar="CAPTURE",
        help="folder with photos and their cameras: transforms.json, COLMAP, Metashape, Bundler and others",
    )


def _add_sphere(command: argparse.ArgumentParser) -> None:
    # Without this, argparse takes -1e-05, which people copy from report.json, for an option.
    command._negative_number_matcher = re.compile(r"-(\d+\.?\d*|\.\d+)(e[-+]?\d+)?$", re.IGNORECASE)
    command.add_argument(
        "--object-center",
        type=_finite,
        nargs=3,
        metavar=("X", "Y", "Z"),
        help="center of the sphere that holds the object, capture coordinates (transforms.json, or estimated)",
    )
    command.add_argument("--object-radius", type=_positive, metavar="R", help="its radius; both or none")


def _add_faces(command: argparse.ArgumentParser) -> None:
    command.add_argument(
        "--faces",
        type=_at_least(LEAST_FACES),
        metavar="N",
        help="largest number of faces of the mesh; a normal map carries the shape that so few faces lack (the preset's)",
    )


def _path(text: str) -> Path:
    if not text:  # Path would take it for the current folder
        raise argparse.ArgumentTypeError("must not be empty; a point is the current folder")
    return Path(text)


def _correction(text: str) -> tuple[int, str, float]:
    number, _, rest = text.partition(":")
    name, _, value = rest.partition("=")
    if name not in ("metallic", "roughness"):
        raise argparse.ArgumentTypeError("must be NUMBER:metallic=VALUE or NUMBER:roughness=VALUE")
    wanted = float(value)
    if not 0 <= wanted <= 1 or (name == "metallic" and wanted not in (0, 1)):
        raise argparse.ArgumentTypeError("metallic must be 0 or 1, roughness between 0 and 1")
    return int(number), name, wanted


def _seed(text: str) -> int:
    value = int(text)
    if not 0 <= value < 2**31:
        raise argparse.ArgumentTypeError("must be between 0 and 2147483647")
    return value


def _at_least(least: int, most: int | None = None) -> Callable[[str], int]:
    def whole_number(text: str) -> int:
        value = int(text)
        if value < least:
            raise argparse.ArgumentTypeError(f"must be at least {least}")
        if most is not None and value > most:
            raise argparse.ArgumentTypeError(f"must be at most {most}")
        return value

    return whole_number


def _finite(text: str) -> float:
    value = float(text)
    if not math.isfinite(value):
        raise argparse.ArgumentTypeError("must be a finite number")
    return value


def _positive(text: str) -> float:
    value = _finite(text)
    if value <= 0:
        raise argparse.ArgumentTypeError("must be positive")
    return value
