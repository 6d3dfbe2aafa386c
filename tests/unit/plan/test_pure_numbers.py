"""A pure number has the dimension "1": written plainly, or with % and ppm, and held against its limits."""

from __future__ import annotations

from collections import defaultdict
from types import SimpleNamespace
from typing import Any

import pytest

from bench.model.ports import Parameter
from bench.plan.check.actions import ActionCheck
from bench.plan.findings import Findings
from instruments.values import check_argument

COUNT = Parameter("count", "1", 1.0, 5.0)
STEP: Any = SimpleNamespace(role="meter", name="average", where="s.yaml:3:5", number=0)


def checker() -> tuple[ActionCheck, Findings]:
    findings = Findings()
    plan: Any = SimpleNamespace(origins=defaultdict(dict), declared=defaultdict(dict))
    station: Any = SimpleNamespace(name="station")
    return ActionCheck(plan, station, findings), findings


@pytest.mark.parametrize(
    ("value", "dimension", "right"),
    [(3, "", True), (2.5, "", True), (0.05, "1", True), (True, "", False), ("3", "", False), (3.0, "A", False)],
)
def test_what_counts_as_a_pure_number(value: Any, dimension: str, right: bool) -> None:
    check, findings = checker()
    assert check._sort_is_right(STEP, COUNT, value, dimension) is right
    assert [one.code for one in findings.sorted()] == ([] if right else ["B-PLAN-052"])


def test_its_limits_are_checked_by_the_plan_and_by_the_driver() -> None:
    check, findings = checker()
    entry: Any = SimpleNamespace(driver="maker_model", limits={})
    check._limits(STEP, COUNT, 3.0, entry)
    assert not findings.sorted()
    check._limits(STEP, COUNT, 7.0, entry)
    assert "count 7 is outside 1 to 5 of driver maker_model" in str(findings.sorted()[0])
    assert check_argument(COUNT, 3) == 3.0
    with pytest.raises(ValueError, match=r"above 5\.0"):
        check_argument(COUNT, 7)
