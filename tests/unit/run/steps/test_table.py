"""A table stands where the plan says: made safe on the way, at a point that is taken again, behind one left out."""

from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from gnc_rig import TableRig, open_table
from plan_sample import planned
from run_rig import HoldRig, Instrument, Rig

from bench.model.drivers import driver_class
from bench.model.ports import Effect, Parameter, action, actions_of, can_move
from bench.plan import Step
from bench.run.position import point_start
from bench.run.setpoints import goes_off, motion_again, steps_again
from bench.run.stop import Wish

DRIVERS = {"turntable": actions_of(driver_class("acutrol_3000")), "supply": actions_of(driver_class("hp_6632b"))}


def plan(*calls: tuple[str, dict[str, Any]] | float, finally_from: int = 10_000) -> list[Step]:
    """Steps of calls to the table; a number is a settle time."""
    steps = []
    for number, call in enumerate(calls):
        phase: Any = "finally" if number >= finally_from else "campaign"
        if isinstance(call, float):
            steps.append(planned("settle", number, phase=phase, duration_s=call))
        else:
            steps.append(planned("call", number, phase=phase, role="turntable", name=call[0], **call[1]))
    return steps


def move(axis: int, angle: float) -> tuple[str, dict[str, Any]]:
    return "move", {"axis": axis, "angle": angle, "rate": 90.0}


def turn(axis: int, angle: float) -> tuple[str, dict[str, Any]]:
    return "turn", {"axis": axis, "angle": angle, "rate": 200.0, "acceleration": 300.0}


def spin(axis: int, rate: float) -> tuple[str, dict[str, Any]]:
    return "spin", {"axis": axis, "rate": rate}


CLOSE: tuple[str, dict[str, Any]] = ("close_interlock", {})
OPEN: tuple[str, dict[str, Any]] = ("open_interlock", {})
LIMITS = [("set_limits", {"axis": axis, "rate": 300.0, "acceleration": 300.0}) for axis in (1, 2, 3)]


def said(steps: Sequence[Step]) -> list[str]:
    return [
        f"settle {one.duration_s:g}"
        if one.kind == "settle"
        else f"{one.name} {' '.join(f'{value:g}' for value in one.arguments.values())}".strip()
        for one in steps
    ]


def test_interlock_then_pose_then_the_longest_settle_time() -> None:
    steps = plan(
        *LIMITS, CLOSE, 15.0, move(1, 90.0), move(2, -34.2), move(3, 10.0), 25.0, turn(3, 1085.0), 5.0, spin(1, -9.0)
    )
    assert said(motion_again(steps, len(steps), DRIVERS)) == [
        "close_interlock", "settle 15", "move 2 -34.2 90", "move 3 15 90", "spin 1 -9", "settle 25",
    ]  # fmt: skip
    assert said(motion_again(steps, 8, DRIVERS)) == [
        "close_interlock", "settle 15", "move 1 90 90", "move 2 -34.2 90", "move 3 10 90",
    ]  # fmt: skip


@pytest.mark.parametrize(
    ("calls", "again"),
    [
        ([CLOSE, move(1, 5.0), OPEN], []),
        ([CLOSE, OPEN, CLOSE, move(1, 5.0)], ["close_interlock", "move 1 5 90"]),
        ([CLOSE, spin(3, 90.0), 3.0, ("stop", {"axis": 3})], ["close_interlock", "settle 3"]),
        ([CLOSE, turn(3, 90.0)], ["close_interlock"]),
        ([CLOSE, move(3, 7.0), ("stop", {"axis": 3})], ["close_interlock", "move 3 7 90"]),
        ([move(1, 5.0)], []),
        ([CLOSE, spin(3, 90.0), OPEN, CLOSE], ["close_interlock"]),  # what turned before somebody came is at rest
        ([CLOSE, move(1, 5.0), spin(3, 90.0), OPEN, CLOSE, turn(3, 9.0)], ["close_interlock", "move 1 5 90"]),
        ([CLOSE, spin(3, 90.0), OPEN, CLOSE, spin(3, 8.0)], ["close_interlock", "spin 3 8"]),
    ],
)
def test_what_is_not_known_or_not_moving_is_left_alone(calls: list[Any], again: list[str]) -> None:
    steps = plan(*calls)
    assert said(motion_again(steps, len(steps), DRIVERS)) == again


def test_nothing_moves_for_the_end_of_a_run() -> None:
    steps = plan(CLOSE, move(1, 5.0), OPEN, finally_from=2)
    assert motion_again(steps, 2, DRIVERS) == []


