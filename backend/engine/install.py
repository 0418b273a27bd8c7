"""Makes a Python environment with the engine: `install.py --source EXTENSION --folder DIR --python BASE --build cpu`.

The add-on starts this file as a separate program, so that Blender does not wait for pip. Therefore this file imports nothing
of this package. The program prints JSON lines (progress, done, error) on standard output; what pip prints goes to standard
error. When standard input is closed, the program stops and removes what it has made. The environment is DIR/nep-engine. Its
file engine.json is written last. An environment without engine.json counts as not installed, and the next run replaces it.
An engine that works is set aside meanwhile, and comes back if the run fails, before what the run has made is deleted.
"""

import argparse
import contextlib
import json
import os
import shutil
import signal
import subprocess
import sys
import tempfile
import threading
import time
from collections.abc import Callable
from pathlib import Path

NAME = "nep-engine"
DONE, UNFINISHED = "engine.json", "unfinished"
CPU_INDEX = "https://download.pytorch.org/whl/cpu"
OLDEST, NEWEST = (3, 11), (3, 13)  # all parts of the engine have builds for these
SOURCES = ("pyproject.toml", "README.md", "LICENSE", "constraints.txt", "blender_nep")
PIP = (
    *("-I", "-m", "pip", "install", "--no-input", "--progress-bar", "off", "--disable-pip-version-check"),
    *("--only-binary", ":all:"),  # no code of a package runs while it is built; our own sources are built all the same
)
PIP_VARIABLES = frozenset(
    f"PIP_{name}"
    for name in (
        *("INDEX_URL", "EXTRA_INDEX_URL", "FIND_LINKS", "NO_INDEX", "TRUSTED_HOST", "CERT", "CLIENT_CERT", "PROXY"),
        *("TIMEOUT", "DEFAULT_TIMEOUT", "RETRIES", "RESUME_RETRIES", "KEYRING_PROVIDER", "CONFIG_FILE"),
        *("CACHE_DIR", "NO_CACHE_DIR"),
    )
)
"""Variables that say how pip reaches its index. Others, such as PIP_TARGET, say what it installs and where: we say that."""
CANCELLED = 7  # exit code
NEUTRAL_FOLDER = Path(sys.prefix).anchor
"""The current folder of every program that is started: the top of the disk that this Python is on.

The current folder of Blender may hold files of strangers, such as a capture or a shelf. A Python imports modules from there,
unless it is started with -I, and libraries look there for their settings.
"""


def clean_environment() -> dict[str, str]:
    """This process's environment without the variables of pip that are not in `PIP_VARIABLES`."""
    return {name: value for name, value in os.environ.items() if not name.startswith("PIP_") or name in PIP_VARIABLES}


class InstallError(Exception):
    """The installation failed. `message` says what went wrong, `hint` what to do about it."""

    def __init__(self, message: str, hint: str = ""):
        super().__init__(message)
        self.message, self.hint = message, hint


class Cancelled(Exception):
    """The installation was cancelled, or the program that started it has ended."""


def emit(event: str, **content) -> None:
    print(json.dumps({"event": event, **content}), flush=True)


def venv_python(folder: Path) -> Path:
    """The path of the Python program in the virtual environment `folder`."""
    return folder / Path(*(("Scripts", "python.exe") if os.name == "nt" else ("bin", "python")))


def whole_path(program: str) -> str:
    """The absolute path of a program. A name without a folder stays: PATH says where that program is."""
    return str(Path(program).absolute()) if os.path.dirname(program) else program


def installed_python(folder: Path) -> str:
    """The path of the Python of the engine that was installed in `folder`; empty where no complete engine is there."""
    environment = Path(folder) / NAME
    python = venv_python(environment)
    return str(python) if (environment / DONE).is_file() and python.exists() else ""


class ProgramRunner:
    """Runs one program after the other.

    When standard input is closed, or a line with "stop" comes, the running program is ended and no other one is started.
    """

    def __init__(self):
        self.cancelled = threading.Event()
        self._process: subprocess.Popen | None = None
        threading.Thread(target=self._watch, daemon=True).start()

    def _watch(self) -> None:
        # This reads with os.read, not sys.stdin: a thread that waits in a buffered reader makes Python abort at its exit.
        while line := os.read(0, 4096):
            if b"stop" in line:
                break
        self.cancelled.set()
        if self._process is not None:
            self._end(self._process)

    @staticmethod
    def _end(process: subprocess.Popen) -> None:
        try:
            if os.name == "nt":
                process.kill()
            else:
                os.killpg(process.pid, signal.SIGKILL)  # ends pip and the programs that pip has started
        except OSError:
            return  # the program has already ended

    def run(self, command: list[str], on_line: Callable[[str], None] = lambda line: None) -> tuple[int, str]:
        """Run `command` and return (exit code, the last lines that it printed).

        `on_line` is called with every line that the program prints. Raises Cancelled where the installation was cancelled,
        and OSError where the program cannot be started.
        """
        if self.cancelled.is_set():
            raise Cancelled
        lines: list[str] = []
        # The output goes to a file, not to a pipe. If the program ended before a child of its own, that child would keep the
        # pipe open, and this loop would wait for the child.
        with tempfile.TemporaryDirectory(prefix="nep_step_") as folder:
            output_file = Path(folder, "output.txt")
            with open(output_file, "wb") as output:
                self._process = subprocess.Popen(
                    command,
                    cwd=NEUTRAL_FOLDER,
                    env=clean_environment(),
                    stdin=subprocess.DEVNULL,
                    stdout=output,
                    stderr=subprocess.STDOUT,
                    start_new_session=os.name != "nt",
                    creationflags=getattr(subprocess, "CREATE_NO_WINDOW", 0),
                )
            unfinished, ended = "", False
            with open(output_file, encoding="utf-8", errors="replace") as reader:
                while not ended:
                    ended = self._process.poll() is not None
                    *new, unfinished = (unfinished + reader.read()).split("\n")
                    for line in [*new, unfinished] if ended else new:
                        lines = [*lines[-40:], line]
                        print(line, file=sys.stderr, flush=True)
                        on_line(line)
                    if self.cancelled.is_set():
                        self._end(self._process)
                        self._process.wait()
                        raise Cancelled
                    if not ended:
                        time.sleep(0.1)
        return self._process.returncode, "\n".join(lines).strip()


