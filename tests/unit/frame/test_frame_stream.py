"""One link: counters without wrap, queue, stamps, counts, and frames that are given up behind a silence of the line."""

import struct
from itertools import pairwise, product
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from crccheck.crc import Crc16Modbus
from hypothesis import example, given, seed, settings
from hypothesis import strategies as st
from record_sample import frame

from bench.frame import FrameDefinition, LinkBatch, LinkDecoder, load_frame, parse_frame
from bench.frame.stream import CounterUnwrapper, Unwrapped

WRAP = 65536
SECOND = 1_000_000_000


def feed(
    unwrapper: CounterUnwrapper, raw: list[int] | np.ndarray, stamps: list[int] | np.ndarray | None = None
) -> Unwrapped:
    values = np.asarray(raw, np.int64) % WRAP
    times = np.zeros(len(values), np.int64) if stamps is None else np.asarray(stamps, np.int64)
    return unwrapper.feed(values, times, lambda first: [b""] * (len(values) - first))


@pytest.mark.parametrize("gap", [1, 2, 500, 65535, 65536, 65537, 200_000, 1_000_000])
def test_gaps_longer_than_a_wrap_by_receive_time(gap: int) -> None:
    """100 Hz in 1 s reads; the time of the gap is off by up to a read."""
    for error in (-SECOND // 2, 0, SECOND // 2):
        unwrapper = CounterUnwrapper(WRAP, 100.0)
        feed(unwrapper, np.arange(1, 101), np.full(100, SECOND))
        raw = 100 + gap + np.arange(100)
        t_ns = SECOND + (gap + 99) * SECOND // 100 + error
        result = feed(unwrapper, raw, np.full(100, t_ns))
        assert result.counter.tolist() == raw.tolist()
        assert result.lost == gap - 1


def test_one_odd_counter_is_suspect_and_changes_nothing_inside_a_batch_or_at_its_end() -> None:
    unwrapper = CounterUnwrapper(WRAP, None)
    result = feed(unwrapper, [100, 101, 40_000, 102, 103, 50_000])
    assert result.suspect.tolist() == [False, False, True, False, False, True]
    assert (result.counter[:5].tolist(), result.lost, result.duplicate) == ([100, 101, 101, 102, 103], 0, 0)
    result = feed(unwrapper, [105, 106])
    assert (result.counter.tolist(), result.lost) == ([105, 106], 1)


def test_a_restart_of_the_unit_goes_on_as_the_time_predicts() -> None:
    """Counter 5000, 10 s without frames, then from 0 again: 1000 frames are missing, the counter goes on upwards."""
    unwrapper = CounterUnwrapper(WRAP, 100.0)
    feed(unwrapper, np.arange(4901, 5001), np.full(100, SECOND))
    result = feed(unwrapper, np.arange(100), np.full(100, 12 * SECOND))
    assert result.suspect.tolist() == [True] + [False] * 99
    assert (np.diff(result.counter[1:]) == 1).all()
    assert abs(int(result.counter[1]) - (5000 + 1002)) <= 2
    assert result.lost == result.counter[1] - 5001


@pytest.mark.parametrize("cut", [1, 7, 40_000])
@pytest.mark.parametrize(
    ("wrap", "counters", "found"),  # lost, repeated, suspect, jumps
    [
        (256, [*range(400), *range(464, 500)], (64, 0, 0, 0)),
        (256, [*range(400), *range(465, 900)], (0, 0, 1, 1)),
        (256, [*range(400), *range(600, 900)], (0, 0, 1, 1)),  # 56 back, as it looks
        (256, [*range(400), *range(380, 500)], (0, 0, 1, 1)),
        (256, [7] * 400, (0, 0, 399, 0)),
        (65536, [*range(9), *range(16_392, 17_000)], (16_383, 0, 0, 0)),
        (65536, [*range(9), *range(60_009, 60_100)], (0, 0, 1, 1)),
        (1 << 32, [*range(9), 12_345_678, *range(10, 20)], (1, 0, 1, 0)),
        (1 << 32, [*range(9), *range(5)], (0, 0, 1, 1)),
        (256, [*range(400, 0, -1)], (0, 0, 399, 0)),  # it counts down: none was there before
    ],
)
def test_what_a_counter_cannot_tell_is_a_jump_of_unknown_size(
    wrap: int, counters: list[int], found: tuple[int, ...], cut: int
) -> None:
    """Without times, however the frames are cut into batches; no frame is the repetition of another one."""
    raw, unwrapper = np.array(counters) % wrap, CounterUnwrapper(wrap, 100.0)
    results = []
    for at in range(0, len(raw), cut):
        part = raw[at : at + cut]
        frames = [bytes(f"{at + index}", "ascii") for index in range(len(part))]
        results.append(unwrapper.feed(part, np.zeros(len(part), np.int64), lambda first, part=frames: part[first:]))
    sums = [sum(one) for one in zip(*(result[2:] for result in results), strict=True)]
    assert tuple(sums) == found


def test_what_a_counter_cannot_tell_is_told_by_time() -> None:
    """u8 at 100 Hz, read every two seconds: 70 frames are lost within a read; their first one behind is not trusted."""
    unwrapper = CounterUnwrapper(256, 100.0)
    true = np.setdiff1d(np.arange(1, 1001), np.arange(420, 490))
    result = unwrapper.feed(
        true % 256, (true + 199) // 200 * 2 * SECOND, lambda first: [b"%d" % at for at in true[first:]]
    )
    assert (result.counter[-1], result.lost, result.doubtful, result.jumps) == (1000, 71, 1, 0)


@pytest.mark.parametrize("seed", range(40))
def test_random_losses_repeats_and_batches(seed: int) -> None:
    """Against the known truth: the counters themselves, and losses and repeats counted with sets."""
    generator = np.random.default_rng(seed)
    true = np.flatnonzero(generator.random(3000) > 0.2) + generator.integers(0, 65536)
    again = generator.random(len(true)) < 0.05
    true = np.repeat(true, 1 + again)
    unwrapper = CounterUnwrapper(WRAP, 100.0)
    cuts = np.unique(generator.integers(0, len(true), 20))
    lost = duplicate = 0
    for part in np.split(true, cuts):
        stamps = np.full(len(part), (int(part[-1]) if len(part) else 0) * SECOND // 100)
        result = feed(unwrapper, part, stamps)
        assert result.counter.tolist() == part.tolist()
        lost, duplicate = lost + result.lost, duplicate + result.duplicate
    unique = set(true.tolist())
    assert lost == int(true[-1] - true[0]) + 1 - len(unique)
    assert duplicate == len(true) - len(unique)


LENGTH = 57


def frames(definition: FrameDefinition, counters: Any) -> np.ndarray:
    counters = np.asarray(counters)
    columns: dict[str, Any] = {"npp": 1, "ppp": 2, "af_clock": 3, "master_count": 4, "fg_count": 5, "status": 0}
    return definition.encode(columns | {"counter": counters % 65536}, len(counters))


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
    batches = []
    for t_ns, chunk in chunks:
        live.push(t_ns, chunk)
        replay.push(t_ns, chunk)
        if generator.random() < 0.5:
            batches.append(live.flush().messages["frame"])
    batches.append(live.flush().messages["frame"])
    whole = replay.flush().messages["frame"]
    assert whole.counter.tolist() == [value for batch in batches for value in batch.counter]  # type: ignore[union-attr]
    assert whole.suspect.tolist() == [mark for batch in batches for mark in batch.suspect]
    assert replay.counts == live.counts
    assert live.counts.suspect > 0
    assert live.counts.lost > 0


@pytest.mark.parametrize("engine", ["numpy", "reference"])
def test_frames_that_are_not_listed_count_with_the_others(engine: str) -> None:
    link = LinkDecoder(load_frame(Path(__file__).with_name("shared_counter.yaml")), engine)  # type: ignore[arg-type]
    for number in range(600):
        if number not in (301, 302, 304):
            body = struct.pack("<5BH", 0xAA, 0x55, 9, number % 256, 1 + number % 2, number)
            link.push(0, body + struct.pack("<H", Crc16Modbus.calc(body)))
    (batch,) = link.finish().messages.values()
    counts = link.counts
    assert batch.counter.tolist() == [number for number in range(0, 600, 2) if number not in (302, 304)]  # type: ignore[union-attr]
    assert (counts.frames, counts.other, counts.lost, counts.suspect, counts.jumps) == (298, 299, 3, 0, 0)


GNC = load_frame(Path(__file__).resolve().parents[3] / "frames" / "gnc_422.yaml")
MS = 1_000_000
ENGINES = ("numpy", "reference")
Chunks = list[tuple[int, bytes]]


def answer(sequence: int, payload: bytes = b"") -> bytes:
    return GNC.encode_one({"command": 0x18, "sequence": sequence, "status": 0, "payload": payload}, "answer")


def sample(counter: int) -> bytes:
    values = {"command": 0x22, "counter": counter, "tick": counter * 5000 % (1 << 32), "gyro": 1, "accel": -2, "mag": 3}
    return GNC.encode_one(values | {"temperature": 2500}, "stream")


def false_length(length: int) -> bytes:
    """The head of an answer that promises more than ever comes."""
    return answer(1)[:8] + length.to_bytes(2, "little")


def link_of(engine: str) -> LinkDecoder:
    return LinkDecoder(GNC, engine)  # type: ignore[arg-type]


def facts(parts: list[LinkBatch], link: LinkDecoder) -> dict[str, Any]:
    """All that a link says, in comparable form."""
    found: dict[str, Any] = {"counts": link.counts}
    found["bad"] = [pair for part in parts for pair in zip(part.bad_offset, part.bad_t_ns, strict=True)]
    for name in GNC.messages:
        for batch in (part.messages[name] for part in parts):
            times = [] if batch.t_ns is None else batch.t_ns.tolist()
            rows = [row.tobytes() for row in batch.rows]
            counters = [] if batch.counter is None else batch.counter.tolist()
            found.setdefault(name, []).extend(zip(batch.offset.tolist(), rows, times, strict=True))
            found.setdefault((name, "counter"), []).extend(counters)
    return found


def decoded(engine: str, chunks: Chunks, flushes: set[int]) -> dict[str, Any]:
    """Facts of chunks that are flushed behind the given numbers, and at the end."""
    link, parts = link_of(engine), []
    for number, (stamp, chunk) in enumerate(chunks):
        link.push(stamp, chunk)
        if number in flushes:
            parts.append(link.flush())
    return facts([*parts, link.finish()], link)


@pytest.mark.parametrize("engine", ENGINES)
def test_a_false_length_is_cleared_by_the_next_chunk_behind_a_silence(engine: str) -> None:
    link = link_of(engine)
    link.push(0, false_length(1000))
    assert not len(link.flush().bad_offset)
    link.push(40 * MS, answer(2))
    assert link.counts.frames == 0
    assert not len(link.flush().messages["answer"])  # no silence: the line may still be inside the long frame
    link.push(91 * MS, answer(3))
    batch = link.flush()
    assert batch.messages["answer"].raw("sequence").tolist() == [2, 3]
    assert batch.messages["answer"].t_ns is not None
    assert batch.messages["answer"].t_ns.tolist() == [40 * MS, 91 * MS]
    assert (batch.bad_offset.tolist(), batch.bad_t_ns.tolist()) == ([0], [0])
    assert (link.counts.frames, link.counts.bad, link.counts.skipped_bytes) == (2, 1, 10)


@pytest.mark.parametrize("engine", ENGINES)
@pytest.mark.parametrize(("pause_ns", "given_up"), [(50 * MS, False), (50 * MS + 1, True)])
def test_a_silence_is_longer_than_the_limit(engine: str, pause_ns: int, given_up: bool) -> None:
    link = link_of(engine)
    for stamp, chunk in ((7, false_length(900)), (7 + pause_ns, answer(2))):
        link.push(stamp, chunk)
    assert len(link.flush().messages["answer"]) == given_up
    assert link.counts.bad == given_up


@pytest.mark.parametrize("engine", ENGINES)
def test_chunks_without_bytes_do_not_end_a_silence(engine: str) -> None:
    link = link_of(engine)
    for stamp, chunk in ((0, false_length(900)), (40 * MS, b""), (80 * MS, b"")):
        link.push(stamp, chunk)
    link.flush()
    assert link.counts.bad == 0
    link.push(90 * MS, answer(2))
    assert len(link.flush().messages["answer"]) == 1
    assert link.counts.bad == 1


@pytest.mark.parametrize("engine", ENGINES)
@pytest.mark.parametrize("cut", range(1, len(answer(5, b"abcdef"))))
def test_a_frame_that_the_chunk_behind_the_silence_completes_is_kept(engine: str, cut: int) -> None:
    frame, link = answer(5, b"abcdef"), link_of(engine)
    link.push(0, frame[:cut])
    link.push(1000 * MS, frame[cut:] + answer(6)[:7])
    assert link.flush().messages["answer"].raw("payload").tolist() == [b"abcdef"]
    link.push(1001 * MS, answer(6)[7:])
    assert link.flush().messages["answer"].raw("sequence").tolist() == [6]
    assert (link.counts.bad, link.counts.skipped_bytes) == (0, 0)


@pytest.mark.parametrize("engine", ENGINES)
@pytest.mark.parametrize("cut", range(1, len(answer(5))))
def test_a_frame_that_stays_behind_is_given_up_wherever_it_ends(engine: str, cut: int) -> None:
    link = link_of(engine)
    link.push(0, answer(5)[:cut])
    link.push(51 * MS, answer(6))
    assert link.flush().messages["answer"].raw("sequence").tolist() == [6]
    assert link.counts.bad == (cut >= 3)  # two sync bytes and the version make a candidate
    assert link.counts.skipped_bytes == cut


@pytest.mark.parametrize("engine", ENGINES)
@pytest.mark.parametrize("bit", range(16))
def test_a_frame_inside_the_claimed_length_of_a_damaged_one_is_found(engine: str, bit: int) -> None:
    damaged = bytearray(answer(1, b"0123456789"))
    damaged[8 + bit // 8] ^= 1 << bit % 8
    link = link_of(engine)
    link.push(0, bytes(damaged) + answer(2) + sample(0))
    link.push(60 * MS, answer(3))
    batch = link.flush()
    assert batch.messages["answer"].raw("sequence").tolist() == [2, 3]
    assert batch.messages["stream"].raw("counter").tolist() == [0]
    assert link.counts.bad == 1


def test_without_the_key_a_decoder_waits() -> None:
    patient = LinkDecoder(parse_frame(GNC.text.replace("silence: 50 ms\n", ""), "patient.yaml"))
    patient.push(0, false_length(900))
    patient.push(3600_000 * MS, answer(2))
    assert not len(patient.flush().messages["answer"])


PIECES = st.one_of(
    st.builds(answer, st.integers(0, 255), st.binary(max_size=30)),
    st.builds(sample, st.integers(0, 1 << 31)),
    st.builds(false_length, st.integers(0, 1100)),
    st.binary(max_size=12),
    st.sampled_from([b"\xeb", b"\xeb\x90", b"\xeb\x90\x01", b"\xeb\x90\xeb\x90\x01\x01"]),
    st.builds(lambda n, cut: answer(n, b"xyz")[:cut], st.integers(0, 255), st.integers(1, 15)),
    st.builds(lambda n, at, bit: flipped(answer(n, b"uvw"), at, bit), st.integers(0, 9), st.integers(0, 15),
              st.integers(0, 7)),
)  # fmt: skip
PAUSES = st.sampled_from([0, 1, 5 * MS, 50 * MS, 50 * MS + 1, 200 * MS, 1000 * MS])


def flipped(frame: bytes, at: int, bit: int) -> bytes:
    changed = bytearray(frame)
    changed[at % len(frame)] ^= 1 << bit
    return bytes(changed)


@st.composite
def chunked(draw: st.DrawFn) -> Chunks:
    stream = b"".join(draw(st.lists(PIECES, max_size=12)))
    cuts = sorted(draw(st.sets(st.integers(0, len(stream)), max_size=12)))
    stamp, chunks = 0, []
    for start, stop in pairwise([0, *cuts, len(stream)]):
        stamp += draw(PAUSES)
        chunks.append((stamp, stream[start:stop]))
    return chunks


@seed(6)
@settings(max_examples=150, deadline=None)
@given(chunks=chunked(), flushes=st.sets(st.integers(0, 13)))
@example(chunks=[(0, b"\xeb"), (60 * MS, b"\x90"), (61 * MS, b"\x01")], flushes={0})
def test_engines_agree_however_the_chunks_are_flushed(chunks: Chunks, flushes: set[int]) -> None:
    due = decoded("reference", chunks, set())
    each = set(range(len(chunks)))
    for engine, flushed in (("numpy", set()), *product(ENGINES, (flushes, each))):
        assert decoded(engine, chunks, flushed) == due
