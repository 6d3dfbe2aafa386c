"""One link: queue, stamps, counters, counts."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
from crccheck.crc import Crc8Smbus
from record_sample import frame

from bench.frame import FrameDefinition, LinkDecoder, parse_frame

LENGTH = 57


def frames(definition: FrameDefinition, counters: Any) -> np.ndarray:
    counters = np.asarray(counters)
    columns: dict[str, Any] = {"npp": 1, "ppp": 2, "af_clock": 3, "master_count": 4, "fg_count": 5, "status": 0}
    return definition.encode(columns | {"counter": counters % 65536}, len(counters))


def test_push_only_queues() -> None:
    definition = frame("ngu_a")
    link = LinkDecoder(definition)
    stream = frames(definition, range(4)).tobytes()
    link.push(10, stream[:100])
    link.push(20, stream[100:])
    assert link.pending_bytes == 4 * LENGTH
    assert link.counts.bytes == 0
    batch = link.flush().messages["frame"]
    assert link.pending_bytes == 0
    assert batch.raw("counter").tolist() == [0, 1, 2, 3]
    assert (link.counts.bytes, link.counts.frames, link.counts.skipped_bytes) == (4 * LENGTH, 4, 0)


@pytest.mark.parametrize("seed", range(5))
def test_the_stamp_is_that_of_the_chunk_that_completed_the_frame(seed: int) -> None:
    generator = np.random.default_rng(seed)
    definition = frame("ngu_a")
    stream = b"\xeb" + frames(definition, range(60)).tobytes()
    link = LinkDecoder(definition)
    arrival: list[int] = []  # chunk number of every byte
    stamps: list[int] = []
    chunk = at = 0
    while at < len(stream):
        part = stream[at : at + int(generator.integers(0, 120))]
        link.push(chunk * 7, part)
        arrival += [chunk * 7] * len(part)
        at, chunk = at + len(part), chunk + 1
        if generator.random() < 0.3:
            stamps += link.flush().messages["frame"].t_ns.tolist()  # type: ignore[union-attr]
    stamps += link.finish().messages["frame"].t_ns.tolist()  # type: ignore[union-attr]
    assert stamps == [arrival[LENGTH * (index + 1)] for index in range(60)]


def test_lost_bad_duplicate_and_their_stamps() -> None:
    definition = frame("ngu_a")
    rows = frames(definition, [0, 1, 2, 3, 4, 4, 7])
    rows[3, 20] ^= 4
    link = LinkDecoder(definition)
    link.push(5, rows[:2].tobytes())
    link.push(6, rows[2:].tobytes())
    batch = link.finish()
    assert batch.messages["frame"].counter.tolist() == [0, 1, 2, 4, 4, 7]  # type: ignore[union-attr]
    assert (batch.bad_offset.tolist(), batch.bad_t_ns.tolist()) == ([3 * LENGTH], [6])
    counts = link.counts
    assert (counts.frames, counts.bad, counts.lost, counts.duplicate, counts.suspect) == (6, 1, 3, 1, 0)
    assert (batch.lost, batch.duplicate, counts.skipped_bytes) == (3, 1, LENGTH)


def test_a_bad_candidate_has_the_stamp_of_the_chunk_where_it_begins() -> None:
    definition = frame("ngu_a")
    rows = frames(definition, range(4))
    rows[1:3, 20] ^= 4
    link = LinkDecoder(definition)
    for stamp, part in ((1, rows[:1]), (2, rows[1:2]), (3, rows[2:])):
        link.push(stamp, part.tobytes())
    assert link.flush().bad_t_ns.tolist() == [2, 3]


def test_a_wrap_between_flushes() -> None:
    definition = frame("ngu_a")
    link = LinkDecoder(definition)
    true = np.arange(65000, 66000)
    found: list[int] = []
    for index in range(10):
        link.push(index * 10**9, frames(definition, true[index * 100 : index * 100 + 100]).tobytes())
        found += link.flush().messages["frame"].counter.tolist()  # type: ignore[union-attr]
    assert found == true.tolist()
    assert link.counts.lost == 0


@pytest.mark.parametrize("seed", range(12))
def test_counters_do_not_depend_on_the_moments_of_flushing(seed: int) -> None:
    """Losses, repeats, odd counters, restarts and long gaps: live in small flushes, in a replay in one."""
    generator = np.random.default_rng(seed)
    definition = frame("ngu_a")
    chunks, t_ns, counter = [], 0, 65000
    for _ in range(40):
        event = generator.random()
        if event < 0.1:
            counter, t_ns = 0, t_ns + 10**9  # restart
        elif event < 0.2:
            counter, t_ns = counter + 70_000, t_ns + 700 * 10**9  # gap longer than a wrap
        true = np.arange(counter, counter + 100)
        true = true[generator.random(100) > 0.02]
        true = np.repeat(true, 1 + (generator.random(len(true)) < 0.02))
        true = np.where(generator.random(len(true)) < 0.01, generator.integers(0, 65536, len(true)), true)
        counter, t_ns = counter + 100, t_ns + int(generator.normal(1e9, 5e6))
        chunks.append((t_ns, frames(definition, true).tobytes()))
    live, replay = LinkDecoder(definition), LinkDecoder(definition)
    counters: list[int] = []
    suspects: list[bool] = []
    for t_ns, chunk in chunks:
        live.push(t_ns, chunk)
        replay.push(t_ns, chunk)
        if generator.random() < 0.5:
            batch = live.flush().messages["frame"]
            counters += batch.counter.tolist()  # type: ignore[union-attr]
            suspects += batch.suspect.tolist()
    batch = live.flush().messages["frame"]
    counters += batch.counter.tolist()  # type: ignore[union-attr]
    suspects += batch.suspect.tolist()
    whole = replay.flush().messages["frame"]
    assert whole.counter.tolist() == counters  # type: ignore[union-attr]
    assert whole.suspect.tolist() == suspects
    assert replay.counts == live.counts
    assert live.counts.suspect > 0
    assert live.counts.lost > 0


def test_an_empty_flush_keeps_the_shape_of_a_batch() -> None:
    batch = LinkDecoder(frame("ngu_a")).flush().messages["frame"]
    assert len(batch) == 0
    assert batch.counter is not None
    assert batch.t_ns is not None
    assert (batch.counter.shape, batch.t_ns.shape, batch.raw("npp").shape) == ((0,), (0,), (0, 10))


SHARED = """frame: shared
endian: little
sync: [0xA5]
rate: 10 Hz
fields: [{name: kind, type: u8}, {name: counter, type: u8, role: counter}]
type: {field: kind}
messages:
  one: {value: 1, fields: [{name: total, type: u8, per: cumulative}], golden: "a5010005CC1", expect: {total: 5}}
  two: {value: 2, fields: [{name: value, type: u16}], golden: "a502000900CC2", expect: {value: 9}}
crc: {name: crc-8/smbus, over: [kind, end]}
"""


def shared() -> FrameDefinition:
    text = SHARED
    for mark, body in (("CC1", "010005"), ("CC2", "02000900")):
        text = text.replace(mark, f"{Crc8Smbus.calc(bytes.fromhex(body)):02x}")
    return parse_frame(text, "shared.yaml")


def test_a_counter_shared_by_all_messages() -> None:
    definition = shared()
    link = LinkDecoder(definition)
    order = ["one", "two", "two", "one", "one", "two"]
    for index, name in enumerate(order):
        if index != 3:
            values = {"counter": (254 + index) % 256, "total" if name == "one" else "value": 1}
            link.push(index * 10**8, definition.encode_one(values, name))
    batch = link.flush()
    assert batch.messages["one"].counter.tolist() == [254, 258]  # type: ignore[union-attr]
    assert batch.messages["two"].counter.tolist() == [255, 256, 259]  # type: ignore[union-attr]
    assert batch.lost == 1
