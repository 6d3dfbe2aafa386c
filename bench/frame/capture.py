"""Raw captures of any length, decoded block by block, and what a terminal or a text file has made of their bytes."""

from __future__ import annotations

import binascii
import re
import zlib
from codecs import utf_8_decode
from collections import Counter
from collections.abc import Callable, Iterable, Iterator, Mapping
from dataclasses import asdict, dataclass, replace
from io import BytesIO
from typing import Any, BinaryIO

from bench.frame.batch import MessageBatch
from bench.frame.definition import Engine, FrameDefinition
from bench.frame.layout import Layout
from bench.frame.packets import why_bad
from bench.frame.parts import Cause, Refusal
from bench.frame.stream import LinkBatch, LinkCounts, LinkDecoder

_BLOCK_BYTES = 4_000_000
_LEAST_BLOCK_BYTES = 1 << 10
_ROW_BYTES = 1 << 25  # of a block, at most, but for blocks of the least size
_EXPLAINED = 1000  # bad candidates of a capture whose cause is looked for
_HEAD_BYTES = 1 << 18  # of a capture, in which is looked for what mangled it
_MANGLED = 0.01  # share of a capture in no frame, from which on that is done
_SURE = 20  # bytes of each value beside one that is missing: by chance it is in one of 10^8 captures
_LOST = "what they were is lost: take the capture again in binary"
_UNKNOWN = Refusal("unknown", "was given up")
Take = Callable[[Mapping[str, MessageBatch]], None]


@dataclass(frozen=True)
class BadFrames:
    """Bad candidates of one cause: how many of the first thousand; of the first one its offset and what is wrong."""

    cause: Cause
    number: int
    offset: int
    text: str


@dataclass(frozen=True)
class Counted:
    """What a capture holds: counts, frames by message name, whether it ends inside a frame, what is bad and why.

    ``mangled``: sentences on what has changed its bytes on their way.
    """

    definition: FrameDefinition
    counts: LinkCounts
    messages: Mapping[str, int]
    cut_off: bool
    bad: tuple[BadFrames, ...] = ()
    mangled: tuple[str, ...] = ()

    def summary(self) -> dict[str, Any]:
        """JSON-able: the check; counts good, bad, other, lost, duplicate, suspect, of bytes; frames by message."""
        seen = asdict(self.counts)
        return {
            "frame": self.definition.name,
            "frame_sha256": self.definition.sha256,
            "check": self.definition.layout.check.name,
            "good": seen.pop("frames"),
            **seen,
            "messages": dict(self.messages),
            "cut_off": self.cut_off,
            "bad_because": [asdict(kind) for kind in self.bad],
            "mangled": list(self.mangled),
        }


def decode_capture(
    definition: FrameDefinition, stream: BinaryIO, take: Take = lambda messages: None, engine: Engine = "numpy"
) -> Counted:
    """Decode a capture to its end; without receive times a gap longer than a counter wrap looks shorter.

    Args:   take: gets the frames of each block by message name, in file order.
    Raises: OSError, and what ``take`` raises.
    """
    counted, head = _decoded(definition, stream, take, engine)
    if counted.counts.skipped_bytes <= _MANGLED * counted.counts.bytes:
        return counted
    return replace(counted, mangled=tuple(_mangled(definition, head)))


def _decoded(definition: FrameDefinition, stream: BinaryIO, take: Take, engine: Engine) -> tuple[Counted, bytes]:
    """Decode a capture to its end; also return its beginning."""
    link, causes, head = LinkDecoder(definition, engine), _Causes(definition.layout), b""
    frames: Counter[str] = Counter()

    def found(batch: LinkBatch) -> None:
        frames.update({name: len(messages) for name, messages in batch.messages.items()})
        causes.look_at(batch.bad_offset.tolist())
        take(batch.messages)

    while block := stream.read(_block_bytes(definition.layout)):
        link.push(0, block)
        causes.read(block)
        head = head or block[:_HEAD_BYTES]
        found(link.flush())
    cut_off = link.undecided_bytes >= _begun_bytes(definition.layout)
    found(tail := link.finish())
    cut_off = cut_off and not any(map(len, tail.messages.values()))
    messages = {name: frames[name] for name in definition.messages}
    return Counted(definition, link.counts, messages, cut_off, tuple(causes.found.values())), head


