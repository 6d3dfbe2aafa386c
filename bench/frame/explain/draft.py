"""From what a capture says about its frames to the first lines of a definition.

What a raw capture says about lines of text in it: how they begin, what separates their values, their check.
"""

from __future__ import annotations

import json
import re
from collections import Counter
from collections.abc import Iterable
from dataclasses import dataclass
from math import isfinite
from typing import Any, NamedTuple

from bench.frame.explain.frames import LEVEL, LOOKED_AT_BYTES, Guess, chance_of, small_checks

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
_NUMBER = re.compile(r"[+-]?(\d+\.?\d*|\.\d+)([eE][+-]?\d+)?", re.ASCII)
_CHECK_TYPES = {1: "u8", 2: "u16", 3: "u24", 4: "u32", 8: "u64"}


@dataclass(frozen=True)
class LineGuess:
    """Lines that begin with ``sync``; ``mark``: the character before the check, "" without one.

    ``check`` is "none" without one; ``over_sync``: whether it covers the sync bytes. ``lines`` without their ends.
    ``covered``, ``chance``: as in Guess.
    """

    sync: bytes
    separator: str
    mark: str
    check: str
    over_sync: bool
    lines: tuple[bytes, ...]
    covered: float
    chance: float = 0.0

    @property
    def body(self) -> list[bytes]:
        """The lines without sync bytes and check."""
        bare = [line[len(self.sync) :] for line in self.lines]
        return [line.rpartition(self.mark.encode())[0] for line in bare] if self.mark else bare


def line_guess(capture: bytes) -> LineGuess | None:
    """Return what the lines of a capture are: those with a check that is right in four of five, else all."""
    capture = capture[:LOOKED_AT_BYTES]
    guess = _checked(capture) or _plain(capture)
    return guess if guess is not None and guess.chance <= LEVEL else None


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
                mark, chance = found[0].mark.decode(), chance_of(len(tried), right, 16.0**-width)
                return LineGuess(sync, _separator(lines), mark, check.name, over_sync, lines, min(1.0, share), chance)
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
    chance = chance_of(len(whole), int(share * len(whole)), len(_PRINTABLE) / 256)
    return LineGuess(b"", separator, "", "none", False, alike, share, chance)


def values_of(line: bytes, separator: str) -> list[str]:
    """Return the values of a line as it is read: between spaces none is empty, spaces beside others do not count."""
    values = line.decode("ascii", "replace").split(separator)
    return [value for value in values if value] if separator == " " else [value.strip(" ") for value in values]


def _separator(lines: tuple[bytes, ...] | list[bytes]) -> str:
    """Return the character that stands in most lines, of several the one that stands there most often."""
    number = {one: (sum(one.encode() in line for line in lines), sum(line.count(one.encode()) for line in lines))
              for one in _SEPARATORS}  # fmt: skip
    return max(_SEPARATORS, key=lambda one: number[one])


def draft(guess: Guess | LineGuess, capture: bytes, name: str) -> str:
    """Return the YAML of a definition of frames that a capture holds; what their bytes mean is for the author."""
    return _of_lines(guess, name) if isinstance(guess, LineGuess) else _of_frames(guess, capture, name)


def _of_lines(guess: LineGuess, name: str) -> str:
    """Return the YAML of lines: with a check the first value, which may be the type; else all values."""
    bodies = [values_of(body, guess.separator) for body in guess.body]
    best = next((at for at, values in enumerate(bodies) if values[0]), 0)
    longest, end = max(map(len, guess.lines)), "crc: {name: none}"
    sync, more, check = "", "", ""
    fields, expect = [], ""
    if guess.mark:
        sync, more, check = f"0x{guess.sync[0]:02X}", ", more: true", f", check: {json.dumps(guess.mark)}"
        most = max(1, *(len(values[0]) for values in bodies))
        fields = [f"{{name: address, type: bytes, count: {most}}} # the values behind it are yours to name"]
        expect = f"address: {json.dumps(bodies[best][0])}"
        end = f"crc: {{name: {guess.check}, over: [{'sync' if guess.over_sync else 'address'}, end]}}"
    else:
        for number, column in enumerate(zip(*bodies, strict=True), 1):
            is_number = all(not text or (_NUMBER.fullmatch(text) and isfinite(float(text))) for text in column)
            kind = "f64" if is_number else f"bytes, count: {max(1, *map(len, column))}"
            fields.append(f"{{name: value_{number}, type: {kind}}}")
            if not expect and column[best]:
                expect = f"value_{number}: {float(column[best]) if is_number else json.dumps(column[best])}"
    separator = json.dumps(guess.separator)
    lines = f"lines: {{separator: {separator}{check}, max: {longest + 2}{more}}} # the longest one seen"
    listed = "\n".join(f"  - {field}" for field in fields)
    golden = json.dumps(guess.lines[best].decode("ascii", "replace"))
    return f"frame: {name}\nsync: [{sync}]\n{lines}\nfields:\n{listed}\n{end}\ngolden: {golden}\nexpect: {{{expect}}}\n"


