"""A small plot of characters: least and greatest value of each column, as dots."""

from __future__ import annotations

import math
from collections.abc import Sequence

_BRAILLE = 0x2800
_DOTS = ((0x01, 0x02, 0x04, 0x40), (0x08, 0x10, 0x20, 0x80))  # bit of a dot by column and row of a cell, from the top
LEAST_SPAN = 0.5  # a plot of less than this would draw the noise of a sensor as a mountain

Range = tuple[float, float]


def dots_across(columns: int, braille: bool) -> int:
    """Return how many values a plot of so many columns shows."""
    return columns * (2 if braille else 1)


def plot(ranges: Sequence[Range | None], rows: int, braille: bool) -> list[str]:
    """Return rows of a plot, top first; (least, greatest) per dot across, None where there was nothing.

    The axis spans all values, at least ``LEAST_SPAN``.
    """
    height = rows * (4 if braille else 1)
    low, high = axis(ranges)
    across = len(ranges) + (len(ranges) % 2 if braille else 0)
    grid = [[False] * across for _ in range(height)]
    for column, found in enumerate(ranges):
        if found is not None:
            top, bottom = (_row(value, low, high, height) for value in (found[1], found[0]))
            for row in range(top, bottom + 1):
                grid[row][column] = True
    if not braille:
        return ["".join("*" if dot else " " for dot in line) for line in grid]
    return [_cells(grid[at : at + 4]) for at in range(0, height, 4)]


def axis(ranges: Sequence[Range | None]) -> Range:
    """Least and greatest value of the axis; (0, 1) without a value."""
    known = [found for found in ranges if found is not None and all(math.isfinite(value) for value in found)]
    if not known:
        return 0.0, 1.0
    low, high = min(one for one, _ in known), max(other for _, other in known)
    missing = max(0.0, LEAST_SPAN - (high - low)) / 2
    return low - missing, high + missing


def _row(value: float, low: float, high: float, height: int) -> int:
    """Row of a value, 0 at the top."""
    return round((high - value) / (high - low) * (height - 1))


def _cells(lines: Sequence[Sequence[bool]]) -> str:
    cells = []
    for column in range(0, len(lines[0]), 2):
        bits = sum(_DOTS[x][y] for x in (0, 1) for y in range(4) if lines[y][column + x])
        cells.append(chr(_BRAILLE + bits) if bits else " ")
    return "".join(cells)
