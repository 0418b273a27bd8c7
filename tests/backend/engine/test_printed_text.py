"""Names of a stranger do nothing to a terminal, and make no lines of their own. Both Pythons escape alike."""

import os
import unicodedata

import pytest

from backend.engine import printed_text
from backend.engine.results import job_files
from backend.engine.results.batch_file import ask_to_stop
from backend.engine.words import EngineMessage, error_words
from backend.headless.stop_requests import say
from blender_nep.safety.printed_text import one_line

HOSTILE, ESCAPED = "p\n\x1b[2J\x9b31m.png", "p\\n\\x1b[2J\\x9b31m.png"


def test_both_sides_escape_alike():
    for code in range(0x3000):
        found = printed_text.one_line(chr(code))
        assert found == one_line(chr(code)) and len(found.splitlines()) == 1
        assert all(unicodedata.category(char) != "Cc" for char in found)
        assert found == chr(code) or not chr(code).isprintable(), "text that is harmless stays as it is"
    assert printed_text.one_line("Größe 写真 \U0001f3fa é") == "Größe 写真 \U0001f3fa é"


def test_headless_scripts_say_lines(capsys):
    say(f"warning: {HOSTILE}", "second")
    assert capsys.readouterr().err == f"warning: {ESCAPED}\nsecond\n"


def test_the_panels_words_have_no_control_characters():
    """Blender prints what its operators report."""
    told = {"code": "capture.photos_blurred", "values": {"count": 1, "names": [HOSTILE]}, "message": HOSTILE}
    for said in (EngineMessage.of(told), EngineMessage.of({"message": HOSTILE}), EngineMessage.of(HOSTILE)):
        assert ESCAPED[1:] in said.words()
    message, _ = error_words("output.is_a_file", {"path": HOSTILE}, "", "")
    assert ESCAPED in message


def test_a_request_to_stop_makes_no_file_elsewhere(tmp_path):
    for link in ("stop", "batch.stop"):
        (tmp_path / link).symlink_to(tmp_path / "elsewhere")
    with pytest.raises(OSError):
        job_files.make_file(tmp_path / "stop")
    with pytest.raises(OSError):
        ask_to_stop(tmp_path)
    assert sorted(os.listdir(tmp_path)) == ["batch.stop", "stop"]
