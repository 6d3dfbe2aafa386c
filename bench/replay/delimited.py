"""Reads a delimited log line by line with a mapping: times, values, what is overloaded and what cannot be read."""

from __future__ import annotations

import csv
import hashlib
import math
import re
from collections import Counter
from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass, field
from datetime import UTC, datetime, timedelta, timezone
from decimal import Decimal, InvalidOperation
from itertools import islice

import numpy as np
from numpy.typing import NDArray

from bench.model.clock import NS
from bench.model.declaration import LogColumn
from bench.model.errors import InputError
from bench.model.units import read_quantity
from bench.plan import ELAPSED, ISO, ROWS, SAMPLES, UNIX, FileForm, LogMapping, Overload, TimeColumn, suggestion
from bench.replay.wording import say

_EPOCH = datetime(1970, 1, 1, tzinfo=UTC)
_MICROSECOND = timedelta(microseconds=1)
CONTROL = re.compile(r"[\x00-\x08\n-\x1f]")  # no text holds them
MAX_LINE_BYTES = 100_000
SHOWN = 5
ENOUGH = 100  # rows that show how short the text in the last column may be
_TICKS = {"ns": 1, "us": 1000, "0.1 ms": 100_000, "ms": 1_000_000}  # of counters of 32 bits, ns
FEW, RARE = 5, 100  # usual steps from a counter's last value to its first one, and of its range at least
_BLANK = "whitespace"
_LINES = 1000  # read at once
_PLAIN = bytes({*range(0x20, 0x7F), *b"\t\r\n"} - {*b'"'})  # bytes of a row without text in quotes
_EXACT_DIGITS, _EXACT_NS = 15, 2**50  # of a decimal that its nearest float tells from every whole ns


class TimeReader:
    """Reads the time of a row as the mapping describes it."""

    def __init__(self, column: TimeColumn, decimal: str) -> None:
        self._format = column.format
        self.numeric = column.format in (ELAPSED, UNIX, SAMPLES)
        self._row = -1
        self._zone = timezone(timedelta(seconds=column.offset_s))
        self._comma = decimal == ","
        self._start_ns = 0 if column.start is None else _utc_ns(datetime.fromisoformat(column.start))
        unit = None if column.unit is None else read_quantity(column.unit) or read_quantity(f"1 {column.unit}")
        self._unit_ns = Decimal(round((1.0 if unit is None else unit[0]) * NS))
        if column.rate is not None:
            self._unit_ns = NS / Decimal(str(column.rate))

    def utc_ns(self, text: str) -> int:
        """Return UTC in ns since 1970, to be asked once for each row. Raises ValueError if the text is no such time."""
        if self._format == ROWS:
            self._row += 1
            return self._start_ns + math.floor(self._row * self._unit_ns)
        if self.numeric:
            return self._start_ns + self._number_ns(text)
        try:
            moment = datetime.fromisoformat(text) if self._format == ISO else datetime.strptime(text, self._format)
        except ValueError:
            raise ValueError(say("bad.no_time", text=text, format=self._format)) from None
        return _utc_ns(moment if moment.tzinfo is not None else moment.replace(tzinfo=self._zone))

    def many_ns(self, numbers: NDArray[np.float64], digits: int, texts: Iterable[str]) -> NDArray[np.int64]:
        """Return `utc_ns` of some rows; ``numbers``: (n,), what texts of at most so many digits are if not words."""
        unit_ns = int(self._unit_ns)
        ns = numbers * unit_ns
        whole = np.rint(ns)
        if (
            self.numeric
            and unit_ns == self._unit_ns
            and digits <= _EXACT_DIGITS
            and np.abs(ns).max() <= _EXACT_NS
            and np.all(np.abs(ns - whole) <= 2 * np.spacing(np.abs(whole)))
        ):
            return self._start_ns + whole.astype(np.int64)
        return np.array([self.utc_ns(text) for text in texts], np.int64)

    def _number_ns(self, text: str) -> int:
        try:
            number = Decimal(text.replace(",", ".") if self._comma else text)
        except InvalidOperation:
            raise ValueError(say("bad.no_time_in_numbers", text=text)) from None
        if not number.is_finite() or abs(number * self._unit_ns) >= 2**62:
            raise ValueError(say("bad.time_out_of_reach", text=text))
        return math.floor(number * self._unit_ns)


