"""The command line: `blender-nep info`, `cameras`, `reconstruct`, `batch`, `materials` and `gallery`."""

from __future__ import annotations

import argparse
import io
import json
import sys
from dataclasses import replace
from importlib.util import find_spec
from pathlib import Path
from typing import TYPE_CHECKING

from blender_nep.command_line import parser, sphere
from blender_nep.safety.printed_text import one_line
from blender_nep.safety.standard_streams import open_closed_streams, prints_go_to_errors, tell

if TYPE_CHECKING:
    from blender_nep.capture.photos.mask_files import MaskMeaning
    from blender_nep.errors import NepError
    from blender_nep.job.reporting.events import Events
    from blender_nep.presets import Preset


def main(arguments: list[str] | None = None) -> int:
    """Run the command line and return its exit code."""
    open_closed_streams()
    if isinstance(sys.stdout, io.TextIOWrapper):
        sys.stdout.reconfigure(errors="backslashreplace")  # names of files may be no UTF-8
    top = parser()
    options = top.parse_args(arguments)
    if options.command in ("info", "reconstruct") and (options.object_center is None) != (options.object_radius is None):
        top.error("--object-center and --object-radius work only together")
    if options.command == "reconstruct" and options.mesh is not None and options.faces is not None:
        top.error("--faces does not work with --mesh: the asset has the given mesh")
    if options.command == "batch" and options.ship and options.ray is None:
        top.error("--ship works only with --ray")
    if options.command == "batch" and options.ray is not None and find_spec("ray") is None:
        top.error("--ray needs the package ray: pip install 'blender-nep[cluster]'")
    commands = {
        "info": _info,
        "cameras": _cameras,
        "reconstruct": _reconstruct,
        "batch": _batch,
        "materials": _materials,
        "gallery": _gallery,
    }
    return commands[options.command](options)


def _report_error(error: NepError) -> int:
    """Tell a person the error, and return its exit code."""
    lines = [f"error: {error.message}", *([f"       {error.hint}"] if error.hint else [])]
    print(*map(one_line, lines), sep="\n", file=sys.stderr)
    return error.code


def _info(options: argparse.Namespace) -> int:
    from blender_nep.capture.doctor.summary import describe, summarize
    from blender_nep.errors import NepError
    from blender_nep.files import jsonable

    try:
        with prints_go_to_errors():  # such as OpenEXR's warnings
            found = summarize(
                options.capture,
                options.picture,
                sphere(options),
                use_masks=options.masks != "ignore",
                mask_meaning=_mask_meaning(options),
                turntable=_turntable(options),
            )
    except NepError as error:
        if options.json:
            _tell(json.dumps({"error": jsonable(error.to_dict())}, indent=1))
        return _report_error(error)
    return _tell(json.dumps(found, indent=1) if options.json else describe(found))


def _tell(*lines: str) -> int:
    """Print lines on standard output, and return the exit code. Perhaps nobody reads them (`blender-nep info | true`)."""
    error = tell(*lines)
    if error is None:
        return 0
    from blender_nep.files import output_error

    return _report_error(output_error(Path("standard output"), error))


def _events() -> Events:
    """Events for programs on standard output, if it is no terminal, and text for people on stderr."""
    from blender_nep.job.reporting.events import Events, open_protocol

    terminal = sys.stdout.isatty()  # asked before open_protocol takes standard output
    protocol = open_protocol()
    return Events(None if terminal else protocol, sys.stderr)


def _cameras(options: argparse.Namespace) -> int:
    events = _events()

    from blender_nep.job.commands import camera_search
    from blender_nep.stop_request import StopRequest

    stop = StopRequest()
    if options.watch_stdin:
        stop.watch()
    with stop.signals():
        wanted = camera_search.CameraSearch(
            options.photos,
            options.out,
            options.features,
            options.improve,
            options.overwrite,
            options.threads,
            options.frames,
            _turntable(options),
        )
        return camera_search.run(wanted, events, stop)


def _turntable(options: argparse.Namespace) -> bool | None:
    """Whether the object turned, as the user says; None: as the capture says, or as the photos show."""
    return None if options.turntable == "auto" else options.turntable == "yes"


