"""Which decoder takes frames one by one, and what it would say of a candidate that is none."""

from __future__ import annotations

from collections.abc import Callable
from functools import partial

from bench.frame.layout import Layout
from bench.frame.packets.escape import ESCAPES, ROOM, PacketDecoder
from bench.frame.packets.lines import LineDecoder, LineReader, search_of
from bench.frame.reference import ReferenceDecoder
from bench.frame.refusal import Refusal, why_refused
from bench.frame.spec import LinesSpec

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
