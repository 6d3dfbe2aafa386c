"""What no recording can show is named with its size, before the flight and after it."""

from __future__ import annotations

import doubt_time_sync as worlds
import pytest

from bench.model.assumptions import Assumption, assumptions_of
from bench.model.shipped import find_shipped
from bench.plan import compile_sequence

STATED = {"analysis": "time_sync", "latency": {"egi_s": 8e-3, "imu_s": 8e-4, "std_s": 1e-3}}


def by_code(**sections: object) -> dict[str, Assumption]:
    return {taken.code: taken for taken in assumptions_of(STATED | sections)}


def test_every_hidden_switch_is_named() -> None:
    assert {switch.assumption for switch in worlds.SWITCHES} - {""} <= set(by_code())


def test_what_passes_unseen_is_that_of_the_stated_latencies() -> None:
    assert "up to 5.5 ms" in by_code()["latency_as_stated"].unseen
    assert "any size" in by_code(latency=None)["latency_as_stated"].unseen


@pytest.mark.parametrize(("velocity_m_s", "text"), [(0.017, "0.11 m"), (0.17, "1.10 m")])
def test_larger_errors_hide_more(velocity_m_s: float, text: str) -> None:
    assert text in by_code(egi={"velocity_m_s": velocity_m_s, "level_deg": 0.0013})["one_place"].unseen


def test_a_plan_names_them() -> None:
    plan = compile_sequence(find_shipped("sequences", "time_sync_turn"), None, {})
    assert len(assumptions_of(plan.campaign)) == 8
