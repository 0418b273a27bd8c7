"""Makes text of strangers harmless on a terminal: names of files may hold any character. No bpy in this file."""

import re

CONTROL = re.compile("[\\x00-\\x1f\\x7f-\\x9f\\u2028\\u2029\\u202a-\\u202e\\u2066-\\u2069]")
"""Line breaks, what moves a terminal's cursor or begins a command to it, and what turns the direction of writing."""


def one_line(text: object) -> str:
    """The text with control characters escaped as in Python's strings (a line break becomes \\\\n): it is one line.

    The engine has the same function in blender_nep/safety/printed_text.py, which Blender's Python does not import. A test
    compares the two.
    """
    return CONTROL.sub(lambda found: found[0].encode("unicode_escape").decode(), str(text))
