"""When the pulses of a record came, against plain Python sums over its frames."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from record_sample import FRAME_NS, constant_stream, frame, stream

from bench.frame import LinkDecoder
from bench.model.ports import RecordWindow
from bench.record import RecordCutter, RecordRow
from bench.record.pulses import pulse_timing

KEYS = ("moment1", "moment2", "first", "last", "at_first", "at_last")


def by_hand(counts: list[list[int]], first_counter: int) -> dict[str, list[int]]:
    """The definition, frame by frame and channel by channel; frames count from 1."""
    found: dict[str, list[int]] = {key: [] for key in KEYS}
    for channel in range(len(counts[0])):
        x = [row[channel] for row in counts]
        pulsed = [j for j, count in enumerate(x) if count]
        found["moment1"].append(sum((j + 1) * count for j, count in enumerate(x)))
        found["moment2"].append(sum((j + 1) ** 2 * count for j, count in enumerate(x)))
        found["first"].append(first_counter + pulsed[0] if pulsed else -1)
        found["last"].append(first_counter + pulsed[-1] if pulsed else -1)
        found["at_first"].append(x[pulsed[0]] if pulsed else 0)
        found["at_last"].append(x[pulsed[-1]] if pulsed else 0)
    return found


@settings(max_examples=60, deadline=None)
@given(seed=st.integers(0, 2**32 - 1), frames=st.integers(1, 60), most=st.sampled_from([0, 1, 3, 2420, 65535]))
def test_moments_and_ends_are_those_of_the_definition(seed: int, frames: int, most: int) -> None:
    rng = np.random.default_rng(seed)
    counts = rng.integers(0, most + 1, (frames, 10)) * (rng.random((frames, 10)) < rng.choice([0.02, 0.5, 1.0]))
    cut = int(rng.integers(0, frames + 1))
    pieces = [{"npp": part.astype(np.uint16)} for part in (counts[:cut], counts[cut:]) if len(part)]
    found = pulse_timing(pieces, 4711)
    assert {name: value.tolist() for name, value in found.items()} == {
        f"npp.{key}": value for key, value in by_hand(counts.tolist(), 4711).items()
    }
    assert {value.dtype for value in found.values()} == {np.dtype(np.int64)}


def test_long_records_at_full_rate_are_exact_to_the_last_digit() -> None:
    """100,000 frames at full rate: beyond what float64 holds; a closed form says what is due."""
    n, each = 100_000, 2420
    found = pulse_timing([{"ppp": np.full((n, 1), each, np.uint16)}], 0)
    assert int(found["ppp.moment1"][0]) == each * n * (n + 1) // 2
    assert int(found["ppp.moment2"][0]) == each * n * (n + 1) * (2 * n + 1) // 6 > 2**53


def rows_of(pieces: list[tuple[int, bytes]], windows: list[RecordWindow], flush_each: int) -> list[RecordRow]:
    decoder, cutter = LinkDecoder(frame("ngu_a")), RecordCutter(frame("ngu_a"))
    for item in windows:
        cutter.open(item, timed=True)
    for index, (t_ns, chunk) in enumerate(pieces):
        decoder.push(t_ns, chunk)
        if index % flush_each == 0:
            cutter.feed(decoder.flush())
    cutter.feed(decoder.flush())
    return sorted(cutter.finished() + cutter.close_all(), key=lambda row: row.window.number)


def window(number: int, first: int, frames: int) -> RecordWindow:
    return RecordWindow(number, "port_a", first, frames, first * FRAME_NS, (first + frames) * FRAME_NS)


@pytest.mark.parametrize("flush_each", [1, 3, 1000])
def test_a_records_timing_comes_from_its_own_frames_however_they_arrive(flush_each: int) -> None:
    rng = np.random.default_rng(8)
    npp, ppp = (rng.integers(0, 2, (700, 10)) * (rng.random((700, 10)) < 0.05) for _ in range(2))
    made = constant_stream(npp, ppp, first_counter=65_500)  # the counter wraps inside
    pieces = [((k + 7) * FRAME_NS, made.frames[k : k + 7].tobytes()) for k in range(0, 700, 7)]
    first, second = rows_of(pieces, [window(1, 65_510, 300), window(2, 65_810, 300)], flush_each)
    for row, at in ((first, 10), (second, 310)):
        for name, counts in (("npp", npp), ("ppp", ppp)):
            due = by_hand(counts[at : at + 300].tolist(), 65_500 + at)
            assert {key: row.timing[f"{name}.{key}"].tolist() for key in KEYS} == due


@pytest.mark.parametrize("wrong", ["missing", "suspect", "not asked for"])
def test_without_all_of_its_frames_a_record_has_no_timing(wrong: str) -> None:
    made = stream(400)
    keep = np.ones(400, bool)
    if wrong == "missing":
        keep[150] = False
    elif wrong == "suspect":
        made.columns["master_count"][150] *= 2
        made.frames = frame("ngu_a").encode(made.columns, 400)
    decoder, cutter = LinkDecoder(frame("ngu_a")), RecordCutter(frame("ngu_a"))
    cutter.open(window(1, 100, 200), timed=wrong != "not asked for")
    cutter.open(window(2, 300, 50), timed=True)
    decoder.push(400 * FRAME_NS, made.frames[keep].tobytes())
    cutter.feed(decoder.flush())
    hurt, whole = cutter.finished()
    assert hurt.timing == {}
    assert len(whole.timing) == 2 * len(KEYS)
