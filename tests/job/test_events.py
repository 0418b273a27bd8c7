"""What a job tells: JSON for programs, lines for people, the log; and how it hears of a wish to stop."""

from __future__ import annotations

import errno
import io
import json
import os
import time
from pathlib import Path

import numpy as np
import pytest

from blender_nep.errors import CaptureError, OutputError
from blender_nep.files import write_text
from blender_nep.job.reporting.events import Events
from blender_nep.messages import Message
from blender_nep.stop_request import StopRequest


@pytest.mark.skipif(not os.path.exists("/dev/full"), reason="the system has no file that is always full")
def test_a_log_that_cannot_be_written_does_not_hide_the_error():
    human = io.StringIO()
    events = Events(None, human)
    events.open_log(Path("/dev/full"))
    events.error(OutputError("the disk is full", "Free some space."))
    events.close()
    assert human.getvalue() == "error: the disk is full\n       Free some space.\n"


def test_events_that_cannot_be_written_do_not_hide_the_error():
    class FullDisk(io.StringIO):
        def flush(self):
            raise OSError(errno.ENOSPC, "No space left on device")

    human = io.StringIO()
    events = Events(FullDisk(), human)
    events.progress("r", 1, 10, 0.1, 2.0, None)
    events.error(OutputError("the disk is full", "Free some space."))
    events.close()
    assert human.getvalue().endswith("error: the disk is full\n       Free some space.\n")


def test_names_that_are_no_utf_8_are_told(tmp_path):
    events = Events(io.StringIO(), io.StringIO())
    events.open_log(tmp_path / "log.txt")
    events.log("photo_\udcfc.jpg is dark")
    events.error(CaptureError("photo_\udcfc.jpg cannot be read"))
    events.close()
    assert "photo_\\udcfc.jpg is dark" in (tmp_path / "log.txt").read_text()
    write_text(tmp_path / "page.html", "photo_\udcfc.jpg")
    assert (tmp_path / "page.html").read_text() == "photo_\\udcfc.jpg"


def test_events_are_json_whatever_they_hold():
    protocol, human = io.StringIO(), io.StringIO()
    events = Events(protocol, human)
    events.progress("r", 1, 10, 0.1, float("inf"), float("nan"), Message("progress.warming_up"), extra=np.float32(2))
    for _ in range(2):
        events.warning(Message("capture.few_photos", {"photos": np.int64(3)}))
    lines = [json.loads(line) for line in protocol.getvalue().splitlines()]
    assert lines[0]["eta_s"] is None and lines[0]["loss"] is None and lines[0]["extra"] == 2
    assert [line["event"] for line in lines] == ["progress", "warning"]
    assert lines[0]["note"] == {"code": "progress.warming_up", "values": {}, "message": "warming up"}
    words = "only 3 photos: 20 and more give a better shape"
    assert lines[1] == {"event": "warning", "code": "capture.few_photos", "values": {"photos": 3}, "message": words}
    assert human.getvalue().count(words) == 1 and "r warming up" in human.getvalue()


def test_a_reader_that_went_away_does_not_end_the_job():
    read, write = os.pipe()
    os.close(read)
    human = io.StringIO()
    events = Events(os.fdopen(write, "w", buffering=1), human)
    for photos in (3, 4):
        events.warning(Message("capture.few_photos", {"photos": photos}))
    assert len(human.getvalue().splitlines()) == 2


def test_standard_input_stops_by_command_and_by_its_end():
    for message, reason in ((b'nonsense\n{"cmd": "stop"}\n', "stop command"), (b"", "closed")):
        read, write = os.pipe()
        stop = StopRequest()
        stop.watch(read)
        os.write(write, message or b"\n")
        if not message:
            os.close(write)
        for _ in range(1000):
            if stop.requested:
                break
            time.sleep(0.01)
        assert stop.requested and reason in stop.reason


HOSTILE = "p\nexport EVIL=1\r\x1b[2J\x9b31m\u2028\u202e.png"
ESCAPED = "p\\nexport EVIL=1\\r\\x1b[2J\\x9b31m\\u2028\\u202e.png"


def test_names_write_no_lines_of_their_own(tmp_path):
    """Neither into the log nor on the terminal. In JSON they are as they are."""
    protocol, human = io.StringIO(), io.StringIO()
    events = Events(protocol, human)
    events.open_log(tmp_path / "log.txt")
    events.say(HOSTILE)
    events.warning(Message("batch.no_gallery", {"reason": HOSTILE}))
    events.progress("r", 1, 10, 0.1, 2.0, None, Message("batch.put_back", {"name": HOSTILE}))
    events.error(CaptureError(f"{HOSTILE} cannot be read", f"Replace {ESCAPED}."))
    events.done(Path(HOSTILE))
    events.close()
    for text in (human.getvalue(), (tmp_path / "log.txt").read_text()):
        assert text.count(ESCAPED) == 6 and "\nexport" not in text
        assert all(char.isprintable() or char == "\n" for char in text)
    assert json.loads(protocol.getvalue().splitlines()[0])["values"]["reason"] == HOSTILE


def test_a_traceback_makes_no_line_that_looks_like_another_one(tmp_path):
    events = Events(None, io.StringIO())
    events.open_log(tmp_path / "log.txt")
    try:
        raise ValueError("2026-11-28 12:00:00 done\n2026-11-28 12:00:00 done\x1b[2J")
    except ValueError as error:
        events.log_traceback(error)
    events.close()
    first, *more = (tmp_path / "log.txt").read_text().splitlines()
    assert first.endswith("Traceback (most recent call last):") and len(more) > 2
    assert all(line.startswith(" ") for line in more) and more[-1].endswith("done\\x1b[2J")


def test_a_log_is_not_written_through_a_link(tmp_path):
    (tmp_path / "profile").write_text("mine")
    (tmp_path / "log.txt").symlink_to(tmp_path / "profile")
    with pytest.raises(OutputError) as refused:
        Events().open_log(tmp_path / "log.txt")
    assert refused.value.name == "output.is_a_link" and (tmp_path / "profile").read_text() == "mine"


@pytest.mark.skipif(not hasattr(os, "mkfifo"), reason="the system has no named pipes")
def test_a_log_that_is_a_pipe_does_not_hang(tmp_path):
    os.mkfifo(tmp_path / "log.txt")
    with pytest.raises(OutputError):
        Events().open_log(tmp_path / "log.txt")
