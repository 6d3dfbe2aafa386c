"""What may be drawn on a terminal: shapes of one column everywhere, ASCII where the terminal knows no more.

Characters of ambiguous width (Unicode Standard Annex #11, class A: box drawing, blocks, the degree sign, the long dash)
take one column or two, as the terminal likes, and shift everything behind them; none is ever drawn.
"""

from __future__ import annotations

import unicodedata
from collections.abc import Mapping
from dataclasses import dataclass
from functools import cache

PLAIN_TERMINALS = ("linux", "dumb", "vt100", "vt102", "vt220", "ansi")  # without braille, whatever their encoding is
_STANDS_FOR = {
    "°": "deg", "º": "deg", "±": "+-", "×": "x", "·": ".", "•": "*", "…": "...", "—": "-", "–": "-", "‐": "-",
    "→": "->", "←": "<-", "≤": "<=", "≥": ">=", "‘": "'", "’": "'", "“": '"', "”": '"', "µ": "u", "μ": "u", "Ω": "ohm",
    "²": "^2", "³": "^3", "√": "sqrt", "−": "-", "\u00a0": " ", "\u202f": " ", "\t": " ",
}  # fmt: skip


@dataclass(frozen=True)
class Glyphs:
    """Shapes by state, the two halves of a progress bar, and whether dots of a plot are braille."""

    states: Mapping[str, str]
    full: str
    empty: str
    braille: bool

    def state(self, name: str) -> str:
        """Shape of a state; a question mark for one that is not known."""
        return self.states.get(name, "?")

    def clean(self, text: object) -> str:
        """Text from a run as it may be drawn: no control character, nothing of ambiguous width, one line."""
        return "".join(_drawn(character, self.braille) for character in str(text))


UNICODE = Glyphs(
    {
        "starting": "▹", "running": "▸", "holding": "▮▮", "ending": "◂", "ended": "◼", "stopped": "◼",
        "failed": "✗", "lost": "?!",
    },
    "▰", "▱", True,
)  # fmt: skip
ASCII = Glyphs(
    {
        "starting": "...", "running": ">", "holding": "||", "ending": "<", "ended": "#", "stopped": "#", "failed": "X",
        "lost": "?!",
    },
    "#", ".", False,
)  # fmt: skip


def glyphs_for(environment: Mapping[str, str], encoding: str) -> Glyphs:
    """Shapes for the terminal of a process: ``encoding`` of its output, LC_ALL, LC_CTYPE, LANG and TERM.

    Python itself calls the encoding UTF-8 in the locale "C" too (PEP 538, PEP 540), and sets LC_CTYPE then: only a
    locale that says UTF-8 and is not that one is believed.
    """
    locale = environment.get("LC_ALL") or environment.get("LC_CTYPE") or environment.get("LANG") or ""
    coerced = (
        not environment.get("LC_ALL") and locale == "C.UTF-8" and environment.get("LANG", "") in ("", "C", "POSIX")
    )
    utf8 = all(name.lower().replace("-", "").endswith("utf8") for name in (locale, encoding))
    plain = environment.get("TERM", "dumb") in PLAIN_TERMINALS
    return UNICODE if utf8 and not coerced and not plain else ASCII


@cache
def _drawn(character: str, unicode: bool) -> str:
    if " " <= character <= "~":
        return character
    if character in _STANDS_FOR:
        return _STANDS_FOR[character]
    if character == "\n":
        return " "
    width = unicodedata.east_asian_width(character)
    mark = unicodedata.combining(character) or not character.isprintable()
    return character if unicode and width != "A" and not mark else "?"