def _utc_ns(instant: datetime) -> int:
    return (instant - _EPOCH) // _MICROSECOND * 1000


@dataclass
class LogCounts:
    """Counts of the lines after the header; ``bad`` holds line and reason of the first few.

    ``rows``: read, with those that hold an overload; ``overloads``: values by quantity; ``nul_lines``: those with
    blocks of zero bytes; ``cut_line``: number of a last line that was not written to its end, 0 for none;
    ``wraps``: how often a counter of time began anew, by its tick.
    """

    rows: int = 0
    bad_rows: int = 0
    nul_lines: int = 0
    cut_line: int = 0
    wraps: Counter[str] = field(default_factory=Counter)
    overload_rows: int = 0
    overloads: Counter[str] = field(default_factory=Counter)
    bad: list[tuple[int, str]] = field(default_factory=list)

    def sentences(self) -> list[str]:
        """Return what a reader of the results must know about rows that do not count."""
        texts = []
        if self.overload_rows:
            cells = ", ".join(f"{name} {count}" for name, count in self.overloads.items())
            texts.append(say("log.overload", rows=self.overload_rows, all=self.rows, cells=cells))
        if self.bad_rows:
            texts.append(say("log.bad", rows=self.bad_rows, reasons=listed(self.bad)))
        return texts + self.salvaged()

    def salvaged(self) -> list[str]:
        """Return what was left out, or counted on, though no mapping says so."""
        texts = []
        if self.nul_lines:
            texts.append(say("log.nul", lines=self.nul_lines))
        if self.cut_line:
            texts.append(say("log.cut", line=self.cut_line))
        return [*texts, *(say("log.wrapped", tick=tick, times=times) for tick, times in self.wraps.items())]


def listed(bad: Sequence[tuple[int, str]]) -> str:
    """Return the first bad rows with their line numbers."""
    return say.listed(say("bad.line", line=line, why=why) for line, why in bad)


