"""Lines of text: NMEA 0183 and other values between separators, with a check in hex digits or none.

A line that is read becomes the bytes of a frame without escapes or check, so that all behind it is as for other frames.
Sources: NMEA 0183 as in the u-blox M8 receiver description, "NMEA protocol" (frame structure, checksum, empty values,
degrees and minutes).

Behind it: which decoder takes frames one by one, and what it would say of a candidate that is none.
"""

from __future__ import annotations

import math
import re
import struct
from collections.abc import Callable
from functools import partial
from typing import NamedTuple

from bench.frame.layout import Field, Layout, Message
from bench.frame.packets.escape import ESCAPES, ROOM, Packet, PacketDecoder, ReferenceDecoder, Search
from bench.frame.parts import Refusal, why_refused
from bench.frame.spec import LinesSpec

_FLOAT = re.compile(r"[+-]?(?:\d+\.?\d*|\.\d+)(?:[eE][+-]?\d+)?", re.ASCII)
_INTEGER = re.compile(r"[+-]?\d+", re.ASCII)
_HEX = re.compile(r"(?:0[xX])?[0-9a-fA-F]+", re.ASCII)
_TIME = re.compile(r"([01]\d|2[0-3])([0-5]\d)([0-5]\d(?:\.\d*)?|60(?:\.\d*)?)", re.ASCII)
_ANGLE = re.compile(r"(\d{1,3})([0-5]\d(?:\.\d*)?)", re.ASCII)
_LETTERS = {"latitude": "NS", "longitude": "EW"}
_END = b"\r\n"
_CONTENT = re.compile(rb"[\t\x20-\x7e]*")


class LineDecoder(PacketDecoder):
    """Decoder of lines: LF or CR LF ends one, its next sync bytes give up one that was begun."""

    def __init__(self, layout: Layout, lines: LinesSpec) -> None:
        super().__init__(layout, search_of(layout.sync), lines.max, b"\n")
        self._read = LineReader(layout, lines).read

    def _frame_of(self, packet: Packet) -> tuple[Message, bytes] | None:
        read = None if packet.frame is None else self._read(packet.frame)
        return None if isinstance(read, Refusal) else read


def search_of(sync: bytes) -> Search:
    """Return the search for lines that begin with these bytes; without any, every line is one.

    Then the rest of a line that is too long, or that holds a CR alone, is passed over up to its end.
    """
    if not sync:
        return _EveryLine()
    content = re.compile(rb"(?:(?!%b)[\t\x20-\x7e])*" % re.escape(sync))

    def next_line(stream: bytes, at: int, longest: int) -> Packet | None:
        begin = stream.find(sync, at)
        if begin != at:
            end = begin if begin >= 0 else len(stream) - _begun(stream, sync)
            return Packet(at, end, b"", noise=True) if end > at else None
        match = content.match(stream, at + len(sync), at + longest)
        end = at + len(sync) if match is None else match.end()
        behind = stream[end : end + 2]
        if end - at < longest:
            if behind == _END or behind[:1] == b"\n":
                return Packet(at, end + (2 if behind == _END else 1), stream[at + len(sync) : end])
            if behind in (b"", b"\r"):
                return None
        return Packet(at, max(end, at + 1), None)

    return next_line


class _EveryLine:
    """Search for lines of which every one counts."""

    def __init__(self) -> None:
        self._inside = False  # of a line that was rejected

    def __call__(self, stream: bytes, at: int, longest: int) -> Packet | None:
        """Return the line at an offset, None while its end is not there."""
        if at >= len(stream):
            return None
        end = stream.find(b"\n", at)
        if self._inside:
            self._inside = end < 0
            return Packet(at, len(stream) if end < 0 else end + 1, b"", noise=True)
        whole = end >= 0 and end - at < longest
        if whole:
            line = stream[at : end - (stream[end - 1 : end] == b"\r" and end > at)]
            return Packet(at, end + 1, None if b"\r" in line else line)
        if end < 0 and len(stream) - at < longest:
            return None
        self._inside = True
        return Packet(at, at + longest, None)


def _begun(stream: bytes, sync: bytes) -> int:
    """Return how many of the last bytes may be the first of the sync bytes."""
    return next((size for size in range(len(sync) - 1, 0, -1) if stream.endswith(sync[:size])), 0)


