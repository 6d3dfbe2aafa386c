"""What is kept of records, packed or in a file; the trend on the disk against a plain loop, whatever is cut or torn."""

import json
import math
import os
import pickle
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray
from trend_sample import FRAMES, UTC_S

from bench.frame import LinkDecoder, all_signals, load_frame
from bench.model.clock import NS
from bench.model.errors import InputError
from bench.model.events import Environment
from bench.model.ports import RecordWindow
from bench.model.quantities import Quality
from bench.record import (
    FOLDER,
    BenchRows,
    PackedList,
    PackedRows,
    RecordCutter,
    RecordRow,
    Samples,
    TrendReader,
    TrendRows,
    TrendWriter,
    sources_of,
)
from bench.record.cut import BLOCK, StoredColumns
from bench.record.trend import spread_ns
from bench.replay.history import _with_gaps

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
    assert again.samples.counter.tolist() == due


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
    assert (third.samples, third.beside) == (None, {}), "it keeps no samples of its own"
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


def test_large_samples_are_read_when_they_are_asked_for_and_small_ones_packed() -> None:
    rows, given = PackedRows(), {k: stored_row(k, samples=sampled(k), beside={"egi": sampled(k + 10)}) for k in (1, 2)}
    rows.update(given)
    for number, kept in rows.items():
        assert isinstance(kept.samples.columns, StoredColumns)
        assert kept.samples.columns["tick"] is not kept.samples.columns["tick"], "it was held in memory"
        same_samples(kept.samples, sampled(number))
        same_samples(kept.beside["egi"], sampled(number + 10))
        np.testing.assert_array_equal(kept.samples.scaled("tick"), sampled(number).scaled("tick"))
        same_samples(kept.samples.until(10), sampled(number).until(10))
    del rows[1]
    assert list(rows) == [2]
    rows[1] = stored_row(1, samples=sampled(1, 2000))
    samples = rows[1].samples
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


SOURCES = sources_of(all_signals({"port_b": FRAMES["port_b"]}), {"port_b": FRAMES["port_b"]})
NAMES = ["port_b.unit_temperature[2]", "port_b.supply_voltage"]
PLACES = [1, 4]


def rows_of(seconds: np.ndarray, seed: int = 5) -> TrendRows:
    rng = np.random.default_rng(seed)
    low = rng.normal(20.0, 5.0, (len(seconds), 9)).astype(np.float32)
    return TrendRows(seconds + UTC_S, low, low + rng.random((len(seconds), 9)).astype(np.float32))


def written(folder: Path, rows: TrendRows, cuts: tuple[int, ...] = ()) -> TrendReader:
    writer = TrendWriter(folder, SOURCES, 0, UTC_S * NS)
    for begin, end in zip((0, *cuts), (*cuts, len(rows)), strict=True):
        writer.add("port_b", rows.cut(begin, end))
        writer.hand_over(writer.take())
    writer.close()
    return TrendReader(folder)


