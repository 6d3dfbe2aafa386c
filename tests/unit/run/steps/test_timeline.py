"""The timeline: planned waits, slip, and that a settle time is never cut short."""

from __future__ import annotations

from pathlib import Path

import pytest
from run_rig import Rig

from bench.model.clock import NS, VirtualClock
from bench.run.steps.timing import Timeline
from bench.run.stop import StopSwitch


def timeline() -> Timeline:
    clock = VirtualClock()
    clock.sleep(5.0)
    return Timeline(clock, StopSwitch(), clock.now_ns())


def test_waits_end_at_planned_times() -> None:
    line = timeline()
    for at_s in (0.5, 2.0, 2.0, 7.25):
        line.wait_until(at_s)
        assert line.clock.now_ns() == 5 * NS + round(at_s * NS)
    assert line.lateness_ns == [0, 0, 0, 0]


def test_a_late_wait_is_noted_and_takes_no_time() -> None:
    line = timeline()
    line.clock.sleep(3.0)
    line.wait_until(1.0)
    assert line.clock.now_ns() == 8 * NS
    assert line.lateness_ns == [2 * NS]


def test_reach_never_goes_back() -> None:
    line = timeline()
    line.clock.sleep(3.0)
    line.reach(1.0)
    assert line.clock.now_ns() == 8 * NS
    assert line.lateness_ns == []
    line.reach(4.0)
    assert line.clock.now_ns() == 9 * NS


def test_slip_moves_everything_after_it() -> None:
    line = timeline()
    line.add_slip(NS)
    line.add_slip(NS // 2)
    line.wait_until(1.0)
    assert line.clock.now_ns() == 7 * NS + NS // 2
    assert line.target_ns(10.0) == 16 * NS + NS // 2


@pytest.mark.parametrize("bus_takes_s", [0.5, 2.0, 2.5, 30.0])
def test_settle_is_never_shorter_than_planned_minus_its_bus_time(tmp_path: Path, bus_takes_s: float) -> None:
    """Planned: 20 s with 2 s of bus time in it. Whatever the bus takes, at least 18 s remain, and later steps shift."""
    rig = Rig(tmp_path, "calibrator")
    rig.instruments["calibrator"].slow_s["output"] = bus_takes_s
    rig.step("call", "calibrator", "output", current=1.0)
    rig.step("settle", duration_s=20.0, bus_s=2.0)
    rig.step("call", "calibrator", "operating")
    rig.step("settle", duration_s=10.0, bus_s=0.1)
    rig.step("call", "calibrator", "operating")
    outcome = rig.run()
    slip_s = max(0.0, bus_takes_s - 2.0)
    first, second = rig.called("calibrator.operating")
    assert first == pytest.approx(20.0 + slip_s, abs=1e-9)
    assert first - bus_takes_s >= 18.0 - 1e-9
    assert second == pytest.approx(first + 10.0, abs=1e-9)
    assert outcome.slip_s == pytest.approx(slip_s)
    assert outcome.overruns == (1 if slip_s else 0)
    assert [event["seconds"] for event in rig.events("overrun")] == pytest.approx([slip_s] if slip_s else [])


def test_lateness_of_the_whole_run_is_in_the_outcome(tmp_path: Path) -> None:
    rig = Rig(tmp_path, "calibrator")
    rig.instruments["calibrator"].slow_s["output"] = 3.0
    rig.step("call", "calibrator", "output", current=1.0)
    rig.step("record", "port_a", seconds=1.0, retry=0, max_lost=0.0, retry_step=0)
    rig.step("settle", duration_s=1.0, bus_s=0.0)
    outcome = rig.run()
    assert outcome.error is None
    assert outcome.lateness_ms == (0.0, 0.0, 0.0)  # shifted by slip, then on time
    assert outcome.slip_s == pytest.approx(3.01)  # the last frame is on the wire 0.6 ms after its gate; 10 ms per look