def test_limits_are_set_again_and_motion_is_not_among_the_settings() -> None:
    steps: Any = plan(*LIMITS, CLOSE, move(1, 90.0), turn(1, 10.0), spin(3, 5.0), OPEN, CLOSE)
    found = steps_again(type("P", (), {"steps": steps})(), len(steps), DRIVERS)  # type: ignore[arg-type]
    assert said(found) == ["set_limits 1 300 300", "set_limits 2 300 300", "set_limits 3 300 300"]


def test_raw_text_to_a_table_is_not_sent_again() -> None:
    raw = planned("send", 0, role="turntable", text=":int:close 1")
    plain = planned("send", 1, role="supply", text="DISP ON")
    steps: Any = [raw, plain]
    again = steps_again(type("P", (), {"steps": steps})(), 2, DRIVERS)  # type: ignore[arg-type]
    assert [step.role for step in again] == ["supply"]


def test_a_table_goes_off_in_a_hold_and_a_supply_does_not() -> None:
    assert can_move(DRIVERS["turntable"])
    assert goes_off(driver_class("acutrol_3000"))
    assert not goes_off(driver_class("hp_6632b"))


def do(rig: TableRig, steps: Sequence[Step]) -> None:
    for step in steps:
        if step.kind == "settle":
            rig.clock.sleep(step.duration_s)
        else:
            getattr(rig.driver, step.name)(**step.arguments)


@pytest.mark.parametrize("seed", range(6))
def test_interrupted_anywhere_it_ends_where_the_undisturbed_one_does(seed: int) -> None:
    rng = np.random.default_rng(seed)
    calls: list[Any] = [*LIMITS, CLOSE, *[move(axis, float(rng.uniform(-180, 180))) for axis in (1, 2, 3)], 10.0]
    for _ in range(12):
        axis = int(rng.integers(1, 4))
        angle = float(rng.uniform(-800, 800))
        calls += [turn(axis, angle) if rng.random() < 0.5 else move(axis, angle % 360.0), 12.0]
    steps = plan(*calls)
    with open_table(seed) as straight, open_table(seed) as broken:
        do(straight, steps)
        number = int(rng.integers(8, len(steps)))
        print(f"seed {seed}: interrupted before step {number}")
        do(broken, steps[:number])
        broken.clock.sleep(float(rng.uniform(0.0, 3.0)))
        with broken.driver.quick(0.45):
            broken.driver.make_safe()
        again = motion_again(steps, number, DRIVERS)
        do(broken, [*again, *plan(10.0)])
        do(broken, steps[number:])
        apart = (np.array(broken.angles()) - straight.angles() + 180.0) % 360.0 - 180.0
        assert np.abs(apart).max() < 1e-6
        assert broken.driver.in_position()


def test_a_recording_with_a_motion_in_it_is_taken_again_from_its_beginning() -> None:
    steps = plan(move(3, 0.0), 5.0, 1.0, turn(3, 1080.0), 9.0, 5.0)
    steps[2] = planned("record", 2, duration_s=1.0, retry_step=0)
    steps[4] = planned("record", 4, duration_s=9.0, follows=True)
    assert [point_start(steps, index) for index in range(6)] == [0, 0, 0, 0, 0, 5]
    steps[3] = replace(steps[3], name="measure_rate")  # without a motion each record is its own
    assert [point_start(steps, index) for index in (2, 3, 4)] == [0, 3, 4]


AXIS, ANGLE, RATE = Parameter("axis", choices=(1, 2, 3)), Parameter("angle", "deg"), Parameter("rate", "deg/s")


