"""From chunks to messages: envelope, running number and hash chain of every segment in turn."""

from __future__ import annotations

import json
import struct
import zlib
from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np

from bench.record import layout
from bench.record import mcap_format as mcap
from bench.record.block import BLOCK_BYTES, Block, Records, Stretch, block_of, proved, stretches, taken_apart, unpacked
from bench.record.layout import Message
from bench.record.mcap_format import Content, Summary, channel_of, let_go, read_summary
from bench.record.scan import Damage, SegmentScan, Span, chain_value, note

_ENVELOPED = mcap.ENVELOPED
_STAMP_AT = 35  # first byte of an enveloped message that its CRC covers
_PAYLOAD_AT = _ENVELOPED.size
_SHORTEST = _ENVELOPED.size - mcap.RECORD.size


@dataclass(slots=True)
class _Topic:
    name: str
    seed: int
    bench: bool
    wanted: bool
    count: int = 0


class Walk:
    """One pass through the segments of a session, in order."""

    def __init__(self, topics: frozenset[str] | None) -> None:
        self._selection = topics
        self._known: dict[str, _Topic] = {}
        self._channels: dict[int, _Topic] = {}
        self._scan = SegmentScan("", b"", False)
        self._sealed = False
        self.damage: list[Damage] = []
        self.unfinished: list[str] = []
        self.chain = layout.CHAIN_START
        self.expected = 0
        self.ends: list[bytes] = []  # chain values behind each segment

    @property
    def counts(self) -> dict[str, int]:
        """Good messages by topic."""
        return {name: topic.count for name, topic in sorted(self._known.items()) if topic.count}

    @property
    def topics(self) -> dict[int, str]:
        """Topics by channel number."""
        return {number: topic.name for number, topic in sorted(self._channels.items())}

    def segment(self, name: str, content: Content) -> Iterator[Message]:
        """Yield all good and wanted messages of the next segment; verifies what can be verified."""
        for block in self.blocks(name, content):
            yield from block.messages(self._selection)

    def blocks(self, name: str, content: Content) -> Iterator[Block]:
        """Yield the same messages, and perhaps others, by the block; from the first doubt on they are seen singly."""
        scan = self._begin(name, content, read_summary(content))
        at = 0
        for stretch in stretches(content):
            block = self._block(content, stretch)
            if block is None:
                break
            yield block
            let_go(content)
            at = stretch.next_at
        singly: list[Message] = []
        size = 0
        for span in scan.spans(at):
            singly += self._messages(span)
            size += len(span.records)
            if size >= BLOCK_BYTES:
                yield Block.of(singly)
                let_go(content)
                singly, size = [], 0
        if singly:
            yield Block.of(singly)
        self._end(scan)

    def _block(self, content: Content, stretch: Stretch) -> Block | None:
        """Return the messages of some chunks if all are as they were written, and in order; else nothing is changed."""
        plain = unpacked(content, stretch)
        found = None if plain is None else taken_apart(*plain)
        if plain is None or found is None:
            return None
        numbers = found.heads["channel"]
        topics = self._with_new(found)
        present = np.flatnonzero(np.bincount(numbers)).tolist()
        if topics is None or not all(number in topics and topics[number].bench for number in present):
            return None
        sequence = np.arange(self.expected, self.expected + len(numbers), dtype=np.uint64)
        if not np.array_equal(found.heads["sequence"], sequence):
            return None
        seeds = np.zeros(1 + max(present, default=0), np.int64)
        seeds[present] = [topics[number].seed for number in present]
        if layout.CHAIN in (topics[number].name for number in present) or not proved(plain[0], found, seeds[numbers]):
            return None
        self._channels = topics
        self.expected += len(numbers)
        for number, count in enumerate(np.bincount(numbers).tolist()):
            if count:
                topics[number].count += count
        return block_of(plain[0], found, {number: topic.name for number, topic in topics.items()})

    def _with_new(self, found: Records) -> dict[int, _Topic] | None:
        """Return the topics with those that begin in a block; None if one is another than before, or begins late."""
        topics = dict(self._channels)
        for place, number, name in found.channels:
            if number not in topics:
                users = found.at[found.heads["channel"] == number]
                if len(users) and users[0] < place:
                    return None
            elif topics[number].name != name:
                return None
            topics[number] = self._topic(name)
        return topics

    def chunks(self, name: str, content: bytes, summary: Summary, offsets: list[int]) -> Iterator[Message]:
        """Wanted messages of some chunks of a finished segment, without a check of order or hash chain."""
        scan = self._begin(name, content, summary)
        for offset in offsets:
            for span in scan.chunk_at(offset):
                self.expected = -1
                yield from self._messages(span)

    def _begin(self, name: str, content: Content, summary: Summary | None) -> SegmentScan:
        self._scan = SegmentScan(name, content, summary is not None, self.damage)
        self._sealed = False
        for number, topic in (summary.channels if summary else {}).items():
            self._channels[number] = self._topic(topic)
        return self._scan

    def _end(self, scan: SegmentScan) -> None:
        if not scan.finished:
            self.unfinished.append(scan.name)
        elif not any(item.segment == scan.name for item in self.damage):
            scan.check_data_crc()
        if not self._sealed:
            self.chain = chain_value(self.chain, scan.content, scan.data_stop)
        self.ends.append(self.chain)

    def _topic(self, name: str) -> _Topic:
        topic = self._known.get(name)
        if topic is None:
            wanted = self._selection is None or layout.matches(name, self._selection)
            topic = _Topic(name, layout.topic_seed(name), layout.is_bench_topic(name), wanted)
            self._known[name] = topic
        return topic

    def _report(self, span: Span, what: str) -> None:
        note(self.damage, Damage(self._scan.name, span.offset, what))

    def _messages(self, span: Span) -> Iterator[Message]:
        records = span.records
        size = len(records)
        view = memoryview(records)
        at = 0
        while at < size:
            if records[at] != mcap.MESSAGE or size - at < _PAYLOAD_AT:
                at = self._other_record(span, at)
                continue
            _, length, number, _, _, _, crc, sequence, t_ns = _ENVELOPED.unpack_from(records, at)
            end = at + 9 + length
            topic = self._channels.get(number)
            if end > size:
                self._report(span, "message is longer than its chunk")
                return
            if topic is None or not topic.bench:
                if topic is None:
                    self._report(span, f"message of the unknown channel {number}")
                at = end
                continue
            payload = records[at + _PAYLOAD_AT : end]
            good = zlib.crc32(payload, zlib.crc32(view[at + _STAMP_AT : at + _PAYLOAD_AT], topic.seed)) == crc
            at = end
            if not good or length < _SHORTEST:
                self._report(span, f"message of {topic.name} has a wrong CRC")
                continue
            if sequence != self.expected:
                self._gap(span, sequence)
            topic.count += 1
            if topic.name == layout.CHAIN:
                self.expected = sequence
                self._check_chain(span, payload)
            else:
                self.expected = sequence + 1
            if topic.wanted:
                yield Message(topic.name, sequence, t_ns, payload)

    def _other_record(self, span: Span, at: int) -> int:
        """Take a channel record, skip another one; returns where the next record begins."""
        size = len(span.records)
        if size - at < mcap.RECORD.size:
            self._report(span, "chunk ends inside a record")
            return size
        opcode, length = mcap.RECORD.unpack_from(span.records, at)
        end: int = at + mcap.RECORD.size + length
        if end > size or opcode not in mcap.KNOWN:
            self._report(span, "chunk holds a damaged record")
            return size
        if opcode == mcap.CHANNEL:
            try:
                number, name = channel_of(span.records[at + mcap.RECORD.size : end])
            except (ValueError, struct.error):
                self._report(span, "channel record is damaged")
                return end
            if span.sound or number not in self._channels:  # a damaged chunk must not rename what others rely on
                self._channels[number] = self._topic(name)
        elif opcode == mcap.MESSAGE:
            number = int.from_bytes(span.records[at + 9 : at + 11], "little")
            topic = self._channels.get(number)
            if topic is None or topic.bench:
                self._report(span, "message without an envelope")
        return end

    def _gap(self, span: Span, sequence: int) -> None:
        if self.expected < 0:
            return
        missing = sequence - self.expected
        if missing < 0:
            self._report(span, f"running number goes back from {self.expected} to {sequence}")
            return
        last = self.damage[-1] if self.damage else None
        if last is not None and last.lost is None and last.segment == self._scan.name:
            last.lost = missing
        else:
            note(self.damage, Damage(self._scan.name, span.offset, "messages are missing", missing))

    def _check_chain(self, span: Span, payload: bytes) -> None:
        try:
            said = json.loads(payload)
        except ValueError:
            said = None
        if not isinstance(said, dict):
            self._report(span, "hash-chain message is not JSON")
            return
        value = chain_value(self.chain, self._scan.content, span.offset)
        if said.get("previous") != self.chain.hex():
            self._report(span, "hash chain does not continue the segment before")
        elif said.get("sha256") != value.hex():
            self._report(span, "bytes of this segment were changed (hash chain)")
        self.chain = value
        self._sealed = True
