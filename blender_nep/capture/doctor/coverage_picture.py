"""Draws from which directions the photos show the object: `blender-nep info CAPTURE --picture FILE.png`.

Two discs show the upper and the lower half of all directions, in Lambert's azimuthal equal-area projection: equal areas of
a disc are equally many directions. The middle of a disc is straight above or below; its edge is the horizon. Azimuth runs
alike in both discs. Shading tells how far a direction is from the nearest photo.
"""

from __future__ import annotations

import math
import os
from pathlib import Path

import numpy as np
from PIL import Image, ImageDraw, ImageFont
from PIL.PngImagePlugin import PngInfo

from blender_nep.capture.doctor.coverage import Coverage, Hole
from blender_nep.errors import OutputError, UsageError
from blender_nep.files import write_atomically

SIZE = (1200, 760)
"""Width and height of the picture in pixels"""
RADIUS = 260
"""Radius of a disc in pixels"""
MIDDLES = ((310, 360), (890, 360))
"""Middles of the discs in pixels: the upper half of the directions, and the lower half"""
LIMITS = (15.0, 30.0, 45.0, 60.0, 90.0)
"""Degrees to the nearest photo at which the shade changes"""
SHADES = ((238, 245, 229), (200, 224, 172), (243, 214, 115), (238, 155, 59), (207, 74, 52), (125, 21, 48))
"""sRGB of the shades, from near to far; each is darker than the one before"""
MOST_NAMES = 9
"""At most this many photos of a half have their names in the picture."""
_INK, _PAPER, _GRAY, _DOT, _HOLE = (30, 30, 30), (255, 255, 255), (120, 120, 120), (20, 60, 140), (0, 0, 0)
_MARK, _BEGIN = b"tEXtSoftware\0blender-nep info", 1000
"""What shows that a picture is ours, and in how many of its first bytes it stands"""
_FINE = 3
"""Dots and lines are drawn this many times larger, so that their edges become smooth."""


def place(direction: np.ndarray) -> tuple[float, float]:
    """Column and row in the picture, in pixels, of a unit direction [3] (upright frame, as in Coverage)."""
    x, y, z = (float(value) for value in direction)
    across = math.hypot(x, y)
    away = RADIUS * math.sqrt(max(1 - abs(z), 0.0)) / across if across > 0 else 0.0
    column, row = MIDDLES[z < 0]
    return column + away * x, row - away * y


def shade(degrees: np.ndarray) -> np.ndarray:
    """The shades [n, 3] uint8 (sRGB) of angles [n] in degrees to the nearest photo."""
    return np.array(SHADES, np.uint8)[np.digitize(degrees, LIMITS)]


def draw_coverage(coverage: Coverage) -> Image.Image:
    """The picture, of SIZE, sRGB."""
    pixels = np.full((SIZE[1], SIZE[0], 3), 255, np.uint8)
    row, column = np.mgrid[: SIZE[1], : SIZE[0]] + 0.5
    for sign, (middle_column, middle_row) in zip((1, -1), MIDDLES, strict=True):
        x, y = (column - middle_column) / RADIUS, (middle_row - row) / RADIUS
        inside = x**2 + y**2 <= 1
        square = (x**2 + y**2)[inside]  # 1 - |z|, so that equal areas are equal solid angles
        stretch = np.sqrt(2 - square)
        direction = np.stack([x[inside] * stretch, y[inside] * stretch, sign * (1 - square)], 1)
        pixels[inside] = shade(coverage.angles(direction))
    hole = coverage.largest_hole()
    picture = _with_marks(Image.fromarray(pixels), coverage, hole)
    _write_texts(picture, coverage, hole)
    return picture


def refuse_foreign_picture(path: Path) -> None:
    """Raises UsageError where there is a file `path` that `write_picture` has not written: it may be a photo."""
    if os.path.lexists(path) and not _is_ours(path):
        hint = "Choose another file for --picture."
        raise UsageError(f"{path} is there already, and is no such picture", hint, "usage.picture_exists", path=path)


def _is_ours(path: Path) -> bool:
    try:
        with open(path, "rb") as file:
            return _MARK in file.read(_BEGIN)
    except OSError:
        return False


def write_picture(coverage: Coverage, path: Path) -> None:
    """Write the picture as PNG, with a mark by which it may be replaced later. Raises OutputError."""
    marked = PngInfo()
    marked.add_text("Software", "blender-nep info")
    try:
        write_atomically(path, lambda temporary: draw_coverage(coverage).save(temporary, format="PNG", pnginfo=marked))
    except OutputError as error:
        hint = "Choose another file for --picture."
        raise OutputError(error.message, hint, error.name, **error.values) from error


