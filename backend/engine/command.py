"""Finds the Python that runs the engine, and makes its environment and its arguments. No bpy in this file."""

import os
import subprocess
import sys
from collections.abc import Mapping, Sequence
from decimal import Decimal
from pathlib import Path
from typing import Any

from .exit_codes import NO_ENGINE
from .install import NEUTRAL_FOLDER, venv_python, whole_path
from .words import Translate, error_words

ENGINE_PYTHON_VARIABLE = "NEP_ENGINE_PYTHON"
ENGINE_MODULE = "blender_nep"
CHECK_LIMIT_S = 60.0
LEAST_FACES = 2000
"""Smallest number of faces that the engine takes: as in blender_nep/command_line.py. A test compares the two."""


class EngineError(Exception):
    """The engine failed or cannot be started.

    `code` is the exit code. `hint` says what to do, or is empty. `log` is the end of the engine's log, or empty. From `name`
    and `values` the panel makes its own message (words.py).
    """

    def __init__(
        self, code: int, message: str, hint: str = "", log: str = "", name: str = "", values: dict[str, Any] | None = None
    ):
        super().__init__("\n".join(text for text in (message, hint, log) if text))
        self.code, self.message, self.hint, self.log = code, message, hint, log
        self.name, self.values = name, values or {}

    def words(self, translate: Translate = str) -> tuple[str, str]:
        """(message, hint) that the panel shows."""
        return error_words(self.name, self.values, self.message, self.hint, translate)


class NoEngineError(EngineError):
    """No Python has the engine, or a part of the engine is missing."""

    def __init__(self, message: str):
        super().__init__(
            NO_ENGINE,
            message,
            "Install the engine in the add-on's preferences, or name a Python that has it "
            f"there, with --engine-python or by the variable {ENGINE_PYTHON_VARIABLE}.",
            name="engine.missing",
        )


def engine_environment() -> dict[str, str]:
    """This process's environment without the variables of Blender and Python.

    Those variables would change what the engine's Python imports.
    """
    return {name: value for name, value in os.environ.items() if not name.startswith(("PYTHON", "BLENDER_"))}


def engine_is_at_hand(configured: str) -> bool:
    """Whether a Python for the engine is named, or lies in this checkout.

    The function does not start that Python, so it does not know whether that Python has the engine.
    """
    return bool(os.environ.get(ENGINE_PYTHON_VARIABLE) or configured or _checkout_python().exists())


def find_engine_python(explicit: str | None = None, configured: str | None = None) -> str:
    """The path of the Python that runs the engine.

    The first of these that is set is taken: `explicit` (an argument), the variable NEP_ENGINE_PYTHON, `configured` (the
    add-on's preferences). A Python that is named in one of these ways is not checked; if it lacks the engine, the start of
    the engine reports that. Where none is named, two Pythons are checked: the one in `.venv` of this checkout, then the
    running one. The first that has the engine is taken. Raises NoEngineError where neither has it.
    """
    for python in (explicit, os.environ.get(ENGINE_PYTHON_VARIABLE), configured):
        if python:
            return whole_path(python)
    for found in (str(_checkout_python()), sys.executable):
        if found and Path(found).exists() and _has_engine(found):
            return found
    raise NoEngineError("No Python with the engine (blender-nep and torch) was found.")


def _checkout_python() -> Path:
    return venv_python(Path(__file__).resolve().parents[2] / ".venv")


def _has_engine(python: str) -> bool:
    script = f"import importlib.util as u; assert all(map(u.find_spec, ('{ENGINE_MODULE}', 'torch')))"
    try:
        return (
            subprocess.run(
                [python, "-I", "-c", script],
                cwd=NEUTRAL_FOLDER,
                env=engine_environment(),
                stdin=subprocess.DEVNULL,
                capture_output=True,
                timeout=CHECK_LIMIT_S,
                creationflags=getattr(subprocess, "CREATE_NO_WINDOW", 0),
            ).returncode
            == 0
        )
    except (OSError, subprocess.TimeoutExpired):
        return False


