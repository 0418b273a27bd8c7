"""Measures the wall and CPU seconds of named sections, which may contain sections (`--profile`).

    with section("marching"):
        ...

A section costs a fraction of a microsecond while nothing is profiled. The result is also written as a flame graph in the
file format of https://www.speedscope.app. Its web page reads files locally; the profilers of Chrome and Firefox cannot read
them.
"""

from __future__ import annotations

import json
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager, nullcontext
from dataclasses import dataclass, field
from functools import wraps
from pathlib import Path

from blender_nep.files import write_text

_NOTHING = nullcontext()
_current: Profile | None = None


def section(name: str):
    """A context whose time is counted under `name`, within the sections that are open. Only for the job's main thread."""
    return _NOTHING if _current is None else _current.section(name)


def profiled(name: str):
    """A decorator: each call of the function is a `section` of this name."""

    def decorate(function):
        @wraps(function)
        def call(*arguments, **keywords):
            with section(name):
                return function(*arguments, **keywords)

        return call

    return decorate


@dataclass
class Part:
    """The calls and seconds of one section, and the sections within it."""

    name: str
    calls: int = 0
    wall: float = 0.0
    """Seconds of wall time of all calls"""
    cpu: float = 0.0
    """CPU seconds of all calls and all threads"""
    parts: dict[str, Part] = field(default_factory=dict)
    """The sections within this one, by name"""

    def rows(self, depth: int = 0) -> Iterator[tuple[int, Part]]:
        """(depth, part) of this section and of all sections within it, in the order in which they were first entered."""
        yield depth, self
        for part in self.parts.values():
            yield from part.rows(depth + 1)


class Profile:
    """Records the sections that are entered within its context `recording`."""

    def __init__(
        self,
        finish: Callable[[], None] | None = None,
        wall: Callable[[], float] = time.perf_counter,
        cpu: Callable[[], float] = time.process_time,
    ) -> None:
        """finish() waits for work that has begun but not ended, as on a GPU. `wall` and `cpu` are clocks in seconds."""
        self.whole = Part("job")
        self._open: list[tuple[Part, float, float]] = []
        self._finish, self._wall, self._cpu = finish, wall, cpu

    @contextmanager
    def recording(self) -> Iterator[Profile]:
        """Within this context, this profile records all sections."""
        global _current
        before, _current = _current, self
        try:
            with self._timed(self.whole):
                yield self
        finally:
            _current = before

    def section(self, name: str):
        """A context whose time is counted under `name` in this profile."""
        parts = self._open[-1][0].parts
        return self._timed(parts.setdefault(name, Part(name)))

    def _now(self) -> tuple[float, float]:
        if self._finish is not None:
            self._finish()
        return self._wall(), self._cpu()

    @contextmanager
    def _timed(self, part: Part) -> Iterator[None]:
        self._open.append((part, *self._now()))
        part.calls += 1
        try:
            yield
        finally:
            self._add(*self._open.pop())

    def _add(self, part: Part, wall: float, cpu: float) -> None:
        now = self._now()
        part.wall += now[0] - wall
        part.cpu += now[1] - cpu

    def _up_to_now(self) -> None:
        """Add the time that the open sections have taken so far."""
        for k, (part, wall, cpu) in enumerate(self._open):
            self._add(part, wall, cpu)
            self._open[k] = (part, *self._now())

    def report(self) -> list[dict]:
        """A row for each section so far; its inner sections follow it. The key `section` is the path of names."""
        self._up_to_now()
        found: list[dict] = []
        path: list[str] = []
        for depth, part in self.whole.rows():
            path[depth:] = [part.name]
            found.append(
                {
                    "section": " / ".join(path),
                    "calls": part.calls,
                    "wall_s": round(part.wall, 3),
                    "cpu_s": round(part.cpu, 3),
                }
            )
        return found

    def table(self) -> str:
        """A table for people: the sections, indented, with their seconds and their share of all CPU seconds."""
        lines = [f"{'section':44}{'calls':>8}{'wall s':>10}{'CPU s':>10}{'CPU %':>8}"]
        for depth, part in self.whole.rows():
            share = 100 * part.cpu / max(self.whole.cpu, 1e-9)
            lines.append(f"{'  ' * depth + part.name:44}{part.calls:8d}{part.wall:10.2f}{part.cpu:10.2f}{share:8.1f}")
        return "\n".join(lines)

    def write(self, path: Path) -> None:
        """Write two flame graphs for speedscope, one of wall seconds and one of CPU seconds. Raises OutputError."""
        text = json.dumps(self._speedscope())
        write_text(path, text)

    def _speedscope(self) -> dict:
        names: dict[str, int] = {}
        stacks: list[list[int]] = []
        own: dict[str, list[float]] = {"wall": [], "cpu": []}
        path: list[int] = []
        for depth, part in self.whole.rows():
            path[depth:] = [names.setdefault(part.name, len(names))]
            stacks.append(list(path))
            for clock, weights in own.items():
                inner = sum(getattr(p, clock) for p in part.parts.values())
                weights.append(max(0.0, getattr(part, clock) - inner))
        profiles = [
            {
                "type": "sampled",
                "name": f"{clock} seconds",
                "unit": "seconds",
                "startValue": 0,
                "endValue": sum(weights),
                "samples": stacks,
                "weights": weights,
            }
            for clock, weights in own.items()
        ]
        return {
            "$schema": "https://www.speedscope.app/file-format-schema.json",
            "name": "blender-nep reconstruct",
            "shared": {"frames": [{"name": name} for name in names]},
            "profiles": profiles,
        }
