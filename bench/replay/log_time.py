"""Times of a log's rows: patterns, ISO 8601, seconds since 1970 or a start, samples numbered or counted; UTC in ns."""

from __future__ import annotations

import math
from datetime import UTC, datetime, timedelta, timezone
from decimal import Decimal, InvalidOperation

from bench.model.clock import NS
from bench.model.units import read_quantity
from bench.plan import ELAPSED, ISO, ROWS, SAMPLES, UNIX, TimeColumn

_EPOCH = datetime(1970, 1, 1, tzinfo=UTC)
_MICROSECOND = timedelta(microseconds=1)


class TimeReader:
    """Reads the time of a row as the mapping describes it."""

    def __init__(self, column: TimeColumn, decimal: str) -> None:
        self._format = column.format
        self._numeric = column.format in (ELAPSED, UNIX, SAMPLES)
        self._row = -1
        self._zone = timezone(timedelta(seconds=column.offset_s))
        self._comma = decimal == ","
        self._start_ns = 0 if column.start is None else _utc_ns(datetime.fromisoformat(column.start))
        unit = None if column.unit is None else read_quantity(f"1 {column.unit}")
        self._unit_ns = Decimal(round((1.0 if unit is None else unit[0]) * NS))
        if column.rate is not None:
            self._unit_ns = NS / Decimal(str(column.rate))

    def utc_ns(self, text: str) -> int:
        """UTC in ns since 1970, to be asked once for each row. Raises ValueError if the text is no such time."""
        if self._format == ROWS:
            self._row += 1
            return self._start_ns + math.floor(self._row * self._unit_ns)
        if self._numeric:
            return self._start_ns + self._number_ns(text)
        try:
            found = datetime.fromisoformat(text) if self._format == ISO else datetime.strptime(text, self._format)
        except ValueError:
            raise ValueError(f"{text!r} is no time of the format {self._format!r}") from None
        return _utc_ns(found if found.tzinfo is not None else found.replace(tzinfo=self._zone))

    def _number_ns(self, text: str) -> int:
        try:
            number = Decimal(text.replace(",", ".") if self._comma else text)
        except InvalidOperation:
            raise ValueError(f"{text!r} is no time in numbers") from None
        if not number.is_finite() or abs(number * self._unit_ns) >= 2**62:
            raise ValueError(f"{text!r} is no time a log can have")
        return math.floor(number * self._unit_ns)


def _utc_ns(instant: datetime) -> int:
    return (instant - _EPOCH) // _MICROSECOND * 1000
