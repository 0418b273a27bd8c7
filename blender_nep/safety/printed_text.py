"""Makes text of strangers harmless in a log and on a terminal: names of photos and folders may hold any character."""

from __future__ import annotations

import re

_CONTROL = re.compile("[\\x00-\\x1f\\x7f-\\x9f\\u2028\\u2029\\u202a-\\u202e\\u2066-\\u2069]")
"""Line breaks, what moves a terminal's cursor or begins a command to it, and what turns the direction of writing"""


def one_line(text: object) -> str:
    """The text with control characters escaped as in Python's strings (a line break becomes \\\\n): it is one line.

    Blender's Python has the same function in `backend/engine/printed_text.py`.
    """
    return _CONTROL.sub(lambda found: found[0].encode("unicode_escape").decode(), str(text))
