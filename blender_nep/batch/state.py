"""What is known of all objects of a batch, and the file batch.json that holds it."""

from __future__ import annotations

import dataclasses
import json
from dataclasses import dataclass, field
from datetime import UTC, datetime
from pathlib import Path
from typing import Any

import blender_nep
from blender_nep.batch.captures import FoundCapture
from blender_nep.batch.names import object_name
from blender_nep.batch.settings import BatchSettings
from blender_nep.errors import UsageError
from blender_nep.files import jsonable, write_text
from blender_nep.safety.folder_names import is_folder_name
from blender_nep.safety.plain_files import read_json

FILE = "batch.json"
FORMAT = 1
WAITING, RUNNING, DONE, FAILED, STOPPED = "waiting", "running", "done", "failed", "stopped"


def now() -> str:
    """The time as text in ISO 8601, in UTC, to the second."""
    return datetime.now(UTC).isoformat(timespec="seconds")


@dataclass
class ObjectState:
    """One object, as batch.json has it. Its asset is in the folder `name`."""

    name: str
    capture: str
    """The absolute path of the capture, or of the folder with photos"""
    photos_alone: bool = False
    size: dict[str, int] | None = None
    """{"photos", "pixels"}; None: not known yet, or the capture cannot be read"""
    state: str = WAITING
    attempts: int = 0
    """How often a job was started for it, in all starts of the batch"""
    stage: str | None = None
    fraction: float = 0.0
    eta_s: float | None = None
    seconds: float = 0.0
    """Wall time of all attempts"""
    cpu_seconds: float = 0.0
    peak_memory_mb: float = 0.0
    promised_memory_mb: float | None = None
    threads: int | None = None
    worker: str | None = None
    warnings: list[dict] = field(default_factory=list)
    error: dict | None = None

    def to_dict(self) -> dict[str, Any]:
        """The plain values for batch.json, with short numbers."""
        numbers = {name: round(getattr(self, name), 1) for name in ("seconds", "cpu_seconds", "peak_memory_mb")}
        # The fields are listed one by one, because dataclasses.asdict copies deeply: 10 times slower with 10,000 objects.
        plain = {part.name: getattr(self, part.name) for part in dataclasses.fields(self)}
        return plain | numbers | {"fraction": round(self.fraction, 4)}

    def interrupt(self) -> None:
        """Note that its job has ended although nobody has seen how. The next start that names it goes on."""
        self.state, self.stage, self.eta_s = STOPPED, None, None

    @classmethod
    def from_dict(cls, told: dict[str, Any]) -> ObjectState:
        """The inverse of `told`. Keys that this version does not know are passed over."""
        known = {part.name for part in dataclasses.fields(cls)}
        return cls(**{key: value for key, value in told.items() if key in known})


@dataclass
class BatchState:
    """All objects of a batch."""

    identity: dict[str, object]
    arguments: dict[str, object] = field(default_factory=dict)
    started: str = field(default_factory=now)
    machine: dict[str, float] = field(default_factory=dict)
    """`workers`, `cores` and `memory_mb` of this start"""
    objects: list[ObjectState] = field(default_factory=list)

    def take(self, captures: list[FoundCapture]) -> list[ObjectState]:
        """The objects of these captures. A capture that is new gets a name; a known one keeps its name and what was done.

        The cameras of a folder of photos may have been found since, by its user.
        """
        known = {one.capture: one for one in self.objects}
        names = {one.name.lower() for one in self.objects}
        for capture in captures:
            if str(capture.path) not in known:
                name = object_name(capture.path, names)
                known[str(capture.path)] = ObjectState(name, str(capture.path), capture.photos_alone)
                self.objects.append(known[str(capture.path)])
            one = known[str(capture.path)]
            if one.state != DONE and one.photos_alone != capture.photos_alone:
                one.photos_alone, one.size = capture.photos_alone, None
        return [known[str(capture.path)] for capture in captures]

    def holds_only(self, captures: list[FoundCapture]) -> bool:
        """Whether all objects are of these captures."""
        return {one.capture for one in self.objects} <= {str(capture.path) for capture in captures}

    def start_again(self, captures: list[FoundCapture]) -> None:
        """Forget what was done for these captures. Their objects keep their names."""
        named = {str(capture.path) for capture in captures}
        for number, one in enumerate(self.objects):
            if one.capture in named:
                self.objects[number] = ObjectState(one.name, one.capture, one.photos_alone)

    def write(self, folder: Path) -> None:
        """Write batch.json. Raises OutputError."""
        content = {
            "format": FORMAT,
            "version": blender_nep.__version__,
            "preset": self.identity["preset"],
            "arguments": self.arguments,
            "started": self.started,
            "updated": now(),
            **self.machine,
            "objects": [one.to_dict() for one in self.objects],
        }
        write_text(folder / FILE, json.dumps(jsonable(content)))


