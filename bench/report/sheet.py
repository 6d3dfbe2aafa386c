"""Tables on paper and page: the widths of their columns, the size of their type, and what becomes of one too wide.

Widths are those of the fonts that print (``bench.report.fonts``); matplotlib measures the same when it places the texts
of a figure.
"""

from __future__ import annotations

import re
from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cache
from typing import TYPE_CHECKING

from bench.report.fonts import font_files
from bench.report.tables import Table

if TYPE_CHECKING:
    from matplotlib.ft2font import FT2Font

SIZES_pt = (7.5, 7.0, 6.5)
ROOM_pt = 493.2  # an A4 page of 595.3 with margins of 18 mm, as in templates/report.typ
GAP_pt = 7.0  # between the texts of two columns
PAGE_px, _PAGE_TYPE_px, _PAGE_GAP_px = 912.0, 12.8, 14.4  # as in templates/report.css
_WRAPPED = 24  # characters of a cell that heads a row and goes over lines on the page
_SLACK = 1.015  # kerning and rounding
_SHORT = 12  # characters of a cell that stays on one line, such as "not tested"
_LONGEST = 40  # characters of a word; what is longer may be broken
_PIECE = 8
_BREAK, _HOLD, _JOIN = "\u200b", "\u00a0", "\u2060"
_TIGHT = re.compile(r"/(?=\S)")
_SYLLABLES = re.compile("[가-힣](?=[가-힣])")
_WORD = re.compile(rf"[^\s{_BREAK}]+")
_WEIGHTS = (False, True)  # bold or not


@dataclass(frozen=True)
class Sheet:
    """A table, or some columns of one, as it is printed: widths of the columns and size of the type in point."""

    table: Table
    widths_pt: tuple[float, ...]
    size_pt: float


def sheets(table: Table, room_pt: float) -> list[Sheet]:
    """Set a table into a width; one whose words need more room than there is in the smallest type goes in parts.

    Each part repeats the ``stub`` columns that head the rows.
    """
    ready = _broken(table)
    for size in SIZES_pt:
        least, natural = _needs(ready, size)
        if sum(least) <= room_pt:
            return [Sheet(ready, _shared(least, natural, room_pt), size)]
    return [_set(_columns(ready, part), room_pt) for part in _parts(ready, _needs(ready, SIZES_pt[-1])[0], room_pt)]


def page_parts(table: Table, continued: str) -> list[Table]:
    """Return a table in parts that each fit on the page; each repeats the columns that head the rows.

    ``continued``: caption of every part but the first.
    """
    widths = [_page_px(table, index) for index in range(len(table.headers))]
    if table.prose or sum(widths) <= PAGE_px:
        return [table]
    parts = [_columns(table, part) for part in _parts(table, widths, PAGE_px)]
    return [parts[0], *(replace(part, caption=continued) for part in parts[1:])]


def _page_px(table: Table, index: int) -> float:
    """Return the width of a column on the page: headings go over lines, and what heads the rows where it is long."""
    least = max(width_pt(word, _PAGE_TYPE_px, bold=True) for word in (table.headers[index].split() or [""]))
    cells = [row[index] for row in table.rows]
    if index < table.stub:
        cells = [text[:_WRAPPED] for text in cells]
    return max([least, *(width_pt(text, _PAGE_TYPE_px, bold=index == 0) for text in cells)]) + _PAGE_GAP_px


def _set(table: Table, room_pt: float) -> Sheet:
    least, natural = _needs(table, SIZES_pt[-1])
    return Sheet(table, _shared(least, natural, room_pt), SIZES_pt[-1])


def _parts(table: Table, least: Sequence[float], room_pt: float) -> list[list[int]]:
    stub = list(range(table.stub))
    head = sum(least[: table.stub])
    parts: list[list[int]] = []
    used = room_pt
    for column in range(table.stub, len(least)):
        if used + least[column] > room_pt and (not parts or len(parts[-1]) > len(stub)):
            parts.append(list(stub))
            used = head
        parts[-1].append(column)
        used += least[column]
    return parts


def _columns(table: Table, chosen: Sequence[int]) -> Table:
    rows = tuple(tuple(row[index] for index in chosen) for row in table.rows)
    return replace(table, headers=tuple(table.headers[index] for index in chosen), rows=rows)