def _of_frames(guess: Guess, capture: bytes, name: str) -> str:
    whole = guess.body_at + guess.behind
    golden = min((frame for frame in guess.frames(capture) if len(frame) > whole), key=len)
    check, length = guess.check, guess.length
    big = length.big if length else check is not None and check.big
    begin = min(len(guess.sync), check.start) if check and check.start else len(guess.sync)
    lines = [f"frame: {name}", f"endian: {'big' if big else 'little'}", f"sync: [{_list(guess.sync[:begin])}]"]
    if guess.trailer:
        lines.append(f"trailer: [{_list(golden[-guess.trailer :])}]")
    lines.append("fields:")
    fields = _fields(guess, golden, begin)
    lines += [f"  - {text}" for _, text in fields]
    if length:
        lines.append(
            f"length: {{field: length, plus: {length.plus}, max: {max(guess.lengths)}}} # the longest one seen"
        )
    if check is None:
        lines.append("crc: {name: none} # no check that is known is right in these frames")
    else:
        over = (
            "sync"
            if check.start == 0
            else next(text.partition("name: ")[2].partition(",")[0] for at, text in fields if at == check.start)
        )
        place = "" if check.at is None else "field: check, "
        stored = f", stored: {'big' if check.big else 'little'}" if check.at is None and check.size > 1 else ""
        told = f" # or {' or '.join(check.also)}: these frames cannot tell" if check.also else ""
        lines.append(f"crc: {{name: {check.name}, {place}over: [{over}, end]{stored}}}{told}")
    body = golden[guess.body_at : len(golden) - guess.behind]
    lines += [f'golden: "{golden.hex(" ")}"', f'expect: {{body: "{body.hex(" ")}"}}']
    return "\n".join(lines) + "\n"


def _fields(guess: Guess, golden: bytes, begin: int) -> list[tuple[int, str]]:
    """Return places and YAML of the fields: what is known, and bytes between and behind."""
    check, length = guess.check, guess.length
    known: dict[int, tuple[int, str]] = {}
    if begin < len(guess.sync):
        rest = guess.sync[begin:]
        text = f'{{name: address, type: bytes, count: {len(rest)}, constant: "{rest.hex(" ")}"}}'
        known[begin] = len(rest), text
    if length:
        known[length.at] = length.size, f"{{name: length, type: u{8 * length.size}}}"
    if check and check.at is not None:
        order = "" if check.size == 1 else f", endian: {'big' if check.big else 'little'}"
        known[check.at] = check.size, f"{{name: check, type: {_CHECK_TYPES[check.size]}{order}}}"
    fields: list[tuple[int, str]] = []
    at, end = begin, guess.body_at
    while at < end:
        if at not in known:
            after = min([place for place in known if place > at] + [end])
            after = min(after, check.start) if check and check.start > at else after
            known[at] = after - at, f"{{name: head{len(fields)}, type: bytes, count: {after - at}}}"
        fields.append((at, known[at][1]))
        at += known[at][0]
    count = "rest" if length else str(len(golden) - end - guess.behind)
    return [*fields, (end, f"{{name: body, type: bytes, count: {count}}}")]


def _list(values: bytes) -> str:
    return ", ".join(f"0x{byte:02X}" for byte in values)