def _mask_meaning(options: argparse.Namespace) -> MaskMeaning | None:
    """What white in the masks means, as the user says; None: as the masks look."""
    from blender_nep.capture.photos.mask_files import MaskMeaning

    return None if options.masks in ("use", "ignore") else MaskMeaning(options.masks)


def _chosen_preset(options: argparse.Namespace) -> Preset:
    from blender_nep.presets import preset

    chosen = preset(options.preset)
    if options.faces is not None:
        chosen = replace(chosen, surface=replace(chosen.surface, asset_faces=options.faces))
    if options.metal == "auto":
        return chosen
    return replace(chosen, material=replace(chosen.material, metallic=(float(options.metal == "yes"),)))


def _reconstruct(options: argparse.Namespace) -> int:
    events = _events()

    from blender_nep.job import runner as job
    from blender_nep.stop_request import StopRequest

    stop = StopRequest()
    if options.watch_stdin:
        stop.watch()
    settings = job.Settings(
        capture=options.capture,
        out=options.out,
        preset=_chosen_preset(options),
        device=options.device,
        seed=options.seed,
        use_masks=options.masks != "ignore",
        mask_meaning=_mask_meaning(options),
        turntable=_turntable(options),
        all_photos=options.all_photos,
        mesh=options.mesh,
        sphere=sphere(options),
        hold_out=options.hold_out,
        resume=options.resume,
        overwrite=options.overwrite,
        clean=options.clean,
        threads=options.threads,
        job_files=options.job_files,
        preview=options.preview,
        profile=options.profile,
    )
    with stop.signals():
        return job.run(settings, events, stop)


def _batch(options: argparse.Namespace) -> int:
    events = _events()

    from blender_nep.batch import runner as batch
    from blender_nep.batch.settings import BatchSettings
    from blender_nep.stop_request import StopRequest

    stop = StopRequest()
    if options.watch_stdin:
        stop.watch()
    settings = BatchSettings(
        captures=tuple(options.captures),
        out=options.out,
        preset=options.preset,
        masks=options.masks,
        metal=options.metal,
        turntable=options.turntable,
        all_photos=options.all_photos,
        faces=options.faces,
        seed=options.seed,
        device=options.device,
        clean=options.clean,
        overwrite=options.overwrite,
        workers=options.workers,
        threads=options.threads,
        memory_mb=options.memory,
        ray=options.ray,
        ship=options.ship,
    )
    with stop.signals():
        return batch.run(settings, events, stop)


def _materials(options: argparse.Namespace) -> int:
    if options.set is None and not options.reset:
        return _list_materials(options.asset)
    events = _events()

    from blender_nep.job.commands import correction
    from blender_nep.materials.corrections import Correction

    wanted: dict[int, dict[str, float]] = {}
    for number, name, value in options.set or ():
        wanted.setdefault(number, {})[name] = value
    return correction.run(options.asset, {k: Correction(**values) for k, values in wanted.items()}, events)


def _list_materials(asset: Path) -> int:
    from blender_nep.errors import NepError, UsageError
    from blender_nep.job.commands.correction import read_report

    try:
        lines = [_material_line(number, found) for number, found in enumerate(read_report(asset)["materials"])]
    except NepError as error:
        return _report_error(error)
    except (KeyError, TypeError, ValueError, OverflowError):
        hint = "Give the folder of a finished reconstruction."
        return _report_error(UsageError(f"{asset / 'report.json'} is damaged", hint))
    return _tell("number  share  roughness  metal  albedo (linear)", *lines)


def _material_line(number: int, found: dict) -> str:
    color = " ".join(f"{x:.3f}" for x in found["albedo"])
    metal = "yes" if found["metallic"] > 0.5 else "no"
    return f"{number:6}  {found['share']:5.1%}  {found['roughness']:9.3f}  {metal:>5}  {color}"


def _gallery(options: argparse.Namespace) -> int:
    from blender_nep.errors import NepError
    from blender_nep.gallery import write_gallery

    try:
        write_gallery(options.folder)
    except NepError as error:
        return _report_error(error)
    return _tell(one_line(options.folder / "index.html"))
