"""The sheet of a comparison: a grid of tiles under titles, and a strip below it."""

import numpy as np

from .lettering import draw_text, fitting

HEADER, STRIP_HEADER, GAP = 58, 34, 6  # pixels
PAPER, INK = 24 / 255, 232 / 255
TITLE, SMALL = 17.0, 13.0  # text sizes, pixels


def strip_tile_size(columns: int, width: int, height: int, count: int) -> int:
    """Side of the `count` square tiles that fill a row below `columns` tiles of width x height, not above its height."""
    return max(1, min((columns * (width + GAP) - count * GAP) // count, height))


def draw_sheet(
    rows: list[list[np.ndarray]], titles: list[str], subtitle: str, strip: list[np.ndarray] = (), strip_title: str = ""
) -> np.ndarray:
    """[H,W,3] uint8 of tiles [h,w,3] (0..1, all of one size), a title a column, and square `strip` tiles below."""
    height, width = rows[0][0].shape[:2]
    columns, grid = len(titles), HEADER + len(rows) * (height + GAP)
    below = STRIP_HEADER + len(strip[0]) + GAP if strip else 0
    sheet = np.full((grid + below, GAP + columns * (width + GAP), 3), PAPER)
    for i, row in enumerate(rows):
        for j, tile in enumerate(row):
            _paste(sheet, tile, HEADER + i * (height + GAP), GAP + j * (width + GAP))
    for j, tile in enumerate(strip):
        _paste(sheet, tile, grid + STRIP_HEADER, GAP + j * (tile.shape[1] + GAP))
    texts = [(GAP + j * (width + GAP), 22.0, TITLE, fitting(title, width, TITLE)) for j, title in enumerate(titles)]
    texts.append((GAP, 46.0, SMALL, fitting(subtitle, sheet.shape[1], SMALL)))
    _write(sheet[:HEADER], texts)
    if strip:
        _write(sheet[grid : grid + STRIP_HEADER], [(GAP, 22.0, TITLE, fitting(strip_title, sheet.shape[1], TITLE))])
    return np.round(sheet * 255).astype(np.uint8)


def _paste(sheet: np.ndarray, tile: np.ndarray, y: int, x: int) -> None:
    sheet[y : y + tile.shape[0], x : x + tile.shape[1]] = tile


def _write(band: np.ndarray, texts: list[tuple[float, float, float, str]]) -> None:
    ink = draw_text(band.shape[1], band.shape[0], texts)[..., None]
    band[:] = band * (1 - ink) + INK * ink
