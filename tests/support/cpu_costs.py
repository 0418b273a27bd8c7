"""Measures the CPU seconds of every test, for `pytest --cpu-costs=FILE`.

CPU seconds say what a test costs also where other programs take most of the machine. They contain the fixtures that a test
is the first to ask for, the kernels that it is the first to compile, and the processes that it starts.
"""

from __future__ import annotations

import resource
import time
from collections import Counter
from collections.abc import Generator
from pathlib import Path

import psutil
import pytest

_SHOWN = 40


def measure(config: pytest.Config) -> None:
    """Register the plugin. FILE becomes a table of seconds and tests; the tests of all workers are added to it."""
    file = Path(config.getoption("--cpu-costs")).resolve()
    if not hasattr(config, "workerinput"):  # the process that starts the workers
        file.write_text("", encoding="utf-8")
    config.pluginmanager.register(CpuCosts(file))


class CpuCosts:
    """The plugin."""

    def __init__(self, file: Path) -> None:
        self.file = file

    @pytest.hookimpl(wrapper=True, tryfirst=True)
    def pytest_runtest_protocol(self, item: pytest.Item) -> Generator[None, object, object]:
        """Add a line for one test."""
        before = cpu_seconds()
        result = yield
        with self.file.open("a", encoding="utf-8") as lines:
            lines.write(f"{cpu_seconds() - before:.3f}\t{item.nodeid}\n")
        return result

    def pytest_terminal_summary(self, terminalreporter: pytest.TerminalReporter) -> None:
        """Show the costliest files and tests."""
        rows = [line.split("\t", 1) for line in self.file.read_text(encoding="utf-8").splitlines()]
        tests = Counter({name: float(seconds) for seconds, name in rows})
        files: Counter[str] = Counter()
        for name, seconds in tests.items():
            files[name.partition("::")[0]] += seconds
        terminalreporter.section(f"{tests.total():.0f} CPU seconds in {len(tests)} tests")
        for counted in (files, tests):
            for name, seconds in counted.most_common(_SHOWN):
                terminalreporter.write_line(f"{seconds:8.1f}  {name}")


def cpu_seconds() -> float:
    """CPU seconds of this process, of those that it has waited for, and of those that run."""
    ended = resource.getrusage(resource.RUSAGE_CHILDREN)
    seconds = time.process_time() + ended.ru_utime + ended.ru_stime
    for child in psutil.Process().children(recursive=True):
        try:
            times = child.cpu_times()
        except psutil.Error:  # it has ended meanwhile, and is counted by the next test
            continue
        seconds += times.user + times.system + times.children_user + times.children_system
    return seconds