def _broken(table: Table) -> Table:
    """Long words get places to break at; cells of numbers get none, whatever spaces they hold."""
    headers = tuple(_whole(text.replace(" / ", f"{_HOLD}/ ")) for text in table.headers)
    rows = tuple(tuple(_whole(_cell(text)) for text in row) for row in table.rows)
    return replace(table, headers=headers, rows=rows)


def _whole(text: str) -> str:
    """Hold units and Korean words together: typst would break the one behind a stroke, the other anywhere."""
    return _SYLLABLES.sub(f"\\g<0>{_JOIN}", _TIGHT.sub(f"/{_JOIN}", text))


def _cell(text: str) -> str:
    if len(text) <= _SHORT or not any(letter.isalpha() for letter in text):
        return text.replace(" ", _HOLD)
    return _WORD.sub(lambda match: _pieces(match[0]), text)


def _pieces(word: str) -> str:
    if len(word) <= _LONGEST:
        return word
    return _BREAK.join(word[start : start + _PIECE] for start in range(0, len(word), _PIECE))


def _needs(table: Table, size_pt: float) -> tuple[list[float], list[float]]:
    """Return the least width of each column (its longest word) and its natural one (its longest cell), gap included."""
    least = [_word_pt(text, size_pt, bold=True) for text in table.headers]
    natural = [width_pt(text, size_pt, bold=True) for text in table.headers]
    for row in table.rows:
        for index, text in enumerate(row):
            bold = index == 0
            least[index] = max(least[index], _word_pt(text, size_pt, bold))
            lines = text.replace(_BREAK, "").split("\n")
            natural[index] = max(natural[index], *(width_pt(line, size_pt, bold) for line in lines))
    return [_SLACK * width + GAP_pt for width in least], [_SLACK * width + GAP_pt for width in natural]


def _word_pt(text: str, size_pt: float, bold: bool) -> float:
    words = text.replace(_BREAK, " ").replace("\n", " ").split(" ")
    return max((width_pt(word, size_pt, bold) for word in words), default=0.0)


def _shared(least: Sequence[float], natural: Sequence[float], room_pt: float) -> tuple[float, ...]:
    """Return what room is left goes to the columns that would use it, in proportion."""
    wanted = sum(natural) - sum(least)
    share = min(1.0, (room_pt - sum(least)) / wanted) if wanted > 0 else 0.0
    return tuple(low + share * (high - low) for low, high in zip(least, natural, strict=True))


def width_pt(text: str, size_pt: float, bold: bool = False) -> float:
    """Return width of a text on one line without kerning, point; a character no font has is as wide as an M."""
    return size_pt * sum(_advance(letter, bold) for letter in text)


def missing(text: str) -> set[str]:
    """Return the characters of a text that no font has a glyph for in both weights; line ends are none."""
    return {
        letter
        for letter in set(text)
        if letter != "\n" and not all(_font_of(letter, bold) is not None for bold in _WEIGHTS)
    }


def legible(text: str) -> str:
    """Return the text with every character that no font has written as its code point: nothing is lost in print."""
    lacking = missing(text)
    return "".join(f"[U+{ord(letter):04X}]" if letter in lacking else letter for letter in text) if lacking else text


@cache
def _advance(character: str, bold: bool) -> float:
    """Return how far a character moves the pen, in parts of the size."""
    from matplotlib.ft2font import LoadFlags

    font = _font_of(character, bold)
    code = ord(character if font is not None else "M")
    font = font or _fonts(bold)[0][0]
    return float(font.load_char(code, flags=LoadFlags.NO_SCALE).horiAdvance / font.units_per_EM)


def _font_of(character: str, bold: bool) -> FT2Font | None:
    """Return the first font that has a character."""
    return next((font for font, characters in _fonts(bold) if ord(character) in characters), None)


@cache
def _fonts(bold: bool) -> list[tuple[FT2Font, frozenset[int]]]:
    """Return the fonts of one weight with their characters."""
    from matplotlib.ft2font import FT2Font

    fonts = [FT2Font(str(path)) for path in font_files(bold)]
    return [(font, frozenset(font.get_charmap())) for font in fonts]
