"""Several units in one chamber, by the plan alone: what is done for whom, how long it takes, and what is refused."""

from __future__ import annotations

from pathlib import Path

import pytest

from bench.model.errors import InputErrors
from bench.plan import UNIT, Plan, PlannedRecord, check_plan, compile_sequence, steps_of
from bench.plan.step_kinds import plan_json

ROOT = Path(__file__).resolve().parents[3]
SHIPPED = ROOT / "sequences" / "scale_factor_units.yaml"


@pytest.fixture(scope="module")
def plan() -> Plan:
    return compile_sequence(SHIPPED)


def changed(folder: Path, *changes: tuple[str, str]) -> Path:
    """The shipped sequence with texts replaced."""
    text = SHIPPED.read_text()
    for old, new in changes:
        assert old in text, old
        text = text.replace(old, new)
    path = folder / SHIPPED.name
    path.write_text(text)
    return path


def codes(path: Path, serials: str = "SIM-1,SIM-2,SIM-3,SIM-4") -> set[str]:
    """Codes of all mistakes."""
    try:
        return {error.code for error in check_plan(compile_sequence(path, None, {"serials": serials}))}
    except InputErrors as errors:
        return {error.code for error in errors.errors}


def test_four_units_take_three_times_as_long_as_one_and_the_ramp_no_longer(plan: Plan) -> None:
    """The soaks are shared, the calibrator is not; open inputs are recorded at once. By planned time, all phases."""

    def length_s(plan: Plan) -> float:
        return plan.prepare_s + plan.duration_s + plan.finally_s

    one, ramp = compile_sequence("scale_factor_38h"), compile_sequence("bias_ramp_25h")
    ramps = compile_sequence("bias_ramp_units")
    assert check_plan(plan) == []
    assert check_plan(ramps) == []
    assert plan.duration_s == 5 * (9000 + 4 * 150 * 120) + 4 * 15 * 120
    assert 2.9 < length_s(plan) / length_s(one) <= 3.1
    assert plan.duration_s / one.duration_s <= 3.1
    assert length_s(ramps) / length_s(ramp) <= 1.05
    assert (plan.record_count, ramps.record_count) == (4 * one.record_count, 4 * ramp.record_count)


def test_links_supply_and_card_are_those_of_the_slot(plan: Plan) -> None:
    of_c = [step for step in plan.steps if step.conditions.get(UNIT) == "SIM-3"]
    roles = {step.role for step in of_c}
    assert {"c_port_a", "c_port_b", "supply_c"} <= roles
    assert roles <= {"", "c_port_a", "c_port_b", "supply_c", "calibrator", "switch"}
    routes = {step.told()["card"] for step in of_c if (step.role, step.name) == ("switch", "route")}
    assert routes == {3}
    assert list(plan.frames) == [f"{slot}_port_{port}" for slot in "abcd" for port in "ab"]
    assert plan.link_bytes_s == pytest.approx(4 * compile_sequence("scale_factor_38h").link_bytes_s)


def test_an_empty_slot_is_left_alone() -> None:
    plan = compile_sequence(SHIPPED, None, {"serials": "X1,,X3"})
    assert [(unit.slot, unit.serial) for unit in plan.units] == [("A", "X1"), ("C", "X3")]
    assert {rule.of for rule in plan.interlocks if rule.signal == "link_age"} == {"a_port_a", "c_port_a"}
    hot = {rule.name: rule.of for rule in plan.interlocks if rule.signal == "unit_temperature"}
    assert hot == {"unit_hot_a": "a_port_a", "unit_hot_c": "c_port_a"}
    assert check_plan(plan) == []


def test_records_outside_the_loop_are_taken_together() -> None:
    plan = compile_sequence("bias_ramp_units")
    records = [step for step in plan.phase("campaign") if isinstance(step, PlannedRecord)]
    for first in range(0, 40, 4):
        group = records[first : first + 4]
        assert [record.together for record in group] == [False, True, True, True]
        assert [record.duration_s for record in group] == [100.0, 0.0, 0.0, 0.0]
        assert [record.conditions[UNIT] for record in group] == ["SIM-1", "SIM-2", "SIM-3", "SIM-4"]
        assert [record.follows for record in group] == [first > 0] * 4
    assert steps_of(plan_json(plan.steps)) == plan.steps


def test_a_wiring_record_looks_at_every_unit(plan: Plan) -> None:
    records = [step for step in plan.steps if isinstance(step, PlannedRecord) and step.purpose == "wiring"]
    assert len(records) == 4 * 10 * 2 * 4
    group = records[:4]
    assert [record.conditions[UNIT] for record in group] == ["SIM-2", "SIM-3", "SIM-4", "SIM-1"]
    assert [record.conditions.get("beside") for record in group] == ["A", "A", "A", None]


def test_what_says_for_no_unit_is_refused(tmp_path: Path) -> None:
    path = changed(tmp_path, ("      - supply.output_on\n", "  - supply.output_on\n"))
    assert codes(path) >= {"B-PLAN-141"}
    decided = (
        "  - function_generator.output_on\n  - if: {reading: rail_dmm.measure_voltage, above: 1 V}\n    then: []\n"
    )
    path = changed(tmp_path, ("  - function_generator.output_on\n", decided.replace("[]", "[{settle: 1 s}]")))
    assert "B-PLAN-141" in codes(path)
    twice = "          - for: unit\n            in: units\n            do: [wiring_point: {polarity: +}]\n"
    path = changed(tmp_path, ("          - wiring_point: {polarity: +}\n", twice))
    assert "B-PLAN-141" in codes(path)


def test_slots_that_do_not_fit_are_refused(tmp_path: Path) -> None:
    assert codes(SHIPPED, "A1,A2,A3,A4,A5") == {"B-PLAN-140"}
    assert codes(SHIPPED, ",,") >= {"B-PLAN-140"}
    assert "B-PLAN-025" in codes(SHIPPED, "A1,A1")
    assert "B-PLAN-025" in codes(SHIPPED, "A 1,A2")
    assert "B-PLAN-140" in codes(changed(tmp_path, ("port_b: ngu_b}", "port_b: ngu_b, port_c: ngu_b}")))
    assert "B-PLAN-140" in codes(changed(tmp_path, ("\nuut:\n", "\nearly: {after: 1 h}\nuut:\n")))


def test_a_unit_that_nothing_proves_is_refused(tmp_path: Path) -> None:
    asked = "      - unit: {port_b: identify}            # is it the serial number of this slot?\n"
    assert codes(changed(tmp_path, (asked, ""))) == {"B-PLAN-142"}
    assert codes(changed(tmp_path, ("          - wiring_point: {polarity: -}\n", ""))) == {"B-PLAN-142"}


def test_the_route_of_another_slot_is_no_route_of_this_unit(tmp_path: Path) -> None:
    assert codes(changed(tmp_path, ('card: "{unit.card}"', "card: 2"))) == {"B-PLAN-076"}
