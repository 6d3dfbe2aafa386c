"""Lines of a page: folded between words to a width of terminal columns, which wide characters take two of."""

from __future__ import annotations

from rich.cells import cell_len, chop_cells
from rich.text import Text

INDENT = "  "


def folded(text: str, width: int, style: str = "", first: str = "", rest: str = INDENT) -> list[Text]:
    """Return a text as lines of at most ``width`` columns; ``first`` and ``rest`` stand before the lines."""
    lines: list[str] = []
    line, empty = first, True
    for word in text.split():
        for piece in chop_cells(word, max(1, width - cell_len(rest))) or [""]:
            gap = "" if empty else " "
            if not empty and cell_len(line + gap + piece) > width:
                lines.append(line)
                line, gap = rest, ""
            line += gap + piece
            empty = False
    return [Text(part, style=style) for part in (*lines, line) if part.strip()]


def cut(text: str, width: int) -> str:
    """Return a text cut to so many columns; what is cut is marked with a tilde."""
    if cell_len(text) <= width:
        return text
    return (chop_cells(text, max(1, width - 1)) or [""])[0] + "~"


def spread(left: Text, right: Text, width: int) -> list[Text]:
    """Return two texts at both edges of one line, or below each other if they do not fit."""
    free = width - left.cell_len - right.cell_len
    return [left, right] if free < 1 else [Text.assemble(left, " " * free, right)]


def joined(parts: list[str], width: int, style: str = "", rest: str = INDENT) -> list[Text]:
    """Return short texts behind each other, two blanks apart, as many on a line as fit; none is broken that fits."""
    lines: list[str] = []
    line = ""
    for part in (part for part in parts if part):
        if line and cell_len(line) + 2 + cell_len(part) > width:
            lines.append(line)
            line = rest + part
        else:
            line = f"{line}  {part}" if line else part
    return [part for text in (*lines, line) if text for part in _indented(text, width, style)]


def _indented(text: str, width: int, style: str) -> list[Text]:
    if cell_len(text) <= width:
        return [Text(text, style=style)]
    lead = text[: len(text) - len(text.lstrip())]
    return folded(text, width, style, first=lead)