def check_base(programs: ProgramRunner, python: str) -> tuple[int, int]:
    """(major, minor) version of `python`. Raises InstallError where `python` cannot make an environment for the engine."""
    script = "import sys; print('version', *sys.version_info[:2]); import venv, ensurepip"
    try:
        code, text = programs.run([python, "-I", "-c", script])
    except OSError as error:
        raise InstallError(
            f"{python} cannot be started: {error.strerror or error}.", "Choose another Base Python."
        ) from error
    words = next((line.split() for line in text.splitlines() if line.startswith("version ")), None)
    if words is None:
        raise InstallError(f"{python} is not a Python that works.", "Choose another Base Python.")
    version = int(words[1]), int(words[2])
    name = "Python {}.{}".format(*version)
    if version < OLDEST:
        raise InstallError(f"{python} is {name}; the engine needs 3.11 or newer.", "Choose another Base Python.")
    if code != 0:
        package = "Debian and Ubuntu ship them apart: install the package python{}.{}-venv. ".format(*version)
        raise InstallError(
            f"{name} ({python}) cannot make environments: it lacks the module venv or ensurepip.",
            (package if version <= NEWEST else "") + "Choose another Base Python, for example 3.13 from python.org.",
        )
    return version


def pip_install(
    programs: ProgramRunner,
    python: Path,
    arguments: list[str],
    what: str,
    span: tuple[float, float],
    version: tuple[int, int],
) -> None:
    """Run `pip install ARGUMENTS` with `python`, whose version is `version`. Raises InstallError where pip fails.

    Progress starts at the first fraction of `span` and grows towards the second one with each line that pip prints. `what`
    is the message of the first progress event.
    """
    fraction, end = span

    def on_line(line: str) -> None:
        nonlocal fraction
        if line.startswith(("Collecting", "Processing", "Downloading", "Using", "Building", "Installing", "  Downloading")):
            fraction += 0.06 * (end - fraction)
            emit("progress", fraction=round(fraction, 3), message=line.strip()[:100])

    emit("progress", fraction=fraction, message=what)
    code, text = programs.run([str(python), *PIP, *arguments], on_line)
    if code == 0:
        return
    if "No space left" in text:
        raise InstallError("The disk is full.", "Free some gigabytes, or choose another folder, and install again.")
    errors = [line for line in text.splitlines() if line.startswith("ERROR:")]
    missing = next((line for line in errors if "No matching distribution" in line), None)
    if missing and "connection broken by" in text and "from versions: none" in text:
        raise InstallError("The package index cannot be reached.", "Look at the network connection, and install again.")
    if missing:
        raise InstallError(
            f"There is no build of {missing.rpartition(' ')[2]} for this computer and Python {version[0]}.{version[1]}.",
            "Choose a Base Python 3.11, 3.12 or 3.13, and look at the network connection.",
        )
    hint = "Choose a Base Python 3.11, 3.12 or 3.13." if version > NEWEST else "The log has the details."
    raise InstallError(f"pip failed: {errors[-1][7:] if errors else text[-300:]}", hint)


