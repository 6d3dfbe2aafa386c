"""What is kept of records: every good sample once, events as their bytes; packed, or in a file until the run ends."""

from __future__ import annotations

import math
import os
import pickle
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray

from bench.frame import LinkDecoder, load_frame
from bench.model.ports import RecordWindow
from bench.model.quality import Quality
from bench.record import PackedList, PackedRows, RecordCutter, RecordRow, Samples, stored
from bench.record.packed import BLOCK

ROOT = Path(__file__).resolve().parents[3]
DEFINITION = load_frame(ROOT / "frames" / "gnc_422.yaml")
PERIOD_NS = 5_000_000
KEYS = ("moment1", "moment2", "first", "last", "at_first", "at_last")


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


def row(number: int, rng: np.random.Generator) -> RecordRow:
    """A record as the bias campaign makes them."""
    first = 10_000 * number
    conditions = {"route": "open", "branch": "up", "window_index": number, "purpose": "measurement"}
    window = RecordWindow(number, "port_a", first, 10_000, number * 10**11, (number + 1) * 10**11, conditions, number)
    pulses = {name: rng.integers(0, 60, 10) for name in ("npp", "ppp")}
    clocks = {name: np.array(rng.integers(10**6, 10**9)) for name in ("af_clock", "master_count", "fg_count")}
    timing = {f"{name}.{key}": rng.integers(-1, 10**12, 10) for name in pulses for key in KEYS}
    context = {"unit_temperature_degC": rng.normal(), "supply_voltage_V": math.pi, "rails_V": math.nan}
    return RecordRow(window, {**pulses, **clocks}, 9990, 10, 3, Quality.LOST, context, 1, 0, timing)


def same(one: RecordRow, other: RecordRow) -> None:
    assert (one.window, one.frames, one.lost, one.bad) == (other.window, other.frames, other.lost, other.bad)
    assert (one.quality, one.duplicate, one.suspect) == (other.quality, other.duplicate, other.suspect)
    assert isinstance(other.quality, Quality)
    np.testing.assert_equal(dict(one.context), dict(other.context))
    for first, second in ((one.sums, other.sums), (one.timing, other.timing)):
        assert list(first) == list(second)
        for name, value in first.items():
            assert (value.dtype, value.shape) == (second[name].dtype, second[name].shape)
            np.testing.assert_array_equal(value, second[name])


def test_rows_come_out_as_they_went_in_and_can_be_taken_back() -> None:
    rng = np.random.default_rng(4)
    rows, packed = [row(number, rng) for number in range(1, 8)], PackedRows()
    for one in rows:
        packed[one.window.number] = one
    assert packed.pop(7, None) is not None
    assert packed.pop(7, None) is None
    packed[3] = rows[5]  # a retake
    assert sorted(packed) == [1, 2, 3, 4, 5, 6]
    for number, one in sorted(packed.items()):
        same(rows[5] if number == 3 else rows[number - 1], one)
    with pytest.raises(KeyError):
        packed[8]


def test_a_thousand_rows_and_a_day_of_events_need_less_than_a_mebibyte() -> None:
    rng = np.random.default_rng(5)
    packed: PackedRows = PackedRows()
    for number in range(1000):
        packed[number] = row(number, rng)
    events: PackedList[tuple[str, int, dict[str, float]]] = PackedList()
    given = [("environment", k, {"air_degC": k / 7, "unit_degC": -k / 3}) for k in range(1700)]
    for event in given:
        events.append(event)
    assert list(events) == given
    size = len(pickle.dumps(packed)) + len(pickle.dumps(events))
    print(f"seed 5: {size} bytes, a block of {BLOCK} events among them")
    assert size < 2**20


COUNT = 200_000


def sampled(seed: int, count: int = COUNT) -> Samples:
    rng = np.random.default_rng(seed)
    blobs = np.empty(count // 1000, object)
    blobs[:] = [rng.bytes(9000 + k % 7) for k in range(len(blobs))]
    columns: dict[str, Any] = {"tick": rng.integers(0, 1 << 60, count), "blob": blobs, "small": np.arange(3)}
    return Samples(columns, np.arange(count), np.arange(count), {"tick": (1e-8, 0.0, "s")})


def stored_row(number: int, **more: Any) -> RecordRow:
    return RecordRow(RecordWindow(number, "imu", 0, 2, 0, 10), {"npp": np.arange(3)}, 2, 0, 0, Quality.GOOD, **more)


def same_samples(one: Samples, other: Samples) -> None:
    assert list(one.columns) == list(other.columns)
    for name in one.columns:
        assert one.columns[name].tolist() == other.columns[name].tolist()
    assert (one.counter.tolist(), one.scales) == (other.counter.tolist(), other.scales)


def test_large_samples_are_read_when_they_are_asked_for() -> None:
    rows, given = PackedRows(), {k: stored_row(k, samples=sampled(k), beside={"egi": sampled(k + 10)}) for k in (1, 2)}
    rows.update(given)
    for number, kept in rows.items():
        assert kept.samples is not None
        assert isinstance(kept.samples.columns, stored.StoredColumns)
        assert kept.samples.columns["tick"] is not kept.samples.columns["tick"], "it was held in memory"
        same_samples(kept.samples, sampled(number))
        same_samples(kept.beside["egi"], sampled(number + 10))
        np.testing.assert_array_equal(kept.samples.scaled("tick"), sampled(number).scaled("tick"))
        same_samples(kept.samples.until(10), sampled(number).until(10))
    del rows[1]
    assert list(rows) == [2]


def test_small_samples_are_packed() -> None:
    rows = PackedRows()
    rows[1] = stored_row(1, samples=sampled(1, 2000))
    samples = rows[1].samples
    assert samples is not None
    assert isinstance(samples.columns, dict)
    same_samples(samples, sampled(1, 2000))


def test_a_disk_without_room_costs_memory_only(monkeypatch: pytest.MonkeyPatch) -> None:
    def full(*_: object) -> int:
        raise OSError(28, "No space left on device")

    monkeypatch.setattr(os, "pwrite", full)
    rows = PackedRows()
    rows[1] = stored_row(1, samples=sampled(1))
    samples = rows[1].samples
    assert samples is not None
    same_samples(samples, sampled(1))