def _with_marks(picture: Image.Image, coverage: Coverage, hole: Hole) -> Image.Image:
    """The picture with circles of equal elevation, a dot for each photo, and a ring at the largest hole."""
    fine = picture.resize((_FINE * SIZE[0], _FINE * SIZE[1]), Image.Resampling.NEAREST)
    draw = ImageDraw.Draw(fine)

    def circle(middle: tuple[float, float], radius: float, width: float, outline, fill=None) -> None:
        (column, row), r = (_FINE * middle[0], _FINE * middle[1]), _FINE * radius
        draw.ellipse((column - r, row - r, column + r, row + r), fill, outline, max(1, round(_FINE * width)))

    for middle in MIDDLES:
        for elevation in (30, 60):
            circle(middle, RADIUS * math.sqrt(1 - math.sin(math.radians(elevation))), 0.7, _GRAY)
        circle(middle, RADIUS, 1.5, _INK)
    for direction in coverage.directions:
        circle(place(direction), 5, 1, _PAPER, _DOT)
    circle(place(hole.direction), 10, 4, _PAPER)
    circle(place(hole.direction), 9, 2, _HOLE)
    return fine.resize(SIZE, Image.Resampling.BOX)


def _write_texts(picture: Image.Image, coverage: Coverage, hole: Hole) -> None:
    draw = ImageDraw.Draw(picture)
    large, normal, small = (ImageFont.load_default(size) for size in (22, 16, 13))
    taken: list[tuple[float, float, float, float]] = []

    def write(column: float, row: float, text: str, font, anchor: str = "mm") -> bool:
        """Write the text unless it would cover another one or leave the picture."""
        left, top, right, bottom = draw.textbbox((column, row), text, font, anchor, stroke_width=2)
        free = all(right < a or c < left or bottom < b or d < top for a, b, c, d in taken)
        if free and left >= 0 and top >= 0 and right <= SIZE[0] and bottom <= SIZE[1]:
            draw.text((column, row), text, _INK, font, anchor, stroke_width=2, stroke_fill=_PAPER)
            taken.append((left, top, right, bottom))
            return True
        return False

    up = "up is the z axis" if coverage.z_up else "up as in the photos, not the z axis"
    covered = f"{coverage.share:.0%} of all directions lie within 30 degrees of a photo; {up}"
    write(SIZE[0] / 2, 26, covered, normal)
    for (column, row), title in zip(MIDDLES, ("photos from above", "photos from below"), strict=True):
        write(column, row - RADIUS - 48, title, large)
        for azimuth in range(0, 360, 90):
            angle = math.radians(azimuth)
            away = RADIUS + (22 if azimuth % 180 == 0 else 14)
            write(column + away * math.cos(angle), row - away * math.sin(angle), f"{azimuth}°", small)
    column_of_hole, row_of_hole = place(hole.direction)
    write(column_of_hole + 14, row_of_hole, f"{hole.degrees:.0f}°", normal, "lm")
    for upper in (True, False):
        _write_names(coverage, upper, lambda column, row, text: write(column, row, text, small, "lm"))
    _write_legend(draw, normal)


def _write_names(coverage: Coverage, upper: bool, write) -> None:
    """Write up to MOST_NAMES names of the photos of one half, those that lie farthest apart."""
    half = np.flatnonzero((coverage.directions[:, 2] >= 0) == upper)
    distance = np.full(len(half), np.inf)
    for _ in range(min(MOST_NAMES, len(half))):
        chosen = half[int(distance.argmax())]
        direction = coverage.directions[chosen]
        column, row = place(direction)
        write(column + 8, row, _short(coverage.names[chosen]))
        distance = np.minimum(distance, np.linalg.norm(coverage.directions[half] - direction, axis=1))


def _short(name: str, most: int = 14) -> str:
    """The end of a long name, where the names of a camera's photos differ."""
    return name if len(name) <= most else ".." + name[2 - most :]


def _write_legend(draw: ImageDraw.ImageDraw, font) -> None:
    row = SIZE[1] - 66
    draw.text((60, row), "Angle to the nearest photo:", _INK, font, "lm")
    column = 290
    for low, high, color in zip((0, *LIMITS), (*LIMITS, None), SHADES, strict=True):
        draw.rectangle((column, row - 11, column + 28, row + 11), color, _GRAY)
        text = f"over {low:.0f}°" if high is None else f"{low:.0f} to {high:.0f}°"
        draw.text((column + 36, row), text, _INK, font, "lm")
        column += 140
    row += 36
    draw.ellipse((66, row - 5, 76, row + 5), _DOT)
    draw.text((88, row), "a photo", _INK, font, "lm")
    draw.ellipse((200, row - 9, 218, row + 9), None, _HOLE, 2)
    draw.text((230, row), "the largest hole", _INK, font, "lm")
    draw.text((400, row), "middle of a disc: straight above or below; edge: the horizon; numbers: azimuth", _INK, font, "lm")