def _from_hex(head: bytes) -> bytes:
    digits = re.sub(rb"0[xX]|[\s,:;-]", b"", head)
    return binascii.unhexlify(digits[: len(digits) // 2 * 2])


def _from_base64(head: bytes) -> bytes:
    digits = b"".join(head.split())
    return binascii.a2b_base64(digits[: len(digits) // 4 * 4], strict_mode=True)


LAYERS: dict[str, Callable[[bytes], bytes]] = {
    "every LF became CR LF": lambda head: head.replace(b"\r\n", b"\n"),
    "every byte above 7F became UTF-8 of Latin-1": lambda head: utf_8_decode(head)[0].encode("latin-1"),
    "it is hex text": _from_hex,
    "it is base64 text": _from_base64,
    "it is compressed with gzip": lambda head: zlib.decompressobj(31).decompress(head, _HEAD_BYTES),
}
"""What may have been done to the bytes of a capture, with what undoes it; ValueError or zlib.error where it was not."""


def undone(head: bytes, deeper: bool = True) -> Iterator[tuple[str, bytes]]:
    """Give what the beginning of a capture was before a layer, or two of them, with their names."""
    for name, undo in LAYERS.items():
        try:
            before = undo(head)
        except (ValueError, zlib.error):
            continue
        if before and before != head:
            yield name, before
            yield from ((f"{name}; then {other}", first) for other, first in undone(before, False) if deeper)


def _mangled(definition: FrameDefinition, head: bytes) -> Iterator[str]:
    """Give what has changed the bytes of a capture: the layer that hides most frames, and bytes that are lost."""

    def good(stream: bytes) -> int:
        return _decoded(definition, BytesIO(stream), lambda messages: None, "numpy")[0].counts.frames

    now = good(head)
    frames, name = max(((good(before), name) for name, before in undone(head)), default=(0, ""))
    if frames > now + now // 50:
        yield f"{name}; undone, the first {len(head)} bytes hold {frames} good frames, {now} as they are"
    yield from _lost_bytes(definition.layout, head)


def _lost_bytes(layout: Layout, head: bytes) -> Iterator[str]:
    number = [head.count(value) for value in range(256)]
    cut, replaced = bytes(byte & 0x7F for byte in layout.pattern), head.count(b"\xef\xbf\xbd")
    if replaced and len(head.decode(errors="ignore").encode()) > len(head) - 4:
        yield f"{replaced} bytes that are no UTF-8 became EF BF BD; {_LOST}"
    if cut != layout.pattern and head.isascii() and (begins := head.count(cut)) > len(head) >> 8 * len(cut):
        places = f"the sync bytes stand there {begins} times as {cut.hex(' ')}"
        yield f"the highest bit of every byte is cut: {places}; {_LOST}"
    if number[0x0D] == 0 and min(number[0x0C], number[0x0E]) >= _SURE:
        yield f"no byte of the first {len(head)} is 0D: CR became LF (0A stands there {number[10]} times); {_LOST}"
    if number[0x11] == number[0x13] == 0 and min(number[0x10], number[0x12], number[0x14]) >= _SURE:
        yield f"no byte of the first {len(head)} is 11 or 13: XON and XOFF were taken out; {_LOST}"


def _block_bytes(layout: Layout) -> int:
    """Return how many bytes to read at once: fewer where short frames become long rows."""
    longer = max(message.body / max(1, message.least + layout.tail) for message in layout.messages)
    return min(_BLOCK_BYTES, max(_LEAST_BLOCK_BYTES, int(_ROW_BYTES / max(1.0, longer))))


def _begun_bytes(layout: Layout) -> int:
    """Return how many bytes that wait for more are surely the beginning of a frame."""
    if layout.escape or layout.lines:
        return max(1, len(layout.sync))
    return max(1, layout.sync_at + len(layout.pattern))


class _Causes:
    """Why the first bad candidates of a capture are bad; keeps as many bytes as one may need."""

    def __init__(self, layout: Layout) -> None:
        self.found: dict[Cause, BadFrames] = {}
        self._why, self._needs = why_bad(layout)
        self._left = _EXPLAINED
        self._bytes, self._begin = b"", 0

    def read(self, block: bytes) -> None:
        """Take the next bytes of the capture."""
        kept = max(0, len(self._bytes) - self._needs)
        self._begin += kept
        self._bytes = self._bytes[kept:] + block

    def look_at(self, bad: Iterable[int]) -> None:
        """Count the causes of candidates at these offsets, which lie in the bytes read last or just before."""
        for offset in list(bad)[: self._left]:
            self._left -= 1
            at = offset - self._begin
            refusal = self._why(self._bytes[at : at + self._needs]) or _UNKNOWN
            before = self.found.get(refusal.cause) or BadFrames(refusal.cause, 0, offset, refusal.text)
            self.found[refusal.cause] = replace(before, number=before.number + 1)
