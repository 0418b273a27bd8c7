"""Lays out the sheet of a comparison: a grid of tiles with a title over each column, and a strip of tiles below the grid."""

from collections.abc import Sequence

import numpy as np

from .lettering import draw_text, shortened

HEADER, STRIP_HEADER, GAP = 58, 34, 6  # pixels
BACKGROUND, TEXT = 24 / 255, 232 / 255  # gray, sRGB-encoded
TITLE, SMALL = 17.0, 13.0  # text sizes, pixels


def strip_tile_size(columns: int, width: int, height: int, count: int) -> int:
    """The side, in pixels, of `count` square tiles in a strip.

    The strip is as wide as a row of `columns` tiles of width x height. The side is at most `height`.
    """
    return max(1, min((columns * (width + GAP) - count * GAP) // count, height))


def empty_tile(width: int, height: int, text: str) -> np.ndarray:
    """A tile [height,width,3] in the color of the sheet, with a text in its middle."""
    tile = np.full((height, width, 3), BACKGROUND)
    _write(tile, [(GAP, height / 2, SMALL, shortened(text, width - 2 * GAP, SMALL))])
    return tile


def in_cell(tile: np.ndarray, width: int, height: int) -> np.ndarray:
    """The tile in the middle of a cell [height,width,3] of the sheet's color, which is at least as large."""
    cell = np.full((height, width, 3), BACKGROUND)
    _paste(cell, tile, (height - tile.shape[0]) // 2, (width - tile.shape[1]) // 2)
    return cell


def draw_sheet(
    rows: list[list[np.ndarray]], titles: list[str], subtitle: str, strip: Sequence[np.ndarray] = (), strip_title: str = ""
) -> np.ndarray:
    """Draw the sheet [H,W,3] uint8.

    `rows` holds the tiles [h,w,3], which are sRGB-encoded 0..1 and all of one size. `titles` has a title for each column.
    `strip` holds square tiles that are shown in a row below, under `strip_title`.
    """
    height, width = rows[0][0].shape[:2]
    columns, grid = len(titles), HEADER + len(rows) * (height + GAP)
    below = STRIP_HEADER + len(strip[0]) + GAP if strip else 0
    sheet = np.full((grid + below, GAP + columns * (width + GAP), 3), BACKGROUND)
    for i, row in enumerate(rows):
        for j, tile in enumerate(row):
            _paste(sheet, tile, HEADER + i * (height + GAP), GAP + j * (width + GAP))
    for j, tile in enumerate(strip):
        _paste(sheet, tile, grid + STRIP_HEADER, GAP + j * (tile.shape[1] + GAP))
    texts = [(GAP + j * (width + GAP), 22.0, TITLE, shortened(title, width, TITLE)) for j, title in enumerate(titles)]
    texts.append((GAP, 46.0, SMALL, shortened(subtitle, sheet.shape[1], SMALL)))
    _write(sheet[:HEADER], texts)
    if strip:
        _write(sheet[grid : grid + STRIP_HEADER], [(GAP, 22.0, TITLE, shortened(strip_title, sheet.shape[1], TITLE))])
    return np.round(sheet * 255).astype(np.uint8)


def _paste(sheet: np.ndarray, tile: np.ndarray, y: int, x: int) -> None:
    sheet[y : y + tile.shape[0], x : x + tile.shape[1]] = tile


def _write(band: np.ndarray, texts: list[tuple[float, float, float, str]]) -> None:
    coverage = draw_text(band.shape[1], band.shape[0], texts)[..., None]
    band[:] = band * (1 - coverage) + TEXT * coverage
