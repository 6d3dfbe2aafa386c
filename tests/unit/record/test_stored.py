"""Records with large samples lie in a file until the end of a run: the same values, a column at a time."""

from __future__ import annotations

import os
from typing import Any

import numpy as np
import pytest

from bench.model.ports import RecordWindow
from bench.model.quality import Quality
from bench.record import PackedRows, RecordRow, Samples, stored

COUNT = 200_000


def sampled(seed: int, count: int = COUNT) -> Samples:
    rng = np.random.default_rng(seed)
    blobs = np.empty(count // 1000, object)
    blobs[:] = [rng.bytes(9000 + k % 7) for k in range(len(blobs))]
    columns: dict[str, Any] = {"tick": rng.integers(0, 1 << 60, count), "blob": blobs, "small": np.arange(3)}
    return Samples(columns, np.arange(count), np.arange(count), {"tick": (1e-8, 0.0, "s")})


def row(number: int, **more: Any) -> RecordRow:
    return RecordRow(RecordWindow(number, "imu", 0, 2, 0, 10), {"npp": np.arange(3)}, 2, 0, 0, Quality.GOOD, **more)


def same(one: Samples, other: Samples) -> None:
    assert list(one.columns) == list(other.columns)
    for name in one.columns:
        assert one.columns[name].tolist() == other.columns[name].tolist()
    assert (one.counter.tolist(), one.scales) == (other.counter.tolist(), other.scales)


def test_large_samples_are_read_when_they_are_asked_for() -> None:
    rows, given = PackedRows(), {k: row(k, samples=sampled(k), beside={"egi": sampled(k + 10)}) for k in (1, 2)}
    rows.update(given)
    for number, kept in rows.items():
        assert kept.samples is not None
        assert isinstance(kept.samples.columns, stored.StoredColumns)
        assert kept.samples.columns["tick"] is not kept.samples.columns["tick"], "it was held in memory"
        same(kept.samples, sampled(number))
        same(kept.beside["egi"], sampled(number + 10))
        np.testing.assert_array_equal(kept.samples.scaled("tick"), sampled(number).scaled("tick"))
        same(kept.samples.until(10), sampled(number).until(10))
    del rows[1]
    assert list(rows) == [2]


def test_small_samples_are_packed() -> None:
    rows = PackedRows()
    rows[1] = row(1, samples=sampled(1, 2000))
    samples = rows[1].samples
    assert samples is not None
    assert isinstance(samples.columns, dict)
    same(samples, sampled(1, 2000))


def test_a_disk_without_room_costs_memory_only(monkeypatch: pytest.MonkeyPatch) -> None:
    def full(*_: object) -> int:
        raise OSError(28, "No space left on device")

    monkeypatch.setattr(os, "pwrite", full)
    rows = PackedRows()
    rows[1] = row(1, samples=sampled(1))
    samples = rows[1].samples
    assert samples is not None
    same(samples, sampled(1))
