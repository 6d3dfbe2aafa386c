"""The font of printed reports: where it lies, how wide its texts are, which characters it has.

DejaVu Sans comes with matplotlib, which measures the same font when it places the texts of a figure.
"""

from __future__ import annotations

from functools import cache
from pathlib import Path

import matplotlib as mpl
from matplotlib.ft2font import FT2Font, LoadFlags

FAMILY = "DejaVu Sans"
_FILES = {False: "DejaVuSans.ttf", True: "DejaVuSans-Bold.ttf"}


def folder() -> Path:
    """Return the folder of the font files."""
    return Path(mpl.get_data_path()) / "fonts" / "ttf"


def width_pt(text: str, size_pt: float, bold: bool = False) -> float:
    """Width of a text on one line without kerning, point; a character that the font lacks is as wide as its M."""
    return size_pt * sum(_advance(one, bold) for one in text)


def missing(text: str) -> set[str]:
    """The characters of a text that the font has no glyph for; line ends are none."""
    return {one for one in set(text) if one != "\n" and not all(ord(one) in _characters(bold) for bold in _FILES)}


def legible(text: str) -> str:
    """The text with every character that the font lacks written as its code point, so that nothing is lost in print."""
    lacking = missing(text)
    return "".join(f"[U+{ord(one):04X}]" if one in lacking else one for one in text) if lacking else text


@cache
def _advance(character: str, bold: bool) -> float:
    """Return how far a character moves the pen, in parts of the size."""
    font = _font(bold)
    code = ord(character if ord(character) in _characters(bold) else "M")
    return float(font.load_char(code, flags=LoadFlags.NO_SCALE).horiAdvance / font.units_per_EM)


@cache
def _characters(bold: bool) -> frozenset[int]:
    return frozenset(_font(bold).get_charmap())


@cache
def _font(bold: bool) -> FT2Font:
    return FT2Font(str(folder() / _FILES[bold]))