def test_every_level_is_the_least_and_greatest_of_its_seconds(tmp_path: Path) -> None:
    seconds = np.array([s for s in range(3, 1234) if not 300 <= s < 457])
    rows = rows_of(seconds)
    reader = written(tmp_path, rows, cuts=(1, 7, 500, 501))
    for n, bucket in ((2000, 1), (200, 10), (20, 100), (7, 200)):
        window = reader.window(NAMES, UTC_S, UTC_S + 2000, n)
        assert window.bucket_s == bucket
        points = {float(t): (low, high) for t, low, high in zip(window.t_utc_s, window.low, window.high, strict=True)}
        blank = [t for t, (low, _) in points.items() if math.isnan(low[0])]
        assert len(blank) == (1 if bucket < 157 else 0), "one row of NaN for a gap"
        for start in {s // bucket * bucket for s in (seconds + UTC_S).tolist()}:
            mine = (rows.start_s >= start) & (rows.start_s < start + bucket)
            assert points.pop(start)[0].tolist() == rows.low[mine][:, PLACES].min(axis=0).tolist()
        assert sorted(points) == blank


def test_cuts_change_no_byte(tmp_path: Path) -> None:
    rows = rows_of(np.arange(1, 777))
    written(tmp_path / "a", rows)
    written(tmp_path / "b", rows, cuts=(1, 2, 9, 10, 11, 400))
    files = sorted(path.name for path in (tmp_path / "a" / FOLDER).iterdir())
    levels = [f"{source}.{step}s" for source in ("bench", "port_b") for step in ("001", "010", "100")]
    assert files == [*levels, "trend.json"]
    for name in files:
        assert (tmp_path / "a" / FOLDER / name).read_bytes() == (tmp_path / "b" / FOLDER / name).read_bytes()


def test_the_file_is_as_documented(tmp_path: Path) -> None:
    rows = rows_of(np.arange(5, 8))
    written(tmp_path, rows)
    raw = (tmp_path / FOLDER / "port_b.001s").read_bytes()
    assert len(raw) == 3 * (8 + 9 * 8)
    assert np.frombuffer(raw[80:88], "<f8")[0] == UTC_S + 6
    assert np.frombuffer(raw[88:160], "<f4").tolist()[:2] == [rows.low[1, 0], rows.high[1, 0]]
    head = json.loads((tmp_path / FOLDER / "trend.json").read_text())
    assert head["version"] == 2
    assert head["offsets_ns"] == [UTC_S * NS]


def test_a_crash_loses_no_more_than_what_was_open(tmp_path: Path) -> None:
    rows = rows_of(np.arange(0, 350))
    writer = TrendWriter(tmp_path, SOURCES, 0, UTC_S * NS)
    writer.add("port_b", rows)
    writer.hand_over(writer.take())  # and no close: the coarse levels lack what was open
    path = tmp_path / FOLDER / "port_b.001s"
    path.write_bytes(path.read_bytes() + b"torn")
    reader = TrendReader(tmp_path)
    coarse = reader.window(NAMES, UTC_S, UTC_S + 400, 5)
    assert coarse.t_utc_s.tolist() == [UTC_S, UTC_S + 100, UTC_S + 200, UTC_S + 300]
    assert coarse.low[3].tolist() == rows.low[300:349, PLACES].min(axis=0).tolist(), "from the level below"
    again = TrendWriter(tmp_path, SOURCES, 7 * NS, (UTC_S + 500) * NS)
    more = rows_of(np.arange(500, 600), seed=6)
    again.add("port_b", more)
    again.close()
    window = TrendReader(tmp_path).window(NAMES, UTC_S, UTC_S + 700, 9)
    times = window.t_utc_s[~np.isnan(window.low[:, 0])] - UTC_S
    assert times.tolist() == [0, 100, 200, 300, 500]
    assert window.high[3].tolist() == rows.high[300:349, PLACES].max(axis=0).tolist()


def test_rows_never_go_backwards_and_without_a_head_there_are_none(tmp_path: Path) -> None:
    written(tmp_path, rows_of(np.arange(0, 50)))
    writer = TrendWriter(tmp_path, SOURCES, 9 * NS, (UTC_S - 3600) * NS)
    assert (writer.offset_ns + 9 * NS) // NS == UTC_S + 49
    writer.close()
    reader = TrendReader(tmp_path)
    assert len(reader.head.offsets_ns) == 2
    with pytest.raises(InputError, match="B-REC-030"):
        TrendReader(tmp_path / "nothing")
    with pytest.raises(InputError, match="B-FRAME-024"):
        reader.window(["port_b.nothing"], 0.0, 1.0, 10)


def test_a_temperature_stands_until_the_next_reading_but_not_for_ever(tmp_path: Path) -> None:
    bench = BenchRows()
    writer = TrendWriter(tmp_path, SOURCES, 0, UTC_S * NS)
    writer.add("bench", bench.setpoint((UTC_S + 2) * NS, 35.0))
    for second, air in ((10, 21.0), (70, 22.0)):
        reading = Environment(air_degC=air, unit_degC=None)
        writer.add("bench", bench.event(reading, (UTC_S + second) * NS))
    writer.add("bench", bench.end((UTC_S + 300) * NS))
    writer.close()
    window = TrendReader(tmp_path).window(["bench.air", "bench.unit", "bench.setpoint"], UTC_S, UTC_S + 400, 1000)
    at = {int(t - UTC_S): low.tolist() for t, low in zip(window.t_utc_s, window.low, strict=True)}
    assert at[1][2] == at[299][2] == 35.0
    assert math.isnan(at[8][0])
    assert (at[9][0], at[68][0], at[150][0]) == (21.0, 21.0, 22.0)
    assert math.isnan(at[200][0]), "a reading of two minutes ago says nothing about now"
    assert math.isnan(at[150][1])
    assert window.high[69 - int(window.t_utc_s[0] - UTC_S)][0] == 22.0


def test_frames_of_one_stamp_are_laid_back_and_never_overlap() -> None:
    stamps = np.array([100, 100, 100, 130, 130, 130, 130, 500], np.int64)
    assert spread_ns(stamps, 10, -1000).tolist() == [80, 90, 100, 109, 116, 123, 130, 500]
    assert spread_ns(stamps[:3], 10, 94).tolist() == [96, 98, 100]


def test_frames_that_the_counter_misses_part_the_curve_of_single_readings() -> None:
    batch: Any = SimpleNamespace(counter=np.array([5, 6, 9, 10]), message=SimpleNamespace(counter=object()))
    values = np.array([[1.0, 10.0], [2.0, 20.0], [3.0, 30.0], [4.0, 40.0]])
    rows = _with_gaps(batch, np.array([0, 10, 40, 50]), values)
    assert rows.start_s.tolist() == [0, 10, 25, 40, 50]
    assert np.isnan(rows.low[2]).all()
    assert np.delete(rows.low, 2, axis=0).tolist() == values.tolist() == np.delete(rows.high, 2, axis=0).tolist()
    batch.counter = np.arange(4)
    assert not np.isnan(_with_gaps(batch, np.array([0, 10, 40, 50]), values).low).any()