class LineReader:
    """Reads lines: all that a layout says of them is worked out once."""

    def __init__(self, layout: Layout, lines: LinesSpec) -> None:
        self._layout = layout
        self._mark = b"" if lines.check is None else lines.check.encode()
        self._covered = layout.sync if layout.messages[0].cover_start == 0 else b""
        self._digits = 2 * layout.check.size
        self._one_space = lines.separator == " "
        self._separators = re.compile(f"[{re.escape(lines.separator)}]")
        self._more = lines.more
        self._types = [(message, _like(message.type_text)) for message in layout.messages]
        self._slots = {message.name: _slots(message) for message in layout.kinds}
        common = self._slots[layout.messages[0].name]
        self._type_at = next((slot.start for slot in common if slot.item is layout.type_field), 0)

    def read(self, line: bytes, due_message: Message | None = None) -> tuple[Message, bytes] | Refusal:
        """Return message and fields of a line without its sync bytes and end, or why it is none.

        Empty floats are NaN, empty bytes zeros; an empty integer is none. ``due_message``: of a golden line.
        """
        body = self._without_check(line)
        if isinstance(body, Refusal):
            return body
        if not _CONTENT.fullmatch(body):
            return Refusal("contents", "holds bytes that cannot be printed")
        values = self._split(body.decode("ascii"))
        message = self._message_of(values)
        if message is None or due_message not in (None, message):
            listed = self._layout.messages if due_message is None else (due_message,)
            types = " or ".join(item.type_text for item in listed[:6]) + " …" * (len(listed) > 6)
            value = values[self._type_at] if self._type_at < len(values) else ""
            return Refusal("type", f"has the type {value!r}, due is {types}")
        if message is self._layout.unlisted and message not in self._layout.told:
            return message, b""
        slots = self._slots[message.name]
        due_values = slots[-1].stop
        more = self._more or message is self._layout.unlisted
        if len(values) < due_values or (len(values) > due_values and not more):
            return Refusal("contents", f"has {len(values)} values, {message.name!r} has {due_values}")
        return self._packed(message, slots, values)

    def _without_check(self, line: bytes) -> bytes | Refusal:
        """Return a line in front of its check, or why the check is wrong."""
        if not self._mark:
            return line
        body, mark, digits = line.rpartition(self._mark)
        if not mark:
            return Refusal("check", f"has no check: there is no {self._mark.decode()!r}")
        due = f"{self._layout.check.of(self._covered + body):0{self._digits}X}"
        if digits.upper() == due.encode():
            return body
        there = f"behind {self._mark.decode()!r} stands {digits.decode('ascii', 'replace')!r}"
        return Refusal("check", f"fails its check: {self._layout.check.name} is {due}, {there}")

    def _split(self, body: str) -> list[str]:
        if self._one_space:
            return [value for value in body.split(" ") if value]
        return [value.strip(" ") for value in self._separators.split(body)]

    def _message_of(self, values: list[str]) -> Message | None:
        if self._layout.type_field is None:
            return self._layout.messages[0]
        value = values[self._type_at] if self._type_at < len(values) else ""
        return next((message for message, is_it in self._types if is_it(value)), self._layout.unlisted)

    def _packed(self, message: Message, slots: list[_Slot], values: list[str]) -> tuple[Message, bytes] | Refusal:
        row = [self._layout.sync]
        for item, start, stop, pack in slots:
            value = values[start] if stop - start == 1 else f"{values[start]},{values[start + 1]}"
            try:
                packed = pack(value)
            except (OverflowError, struct.error):
                packed = None
            if packed is None:
                return Refusal("contents", _why_no_value(value, item))
            row.append(packed)
        return message, b"".join(row)


class _Slot(NamedTuple):
    """One value of a message: its field, the values of a line [start, stop) that say it, and what makes bytes of it."""

    item: Field
    start: int
    stop: int
    pack: Callable[[str], bytes | None]


def _slots(message: Message) -> list[_Slot]:
    slots: list[_Slot] = []
    at = 0
    for item in message.fields:
        for _ in range(1 if item.kind == "b" else item.count or 1):
            stop = at + (2 if item.form in _LETTERS else 1)
            slots.append(_Slot(item, at, stop, _packer(item)))
            at = stop
    return slots


def _like(text: str) -> Callable[[str], object]:
    """Return what says whether a value is of a type; a '?' in it stands for any character."""
    return re.compile("".join("." if char == "?" else re.escape(char) for char in text), re.DOTALL).fullmatch


