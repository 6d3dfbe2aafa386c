"""How frames are set apart on a wire whose bytes are escaped: SLIP, HDLC in bytes, COBS, and DLE with STX or without.

Sources: RFC 1055 (SLIP); RFC 1662, 4 (HDLC-like framing in octets); S. Cheshire, M. Baker, "Consistent overhead byte
stuffing", IEEE/ACM Trans. Netw. 7 (1999) 159; ISO 1745 and ANSI X3.28 (DLE STX … DLE ETX, DLE doubled); Trimble TSIP
(DLE, a first byte that is neither DLE nor ETX, … DLE ETX, DLE doubled).
"""

from __future__ import annotations

import re
from collections.abc import Callable
from functools import partial
from typing import NamedTuple

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
