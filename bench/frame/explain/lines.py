"""What a raw capture says about lines of text in it: how they begin, what separates their values, their check."""

from __future__ import annotations

import re
from collections import Counter
from collections.abc import Iterable
from dataclasses import dataclass
from typing import Any, NamedTuple

from bench.frame.explain.frames import LOOKED_AT_BYTES, small_checks

_MARKS = "!#$%&'*+/:;<=>?@^_`|~"
_CHECKED = re.compile(rb"([!-/:-@\[-`{-~])((?:[0-9A-Fa-f]{2}){1,4})$")
_PRINTABLE = bytes(range(0x20, 0x7F)) + b"\t"
_LONGEST = 4094  # bytes of a line without its end
_MOST_VALUES = 100
_SEPARATORS = ",;\t|: "
_FEWEST = 5
_MANY = 200  # lines on which a check is judged
_RIGHT = 0.8
_COVERED, _COVERED_WITHOUT_CHECK = 0.2, 0.9  # share of the capture that lines must explain


@dataclass(frozen=True)
class LineGuess:
    """Lines that begin with ``sync``; ``mark``: the character before the check, "" without one.

    ``check`` is "none" without one; ``over_sync``: whether it covers the sync bytes. ``lines`` without their ends.
    """

    sync: bytes
    separator: str
    mark: str
    check: str
    over_sync: bool
    lines: tuple[bytes, ...]
    covered: float

    @property
    def body(self) -> list[bytes]:
        """The lines without sync bytes and check."""
        bare = [line[len(self.sync) :] for line in self.lines]
        return [line.rpartition(self.mark.encode())[0] for line in bare] if self.mark else bare


def line_guess(capture: bytes) -> LineGuess | None:
    """Return what the lines of a capture are: those with a check that is right in four of five, else all."""
    capture = capture[:LOOKED_AT_BYTES]
    return _checked(capture) or _plain(capture)


class _Line(NamedTuple):
    """A line that ends like one with a check: bytes covered, from the sync bytes on; mark; digits of the check."""

    text: bytes
    mark: bytes
    digits: bytes


def _checked(capture: bytes) -> LineGuess | None:
    lines = [line.rstrip(b"\r") for line in capture.split(b"\n") if len(line) <= _LONGEST]
    ends = [line[len(line.rstrip(_PRINTABLE)) :] for line in lines]
    for sync in _most_common(begin for end in ends for begin in {chr(byte) for byte in end} if begin in _MARKS):
        found = [line for end in ends if (line := _line(end[max(0, end.rfind(sync)) :], sync)) is not None]
        for mark, size in _most_common((line.mark, len(line.digits)) for line in found):
            alike = [line for line in found if (line.mark, len(line.digits)) == (mark, size)]
            guess = _with_check(capture, sync, alike)
            if guess is not None:
                return guess if guess.covered >= _COVERED else None
    return None


def _line(line: bytes, sync: bytes) -> _Line | None:
    match = _CHECKED.search(line)
    if match is None or not line.startswith(sync) or match.start() < 2:
        return None
    return _Line(line[: match.start()], match[1], match[2])


def _most_common(values: Iterable[Any]) -> list[Any]:
    """Return up to three values that occur often enough, characters as bytes."""
    often = [value for value, number in Counter(values).most_common(3) if number >= _FEWEST]
    return [value.encode() if isinstance(value, str) else value for value in often]


def _with_check(capture: bytes, sync: bytes, found: list[_Line]) -> LineGuess | None:
    """Return the lines with the check that is right in them."""
    tried = found[:: max(1, len(found) // _MANY)][:_MANY]
    width = len(found[0].digits)
    for check in small_checks(width // 2):
        for over_sync in (False, True):
            dues = [f"{check.of(line.text[0 if over_sync else len(sync) :]):0{width}X}".encode() for line in tried]
            right = sum(line.digits.upper() == due for line, due in zip(tried, dues, strict=True))
            if right >= _RIGHT * len(tried) and len(set(dues)) > 1:
                lines = tuple(line.text + line.mark + line.digits for line in found)
                share = sum(len(line) + 2 for line in lines) / len(capture)
                mark = found[0].mark.decode()
                return LineGuess(sync, _separator(lines), mark, check.name, over_sync, lines, min(1.0, share))
    return None


def _plain(capture: bytes) -> LineGuess | None:
    whole = capture[: capture.rfind(b"\n") + 1].replace(b"\r\n", b"\n")
    lines = [line for line in whole.split(b"\n") if line]
    printable = [line for line in lines if len(line) <= _LONGEST and not line.strip(_PRINTABLE)]
    share = sum(len(line) + 1 for line in printable) / max(1, len(whole))
    if len(printable) < _FEWEST or share < _COVERED_WITHOUT_CHECK:
        return None
    separator = _separator(printable)
    counts = Counter(len(values_of(line, separator)) for line in printable)
    values, often = counts.most_common(1)[0]
    if not 2 <= values <= _MOST_VALUES or often < _RIGHT * len(printable):
        return None
    alike = tuple(line for line in printable if len(values_of(line, separator)) == values)
    return LineGuess(b"", separator, "", "none", False, alike, share)


def values_of(line: bytes, separator: str) -> list[str]:
    """Return the values of a line as it is read: between spaces none is empty, spaces beside others do not count."""
    values = line.decode("ascii", "replace").split(separator)
    return [value for value in values if value] if separator == " " else [value.strip(" ") for value in values]


def _separator(lines: tuple[bytes, ...] | list[bytes]) -> str:
    """Return the character that stands in most lines, of several the one that stands there most often."""
    number = {one: (sum(one.encode() in line for line in lines), sum(line.count(one.encode()) for line in lines))
              for one in _SEPARATORS}  # fmt: skip
    return max(_SEPARATORS, key=lambda one: number[one])