def is_batch(folder: Path) -> bool:
    """Whether the folder holds a batch.json that has our keys, of whatever version."""
    path = folder / FILE
    try:
        content = read_json(path) if path.is_file() else None
    except (OSError, ValueError):
        return False
    return isinstance(content, dict) and {"format", "preset", "objects"} <= content.keys()


def read_state(folder: Path) -> BatchState | None:
    """The state in batch.json; None if there is no such file.

    Raises UsageError where the file is damaged or of another version, or where it names folders elsewhere.
    """
    path = folder / FILE
    if not path.is_file():
        return None
    hint = "Choose another --out, or name all captures and start again with --overwrite."
    try:
        content = read_json(path)
        if content["format"] != FORMAT:
            message = f"{path} is of another version of blender_nep"
            raise UsageError(message, hint, "usage.other_version", folder=folder)
        arguments = dict(content["arguments"])
        identity = {"preset": content["preset"], **{key: arguments[key] for key in ("masks", "metal", "seed")}}
        identity |= {"faces": arguments.get("faces"), "all_photos": arguments.get("all_photos", False)}
        identity["turntable"] = arguments.get("turntable", "auto")
        objects = [ObjectState.from_dict(told) for told in content["objects"]]
        _check_names(path, [one.name for one in objects])
        return BatchState(identity, arguments, content["started"], objects=objects)
    except (OSError, ValueError, KeyError, TypeError) as error:
        raise UsageError(f"{path} is damaged", hint, "usage.batch_damaged", path=path) from error


def _check_names(path: Path, names: list[str]) -> None:
    """Raises UsageError where a name is none of a folder in the batch's folder, or where two objects share one."""
    taken: set[str] = set()
    for name in names:
        if not is_folder_name(name) or name.lower() in taken:
            raise UsageError(
                f"{path} calls an object {name!r}: that is no name of a folder of its own",
                "Somebody has changed the file. Choose another --out.",
                "usage.object_name",
                path=path,
                object=name,
            )
        taken.add(name.lower())


def captures_before(folder: Path) -> list[FoundCapture]:
    """The captures of the batch in `folder`; none if there is no batch. Raises UsageError as `read_state`."""
    state = read_state(folder)
    return [] if state is None else [FoundCapture(Path(one.capture), one.photos_alone) for one in state.objects]


def refuse_other_batch(folder: Path, before: BatchState, settings: BatchSettings) -> None:
    """Raises UsageError when the batch in `folder` had other settings than those that are asked for."""
    wanted = settings.identity()
    different = [name for name in wanted if before.identity.get(name) != wanted[name]]
    if different:
        which = ", ".join(f"--{name.replace('_', '-')} {before.identity.get(name)}" for name in different)
        raise UsageError(
            f"the batch in {folder} was started with {which}",
            "Give the same options as then, choose another --out, or name all captures and start again with --overwrite.",
            "usage.other_batch",
            folder=folder,
            different=different,
        )
