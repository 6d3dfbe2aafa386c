"""Points that are taken again or left out while a table is in the plan: it must stand where the plan says it does."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import pytest
from hold_rig import HoldRig
from run_rig import Instrument, Rig

from bench.model.ports import Effect, Parameter, action
from bench.run.stop import Wish

AXIS, ANGLE, RATE = Parameter("axis", choices=(1, 2, 3)), Parameter("angle", "deg"), Parameter("rate", "deg/s")


class Table(Instrument):
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


class TableRig(HoldRig):
    """Two points, each with motions of its own between two settle times, a record and a verify step."""

    def __init__(self, folder: Path, first: list[tuple[str, dict[str, Any]]], second: list[tuple[str, Any]]) -> None:
        super().__init__(folder, 0)
        self.table = Table("turntable", self)
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
OPEN: tuple[str, dict[str, Any]] = ("open_interlock", {})


@pytest.mark.parametrize("moment_s", [7.0, 12.0, 19.99])
@pytest.mark.parametrize(
    ("motions", "state"),
    [([TURN], (100.0, 0.0, True)), ([SPIN], (10.0, 5.0, True)), ([OPEN], (10.0, 0.0, False))],
)
def test_a_point_that_is_taken_again_begins_where_it_began(
    tmp_path: Path, motions: list[Any], state: Any, moment_s: float
) -> None:
    rig = TableRig(tmp_path, motions, [])
    rig.at(moment_s, lambda: rig.stop.holds.wish(Wish("retake", "somebody", "test")))
    assert rig.run_beside().error is None
    assert len(rig.events("retake")) <= 1
    assert rig.states() == {0: state, 1: state}


def test_a_point_whose_verification_failed_begins_where_it_began(tmp_path: Path) -> None:
    rig = TableRig(tmp_path, [TURN], [])
    rig.source.answers["operating"] = [False]
    assert rig.run_beside().error is None
    assert len(rig.events("retake")) == 1
    assert rig.states() == {0: (100.0, 0.0, True), 1: (100.0, 0.0, True)}


@pytest.mark.parametrize("moment_s", [7.0, 12.0, 19.99])
@pytest.mark.parametrize(
    ("motions", "state"),
    [([TURN], (100.0, 0.0, True)), ([SPIN], (10.0, 5.0, True)), ([OPEN], (10.0, 0.0, False))],
)
def test_behind_a_point_that_is_left_out_the_table_is_where_the_plan_has_it(
    tmp_path: Path, motions: list[Any], state: Any, moment_s: float
) -> None:
    """An interlock that is not opened because its step was skipped would be closed at the next prompt."""
    rig = TableRig(tmp_path, motions, [])
    rig.at(moment_s, lambda: rig.stop.holds.wish(Wish("skip", "somebody", "test")))
    assert rig.run_beside().error is None
    assert len(rig.events("skip")) == 1
    assert rig.states() == {1: state}


def test_a_table_that_does_not_move_is_left_alone(tmp_path: Path) -> None:
    rig = TableRig(tmp_path, [], [])
    rig.at(12.0, lambda: rig.stop.holds.wish(Wish("retake", "somebody", "test")))
    assert rig.run_beside().error is None
    assert len(rig.events("retake")) <= 1
    assert [name for _, name, _ in rig.calls if name == "turntable.make_safe"] == ["turntable.make_safe"]
