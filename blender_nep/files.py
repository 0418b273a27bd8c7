"""Writes files so that there is always the old file or the new file, and never half a file, and follows no link.

This holds when the process is killed, when the disk is full, and when a permission is missing. If the operating system
refuses to write, the error becomes an OutputError with a hint.
"""

from __future__ import annotations

import errno
import math
import os
import time
from collections.abc import Callable, Iterable, Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

from blender_nep.errors import OutputError

_WINDOWS = os.name == "nt"
_TRIES, _PAUSE_S = 20, 0.05
"""How often a file is replaced while another program reads the old one, and the seconds between"""


def write_atomically(path: Path, write: Callable[[Path], object]) -> None:
    """Call write(temporary path), flush that file to the disk, and rename it to `path`. Raises OutputError.

    Where `path` is a link, the file takes the place of the link, and what the link leads to stays as it is.
    """
    temporary = path.with_name(f".{path.name}.{os.getpid()}.tmp")
    with output_errors(path):
        try:
            temporary.unlink(missing_ok=True)  # a link of a stranger may be there
            os.close(os.open(temporary, os.O_WRONLY | os.O_CREAT | os.O_EXCL, 0o666))
            write(temporary)
            with open(temporary, "rb+") as file:
                os.fsync(file.fileno())
            _replace(temporary, path)
        finally:
            temporary.unlink(missing_ok=True)


def _replace(temporary: Path, path: Path) -> None:
    """Rename `temporary` to `path`. Windows refuses that for the instant in which another program reads the old file."""
    for attempt in range(_TRIES):
        try:
            return os.replace(temporary, path)
        except PermissionError:
            if not _WINDOWS or attempt == _TRIES - 1:
                raise
            time.sleep(_PAUSE_S)


def write_text(path: Path, text: str) -> None:
    """Write a text file by `write_atomically`. It is UTF-8; names of files that are not are escaped. Raises OutputError."""
    write_atomically(path, lambda temporary: temporary.write_bytes(text.encode("utf-8", "backslashreplace")))


def refuse_links(folder: Path, names: Iterable[str]) -> None:
    """Raises OutputError where one of these files and folders in `folder` is a link. Missing ones are fine.

    A shelf or an asset from a stranger may hold links to files of the user. `folder` itself may be a link: the user has
    named it.
    """
    for name in names:
        if is_link(folder / name):
            raise _link_error(folder / name)


def is_link(path: Path) -> bool:
    """Whether the path is a symbolic link, or a junction of Windows."""
    try:
        os.readlink(path)
        return True
    except (OSError, ValueError):
        return False


def open_in_place(path: Path, flags: int) -> int:
    """`os.open` of a file that is not replaced, such as a log. Raises OutputError for a link, which it does not follow.

    A pipe without a reader is an error, too, and not a wait for ever.
    """
    with output_errors(path):
        refuse_links(path.parent, [path.name])
        guards = (getattr(os, name, 0) for name in ("O_NOFOLLOW", "O_NONBLOCK", "O_BINARY"))
        return os.open(path, flags | sum(guards), 0o666)


def _link_error(path: Path) -> OutputError:
    message = f"{path} is a link, and nothing is written through a link"
    return OutputError(message, "Remove the link, or choose another --out.", "output.is_a_link", path=path)


@contextmanager
def output_errors(path: Path) -> Iterator[None]:
    """A context that turns the operating system's errors while writing `path` into OutputError."""
    try:
        yield
    except OSError as error:
        raise output_error(path, error) from error
    except RuntimeError as error:  # torch's own writer raises RuntimeError if the disk is full
        if "PytorchStreamWriter" in str(error) or "unexpected pos" in str(error):
            raise output_error(path, OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))) from error
        raise


def output_error(path: Path, error: OSError) -> OutputError:
    """The OutputError for an OSError that was raised while writing `path`."""
    reason = error.strerror or str(error)
    if error.errno in (errno.ENOSPC, errno.EDQUOT):
        hint = "Free some space, then go on with --resume."
        return OutputError(f"the disk is full: {path} cannot be written", hint, "output.disk_full", path=path)
    if error.errno in (errno.EACCES, errno.EPERM, errno.EROFS):
        hint = "Choose another --out, or change its permissions."
        return OutputError(f"{path} may not be written ({reason})", hint, "output.not_permitted", path=path, reason=reason)
    return OutputError(f"{path} cannot be written ({reason})", "Choose another --out.", path=path, reason=reason)


def jsonable(value: Any) -> Any:
    """The value as JSON can hold it: containers of strings, numbers and null. NaN and infinity become null."""
    if isinstance(value, dict):
        return {str(k): jsonable(v) for k, v in value.items()}
    if isinstance(value, list | tuple | set):
        return [jsonable(v) for v in value]
    if hasattr(value, "tolist"):  # numpy and torch
        return jsonable(value.tolist())
    if isinstance(value, Path):
        return str(value)
    return None if isinstance(value, float) and not math.isfinite(value) else value