class FakeTable(Instrument):
    """One axis that is at once where it is sent; ``past`` holds (time, angle, rate, interlock closed)."""

    def __init__(self, role: str, rig: Rig) -> None:
        super().__init__(role, rig)
        self.angle, self.rate, self.closed = 0.0, 0.0, False
        self.past: list[tuple[float, float, float, bool]] = []

    operate = None

    def _do(self, name: str, **state: Any) -> None:
        self._call(name)
        vars(self).update(state)
        self.past.append((self._rig.clock.now_ns() / 1e9, self.angle, self.rate, self.closed))

    @action(effect=Effect.MOTION_ON)
    def close_interlock(self) -> None:
        self._do("close_interlock", closed=True)

    @action(effect=Effect.MOTION_OFF)
    def open_interlock(self) -> None:
        self._do("open_interlock", closed=False, rate=0.0)

    @action(AXIS, ANGLE, RATE, effect=Effect.MOTION_ON)
    def move(self, axis: int, angle: float, rate: float) -> None:
        assert self.closed
        self._do("move", angle=angle, rate=0.0)

    @action(AXIS, ANGLE, effect=Effect.MOTION_ON)
    def turn(self, axis: int, angle: float) -> None:
        assert self.closed
        self._do("turn", angle=self.angle + angle)

    @action(AXIS, RATE, effect=Effect.MOTION_ON)
    def spin(self, axis: int, rate: float) -> None:
        assert self.closed
        self._do("spin", rate=rate)

    def make_safe(self) -> None:
        self._do("make_safe", closed=False, rate=0.0)

    def at(self, t_s: float) -> tuple[float, float, bool]:
        return [one[1:] for one in self.past if one[0] <= t_s + 1e-9][-1]


class JumpRig(HoldRig):
    """Two points, each with motions of its own between two settle times, a record and a verify step."""

    def __init__(self, folder: Path, first: list[tuple[str, dict[str, Any]]], second: list[tuple[str, Any]]) -> None:
        super().__init__(folder, 0)
        self.table = FakeTable("turntable", self)
        self.instruments |= {"turntable": self.table}
        self.step("call", "turntable", "close_interlock")
        self.step("call", "turntable", "move", axis=1, angle=10.0, rate=9.0)
        self.step("settle", duration_s=5.0)
        self._point(first, 0)
        self._point(second, 1)

    def _point(self, motions: list[tuple[str, dict[str, Any]]], number: int) -> None:
        start = len(self.steps)
        self.step("settle", duration_s=5.0)
        for name, arguments in motions:
            self.step("call", "turntable", name, **arguments)
        self.step("settle", duration_s=5.0)
        conditions = {"point": number}
        self.step("record", "port_a", seconds=10.0, retry=1, max_lost=0.0, retry_step=start, conditions=conditions)
        self.step("verify", "source", "operating")

    def states(self) -> dict[int, tuple[float, float, bool]]:
        """Angle, rate and interlock of the table at the begin of the record of each point."""
        rows = [row for _, row in sorted(self.ran.rows.items())]
        return {row.window.conditions["point"]: self.table.at(row.window.t_start_ns / 1e9) for row in rows}


TURN = ("turn", {"axis": 1, "angle": 90.0})
SPIN = ("spin", {"axis": 1, "rate": 5.0})
OPENED: tuple[str, dict[str, Any]] = ("open_interlock", {})


@pytest.mark.parametrize("wish", ["retake", "skip"])
@pytest.mark.parametrize("moment_s", [7.0, 12.0, 19.99])
@pytest.mark.parametrize(
    ("motions", "state"),
    [([TURN], (100.0, 0.0, True)), ([SPIN], (10.0, 5.0, True)), ([OPENED], (10.0, 0.0, False))],
)
def test_at_a_point_taken_again_and_behind_one_left_out_it_is_where_the_plan_has_it(
    tmp_path: Path, motions: list[Any], state: Any, moment_s: float, wish: Any
) -> None:
    """An interlock that is not opened because its step was skipped would be closed at the next prompt."""
    rig = JumpRig(tmp_path, motions, [])
    rig.at(moment_s, lambda: rig.stop.holds.wish(Wish(wish, "somebody", "test")))
    assert rig.run_beside().error is None
    assert (len(rig.events("retake")) <= 1, len(rig.events("skip"))) == (True, int(wish == "skip"))
    assert rig.states() == ({1: state} if wish == "skip" else {0: state, 1: state})


def test_a_point_whose_verification_failed_begins_where_it_began(tmp_path: Path) -> None:
    rig = JumpRig(tmp_path, [TURN], [])
    rig.source.answers["operating"] = [False]
    assert rig.run_beside().error is None
    assert len(rig.events("retake")) == 1
    assert rig.states() == {0: (100.0, 0.0, True), 1: (100.0, 0.0, True)}


def test_a_table_that_does_not_move_is_left_alone(tmp_path: Path) -> None:
    rig = JumpRig(tmp_path, [], [])
    rig.at(12.0, lambda: rig.stop.holds.wish(Wish("retake", "somebody", "test")))
    assert rig.run_beside().error is None
    assert len(rig.events("retake")) <= 1
    assert [name for _, name, _ in rig.calls if name == "turntable.make_safe"] == ["turntable.make_safe"]
