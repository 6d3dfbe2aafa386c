"""Frames between delimiters, one packet each, on a wire whose bytes are escaped: SLIP, HDLC in bytes, COBS, and DLE
with STX or without; all else is as in the reference engine.

Sources: RFC 1055 (SLIP); RFC 1662, 4 (HDLC-like framing in octets); S. Cheshire, M. Baker, "Consistent overhead byte
stuffing", IEEE/ACM Trans. Netw. 7 (1999) 159; ISO 1745 and ANSI X3.28 (DLE STX … DLE ETX, DLE doubled); Trimble TSIP
(DLE, a first byte that is neither DLE nor ETX, … DLE ETX, DLE doubled).

The reference engine: one byte at a time, plain Python. It is the oracle of the vectorised engine.

At each position: no sync -> one byte on; sync but not all bytes there -> wait, unless the line has been silent since;
check, length or type wrong -> count one rejected candidate, one byte on; else accept the frame and go on behind it.
"""

from __future__ import annotations

import re
from collections.abc import Callable
from functools import partial
from typing import NamedTuple

import numpy as np

from bench.frame.batch import Decoder, FrameBatch, MessageBatch, rows_of_frames
from bench.frame.layout import Layout, Message
from bench.frame.parts import Refusal, measured, why_none

Pieces = dict[str, list[tuple[int, bytes]]]
"""By message the frames of a stream, each with its offset there."""


class ReferenceDecoder(Decoder):
    """Byte-at-a-time decoder; same interface and results as ``NumpyDecoder``."""

    def feed(self, chunk: bytes, final: bool = False, before: int = 0) -> FrameBatch:
        self.counts.bytes += len(chunk)
        stream = self._tail + chunk
        found: Pieces = {message.name: [] for message in self._layout.kinds}
        bad: list[int] = []
        at = 0
        pattern = self._layout.pattern
        while at < len(stream):
            may_wait = not final and self._position + at >= before
            if len(stream) - at < self._layout.sync_at + len(pattern) and may_wait:
                break
            if not stream.startswith(pattern, at + self._layout.sync_at):
                at += 1
                self.counts.skipped_bytes += 1
                continue
            head = stream[at : at + self._layout.header]
            read = measured(self._layout, head) if len(head) == self._layout.header else None
            if read is None or (not isinstance(read, Refusal) and at + read[1] > len(stream)):
                if may_wait:
                    break
                if not final:
                    bad.append(self._position + at)
            elif not isinstance(read, Refusal) and why_none(self._layout, read[0], stream[at : at + read[1]]) is None:
                found[read[0].name].append((at, stream[at : at + read[1]]))
                at += read[1]
                continue
            else:
                bad.append(self._position + at)
            at += 1
            self.counts.skipped_bytes += 1
        return self._batch(found, bad, stream, at)

    def _batch(self, found: Pieces, bad: list[int], stream: bytes, consumed: int) -> FrameBatch:
        numbers = [len(found[message.name]) for message in self._layout.kinds]
        messages = {}
        for message in self._layout.told:
            frames = found[message.name]
            offset = np.array([self._position + at for at, _ in frames], np.int64)
            rows, rest = rows_of_frames(message, (frame for _, frame in frames), self._layout.tail)
            batch = MessageBatch(message, offset, rows, rest)
            batch.ends = offset + np.array([len(frame) for _, frame in frames], np.int64)
            messages[message.name] = batch
        return self._decided(messages, numbers, np.array(bad, np.int64), stream, consumed)


_SLIP_END, _SLIP_ESC = b"\xc0", b"\xdb"
_FLAG, _CONTROL = b"\x7e", b"\x7d"
_DLE_CONTENT = re.compile(rb"(?:[^\x10]|\x10\x10)*", re.DOTALL)
_DLE_BEGIN, _DLE_ALONE = re.compile(rb"\x10\x02"), re.compile(rb"\x10(?=[^\x03\x10])", re.DOTALL)
_DLE_END = b"\x10\x03"
_COBS_LONGEST = 254


class Packet(NamedTuple):
    """One piece of a stream, [begin, end) on the wire with its delimiters.

    ``frame``: the bytes without escapes; empty between two delimiters and for ``noise`` outside packets, None where the
    escapes are wrong or no end comes.
    """

    begin: int
    end: int
    frame: bytes | None
    noise: bool = False


Search = Callable[[bytes, int, int], Packet | None]
"""Of a stream the piece at an offset, None while its end is not there; a packet of more than so many bytes is none."""


class Escape(NamedTuple):
    """One way of escaping: a frame to its bytes on the wire, the search for packets, the delimiter behind one."""

    packed: Callable[[bytes], bytes]
    next_packet: Search
    end: bytes


def _between(delimiter: bytes, unescape: Callable[[bytes], bytes | None]) -> Search:
    """Return the search for packets that end with a delimiter."""

    def next_packet(stream: bytes, at: int, longest: int) -> Packet | None:
        end = stream.find(delimiter, at, at + longest)
        if end >= 0:
            return Packet(at, end + 1, unescape(stream[at:end]))
        return Packet(at, at + longest, None) if len(stream) - at >= longest else None

    return next_packet


def _slip_packed(frame: bytes) -> bytes:
    escaped = frame.replace(_SLIP_ESC, b"\xdb\xdd").replace(_SLIP_END, b"\xdb\xdc")
    return _SLIP_END + escaped + _SLIP_END


