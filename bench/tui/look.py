"""How a page is drawn: language, shapes, width, and which time zone; times and durations in words."""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from datetime import UTC, datetime
from pathlib import Path

from bench.model.texts import Texts
from bench.tui.glyphs import ASCII, Glyphs

HOUR_S = 3600.0
MINUTE_S = 60.0
_FOLDER = Path(__file__).parent


def catalogue(language: str = "en") -> Texts:
    """Texts of the terminal view."""
    return Texts(_FOLDER, language)


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
        """``2026-11-20 18:45:50Z`` or with the zone's offset; without the date when it is that of ``now_utc_s``."""
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
        """Text of a run as it may be drawn."""
        return self.glyphs.clean(text)

    def degC(self, value: float | None) -> str:
        """Return a temperature with its unit, a dash for none."""
        return self.texts("none") if value is None or math.isnan(value) else self.texts("value.degC", value=value)


def duration(seconds: float | None) -> str:
    """``0.4 s``, ``12:40`` (minutes) or ``3:12:40``; a dash for none; never negative."""
    if seconds is None:
        return "-"
    whole = max(0.0, seconds)
    if whole < 10.0:
        return f"{whole:.1f} s"
    if whole < MINUTE_S:
        return f"{whole:.0f} s"
    minutes, rest = divmod(round(whole), 60)
    return f"{minutes}:{rest:02d}" if whole < HOUR_S else f"{minutes // 60}:{minutes % 60:02d}:{rest:02d}"
