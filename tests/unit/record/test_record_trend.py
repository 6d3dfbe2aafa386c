"""The trend on the disk: values against a plain loop, whatever is cut, torn or gone on with."""

from __future__ import annotations

import json
import math
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
from trend_sample import FRAMES, UTC_S

from bench.frame import all_signals
from bench.model.clock import NS
from bench.model.errors import InputError
from bench.model.events import Environment
from bench.record import FOLDER, BenchRows, TrendReader, TrendRows, TrendWriter, sources_of
from bench.record.trend_rows import spread_ns
from bench.replay.history import _with_gaps

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
    assert files == [
        "bench.001s",
        "bench.010s",
        "bench.100s",
        "port_b.001s",
        "port_b.010s",
        "port_b.100s",
        "trend.json",
    ]
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
