"""Every item of the unit test can be repeated, if the time for it is stated."""

from __future__ import annotations

import pytest

from bench.commands.check import checked_plan
from bench.plan import Plan, PlannedCommand


def commands_of(plan: Plan, item: str) -> int:
    """Return how many commands of a plan belong to a test item."""
    return sum(isinstance(step, PlannedCommand) and step.item == item for step in plan.steps)


@pytest.fixture(scope="module")
def shipped() -> Plan:
    """Return the plan of one unit as it is shipped."""
    return checked_plan("gnc_unit_test", None, ["units=GNC-01"])


@pytest.mark.parametrize("turns", [2, 3, 10])
@pytest.mark.parametrize("item", ["loopback", "cpu", "timer", "memory", "imu", "gps", "ad"])
def test_an_item_is_repeated(item: str, turns: int, shipped: Plan) -> None:
    repeats = ",".join(map(str, range(1, turns + 1)))
    plan = checked_plan("gnc_unit_test", None, ["units=GNC-01", f"{item}_turns={repeats}", "functions_time=60 s"])
    name = "io" if item == "loopback" else item
    assert commands_of(plan, name) == turns * commands_of(shipped, name) > 0


@pytest.mark.parametrize("item", ["loopback", "cpu", "timer", "memory", "imu", "gps", "ad"])
def test_an_item_is_left_out_by_name(item: str) -> None:
    plan = checked_plan("gnc_unit_test", None, ["units=GNC-01", f"{item}_turns="])
    asked = {step.item for step in plan.steps if isinstance(step, PlannedCommand)}
    name = "io" if item == "loopback" else item
    assert name not in asked
    assert len(asked) > 5
