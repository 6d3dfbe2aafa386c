"""The look of a page: language, shapes, width, and time zone; times and durations in words.

Characters of ambiguous width (Unicode Standard Annex #11, class A: box drawing, blocks, the degree sign, the long dash)
take one column or two, as the terminal likes, and shift everything behind them; none is ever drawn.
"""

from __future__ import annotations

import math
import unicodedata
from collections.abc import Mapping
from dataclasses import dataclass, replace
from datetime import UTC, datetime
from functools import cache
from pathlib import Path

from bench.model.texts import Texts

PLAIN_TERMINALS = ("linux", "dumb", "vt100", "vt102", "vt220", "ansi")  # without braille, whatever their encoding is
_STANDS_FOR = {
    "°": "deg", "º": "deg", "±": "+-", "×": "x", "·": ".", "•": "*", "…": "...", "—": "-", "–": "-", "‐": "-",
    "→": "->", "←": "<-", "≤": "<=", "≥": ">=", "‘": "'", "’": "'", "“": '"', "”": '"', "µ": "u", "μ": "u", "Ω": "ohm",
    "²": "^2", "³": "^3", "√": "sqrt", "−": "-", "\u00a0": " ", "\u202f": " ", "\t": " ",
}  # fmt: skip
HOUR_S = 3600.0
MINUTE_S = 60.0
FOLDER = Path(__file__).parent


@dataclass(frozen=True)
class Glyphs:
    """Shapes by state, the two halves of a progress bar, and whether dots of a plot are braille."""

    states: Mapping[str, str]
    full: str
    empty: str
    braille: bool

    def state(self, name: str) -> str:
        """Return shape of a state; a question mark for one that is not known."""
        return self.states.get(name, "?")

    def clean(self, text: object) -> str:
        """Return text from a run as it may be drawn: no control character, nothing of ambiguous width, one line."""
        return "".join(_drawn(character, self.braille) for character in str(text))


UNICODE = Glyphs(
    {
        "starting": "▹", "running": "▸", "waiting": "??", "holding": "▮▮", "ending": "◂", "ended": "◼", "stopped": "◼",
        "failed": "✗", "lost": "?!",
    },
    "▰", "▱", True,
)  # fmt: skip
ASCII = Glyphs(
    {
        "starting": "...", "running": ">", "waiting": "??", "holding": "||", "ending": "<", "ended": "#",
        "stopped": "#", "failed": "X", "lost": "?!",
    },
    "#", ".", False,
)  # fmt: skip


def glyphs_for(environment: Mapping[str, str], encoding: str) -> Glyphs:
    """Return shapes for the terminal of a process: ``encoding`` of its output, LC_ALL, LC_CTYPE, LANG and TERM.

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


def catalogue(language: str = "en") -> Texts:
    """Return texts of the terminal view."""
    return Texts(FOLDER, language)


@dataclass(frozen=True)
class Look:
    """Everything about a page that is not the run. ``width`` in columns; ``local`` shows the time of this machine."""

    texts: Texts
    glyphs: Glyphs = ASCII
    width: int = 80
    local: bool = False

    def at(self, *, width: int | None = None, local: bool | None = None) -> Look:
        """Return the same with another width or time zone."""
        return replace(self, width=self.width if width is None else width, local=self.local if local is None else local)

    def time(self, t_utc_s: float | None, now_utc_s: float | None = None) -> str:
        """Return ``2026-11-20 18:45:50Z`` or with the zone's offset; without the date if that of ``now_utc_s``."""
        if t_utc_s is None:
            return self.texts("none")
        moment = self._moment(t_utc_s)
        same_day = now_utc_s is not None and self._moment(now_utc_s).date() == moment.date()
        return moment.strftime("%H:%M:%S" if same_day else "%Y-%m-%d %H:%M:%S") + self._zone(moment)

    def _moment(self, t_utc_s: float) -> datetime:
        utc = datetime.fromtimestamp(t_utc_s, tz=UTC)
        return utc.astimezone() if self.local else utc

    def _zone(self, moment: datetime) -> str:
        return moment.isoformat()[-6:] if self.local else "Z"

    def clean(self, text: object) -> str:
        """Return text of a run as it may be drawn."""
        return self.glyphs.clean(text)

    def degC(self, value: float | None) -> str:
        """Return a temperature with its unit, a dash for none."""
        return self.texts("none") if value is None or math.isnan(value) else self.texts("value.degC", value=value)


def duration(seconds: float | None) -> str:
    """Return ``0.4 s``, ``12:40`` (minutes) or ``3:12:40``; a dash for none; never negative."""
    if seconds is None:
        return "-"
    whole = max(0.0, seconds)
    if whole < 10.0:
        return f"{whole:.1f} s"
    if whole < MINUTE_S:
        return f"{whole:.0f} s"
    minutes, rest = divmod(round(whole), 60)
    return f"{minutes}:{rest:02d}" if whole < HOUR_S else f"{minutes // 60}:{minutes % 60:02d}:{rest:02d}"
