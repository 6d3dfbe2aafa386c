"""A request for history: which signals, from when to when, how many points."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass

from bench.web.security.refusal import Refusal

MOST_POINTS = 4000
MOST_SIGNALS = 40
_DEFAULT_POINTS = 1000


@dataclass(frozen=True)
class HistoryQuery:
    """What a page asks for; times in seconds since 1970 (UTC)."""

    signals: tuple[str, ...]
    t0_utc_s: float
    t1_utc_s: float
    n: int


def history_query(words: Mapping[str, str]) -> HistoryQuery:
    """Read the query of a history request. Raises: Refusal B-WEB-020, status 400, naming what is wrong."""
    signals = tuple(dict.fromkeys(name for name in words.get("signals", "").split(",") if name))
    if not 1 <= len(signals) <= MOST_SIGNALS:
        raise _refused(f"signals names {len(signals)} signals; one to {MOST_SIGNALS} can be asked for, by commas")
    t0_utc_s, t1_utc_s = _time(words, "t0"), _time(words, "t1")
    if not t1_utc_s > t0_utc_s:
        raise _refused(f"t1 ({t1_utc_s} s) must be later than t0 ({t0_utc_s} s)")
    asked = words.get("n", str(_DEFAULT_POINTS))
    if not (asked.isascii() and asked.isdigit() and len(asked) < 10 and int(asked) >= 1):
        raise _refused(f"n is {asked[:20]!r}; it must be a whole number from 1 on")
    return HistoryQuery(signals, t0_utc_s, t1_utc_s, min(int(asked), MOST_POINTS))


def _time(words: Mapping[str, str], key: str) -> float:
    text = words.get(key, "")
    try:
        value = float(text)
    except ValueError:
        value = math.nan
    if not math.isfinite(value):
        raise _refused(f"{key} is {text[:20]!r}; it must be a number: seconds since 1970 (UTC)")
    return value


def _refused(message: str) -> Refusal:
    return Refusal(400, "B-WEB-020", f"history: {message}", next_step="ask again, as docs/live-protocol.md says")
