"""A machine that slept, or a process that was stopped, holds the run: stimulus off, and the point is taken again."""

from __future__ import annotations

import time
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import pytest
from hold_rig import HoldRig, sound

from bench.model import clock as clock_module
from bench.model.clock import NS, VirtualClock, WallClock, to_ns
from bench.run.stop import StopSwitch
from bench.run.watch import clock as watch_module
from bench.run.watch.clock import SUSPEND_S, ClockWatch, clock_watch

AT_S = 8.2  # in the record of the first point


class SleepingRig(HoldRig):
    """Its machine sleeps once, by the boot clock or, ``stopped``, with its monotonic clock going on."""

    def __init__(self, folder: Path, seconds: float, *, stopped: bool = False, at_s: float = AT_S) -> None:
        super().__init__(folder, 2)
        self.asleep_ns = 0
        self.clock.boot_ns = lambda: self.clock.now_ns() + self.asleep_ns  # type: ignore[method-assign]
        self.at(at_s, lambda: self.stop_for(seconds) if stopped else self.sleep_for(seconds))

    def sleep_for(self, seconds: float) -> None:
        self.asleep_ns += to_ns(seconds)

    def stop_for(self, seconds: float) -> None:
        self.clock.pass_to_ns(self.clock.now_ns() + to_ns(seconds))


@pytest.mark.parametrize(("stopped", "seen"), [(False, "boottime"), (True, "late beat")])
@pytest.mark.parametrize("seconds", [2.6, 60.0])
def test_a_suspend_makes_the_stimulus_safe_and_the_point_is_taken_again(
    tmp_path: Path, stopped: bool, seen: str, seconds: float
) -> None:
    rig = SleepingRig(tmp_path, seconds, stopped=stopped)
    outcome = rig.run_beside(clock_watch)
    assert outcome.error is None
    sound(rig, 2)
    (suspend,) = rig.events("suspend")
    assert (suspend["seen"], suspend["seconds"]) == (seen, pytest.approx(seconds, abs=0.5))
    (hold,) = rig.events("hold")
    assert (hold["step"], hold["by"]) == (2, "suspend")
    assert rig.called("source.make_safe")[0] <= max(15.1, AT_S + seconds + 0.1)  # a virtual wait is never sliced
    assert rig.events("release")[0]["seconds"] <= 1.5  # it is let go once it stands still ...
    assert rig.events("armed") == [{"step": 2, "by": "somebody"}]  # ... and somebody arms what follows
    assert [step for step in rig.listener.steps if step == 0] == [0, 0]  # from its relays on
    assert rig.stop.holds.reasons == {}


@pytest.mark.parametrize("stopped", [False, True])
def test_a_machine_with_much_to_do_is_no_suspend(tmp_path: Path, stopped: bool) -> None:
    rig = SleepingRig(tmp_path, SUSPEND_S - 0.51, stopped=stopped)
    assert rig.run_beside(clock_watch).error is None
    assert rig.events("suspend") == rig.events("hold") == []


def test_no_step_ends_between_a_suspend_and_the_next_look(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """The machine wakes up at 14.9 s, the record ends at 15.0 s, and the next look is at 15.4 s."""
    monkeypatch.setattr(watch_module, "LOOK_S", 0.7)
    rig = SleepingRig(tmp_path, 60.0, at_s=14.9)
    assert rig.run_beside(clock_watch).error is None
    assert rig.events("hold")[0]["step"] == 2
    sound(rig, 2)


def test_a_run_that_stands_still_already_is_let_go_too(tmp_path: Path) -> None:
    rig = SleepingRig(tmp_path, 60.0, at_s=30.2)
    rig.at(8.0, lambda: rig.stop.holds.hold("door", "it is open"))
    rig.at(40.0, lambda: rig.stop.holds.release("door"))
    assert rig.run_beside(clock_watch).error is None
    assert len(rig.events("suspend")) == len(rig.events("hold")) == 1
    assert rig.events("release")[0]["seconds"] == pytest.approx(40.0 - 15.0, abs=1.0)
    sound(rig, 2)


def test_whoever_armed_the_bench_before_a_suspend_has_not_seen_it() -> None:
    virtual: Any = VirtualClock()
    stop = StopSwitch()
    watch = ClockWatch(SimpleNamespace(clock=virtual, stop=stop, note=lambda event: None))  # type: ignore[arg-type]
    stop.holds.hold("operator", "lunch")
    stop.holds.let_go(["operator"], armed_by="kim")
    assert stop.holds.armed_by == "kim"
    virtual.boot_ns = lambda: virtual.now_ns() + 10 * NS
    watch.look()
    assert list(stop.holds.reasons) == ["suspend"]
    assert stop.holds.armed_by == ""
    watch.look()
    assert list(stop.holds.reasons) == ["suspend"]  # nobody has stood still for it yet


def test_the_end_of_a_run_is_told_of_a_suspend_and_not_held_up(tmp_path: Path) -> None:
    rig = SleepingRig(tmp_path, 60.0, at_s=33.0)
    rig.step("settle", duration_s=30.0, bus_s=0.0, phase="finally")
    assert rig.run_beside(clock_watch).error is None
    assert len(rig.events("suspend")) == 1
    assert rig.events("hold") == []


def test_the_boot_clock_is_that_of_the_system_or_the_monotonic_one(monkeypatch: pytest.MonkeyPatch) -> None:
    clock = WallClock()
    before_ns, boot_ns, after_ns = clock.now_ns(), clock.boot_ns(), clock.now_ns()
    assert boot_ns >= before_ns
    monkeypatch.setattr(clock_module, "_BOOT", None)  # a system that has none
    assert before_ns <= clock.boot_ns() <= after_ns + NS
    assert clock.boot_ns() - time.monotonic_ns() < NS
    assert VirtualClock().boot_ns() == 0