def _slip_unescaped(packet: bytes) -> bytes | None:
    if re.search(rb"\xdb(?![\xdc\xdd])", packet):
        return None
    return packet.replace(b"\xdb\xdc", _SLIP_END).replace(b"\xdb\xdd", _SLIP_ESC)


def _hdlc_packed(frame: bytes) -> bytes:
    return _FLAG + re.sub(rb"[\x7d\x7e]", lambda match: bytes((0x7D, match[0][0] ^ 0x20)), frame) + _FLAG


def _hdlc_unescaped(packet: bytes) -> bytes | None:
    if packet.endswith(_CONTROL):
        return None  # the sender gave the packet up
    return re.sub(rb"\x7d(.)", lambda match: bytes((match[1][0] ^ 0x20,)), packet, flags=re.DOTALL)


def _cobs_packed(frame: bytes) -> bytes:
    out = bytearray()
    for number, block in enumerate(blocks := frame.split(b"\0")):
        while len(block) >= _COBS_LONGEST and (len(block) > _COBS_LONGEST or number < len(blocks) - 1):
            out += b"\xff" + block[:_COBS_LONGEST]
            block = block[_COBS_LONGEST:]
        out += bytes((len(block) + 1,)) + block
    return bytes(out) + b"\0"


def _cobs_unescaped(packet: bytes) -> bytes | None:
    out, at = bytearray(), 0
    while at < len(packet):
        code = packet[at]
        if at + code > len(packet):
            return None
        out += packet[at + 1 : at + code]
        at += code
        if code <= _COBS_LONGEST and at < len(packet):
            out.append(0)
    return bytes(out)


def _dle_packed(begin: bytes, frame: bytes) -> bytes:
    return begin + frame.replace(b"\x10", b"\x10\x10") + _DLE_END


def _dle_next(beginning: re.Pattern[bytes], stream: bytes, at: int, longest: int) -> Packet | None:
    first = beginning.search(stream, at)
    begin = -1 if first is None else first.start()
    if first is None or begin != at:
        end = begin if begin >= 0 else len(stream) - stream.endswith(b"\x10")
        return Packet(at, end, b"", noise=True) if end > at else None
    match = _DLE_CONTENT.match(stream, first.end(), at + longest)
    end = first.end() if match is None else match.end()
    if stream[end : end + 2] == _DLE_END:
        return Packet(at, end + 2, stream[first.end() : end].replace(b"\x10\x10", b"\x10"))
    if end + 1 < len(stream) or len(stream) - at >= longest:
        return Packet(at, end, None)
    return None


ESCAPES = {
    "slip": Escape(_slip_packed, _between(_SLIP_END, _slip_unescaped), _SLIP_END),
    "hdlc": Escape(_hdlc_packed, _between(_FLAG, _hdlc_unescaped), _FLAG),
    "cobs": Escape(_cobs_packed, _between(b"\0", _cobs_unescaped), b"\0"),
    "dle": Escape(partial(_dle_packed, b"\x10\x02"), partial(_dle_next, _DLE_BEGIN), _DLE_END),
    "dle_etx": Escape(partial(_dle_packed, b"\x10"), partial(_dle_next, _DLE_ALONE), _DLE_END),
}


ROOM = 2  # bytes on the wire for one of a frame, at most


class PacketDecoder(ReferenceDecoder):
    """Decoder of packets that a search finds, each of at most so many bytes on the wire; ``end``: what ends one.

    The last packet of a stream may lack its end if its check is right. A packet that is no frame is one rejected
    candidate. Offsets are those of the wire; delimiters belong to the packet that they end; noise outside packets, and
    rejected ones, are skipped.
    """

    def __init__(self, layout: Layout, search: Search, longest: int, end: bytes) -> None:
        super().__init__(layout)
        self._next = search
        self._longest, self._end = longest, end

    def feed(self, chunk: bytes, final: bool = False, before: int = 0) -> FrameBatch:
        self.counts.bytes += len(chunk)
        stream = self._tail + chunk
        found: Pieces = {message.name: [] for message in self._layout.kinds}
        ends: dict[str, list[int]] = {message.name: [] for message in self._layout.told}
        bad: list[int] = []
        at = taken = 0
        while at < len(stream):
            packet = self._next(stream, at, self._longest)
            if packet is None and final and self._layout.check.size:
                packet = self._next(stream + self._end, at, self._longest)
                packet = packet and packet._replace(end=len(stream))
            if packet is None:
                if not final and self._position + at >= before:
                    break
                bad += [] if final else [self._position + at]
                at = len(stream) if final else min(before - self._position, len(stream))
                continue
            at = packet.end
            read = self._frame_of(packet) if packet.frame else None
            if read is None and packet.frame != b"":
                bad.append(self._position + packet.begin)
                continue
            taken += 0 if packet.noise else packet.end - packet.begin
            if read is None:
                continue
            message, frame = read
            found[message.name].append((packet.begin, frame))
            if message.name in ends:
                ends[message.name].append(self._position + packet.end)
        self.counts.skipped_bytes += at - taken
        batch = self._batch(found, bad, stream, at)
        for name, stops in ends.items():
            batch.messages[name].ends = np.array(stops, np.int64)
        return batch

    def _frame_of(self, packet: Packet) -> tuple[Message, bytes] | None:
        """Return message and frame of a packet, None if it is no frame."""
        frame, layout = packet.frame, self._layout
        if frame is None or not frame.startswith(layout.pattern, layout.sync_at) or len(frame) < layout.header:
            return None
        read = measured(layout, frame)
        if isinstance(read, Refusal) or read[1] != len(frame) or why_none(layout, read[0], frame):
            return None
        return read[0], frame