def _packer(item: Field) -> Callable[[str], bytes | None]:
    """Return what makes the bytes of a field of one value, None if it does not fit."""
    if item.kind == "b":
        most = item.length
        return lambda value: None if len(value) > most else value.encode().ljust(most, b"\0")
    if item.kind == "f":
        return partial(_packed_float, _READ.get(item.form, _float), struct.Struct(item.float_code).pack)
    digits, base = (_HEX, 16) if item.form == "hex" else (_INTEGER, 10)

    def integer(value: str) -> bytes | None:
        if not digits.fullmatch(value):
            return None
        return int(value, base).to_bytes(item.size, item.order, signed=item.kind == "i")

    return integer


def _why_no_value(value: str, item: Field) -> str:
    if item.kind == "b":
        return f"{item.name}: {value!r} has {len(value)} characters, its 'count' is {item.length}"
    kind = "float" if item.kind == "f" else "unsigned integer" if item.kind == "u" else "integer"
    form = f" in the form {item.form!r}" if item.form else ""
    empty = "; an empty value needs f32 or f64" if not value and item.kind != "f" else ""
    return f"{item.name}: {value!r} is no {kind} of {8 * item.size} bits{form}{empty}"


def _packed_float(number_of: Callable[[str], float | None], pack: Callable[[float], bytes], value: str) -> bytes | None:
    number = number_of(value)
    return None if number is None or math.isinf(number) else pack(number)


def _float(value: str) -> float | None:
    if not value:
        return math.nan
    return float(value) if _FLOAT.fullmatch(value) else None


def _seconds(value: str) -> float | None:
    """Return hhmmss.ss as seconds of the day."""
    if not value:
        return math.nan
    match = _TIME.fullmatch(value)
    return int(match[1]) * 3600 + int(match[2]) * 60 + float(match[3]) if match else None


def _degrees(value: str, positive: str, negative: str, limit: float) -> float | None:
    """Return dddmm.mmmm and a letter as degrees, positive to north and east."""
    angle, _, letter = value.partition(",")
    if not angle and not letter:
        return math.nan
    match = _ANGLE.fullmatch(angle)
    if match is None or letter not in (positive, negative):
        return None
    degrees = int(match[1]) + float(match[2]) / 60
    return None if degrees > limit else degrees if letter == positive else -degrees


_READ: dict[str, Callable[[str], float | None]] = {
    "time": _seconds,
    "latitude": lambda value: _degrees(value, "N", "S", 90.0),
    "longitude": lambda value: _degrees(value, "E", "W", 180.0),
}


WhyBad = Callable[[bytes], Refusal | None]
"""Says why bytes are no frame, from the first one of a rejected candidate on; None if a frame begins there."""


def one_by_one(layout: Layout) -> ReferenceDecoder:
    """Return the decoder of lines, of escaped packets, or of frames byte by byte."""
    if layout.lines:
        return LineDecoder(layout, layout.lines)
    if layout.escape:
        escape = ESCAPES[layout.escape]
        return PacketDecoder(layout, escape.next_packet, ROOM * layout.max_length + 4, escape.end)
    return ReferenceDecoder(layout)


def why_bad(layout: Layout) -> tuple[WhyBad, int]:
    """Return what says why candidates are rejected, and how many bytes of each it needs at most."""
    if layout.lines:
        return partial(_of_line, layout, layout.lines, LineReader(layout, layout.lines)), layout.lines.max
    if layout.escape:
        return partial(_of_packet, layout), ROOM * layout.max_length + 4
    return partial(why_refused, layout), layout.max_length


def _of_line(layout: Layout, lines: LinesSpec, reader: LineReader, candidate: bytes) -> Refusal | None:
    packet = search_of(layout.sync)(candidate, 0, lines.max)
    if packet is not None and packet.frame is None and layout.sync and candidate.startswith(layout.sync, packet.end):
        return Refusal("contents", "is cut off by the sync bytes of the next one")
    if packet is None or packet.frame is None:
        return Refusal("contents", f"has no end within {lines.max} bytes, or holds what cannot be printed")
    read = reader.read(packet.frame)
    return read if isinstance(read, Refusal) else None


def _of_packet(layout: Layout, candidate: bytes) -> Refusal | None:
    packet = ESCAPES[layout.escape].next_packet(candidate, 0, ROOM * layout.max_length + 4)
    if packet is None or not packet.frame:
        return Refusal("escape", "has wrong escapes, or no end")
    if len(packet.frame) < layout.header or not packet.frame.startswith(layout.pattern, layout.sync_at):
        return Refusal("contents", f"of {len(packet.frame)} bytes begins with {packet.frame[:4].hex(' ')}")
    return why_refused(layout, packet.frame, exact=True)