def install(options: argparse.Namespace, programs: ProgramRunner) -> None:
    """Make the environment and install the engine into it. Raises InstallError, Cancelled and OSError."""
    environment = options.folder / NAME
    emit("progress", fraction=0.0, message="Looking at the base Python")
    version = check_base(programs, options.python)
    if (
        environment.exists()
        and any(environment.iterdir())
        and not any((environment / name).exists() for name in (DONE, UNFINISHED))
    ):
        raise InstallError(f"{environment} is there already and is no engine.", "Delete it, or choose another folder.")
    set_aside(environment)
    environment.mkdir(parents=True, exist_ok=True)  # an empty folder may be there
    (environment / UNFINISHED).touch()
    emit("progress", fraction=0.02, message="Making the environment")
    code, text = programs.run([options.python, "-I", "-m", "venv", str(environment)])
    if code != 0:
        raise InstallError(
            f"{options.python} could not make an environment: {text[-300:]}",
            "Choose another Base Python, for example one from python.org.",
        )
    python = venv_python(environment)
    pinned = ["--constraint", str(options.source / "constraints.txt")] if version <= NEWEST else []
    index = ["--index-url", CPU_INDEX] if options.build == "cpu" else []
    # torch comes without its dependencies here, because torch's own index has other versions of them. The second pip call
    # below takes them from pip's usual index.
    pip_install(programs, python, ["torch", "--no-deps", *index, *pinned], "Fetching torch", (0.05, 0.5), version)
    # pip installs from a copy: it writes files beside the sources, and must not write into the extension.
    with tempfile.TemporaryDirectory(prefix="nep_source_") as copy:
        for name in SOURCES:
            place = options.source / name
            if place.is_dir():
                shutil.copytree(place, Path(copy, name), ignore=shutil.ignore_patterns("__pycache__"))
            else:
                shutil.copy(place, Path(copy, name))
        pip_install(programs, python, [copy, *pinned], "Fetching what else the engine needs", (0.5, 0.95), version)
    emit("progress", fraction=0.95, message="Trying the engine")
    script = "import torch, blender_nep; print('versions', torch.__version__, blender_nep.__version__)"
    code, text = programs.run([str(python), "-I", "-c", script])
    if code != 0:
        raise InstallError(f"The engine was installed and does not start: {text[-300:]}", "The log has the details.")
    torch, library = text.split("versions ")[-1].split()[:2]
    emit("progress", fraction=0.96, message="Compiling the engine's kernels: about a minute")
    # If this fails, the first job compiles them.
    programs.run([str(python), "-I", "-m", "blender_nep.ops.rehearsal"])
    about = {"python": "{}.{}".format(*version), "torch": torch, "blender_nep": library, "build": options.build}
    partial = environment / (DONE + ".partial")
    partial.write_text(json.dumps(about, indent=1), encoding="utf-8")
    (environment / UNFINISHED).unlink()
    os.replace(partial, environment / DONE)
    _remove(_aside(environment))
    emit("done", python=str(python), **{k: v for k, v in about.items() if k != "python"})


def _aside(environment: Path) -> Path:
    """Where an engine waits that works, while another one is made in its place."""
    return environment.with_name(f"{environment.name}.before")


def set_aside(environment: Path) -> None:
    """Put a complete engine aside, so that it can come back, and remove what an unfinished run has left."""
    bring_back(environment)  # of a run that was killed
    if (environment / DONE).is_file():
        os.replace(environment, _aside(environment))


def bring_back(environment: Path) -> None:
    """Remove what an unfinished run has left. Put the engine that was set aside to its place again, if there is one.

    The engine is in its place before anything is deleted. Deleting some gigabytes can take minutes, and this program may be
    killed meanwhile.
    """
    aside, left = _aside(environment), environment.with_name(f"{environment.name}.{UNFINISHED}")
    if not (environment / DONE).is_file():
        if (environment / UNFINISHED).exists():
            _remove(left)
            os.replace(environment, left)
        if (aside / DONE).is_file():
            os.replace(aside, environment)
    for folder in (aside, left):
        _remove(folder)


def _remove(environment: Path) -> None:
    """Remove an environment of ours, or what is left of it. A folder without our mark stays.

    The mark goes last. So what could not be removed, or is left when this program is killed, is removed another time.
    """
    marks = [mark for name in (DONE, UNFINISHED) if (mark := environment / name).is_file()]
    if not marks or environment.is_symlink():
        return
    with contextlib.suppress(OSError):
        for path in environment.iterdir():
            if path.is_dir() and not path.is_symlink():
                shutil.rmtree(path, ignore_errors=True)
            elif path not in marks:
                path.unlink()
        if set(environment.iterdir()) == set(marks):
            shutil.rmtree(environment)


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__.split("\n\n")[0])
    parser.add_argument("--source", type=Path, required=True, help="folder with pyproject.toml")
    parser.add_argument("--folder", type=Path, required=True, help=f"where {NAME} is made")
    parser.add_argument("--python", required=True, help="the Python that makes the environment")
    parser.add_argument("--build", choices=("cpu", "cuda"), default="cpu")
    options = parser.parse_args()
    options.folder, options.source = options.folder.absolute(), options.source.absolute()
    options.python = whole_path(options.python)
    programs = ProgramRunner()
    try:
        install(options, programs)
        return 0
    except Cancelled:
        code, message, hint = CANCELLED, "The installation was cancelled.", ""
    except InstallError as error:
        code, message, hint = 1, error.message, error.hint
    except OSError as error:
        code, message = 1, f"{error.filename or options.folder}: {error.strerror or error}."
        hint = "Choose another folder, or free some space."
    environment = options.folder / NAME
    with contextlib.suppress(OSError):
        bring_back(environment)
    emit("error", code=code, message=message, hint=hint)
    return code


if __name__ == "__main__":
    sys.exit(main())
