"""Records without a gap: every frame in exactly one of them, whatever happens between and to the frames."""

from __future__ import annotations

from itertools import pairwise
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from run_rig import BLOCK, GATE_NS, Rig

from bench.model.clock import NS
from bench.model.quality import Quality
from bench.record import RecordRow
from bench.run.steps.windows import AHEAD_S

SEED = 21


def chained(folder: Path, *, windows: int = 5, seconds: float = 2.0, call_after: int = 0, **more: Any) -> Rig:
    """Windows behind each other; behind number ``call_after`` (from 1) the chamber is told to go on."""
    rig = Rig(folder, "chamber")
    rig.step("settle", duration_s=5.0, bus_s=0.0)
    for number in range(windows):
        follows = {"follows": True} if number else {}
        conditions = {"route": "open", "window_index": number}
        rig.step(
            "record", "port_a", seconds=seconds, retry=0, max_lost=0.0, retry_step=0, conditions=conditions, **follows,
            **more,
        )  # fmt: skip
        if number + 1 == call_after:
            rig.step("call", "chamber", "set_temperature", temperature=50.0, ramp=0.1)
            rig.step("call", "chamber", "run")
    return rig


def assert_contiguous(rows: list[RecordRow]) -> None:
    for before, after in pairwise(rows):
        assert after.window.first_counter == before.window.first_counter + before.window.frames
        assert after.window.t_start_ns == before.window.t_end_ns