class LogParser:
    """Takes the lines of one log in order and gives its rows. ``name`` is the file in messages.

    ``first_ns``, ``last_ns``: times of the first and newest row, UTC since 1970; ``size``, ``digest``: of all lines.
    """

    def __init__(self, mapping: LogMapping, name: str) -> None:
        self.counts = LogCounts()
        self.size, self.digest = 0, hashlib.sha256()
        self._name = name
        self._form = mapping.file
        self._columns = list(mapping.values.items())
        self._factors = [column.factor for column in mapping.values.values()]
        self._time_header, column = mapping.time
        self._counts_rows = column.format == ROWS
        self._none_left_out, self._bad_rows = mapping.counts_rows, mapping.bad_rows
        self._may_wrap = column.format == ELAPSED
        self._time = TimeReader(column, mapping.file.decimal)
        self._sentinels = _Sentinels(mapping.overload, mapping.file)
        self._readers: list[tuple[int, LogColumn]] = []
        self._time_at = 0
        self._width = 0
        self._line = 0
        self._open = False  # the piece of a line that came last has no end
        self._shortest = MAX_LINE_BYTES  # text in the last column
        self.first_ns = self.last_ns = 0
        self._last_line = 0  # with a row
        self._ahead_ns = 0  # of a counter that began anew
        if self._form.names is not None:
            self._take_header(self._form.names)

    def read(self, lines: Iterable[bytes]) -> Iterator[tuple[NDArray[np.int64], NDArray[np.float64]]]:
        """Yield what stands in the next lines, some at a time.

        Yields: of each line the time of the newest row, ns from the first one on; of each row that time in s and its
                values as `row` returns them, (n, 1 + columns).
        Raises: as `row`.
        """
        left = iter(lines)
        while part := list(islice(left, _LINES if self._width and self._line >= (self._form.header or 0) else 1)):
            yield self._plain(part) or self._each(part)

    def _each(self, lines: list[bytes]) -> tuple[NDArray[np.int64], NDArray[np.float64]]:
        lines_ns, rows = [], []
        for line in lines:
            values = self.row(line)
            lines_ns.append(self.last_ns - self.first_ns)
            if values is not None:
                rows.append((lines_ns[-1] / NS, *values))
        return np.array(lines_ns, np.int64), np.array(rows, float).reshape(-1, 1 + len(self._columns))

    @np.errstate(over="ignore", invalid="ignore")  # a number out of reach is told by its line
    def _plain(self, lines: list[bytes]) -> tuple[NDArray[np.int64], NDArray[np.float64]] | None:
        """Return what `_each` would, if every line is a row of numbers in which nothing is to be told apart."""
        whole = b"".join(lines)
        lengths = self._lengths(whole, len(lines))
        if lengths is None:
            return None
        places = [self._time_at] * self._time.numeric + [place for place, _ in self._readers]
        texts = (self._fields(line.decode("ascii"))[self._time_at].strip() for line in lines)
        try:
            cells = np.loadtxt(lines, delimiter=self._form.delimiter, comments=None, usecols=places, ndmin=2)
            values = self._sentinels.without(cells[:, -len(self._readers) :])
            t_ns = self._ahead_ns + self._time.many_ns(cells[:, 0], int(lengths[:, self._time_at].max()), texts)
        except ValueError:
            return None
        first_ns, last_ns = (self.first_ns, self.last_ns) if self._last_line else (int(t_ns[0]), int(t_ns[0]))
        if np.any(np.diff(t_ns, prepend=last_ns) < 0):
            return None
        self.size += len(whole)
        self.digest.update(whole)
        self._line += len(lines)
        self.first_ns, self.last_ns, self._last_line = first_ns, int(t_ns[-1]), self._line
        self.counts.rows += len(lines)
        self._shortest = min(self._shortest, int(lengths[:, -1].min()) - whole.endswith(b"\r\n"))
        return t_ns - first_ns, np.column_stack(((t_ns - first_ns) / NS, values * self._factors))

    def _lengths(self, whole: bytes, lines: int) -> NDArray[np.intp] | None:
        """Return the length of each field, (lines, width), if the text holds that many rows of plain characters."""
        comment, mark = self._form.comment, self._form.delimiter
        odd = whole.translate(None, _PLAIN) or (comment is not None and comment.encode() in whole)
        if odd or self._open or self._width < 2 or mark == _BLANK or whole.count(b"\n") != lines:
            return None
        cut = np.frombuffer(whole, np.uint8)
        ends = np.flatnonzero((cut == ord(mark)) | (cut == ord("\n")))
        if len(ends) != lines * self._width or np.any(cut[ends[self._width - 1 :: self._width]] != ord("\n")):
            return None
        lengths = np.diff(ends, prepend=-1).reshape(lines, self._width) - 1
        return lengths if lengths.max() <= MAX_LINE_BYTES // self._width else None

    def row(self, raw: bytes) -> list[float] | None:
        """Return the values of the next line, base units in the order of the mapping, NaN where overloaded.

        It is None if the line is no row (comment, blank, header) or a bad one. The time of a row is ``last_ns``.

        Raises: InputError B-IMP-002 (not text), B-IMP-003 (a column is missing), B-IMP-006 (time goes back).
        """
        self.size += len(raw)
        self.digest.update(raw)
        begins, self._open = not self._open, not raw.endswith(b"\n")
        self._line += begins
        if b"\0" in raw or not begins:
            if not self._none_left_out:
                self.counts.nul_lines += begins
            elif begins:
                self._is_bad(say("bad.nul"))
            return None
        text = self._text(raw)
        if self._width == 0:
            if self._is_header(text):
                self._take_header(self._fields(text))
            return None
        if self._line <= (self._form.header or 0) or self._passed_over(text):
            return None
        try:
            return self._read(self._fields(text))
        except ValueError as error:
            if self._open:
                self.counts.cut_line = self._line
            else:
                self._is_bad(error.args[0])
            return None

    def _is_bad(self, why: str) -> None:
        self.counts.bad_rows += 1
        if len(self.counts.bad) < SHOWN:
            self.counts.bad.append((self._line, why))

    def finish(self) -> None:
        """Say that the file has ended.

        Raises: InputError B-IMP-001 (empty), B-IMP-004 (no header, or no row), B-IMP-005 (too many bad rows).
        """
        if self.size == 0:
            raise InputError("B-IMP-001", "is empty", where=self._name, next_step="name the file of the log")
        if self.counts.rows:
            self._few_are_bad(self.counts.bad_rows, self.counts.rows + self.counts.bad_rows)
            return
        what = "no row that can be read" if self._width else "no line of column names"
        why = f"; {listed(self.counts.bad)}" if self.counts.bad else ""
        raise InputError(
            "B-IMP-004",
            f"holds {what}{why}",
            where=self._name,
            next_step="compare delimiter, header and time format of the mapping with the first lines of the file",
        )

    def _few_are_bad(self, bad: int, lines: int) -> None:
        if bad <= self._bad_rows * lines:
            return
        step = "correct the mapping, or allow more there with 'bad_rows: 1 %'; they are left out and counted"
        if self._none_left_out:
            step = "correct those lines, or cut the file in front of them: the mapping counts rows, so none is left out"
        raise InputError(
            "B-IMP-005",
            f"{bad} of {lines} rows cannot be read, {100 * self._bad_rows:g} % may be: {listed(self.counts.bad)}",
            where=self._name,
            next_step=step,
        )

    def _text(self, raw: bytes) -> str:
        try:
            text = raw.decode(self._form.encoding).rstrip("\r\n")
        except UnicodeDecodeError as error:
            cure = (
                ""
                if CONTROL.search(raw.decode("latin-1").rstrip("\r\n"))
                else "; 'file: {encoding: latin-1}' in the mapping if it is not UTF-8"
            )
            raise self._not_text(f"byte {error.start + 1} is not {self._form.encoding}", cure) from error
        if len(raw) > MAX_LINE_BYTES:
            raise self._not_text(f"longer than {MAX_LINE_BYTES} bytes")
        if not text.isprintable() and (wrong := CONTROL.search(text)) is not None:
            raise self._not_text(f"holds the control character U+{ord(wrong[0]):04X}")
        return text.removeprefix("\ufeff") if self._line == 1 else text

    def _not_text(self, why: str, cure: str = "") -> InputError:
        return InputError(
            "B-IMP-002",
            f"is not the text of a delimited log: {why}",
            where=f"{self._name}:{self._line}",
            next_step=f"name the exported text file{cure}",
        )

    def _passed_over(self, text: str) -> bool:
        comment = self._form.comment
        return not text.strip() or (comment is not None and text.lstrip().startswith(comment))

    def _is_header(self, text: str) -> bool:
        return not self._passed_over(text) if self._form.header is None else self._line == self._form.header

    def _fields(self, text: str) -> list[str]:
        if self._form.delimiter == _BLANK:
            return text.split()
        if '"' not in text:
            return text.split(self._form.delimiter)
        try:  # one line at a time: a stray quotation mark must not swallow the rest of the file
            return next(csv.reader([text], delimiter=self._form.delimiter, strict=True))
        except csv.Error as error:
            raise ValueError(say("bad.quotation", why=error)) from error

    def _take_header(self, headers: list[str]) -> None:
        names = [name.strip() for name in headers]
        self._width = len(names)
        numbered = self._counts_rows and self._time_header not in names  # nothing of the column is read
        self._time_at = 0 if numbered else self._place(names, self._time_header)
        self._readers = [(self._place(names, header), column) for header, column in self._columns]

    def _place(self, names: list[str], header: str) -> int:
        if names.count(header) == 1:
            return names.index(header)
        why = f"has the column {header!r} {names.count(header)} times"
        if header not in names:
            why = f"has no column {header!r}{suggestion(header, [name for name in names if name][:40])}"
        raise InputError(
            "B-IMP-003",
            why,
            where=f"{self._name}:{self._line}",
            next_step="correct the column of the mapping, or its 'file: {delimiter: ..., header: ...}'",
        )

    def _read(self, fields: list[str]) -> list[float]:
        if len(fields) == self._width + 1 and not fields[-1].strip():
            fields = fields[:-1]  # behind a delimiter at the end
        if len(fields) != self._width:
            raise ValueError(say("bad.fields", found=len(fields), due=self._width))
        t_ns = self._time.utc_ns(fields[self._time_at].strip())
        last = len(fields[-1])
        if self._open and self.counts.rows >= ENOUGH and last < self._shortest:
            raise ValueError
        over = []
        values = []
        for place, column in self._readers:
            text = fields[place].strip()
            number = self._sentinels.number(text)
            if number is None:
                over.append(column.quantity)
                number = math.nan
            elif not math.isfinite(number):
                raise ValueError(say("bad.column_not_finite", column=column.quantity, text=text))
            values.append(number)
        t_ns += self._ahead_ns
        if self._last_line == 0:
            self.first_ns = t_ns
        elif t_ns < self.last_ns:
            t_ns += self._further_ns(self.last_ns - t_ns)
        self._last_line, self.last_ns = self._line, t_ns
        self._shortest = min(self._shortest, last)
        self.counts.rows += 1
        if over:
            self.counts.overload_rows += 1
            self.counts.overloads.update(over)
        return [value * factor for value, factor in zip(values, self._factors, strict=True)]

    def _further_ns(self, back_ns: int) -> int:
        """Return what a counter of 32 bits lost when it began anew and went back by ``back_ns``."""
        usual_ns = (self.last_ns - self.first_ns) / max(1, self.counts.rows - 1)
        for tick, tick_ns in _TICKS.items():
            whole_ns = tick_ns << 32
            if self._may_wrap and 0 < whole_ns - back_ns <= FEW * usual_ns < whole_ns / RARE:
                self._ahead_ns += whole_ns
                self.counts.wraps[tick] += 1
                return whole_ns
        if self._open:
            raise ValueError
        raise InputError(
            "B-IMP-006",
            f"the time goes back by {back_ns / 1e9:g} s after line {self._last_line}",
            where=f"{self._name}:{self._line}",
            next_step="cut the file where the clock was set or the log began anew, and import the parts",
        )


