"""Texts that are wider than a sidebar."""

from collections.abc import Callable

import blf

MARGINS = 64  # of a panel in a sidebar, its tabs included, in pixels at a scale of 1
ICON = 20


def inner_width(context) -> float:
    """What a panel of this region has for its content, in pixels at a scale of 1."""
    width = context.region.width if context.region else 280
    return width / context.preferences.system.ui_scale - MARGINS


def say(layout, context, text: str, icon: str = "NONE") -> None:
    """A text in as many rows as the sidebar's width asks for; the icon stands before the first.

    Nothing for an empty text."""
    blf.size(0, context.preferences.ui_styles[0].widget.points)
    column = layout.column(align=True)
    column.scale_y = 0.8
    room = inner_width(context) - (ICON if icon != "NONE" else 0)
    for index, line in enumerate(wrapped(text, room, lambda words: blf.dimensions(0, words)[0])):
        column.label(text=line, icon=icon if index == 0 else "BLANK1" if icon != "NONE" else "NONE")


def wrapped(text: str, limit: float, width: Callable[[str], float] = len) -> list[str]:
    """The words of a text in lines of at most `limit`, as `width` measures; longer words, as paths are, are cut."""
    limit, lines = max(limit, width("m" * 12)), []
    for paragraph in text.splitlines():
        line = ""
        for word in paragraph.split():
            if line and width(f"{line} {word}") > limit:
                lines.append(line)
                line = ""
            while width(word) > limit:
                cut = next(count for count in range(len(word), 0, -1) if width(word[:count]) <= limit)
                lines.append(word[:cut])
                word = word[cut:]
            line = f"{line} {word}".strip()
        if line:
            lines.append(line)
    return lines
