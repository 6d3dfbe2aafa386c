"""The words of ``--select``: which sessions of the archive are meant."""

from __future__ import annotations

from collections.abc import Sequence
from datetime import UTC, date, datetime, time, timedelta

from bench.model.clock import NS
from bench.model.errors import InputError
from bench.store import Selection

_WORDS = ("uut", "campaign", "station", "verdict", "standard", "certificate")
_DAYS = ("since", "until")


def selection_of(words: Sequence[str]) -> Selection:
    """Return the selection that ``NAME=VALUE`` words stand for; the day ``until`` is among them.

    Raises: InputError B-ARC-001 for another name, one that is said twice, or no day.
    """
    said: dict[str, str] = {}
    for word in words:
        name, is_pair, value = word.partition("=")
        if not is_pair or not value or name in said or name not in (*_WORDS, *_DAYS):
            raise InputError(
                "B-ARC-001",
                f"{word!r} selects nothing",
                where="--select",
                next_step=f"write NAME=VALUE, each name once: {', '.join((*_WORDS, *_DAYS))}",
            )
        said[name] = value
    days = {f"{name}_utc_ns": _begin_ns(name, said.pop(name)) for name in _DAYS if name in said}
    return Selection(**said, **days)  # type: ignore[arg-type]  # the names are looked at above


def _begin_ns(name: str, text: str) -> int:
    """Return when a day begins, or ends for ``until``; UTC, nanoseconds."""
    try:
        day = date.fromisoformat(text) + timedelta(days=name == "until")
        return int(datetime.combine(day, time(), UTC).timestamp()) * NS
    except (ValueError, OverflowError) as error:
        raise InputError(
            "B-ARC-001",
            f"{text!r} is no day",
            where=f"--select {name}",
            next_step="write YYYY-MM-DD",
        ) from error
