"""The commands that render captures: an interrupt ends what they have started, and captures of another size are refused."""

import os
import signal
import subprocess
import sys
import time
from pathlib import Path

import psutil
import pytest

pytest.importorskip("fcntl", reason="the suite runs on POSIX systems")
import benchmarks.__main__ as command
from benchmarks.row_files import write_row
from benchmarks.suite.derived_captures import derive
from benchmarks.suite.fewer_views import with_fewer_views
from benchmarks.suite.harness import MADE_FROM, Ended
from support.paths import ROOT, SUZANNE_SMALL

RANDOM, RENDER = ("random", "--scenes", "1"), ("render", "shapes")
DEADLINE_S = 60


def with_document(words: tuple[str, ...], folder: Path) -> tuple[str, ...]:
    """The words of a command. `random` gets a document of its own to fill, because it removes its document's pictures."""
    if words == RENDER:
        return words
    document = folder / "random-scenes.md"
    document.write_text((ROOT / "docs" / "random-scenes.md").read_text(encoding="utf-8"), encoding="utf-8")
    return *words, "--write", str(document)


@pytest.mark.parametrize("words", [RENDER, RANDOM], ids=["render", "random"])
@pytest.mark.parametrize("number", [signal.SIGINT, signal.SIGTERM])
def test_an_interrupt_ends_the_render_and_what_it_started(number, words, tmp_path):
    """A shell script plays Blender. It starts a program of its own, and writes both process numbers."""
    blender, pids = tmp_path / "blender", tmp_path / "pids"
    blender.write_text(f"#!/bin/sh\nsleep 100 &\necho $$ $! > {pids}.part\nmv {pids}.part {pids}\nwait\n")
    blender.chmod(0o755)
    code = "import sys, benchmarks.__main__ as c; sys.executable = sys.argv[1]; sys.exit(c.main(sys.argv[2:]))"
    arguments = [sys.executable, "-c", code, blender, *with_document(words, tmp_path), "--out", tmp_path / "out"]
    running = subprocess.Popen(
        arguments, stderr=subprocess.PIPE, text=True, cwd=ROOT, start_new_session=True, preexec_fn=hear_interrupts
    )
    try:
        started = [
            psutil.Process(int(pid)) for pid in wait_for(lambda: pids.read_text().split() if pids.is_file() else None)
        ]
        os.kill(running.pid, number)
        said = running.communicate(timeout=DEADLINE_S)[1]
    finally:
        running.kill()  # where it did not end, it would go on after the test
    left = [one for one in psutil.wait_procs(started, timeout=5)[1] if one.status() != psutil.STATUS_ZOMBIE]
    for one in left:
        one.kill()
    assert not left and running.returncode == command.INTERRUPTED
    assert said.splitlines() == ["interrupted; the same command goes on"]


def hear_interrupts() -> None:
    """A shell that starts tests in the background lets them, and so their programs, ignore SIGINT."""
    signal.signal(signal.SIGINT, signal.SIG_DFL)


def wait_for(find):
    """What `find` returns as soon as it is something. Fails where that takes very long."""
    deadline = time.monotonic() + DEADLINE_S
    while not (found := find()):
        assert time.monotonic() < deadline
        time.sleep(0.05)
    return found


@pytest.mark.parametrize("words", [RENDER, RANDOM], ids=["render", "random"])
def test_captures_of_another_size_are_refused_before_rendering(words, tmp_path, monkeypatch, capsys):
    class FakeChildren:
        def run(self, *_):
            raise AssertionError("something is rendered")

    monkeypatch.setattr(command, "Children", FakeChildren)
    name = "box" if words == RENDER else "random_1"
    write_row(tmp_path / "captures" / name / "transforms.json", {"w": 64, "h": 64, "frames": []})
    arguments = [*with_document(words, tmp_path), "--out", str(tmp_path), "--size", "128"]
    assert command.main(arguments) == command.REFUSED
    assert f"{name} has photos that are 64 pixels wide, and 128 are asked for. Give --size 64" in capsys.readouterr().err


def test_captures_of_the_size_that_is_asked_for_are_kept(tmp_path, monkeypatch):
    class FakeChildren:
        def run(self, arguments, *_):
            rendered.append(arguments[-6])
            return Ended(0, 1.0, 1.0, 1.0, False)

    rendered: list[str] = []
    monkeypatch.setattr(command, "Children", FakeChildren)
    write_row(tmp_path / "captures" / "box" / "transforms.json", {"w": 64, "h": 64, "frames": []})
    assert command.main([*RENDER, "--out", str(tmp_path), "--size", "64"]) == 0 and rendered == ["suzanne"]


def distant_of_small(out: Path) -> Path:
    return derive(SUZANNE_SMALL, "distant", out)


def few_of_small(out: Path) -> Path:
    return with_fewer_views(SUZANNE_SMALL, 4, out)


@pytest.mark.slow
@pytest.mark.parametrize("make", [distant_of_small, few_of_small])
def test_a_capture_whose_making_was_cut_off_is_made_again(make, tmp_path, monkeypatch):
    """Only half of the file that is written last, whichever it is, reaches the disk."""
    written, whole = [], Path.write_text

    def cut_off(path: Path, text: str, *_, **__) -> None:
        written.append(path)
        whole(path, text[: len(text) // 2])
        raise KeyboardInterrupt

    with monkeypatch.context() as patch:
        patch.setattr(Path, "write_text", cut_off)
        patch.setattr(Path, "write_bytes", lambda path, data: cut_off(path, data.decode()))
        with pytest.raises(KeyboardInterrupt):
            make(tmp_path / "made")
    made = tmp_path / "made"
    assert written and not (made / "transforms.json").exists() and not (made / MADE_FROM).exists()
    make(made)
    stamp = (made / "transforms.json").stat().st_mtime_ns
    make(made)
    assert (made / "transforms.json").stat().st_mtime_ns == stamp, "it is not made twice"
