"""Texts that are wider than a sidebar."""

LETTER = 8.5  # pixels of an average letter at a scale of 1


def say(layout, context, text: str, icon: str = "NONE") -> None:
    """A text in as many rows as the sidebar's width asks for; the icon stands before the first.

    Nothing for an empty text."""
    width = (context.region.width if context.region else 280) / context.preferences.system.ui_scale
    column = layout.column(align=True)
    column.scale_y = 0.8
    for index, line in enumerate(wrapped(text, int(width / LETTER))):
        column.label(text=line, icon=icon if index == 0 else "BLANK1" if icon != "NONE" else "NONE")


def wrapped(text: str, letters: int) -> list[str]:
    """The words of a text in lines of at most `letters`; longer words, as paths are, are cut."""
    letters, lines = max(letters, 12), []
    for paragraph in text.splitlines():
        line = ""
        for word in paragraph.split():
            while len(word) > letters:
                if line:
                    lines.append(line)
                    line = ""
                lines.append(word[:letters])
                word = word[letters:]
            if line and len(line) + 1 + len(word) > letters:
                lines.append(line)
                line = word
            else:
                line = f"{line} {word}".strip()
        if line:
            lines.append(line)
    return lines
