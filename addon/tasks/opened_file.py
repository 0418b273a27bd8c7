"""Which .blend file is open, for work that ends later: its result belongs to the file in which it was asked for.

The path does not say it. Save As changes the path of a file, and files that were never saved have none.
"""

from bpy.app.handlers import persistent

_files_opened = 0


def opened_file() -> int:
    """A number that is another one after each file that was opened, and after File > New."""
    return _files_opened


@persistent
def on_file_loaded(*_: object) -> None:
    """Blender's handler after another file was opened."""
    global _files_opened
    _files_opened += 1
