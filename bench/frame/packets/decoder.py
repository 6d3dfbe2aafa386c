"""Frames between delimiters: one packet, one frame; all else is as in the reference engine."""

from __future__ import annotations

import numpy as np

from bench.frame.batch import FrameBatch
from bench.frame.layout import Layout, Message
from bench.frame.packets.escape import Packet, Search
from bench.frame.reference import Pieces, ReferenceDecoder
from bench.frame.refusal import Refusal, measured, why_none

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
