"""From what a capture says about its frames to the first lines of a definition."""

from __future__ import annotations

import json
import re
from math import isfinite

from bench.frame.explain.frames import Guess
from bench.frame.explain.lines import LineGuess, values_of

_NUMBER = re.compile(r"[+-]?(\d+\.?\d*|\.\d+)([eE][+-]?\d+)?", re.ASCII)
_CHECK_TYPES = {1: "u8", 2: "u16", 3: "u24", 4: "u32", 8: "u64"}


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
        over = "sync" if check.start == 0 else next(name for at, name in _names(fields) if at == check.start)
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


def _names(fields: list[tuple[int, str]]) -> list[tuple[int, str]]:
    return [(at, text.partition("name: ")[2].partition(",")[0]) for at, text in fields]


def _list(values: bytes) -> str:
    return ", ".join(f"0x{byte:02X}" for byte in values)
