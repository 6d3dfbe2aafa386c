"""A frame that never becomes whole: given up behind a silence of the line, in any chunks, by both engines alike."""

from __future__ import annotations

from itertools import pairwise, product
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from hypothesis import example, given, seed, settings
from hypothesis import strategies as st

from bench.frame import LinkBatch, LinkDecoder, load_frame, parse_frame
from bench.model.errors import InputErrors

GNC = load_frame(Path(__file__).resolve().parents[3] / "frames" / "gnc_422.yaml")
MS = 1_000_000
ENGINES = ("kernel", "numpy", "reference")  # without numba the first one is the second
LONGEST = 1036
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
    batch = link.flush()
    assert batch.messages["answer"].raw("payload").tolist() == [b"abcdef"]
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


@pytest.mark.parametrize("engine", ENGINES)
def test_samples_among_answers_and_lost_samples_by_their_counter(engine: str) -> None:
    stream = b"".join(sample(n) + (answer(n) if n % 7 == 0 else b"") for n in range(40) if n not in (11, 30, 31))
    link = link_of(engine)
    link.push(0, stream)
    batch = link.flush()
    counter = batch.messages["stream"].counter
    assert counter is not None
    assert counter.tolist() == [n for n in range(40) if n not in (11, 30, 31)]
    assert (batch.lost, link.counts.lost, link.counts.duplicate) == (3, 3, 0)
    assert batch.messages["answer"].raw("sequence").tolist() == [0, 7, 14, 21, 28, 35]


@pytest.mark.parametrize("engine", ENGINES)
def test_damage_of_single_bits_costs_the_frames_it_hits_and_no_other(engine: str) -> None:
    print("seed 20")
    generator, chunks, hit = np.random.default_rng(20), [], set()
    for number in range(400):
        frame = bytearray(answer(number % 256, generator.bytes(int(generator.integers(0, 60)))))
        if generator.random() < 0.05:
            hit.add(number)
            frame[int(generator.integers(len(frame)))] ^= 1 << int(generator.integers(8))
        chunks.append((number * 100 * MS, bytes(frame)))  # command and answer: silence in between
    found = decoded(engine, chunks, set(range(400)))
    sequences = [row[5] for _, row, _ in found["answer"]]
    assert sequences == [number % 256 for number in range(400) if number not in hit]
    assert len(hit) > 10


@pytest.mark.parametrize("engine", ENGINES)
def test_polls_once_a_second_lose_no_frame(engine: str) -> None:
    stream = b"".join(sample(n) for n in range(1000))
    size = LONGEST + 17
    chunks = [(n * 1000 * MS, stream[at : at + size]) for n, at in enumerate(range(0, len(stream), size))]
    found = decoded(engine, chunks, {*range(0, len(chunks), 3)})
    assert found["stream", "counter"] == list(range(1000))
    assert (found["counts"].bad, found["counts"].skipped_bytes, found["counts"].lost) == (0, 0, 0)


def test_without_the_key_a_decoder_waits() -> None:
    patient = LinkDecoder(parse_frame(GNC.text.replace("silence: 50 ms\n", ""), "patient.yaml"))
    patient.push(0, false_length(900))
    patient.push(3600_000 * MS, answer(2))
    assert not len(patient.flush().messages["answer"])


@pytest.mark.parametrize("silence", ["50", "0 ms", "2 min", "50 mV"])
def test_a_silence_is_a_time(silence: str) -> None:
    with pytest.raises(InputErrors, match="silence"):
        parse_frame(GNC.text.replace("silence: 50 ms", f"silence: {silence}"), "sample.yaml")


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


@seed(7)
@settings(max_examples=100, deadline=None)
@given(chunks=chunked(), payload=st.binary(max_size=40))
def test_a_whole_frame_behind_a_silence_is_found_at_once(chunks: Chunks, payload: bytes) -> None:
    for engine in ENGINES:
        link = link_of(engine)
        for stamp, chunk in chunks:
            link.push(stamp, chunk)
        link.flush()
        link.push(chunks[-1][0] + 101 * MS, answer(200, payload))
        found = link.flush().messages["answer"]
        heard = any(chunk for _, chunk in chunks)
        assert not heard or (200, payload) in zip(found.raw("sequence").tolist(), found.raw("payload"), strict=True)
