"""The command line as a process: exit codes, the two streams, stopping."""

from __future__ import annotations

import json
import subprocess
import sys

import pytest

from blender_nep.cli import main
from blender_nep.command_line import parser

LIMIT = 120


def blender_nep(*arguments, **keywords):
    command = [sys.executable, "-m", "blender_nep", *map(str, arguments)]
    return subprocess.run(command, capture_output=True, text=True, timeout=LIMIT, **keywords)


@pytest.mark.parametrize("command", [[], ["info"], ["cameras"], ["reconstruct"], ["batch"], ["materials"], ["gallery"]])
def test_help_documents_exit_codes(command, capsys):
    with pytest.raises(SystemExit) as ended:
        main([*command, "--help"])
    text = capsys.readouterr().out
    assert ended.value.code == 0
    for code in (*range(8), 9):
        assert f"\n  {code}  " in text


@pytest.mark.parametrize(
    "arguments",
    [
        [],
        ["paint"],
        ["reconstruct", "x"],
        ["reconstruct", "x", "--out", "y", "--preset", "best"],
        ["reconstruct", "x", "--out", ""],
        ["reconstruct", "", "--out", "y"],
        ["batch", "x", "--out", ""],
        ["cameras", "x", "--out", ""],
        ["info", "x", "--picture", ""],
        ["materials", "", "--reset"],
        ["gallery", ""],
        ["reconstruct", "x", "--out", "y", "--seed", "-1"],
        ["reconstruct", "x", "--out", "y", "--threads", "0"],
        ["reconstruct", "x", "--out", "y", "--masks", "some"],
        ["reconstruct", "x", "--out", "y", "--object-center", "0", "0", "0"],
        ["reconstruct", "x", "--out", "y", "--object-radius", "1"],
        ["reconstruct", "x", "--out", "y", "--object-center", "0", "0", "--object-radius", "1"],
        ["batch", "x"],
        ["batch", "x", "--out", "y", "--workers", "0"],
        ["batch", "x", "--out", "y", "--ship"],
        ["reconstruct", "x", "--out", "y", "--object-center", "0", "-0.5", "nan", "--object-radius", "1"],
        ["reconstruct", "x", "--out", "y", "--object-center", "0", "-0.5", "1", "--object-radius", "0"],
    ],
)
def test_wrong_arguments_are_code_2(arguments, capsys):
    with pytest.raises(SystemExit) as ended:
        main(arguments)
    assert ended.value.code == 2 and "usage:" in capsys.readouterr().err


@pytest.mark.parametrize("number", ["-0.5", "-1e-05", "-4.4E-08", "-.5", "-2e+1"])
def test_coordinates_of_a_report_can_be_given_again(number):
    arguments = ["reconstruct", "x", "--out", "y", "--object-center", "0", number, "1", "--object-radius", "1"]
    assert parser().parse_args(arguments).object_center == [0, float(number), 1]


def test_info_for_people_and_programs(make_capture, capsys):
    folder = make_capture(masks=True).folder
    assert main(["info", str(folder)]) == 0
    assert "6 photos (exr), 24 x 24 pixels" in capsys.readouterr().out
    assert main(["info", str(folder), "--json"]) == 0
    assert json.loads(capsys.readouterr().out)["photos"] == 6


def test_info_of_a_bad_capture(make_capture, capsys):
    tiny = make_capture()
    (tiny.folder / "images/000.exr").write_bytes(b"no photo")
    assert main(["info", str(tiny.folder), "--json"]) == 3
    out, err = capsys.readouterr()
    told = json.loads(out)["error"]
    assert told["code"] == 3 and told["name"] == "capture" and "000.exr" in err


def test_events_alone_are_on_stdout(tmp_path):
    ended = blender_nep("reconstruct", tmp_path, "--out", tmp_path / "asset")
    events = [json.loads(line) for line in ended.stdout.splitlines()]
    assert ended.returncode == 3 and events[-1]["event"] == "error" and events[-1]["code"] == 3
    assert ended.stderr.count("error:") == 1 and "Traceback" not in ended.stderr


def test_stray_prints_do_not_break_the_protocol():
    script = (
        "import os, sys; from blender_nep.job.reporting.events import Events, open_protocol\n"
        "events = Events(open_protocol(), sys.stderr)\n"
        "print('a library prints'); os.write(1, b'so does C\\n'); events.emit('warning', message='x')\n"
    )
    ended = subprocess.run([sys.executable, "-c", script], capture_output=True, text=True, timeout=LIMIT)
    assert ended.returncode == 0 and ended.stdout == '{"event": "warning", "message": "x"}\n'
    assert "a library prints" in ended.stderr and "so does C" in ended.stderr


def test_a_process_that_watches_stdin_ends_cleanly(tmp_path):
    """A thread that still waits for standard input must not make the interpreter abort at its exit."""
    command = [sys.executable, "-m", "blender_nep", "reconstruct", str(tmp_path), "--out", str(tmp_path / "a")]
    process = subprocess.Popen(
        [*command, "--watch-stdin"], stdin=subprocess.PIPE, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True
    )
    try:
        assert process.wait(LIMIT) == 3
        assert "Fatal" not in process.stderr.read()
    finally:
        process.kill()
        for stream in (process.stdin, process.stdout, process.stderr):
            stream.close()