def reconstruct_arguments(
    capture: Path | str,
    out: Path | str,
    *,
    preset: str | None = None,
    device: str = "auto",
    seed: int | None = None,
    masks: str | None = None,
    metal: str | None = None,
    turntable: str | None = None,
    faces: int | None = None,
    mesh: str | None = None,
    threads: int | None = None,
    all_photos: bool = False,
    resume: bool = False,
    overwrite: bool = False,
    preview: bool = False,
    keep_going: bool = False,
    more: tuple[str, ...] = (),
) -> list[str]:
    """The engine's command line for one reconstruction.

    keep_going: the engine goes on when this program ends. Otherwise the engine writes its checkpoint and ends when its
    standard input is closed. more: further arguments, which are passed on unchanged.
    """
    arguments = ["reconstruct", _whole(capture), "--out", _whole(out), "--device", device, "--job-files"]
    for name, value in (
        ("--preset", preset),
        ("--seed", seed),
        ("--masks", masks),
        ("--metal", metal),
        ("--turntable", turntable),
        ("--faces", faces),
        ("--mesh", None if mesh is None else _whole(mesh)),
        ("--threads", threads),
    ):
        if value is not None:
            arguments += [name, str(value)]
    flags = {"--all-photos": all_photos, "--watch-stdin": not keep_going}
    flags |= {"--resume": resume, "--overwrite": overwrite, "--preview": preview}
    return [*arguments, *more, *(name for name, wanted in flags.items() if wanted)]


def sphere_arguments(center: Sequence[float], radius: float) -> list[str]:
    """The engine's arguments for the object's sphere, in the capture's units. argparse takes -1e-05 for an option."""
    x, y, z, r = (format(Decimal(repr(float(value))), "f") for value in (*center, radius))
    return ["--object-center", x, y, z, "--object-radius", r]


def materials_arguments(asset: Path | str, corrections: Mapping[int, Mapping[str, float]]) -> list[str]:
    """The engine's command line that gives the materials of an asset these corrections, and no others.

    `corrections`: number of a material -> its corrected values, by the names `metallic` and `roughness`. Where there is
    none, all materials go back to what was learned.
    """
    given = [f"{number}:{name}={value:.4g}" for number, values in corrections.items() for name, value in values.items()]
    options = [text for one in given for text in ("--set", one)]
    return ["materials", _whole(asset), *(options or ["--reset"])]


def cameras_arguments(
    photos: Path | str,
    *,
    threads: int | None = None,
    overwrite: bool = False,
    improve: bool = False,
    features: str = "everywhere",
    out: Path | str | None = None,
    frames: int | None = None,
) -> list[str]:
    """The engine's command line that finds the cameras of the photos in a folder, and writes them into the folder.

    photos: or a video. out: another folder for the cameras, and for a video's frames; frames: how many at most.

    The engine ends, and writes nothing, when its standard input is closed. overwrite: replace cameras that are there.
    improve: begin with the cameras that are there. features: "everywhere", or, where the photos have masks, "object" or
    "surroundings".
    """
    options = [] if threads is None else ["--threads", str(threads)]
    options += [] if features == "everywhere" else ["--features", features]
    options += [] if out is None else ["--out", _whole(out)]
    options += [] if frames is None else ["--frames", str(frames)]
    flags = {"--improve": improve, "--overwrite": overwrite}
    return ["cameras", _whole(photos), "--watch-stdin", *options, *(name for name, wanted in flags.items() if wanted)]


def info_arguments(capture: Path | str, *, picture: Path | None = None, bounds: tuple[str, ...] = ()) -> list[str]:
    """The engine's command line that says what it knows of a capture, as JSON.

    picture: the file for a drawing of the photos' directions. bounds: arguments with the object's sphere.
    """
    drawing = [] if picture is None else ["--picture", _whole(picture)]
    return ["info", _whole(capture), "--json", *drawing, *bounds]


def gallery_arguments(folder: Path | str) -> list[str]:
    """The engine's command line that writes the pages of the batch in `folder`."""
    return ["gallery", _whole(folder)]


def _whole(path: Path | str) -> str:
    """The path as an absolute one. The engine has another current folder than this program."""
    return str(Path(path).absolute())


def batch_arguments(
    captures: Sequence[Path | str],
    out: Path | str,
    *,
    preset: str | None = None,
    device: str = "auto",
    seed: int | None = None,
    masks: str | None = None,
    metal: str | None = None,
    turntable: str | None = None,
    faces: int | None = None,
    workers: int | None = None,
    threads: int | None = None,
    all_photos: bool = False,
    overwrite: bool = False,
    keep_going: bool = False,
) -> list[str]:
    """The engine's command line for a batch. No captures: those of the last start in the folder `out`.

    keep_going: the engine goes on when this program ends. Otherwise its jobs write their checkpoints, and it ends when its
    standard input is closed.
    """
    arguments = ["batch", *map(_whole, captures), "--out", _whole(out), "--device", device]
    for name, value in (
        ("--preset", preset),
        ("--seed", seed),
        ("--masks", masks),
        ("--metal", metal),
        ("--turntable", turntable),
        ("--faces", faces),
        ("--workers", workers),
        ("--threads", threads),
    ):
        if value is not None:
            arguments += [name, str(value)]
    flags = {"--all-photos": all_photos, "--watch-stdin": not keep_going, "--overwrite": overwrite}
    return [*arguments, *(name for name, wanted in flags.items() if wanted)]
