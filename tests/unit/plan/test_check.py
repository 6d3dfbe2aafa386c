"""The static check against a brute-force model of the bench, and settings that an instrument does not have."""

from __future__ import annotations

from pathlib import Path

import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st
from plan_sample import FLAT, changed, make_bench, mistakes

from bench.model.clock import NS, VIRTUAL_START_UTC_NS
from bench.plan import check_plan, compile_sequence

CALLS = {
    "standby": "calibrator.standby",
    "open": "switch.open_all",
    "route": "{switch.route: {channel: 1, polarity: -}}",
    "set": "{calibrator.output: {current: 1 mA}}",
    "on": "calibrator.operate",
}
ORDERS = st.lists(st.sampled_from(sorted(CALLS)), min_size=1, max_size=8)


def hazards(order: list[str]) -> set[tuple[int, str]]:
    """What happens on a bench whose relays and output do just as they are told: (place, code)."""
    output, closed, found = False, False, set()
    for place, name in enumerate(order):
        if name in ("open", "route") and output:
            found.add((place, "B-PLAN-070"))
        if name == "on" and not closed:
            found.add((place, "B-PLAN-072"))
        output = {"on": True, "standby": False}.get(name, output)
        closed = {"route": True, "open": False}.get(name, closed)
    return found


@settings(max_examples=60, deadline=None, suppress_health_check=[HealthCheck.function_scoped_fixture])
@given(ORDERS)
def test_exactly_the_unsafe_steps_are_found(tmp_path: Path, order: list[str]) -> None:
    head = FLAT[: FLAT.index("timeline:") + len("timeline:\n")]
    lines = [f'  - {{at: "00:00:{5 * place:02}", call: {CALLS[name]}}}\n' for place, name in enumerate(order)]
    first = head.count("\n") + 1
    errors = mistakes(make_bench(tmp_path, head + "".join(lines)))
    found = {(int(e.where.split(":")[1]) - first, e.code) for e in errors if e.code.startswith("B-PLAN-07")}
    assert found == hazards(order)


def test_the_end_of_the_run_decides_whether_a_standard_is_due(tmp_path: Path) -> None:
    path = make_bench(tmp_path)
    station = tmp_path / "stations" / "af_bench_sim.yaml"
    station.write_text(station.read_text().replace("age: 2160 h, ", ""))
    plan = compile_sequence(path)
    day_ns = 86_400 * NS
    due_2000_11_01 = VIRTUAL_START_UTC_NS + 305 * day_ns
    last_second = due_2000_11_01 + day_ns - NS - round(plan.duration_s + plan.prepare_s) * NS
    assert check_plan(plan, start_utc_ns=last_second) == []
    codes = {error.code for error in check_plan(plan, start_utc_ns=last_second + 2 * NS)}
    assert codes == {"B-PLAN-063"}


def test_the_end_of_the_run_decides_whether_a_specification_holds(tmp_path: Path) -> None:
    """Calibrated on 1 November 1999 and good for 90 days: until midnight before 30 January 2000."""
    plan = compile_sequence(make_bench(tmp_path))
    length_ns = round(plan.duration_s + plan.prepare_s + plan.finally_s) * NS
    last = VIRTUAL_START_UTC_NS + 29 * 86_400 * NS - length_ns
    assert check_plan(plan, start_utc_ns=last - NS) == []
    (error,) = check_plan(plan, start_utc_ns=last + 2 * NS)
    assert error.code == "B-PLAN-130"
    assert "calibrator: a specification holds 90 days after the calibration of 1999-11-01" in error.message


@pytest.mark.parametrize("text", ["OUT 1.0E-03 A, 0 HZ", "OPER"])
def test_raw_text_to_a_source_needs_a_closed_route_and_a_call_to_switch_it_off(tmp_path: Path, text: str) -> None:
    flat = changed("call: switch.open_all", "call: {switch.route: {channel: 1, polarity: +}}", FLAT)
    flat = changed("record: 10 s", f'send: {{calibrator: "{text}"}}', flat)
    assert [error.code for error in mistakes(make_bench(tmp_path, flat))] == ["B-PLAN-070"]
    safe = flat.replace('at: "00:00:20", call: switch.open_all', 'at: "00:00:20", call: calibrator.standby')
    assert mistakes(make_bench(tmp_path, safe)) == []


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