class _Sentinels:
    """Tells numbers from what an instrument writes when it could not measure."""

    def __init__(self, overload: Overload, form: FileForm) -> None:
        self._limit = overload.at_least
        self._texts = {text.strip().casefold() for text in overload.values if isinstance(text, str)}
        self._numbers = {float(number) for number in overload.values if not isinstance(number, str)}
        self._comma = form.decimal == ","

    def without(self, numbers: NDArray[np.float64]) -> NDArray[np.float64]:
        """Return numbers of texts. Raises ValueError if one of them may be a sentinel, or is infinite."""
        beyond = np.abs(numbers).max() >= (np.inf if self._limit is None else self._limit)
        if (
            not np.isfinite(numbers).all()
            or beyond
            or self._comma
            or self._texts
            or np.isin(numbers, [*self._numbers]).any()
        ):
            raise ValueError
        return numbers

    def number(self, text: str) -> float | None:
        """Return the number that a text is, or None for a sentinel. Raises ValueError if it is neither."""
        if self._texts and text.casefold() in self._texts:
            return None
        if self._comma:
            if "." in text:
                raise ValueError(say("bad.decimal_comma", text=text))
            text = text.replace(",", ".")
        try:
            if "_" in text:
                raise ValueError(text)
            number = float(text)
        except ValueError:
            raise ValueError(say("bad.no_number", text=text)) from None
        beyond = self._limit is not None and abs(number) >= self._limit
        return None if beyond or number in self._numbers else number


def lines_of(chunks: Iterable[bytes]) -> Iterator[bytes]:
    """Yield lines, with their ends, of bytes that are cut anywhere; no more than a line over the limit is held."""
    rest = b""
    for chunk in chunks:
        *whole, rest = (rest + chunk).split(b"\n")
        yield from (line + b"\n" for line in whole)
        if len(rest) > MAX_LINE_BYTES:
            yield rest
            rest = b""
    if rest:
        yield rest