@pytest.mark.parametrize("phase_ns", [0, 600_000, 11_000, GATE_NS // 2, GATE_NS - 1])
def test_windows_are_contiguous_wherever_they_begin(tmp_path: Path, phase_ns: int) -> None:
    rig = chained(tmp_path)
    rig.clock.sleep(phase_ns / NS)
    rig.port_a.npp = np.arange(10)
    outcome = rig.run()
    assert outcome.error is None
    assert outcome.slip_s == 0.0
    assert [row.window.number for row in outcome.rows] == [1, 2, 3, 4, 5]
    assert_contiguous(list(outcome.rows))
    for row in outcome.rows:
        assert (row.frames, row.lost, row.quality, row.timing) == (200, 0, Quality.GOOD, {})
        assert row.sums["npp"].tolist() == [200 * k for k in range(10)]
        gate_ns = row.window.first_counter * GATE_NS
        assert abs(gate_ns - row.window.t_start_ns) < 4 * GATE_NS
    assert [event["number"] for event in rig.events("record")] == [1, 2, 3, 4, 5]
    assert rig.events("gap") == []


@pytest.mark.parametrize("slow_s", [0.0, 0.7, 1.9, 7.0, AHEAD_S - 1.0])
def test_calls_between_windows_cost_no_frame(tmp_path: Path, slow_s: float) -> None:
    """Even if the bus takes longer than whole windows."""
    rig = chained(tmp_path, windows=8, call_after=3)
    rig.instruments["chamber"].slow_s["set_temperature"] = slow_s
    outcome = rig.run()
    assert outcome.error is None
    assert len(rig.called("chamber.set_temperature")) == 1
    assert_contiguous(list(outcome.rows))
    assert {(row.frames, row.lost) for row in outcome.rows} == {(200, 0)}
    assert rig.events("gap") == []


def test_a_bus_that_hangs_for_longer_begins_anew_and_says_so(tmp_path: Path) -> None:
    rig = chained(tmp_path, windows=60, call_after=3)
    rig.instruments["chamber"].slow_s["set_temperature"] = AHEAD_S + 40.0
    outcome = rig.run()
    assert outcome.error is None
    assert len(outcome.rows) == 60
    assert {(row.frames, row.lost) for row in outcome.rows} == {(200, 0)}
    starts = [row.window.first_counter for row in outcome.rows]
    gaps = [k for k in range(1, 60) if starts[k] != starts[k - 1] + 200]
    (gap,) = rig.events("gap")
    assert [gap["record"]] == [outcome.rows[k].window.number for k in gaps]
    assert gap["first_counter"] == starts[gaps[0]] > starts[gaps[0] - 1] + 200  # later, never twice
    assert any("begun anew" in message for message in rig.listener.messages)


@pytest.mark.parametrize("share", [0.01, 0.3])
def test_no_frame_is_in_two_windows_and_none_between_with_dropped_frames(tmp_path: Path, share: float) -> None:
    """Frame k carries one pulse in channel (k mod 10): what arrives must be counted exactly once."""
    gone = set(np.flatnonzero(np.random.default_rng(SEED).random(4000) < share).tolist())
    print(f"seed {SEED}, share {share}")
    rig = chained(tmp_path, windows=12, call_after=4, pulse_timing=True)
    rig.port_a.dropped = lambda counter: counter in gone
    rig.port_a.npp = np.tile(np.eye(10, dtype=np.int64), (BLOCK // 10, 1))
    outcome = rig.run()
    assert outcome.error is None
    assert_contiguous(list(outcome.rows))
    first = outcome.rows[0].window.first_counter
    assert [row.window.first_counter for row in outcome.rows] == [first + 200 * k for k in range(12)]
    for row in outcome.rows:
        span = range(row.window.first_counter, row.window.first_counter + 200)
        arrived = [counter for counter in span if counter not in gone]
        assert (row.frames, row.lost) == (len(arrived), 200 - len(arrived))
        assert row.sums["npp"].tolist() == [sum(counter % 10 == k for counter in arrived) for k in range(10)]
        assert bool(row.timing) == (row.lost == 0)
    total = sum(row.sums["npp"].sum() for row in outcome.rows)
    assert total == len([counter for counter in range(first, first + 2400) if counter not in gone])


def test_pulse_times_are_kept_where_they_are_asked_for(tmp_path: Path) -> None:
    rig = chained(tmp_path, windows=2, pulse_timing=True)
    rig.port_a.npp[3] = 2
    first, second = rig.run().rows
    for row in (first, second):
        assert row.timing["npp.moment1"].tolist() == [0, 0, 0, 2 * 200 * 201 // 2] + [0] * 6
        assert row.timing["npp.first"].tolist() == [-1, -1, -1, row.window.first_counter] + [-1] * 6
        assert row.timing["npp.last"][3] == row.window.first_counter + 199
    assert [event["pulse_timing"] for event in rig.events("record")] == [True, True]


@pytest.mark.parametrize("span", [(900, 950), (690, 900)])
def test_a_window_that_loses_frames_keeps_its_place(tmp_path: Path, span: tuple[int, int]) -> None:
    """The second case loses the end of one window, the start of the next; nothing is waited for beyond the limit."""
    rig = chained(tmp_path)
    rig.port_a.dropped = lambda counter: span[0] <= counter < span[1]
    outcome = rig.run()
    assert outcome.error is None
    assert_contiguous(list(outcome.rows))
    assert sum(row.lost for row in outcome.rows) == span[1] - span[0]
    assert [bool(row.quality & Quality.LOST) for row in outcome.rows] == [row.lost > 0 for row in outcome.rows]


def test_a_window_without_any_frame_ends_no_run_that_goes_on(tmp_path: Path) -> None:
    """Of integrated frames a window holds one: a damaged one must not cost the other 899."""
    rig = chained(tmp_path)
    first = 500
    rig.port_a.dropped = lambda counter: first + 200 <= counter < first + 400
    outcome = rig.run()
    assert outcome.error is None
    assert [row.frames for row in outcome.rows] == [200, 0, 200, 200, 200]
    assert_contiguous(list(outcome.rows))


def test_a_unit_that_falls_silent_between_windows_ends_the_run(tmp_path: Path) -> None:
    rig = chained(tmp_path)
    rig.port_a.dropped = lambda counter: counter >= 900
    error = rig.run().error
    assert error.code == "B-RUN-021"


@pytest.mark.parametrize("ppm", [-200.0, 200.0])
def test_windows_follow_the_units_clock_not_the_benchs(tmp_path: Path, ppm: float) -> None:
    """200 ppm over 600 s are 0.12 s: waiting by the bench's clock would drift away from the frames."""
    rig = chained(tmp_path, windows=60, seconds=10.0)
    line_ns = 600_000
    period_ns = GATE_NS * (1 + 1e-6 * ppm)
    shown = rig.port_a.clock

    class UnitClock:
        """The bench's time as the unit's own oscillator counts it."""

        def now_ns(self) -> int:
            return round((shown.now_ns() - line_ns) * GATE_NS / period_ns) + line_ns

    rig.port_a.clock = UnitClock()  # type: ignore[assignment]
    outcome = rig.run()
    assert outcome.error is None
    assert_contiguous(list(outcome.rows))
    assert {row.lost for row in outcome.rows} == {0}
    for row in outcome.rows:
        end_ns = (row.window.first_counter + row.window.frames) * period_ns
        assert abs(row.window.t_end_ns - end_ns) < 1.2 * NS  # a poll each second is as near as the stamps can tell
    last = outcome.rows[-1].window
    assert abs(last.t_end_ns - (last.first_counter + last.frames) * period_ns) < 0.05 * NS
