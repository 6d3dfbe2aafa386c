"""Records of frames of variable length: time-stamped events in blocks, as bytes, whatever the stream was cut into."""

from __future__ import annotations

import struct
import zlib
from pathlib import Path

import numpy as np
import pytest

from bench.frame import LinkDecoder, load_frame
from bench.frame.signals import all_signals
from bench.model.ports import RecordWindow
from bench.record import PackedRows, RecordCutter, RecordRow

ROOT = Path(__file__).resolve().parents[3]
DEFINITION = load_frame(ROOT / "frames" / "time_tags.yaml")
PERIOD_NS = 10_000_000


def block(counter: int, events: bytes) -> bytes:
    """One block, packed by hand."""
    head = struct.pack("<HIQIIH", 32 + len(events), counter, counter * 10**6, 10**8, 0, len(events) // 4)
    return b"\xa5\x5a\xc3\x3c" + head + events + struct.pack("<I", zlib.crc32(head + events))


def events_of(counter: int) -> bytes:
    generator = np.random.default_rng(counter)
    return generator.integers(0, 2**32, generator.integers(0, 400), dtype=np.uint32).astype("<u4").tobytes()


def cut(blocks: list[bytes], chunk: int) -> RecordRow:
    decoder, cutter = LinkDecoder(DEFINITION), RecordCutter(DEFINITION)
    cutter.open(RecordWindow(1, "edges", 105, 20, 105 * PERIOD_NS, 125 * PERIOD_NS), sampled=True)
    stream = b"".join(blocks)
    for start in range(0, len(stream), chunk):
        decoder.push(start, stream[start : start + chunk])
        cutter.feed(decoder.flush())
    return (cutter.finished() + cutter.close_all())[0]


@pytest.mark.parametrize("chunk", [13, 1000, 1_000_000])
def test_the_events_of_a_record_are_its_bytes(chunk: int) -> None:
    row = cut([block(counter, events_of(counter)) for counter in range(100, 130)], chunk)
    assert (row.frames, row.lost, row.samples is not None) == (20, 0, True)
    assert row.samples is not None
    assert row.samples.columns["events"].tolist() == [events_of(counter) for counter in range(105, 125)]
    assert row.samples.columns["edges"].tolist() == [len(events_of(counter)) // 4 for counter in range(105, 125)]
    assert row.samples.counter.tolist() == list(range(105, 125))


def test_a_damaged_block_is_missing_and_the_next_one_is_found() -> None:
    blocks = [block(counter, events_of(counter)) for counter in range(100, 130)]
    blocks[10] = blocks[10][:-6] + bytes([blocks[10][-6] ^ 1]) + blocks[10][-5:]
    row = cut(blocks, 777)
    assert (row.frames, row.lost, row.bad) == (19, 1, 1)
    assert row.samples is not None
    assert row.samples.counter.tolist() == [number for number in range(105, 125) if number != 110]


def test_a_record_of_blocks_can_be_packed() -> None:
    row, rows = cut([block(counter, events_of(counter)) for counter in range(100, 130)], 5000), PackedRows()
    rows[1] = row
    assert rows[1].samples is not None
    assert rows[1].samples.columns["events"].tolist() == [events_of(counter) for counter in range(105, 125)]


def test_the_numbers_of_a_block_can_be_looked_at() -> None:
    names = [signal.name for signal in all_signals({"edges": DEFINITION}) if signal.link == "edges"]
    assert names == ["edges.tick", "edges.clock", "edges.dropped", "edges.edges"]
