"""Settings that an instrument does not have are told before a run, not by the instrument in the middle of it."""

from __future__ import annotations

import pytest

from bench.plan import check_plan, compile_sequence


@pytest.mark.parametrize(
    ("name", "settings", "said"),
    [
        ("rlg_lock_in", {"clocks": "20 MHz,30 MHz"}, "clock 3e+07 Hz is none of its settings; the nearest is 2e+07"),
        ("fog_north", {"time_constant": "2 s"}, "time_constant 2 s is none of its settings; the nearest is 3 s"),
    ],
)  # fmt: skip
def test_a_setting_between_two_that_there_are_is_refused(name: str, settings: dict[str, str], said: str) -> None:
    findings = [str(one) for one in check_plan(compile_sequence(name, None, settings))]
    assert findings
    assert all("B-PLAN-055" in one and said in one for one in findings), findings


@pytest.mark.parametrize("clock", ["10 MHz", "20 MHz", "50 MHz", "100 MHz"])
def test_a_setting_there_is_passes(clock: str) -> None:
    assert check_plan(compile_sequence("rlg_lock_in", None, {"clocks": clock, "paths": "15 cm"})) == []
