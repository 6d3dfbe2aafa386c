"""What a run keeps of its records and events until its end: unchanged, and small."""

from __future__ import annotations

import math
import pickle

import numpy as np
import pytest

from bench.model.ports import RecordWindow
from bench.model.quality import Quality
from bench.record import PackedList, PackedRows, RecordRow
from bench.record.packed import BLOCK

KEYS = ("moment1", "moment2", "first", "last", "at_first", "at_last")


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
