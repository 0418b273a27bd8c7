"""Which names a folder of an object may have: a second copy of blender_nep/safety/folder_names.py. No bpy in this file.

Blender's Python does not import that file. A test compares the two.
"""

LONGEST_BYTES = 200
"""Of a name in UTF-8. File systems take 255; the rest is left for what is made beside it."""
DEVICES = frozenset(
    ("con", "prn", "aux", "nul", "conin$", "conout$", *(f"{port}{n}" for port in ("com", "lpt") for n in "123456789¹²³"))
)
"""To Windows, a name that begins with one of these and a point, or is one of these, is a device"""
FORBIDDEN = frozenset('/\\:*?"<>|')
"""Characters that lead elsewhere, or that Windows does not take"""


def is_folder_name(name: object) -> bool:
    """Whether `name` names a folder beside others, and nothing else, on each operating system."""
    if not isinstance(name, str) or name.startswith(".") or name.endswith((".", " ")):
        return False
    if any(ord(letter) < 32 or ord(letter) == 127 or letter in FORBIDDEN for letter in name):
        return False
    try:
        size = len(name.encode())
    except UnicodeEncodeError:  # half a character
        return False
    return 0 < size <= LONGEST_BYTES and name.partition(".")[0].rstrip(" ").lower() not in DEVICES
