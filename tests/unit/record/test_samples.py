"""Samples of a record: every good frame once, in the order of its counter, whatever the stream was cut into."""

from __future__ import annotations

import pickle
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from numpy.typing import NDArray

from bench.analysis import joined
from bench.frame import LinkDecoder, load_frame
from bench.model.ports import RecordWindow
from bench.record import RecordCutter, RecordRow

ROOT = Path(__file__).resolve().parents[3]
DEFINITION = load_frame(ROOT / "frames" / "gnc_422.yaml")
PERIOD_NS = 5_000_000


def stream(first: int, count: int) -> list[bytes]:
    """Frames whose values are their counter, each as its own bytes."""
    counter = np.arange(first, first + count)
    columns = {
        "counter": counter,
        "tick": counter * 5000,
        "gyro": np.stack([counter, -counter, 2 * counter], axis=1),
        "accel": np.stack([counter, counter, 1000 + counter], axis=1),
        "mag": np.zeros((count, 3)),
        "temperature": 2500,
        "command": 0x22,
        "sequence": 0,
    }
    rows: NDArray[np.uint8] = DEFINITION.encode(columns, count, "stream")
    return [row.tobytes() for row in rows]


def window(number: int, first: int, frames: int, **conditions: object) -> RecordWindow:
    span = first * PERIOD_NS, (first + frames) * PERIOD_NS
    return RecordWindow(number, "rs422", first, frames, *span, conditions)


def cut(frames: list[bytes], windows: list[RecordWindow], chunk: int) -> list[RecordRow]:
    decoder, cutter = LinkDecoder(DEFINITION), RecordCutter(DEFINITION)
    for item in windows:
        cutter.open(item, sampled=True)
    whole = b"".join(frames)
    for start in range(0, len(whole), chunk):
        decoder.push((start // 59) * PERIOD_NS, whole[start : start + chunk])
        cutter.feed(decoder.flush())
    cutter.feed(decoder.finish())
    return sorted(cutter.finished() + cutter.close_all(), key=lambda row: row.window.number)


@pytest.mark.parametrize("chunk", [7, 61, 1000, 100_000])
def test_each_sample_once_and_in_order(chunk: int) -> None:
    frames = stream(100, 300)
    frames[50] = frames[50][:20] + bytes([frames[50][20] ^ 4]) + frames[50][21:]
    frames.insert(80, frames[79])
    (row,) = cut(frames, [window(1, 120, 200)], chunk)
    assert row.samples is not None
    due = [counter for counter in range(120, 320) if counter != 150]
    assert row.samples.counter.tolist() == due
    assert row.samples.columns["tick"].tolist() == [5000 * counter for counter in due]
    np.testing.assert_allclose(row.samples.scaled("gyro")[:, 1], [-0.005 * counter for counter in due])
    assert row.samples.unit("accel") == "g"
    assert (row.frames, row.lost, row.duplicate) == (199, 1, 1)
    again: RecordRow = pickle.loads(pickle.dumps(row))
    assert again.samples is not None
    assert again.samples.counter.tolist() == due


def test_nothing_is_kept_that_was_not_asked_for() -> None:
    decoder, cutter = LinkDecoder(DEFINITION), RecordCutter(DEFINITION)
    cutter.open(window(1, 100, 10))
    decoder.push(0, b"".join(stream(100, 20)))
    cutter.feed(decoder.finish())
    (row,) = cutter.finished()
    assert row.samples is None
    assert row.frames == 10


def test_samples_of_other_links_are_kept_beside_a_record_and_none_is_missing_at_a_joint() -> None:
    def fed(batches: list[tuple[str, int, list[bytes]]]) -> list[RecordRow]:
        decoders = {link: LinkDecoder(DEFINITION) for link in ("rs422", "other")}
        cutter = RecordCutter(DEFINITION)
        cutter.open(window(1, 110, 50), sampled=True)
        cutter.open(window(2, 160, 100), sampled=True, chained=True)
        cutter.open(window(3, 400, 20))
        for link, number, frames in batches:
            for index, frame in enumerate(frames):
                decoders[link].push((number + index) * PERIOD_NS, frame)
        for link in ("other", "rs422"):
            batch = decoders[link].flush()
            cutter.feed(batch) if link == "rs422" else cutter.feed_context(batch, link)
        return sorted(cutter.finished() + cutter.close_all(), key=lambda row: row.window.number)

    other = stream(7, 300)
    other.insert(41, other[40])
    first, second, third = fed([("rs422", 100, stream(100, 330)), ("other", 100, other)])
    # a frame is received at the number it was given above; the double of counter 47 shifts those behind it by one
    assert first.beside["other"].counter.tolist() == list(range(17, 66))
    assert first.beside["other"].t_ns[[0, -1]].tolist() == [110 * PERIOD_NS, 159 * PERIOD_NS]
    assert second.beside["other"].counter.tolist() == list(range(27, 166)), "0.2 s before its begin, that is 40 frames"
    np.testing.assert_allclose(second.beside["other"].scaled("gyro")[:, 1], -0.005 * np.arange(27, 166))
    assert third.beside == {}, "it keeps no samples of its own"
    assert first.context == {}, "samples are no housekeeping"


def test_a_record_that_continues_is_part_of_the_one_before() -> None:
    first, second, other = cut(
        stream(100, 300),
        [window(1, 110, 50, item="rotation"), window(2, 160, 100, continues=1), window(3, 300, 20, item="rotation")],
        61,
    )
    both, alone = joined([first, second, other])
    assert both.samples is not None
    assert both.samples.counter.tolist() == list(range(110, 260))
    assert (both.frames, both.window.frames, both.window.conditions) == (150, 150, {"item": "rotation"})
    assert alone is other


def test_a_record_that_does_not_follow_stays_alone() -> None:
    first, second = cut(stream(100, 300), [window(1, 110, 50), window(2, 170, 50, continues=1)], 61)
    assert joined([first, second]) == [first, second]
    assert joined([replace(second, window=first.window)]) == [replace(second, window=first.window)]
