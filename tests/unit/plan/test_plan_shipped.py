"""The shipped sequences against the paper's own figures, by plain loops; several units in one chamber."""

from functools import cache
from pathlib import Path
from typing import Any

import pytest
from plan_sample import reworded
from units_campaign import CUTS, OF_SEVERAL, cut

from bench.model.errors import InputErrors
from bench.plan import UNIT, Plan, PlannedRecord, Step, check_plan, compile_sequence, plan_json, steps_of, summarise

TEMPERATURES_DEGC = (-10.0, 5.0, 20.0, 35.0, 50.0)
GYRO_A = (30e-6, 100e-6, 1e-3, 10e-3, 100e-3, 200e-3)
ACCELEROMETER_A = (500e-6, 1e-3, 2e-3, 5e-3, 10e-3, 20e-3)
SHIPPED = sorted(path.stem for path in (Path(__file__).resolve().parents[3] / "sequences").glob("*.yaml"))
RANGES_A = (220e-6, 2.2e-3, 22e-3, 220e-3)
POINT_s, SOAK_s = 120.0, 9000.0
# every shipped sequence: how long its campaign lasts, in seconds, and its records
PLANS = {
    "bias_ramp_25h": (900 * 100.0, 900),
    "bias_ramp_25h_integrated": (900 * 100.0, 900),
    "bias_ramp_short": (540 * 20.0, 540),
    "bias_ramp_units": (90_000.0, 3600),
    "scale_factor_units": (412_200.0, 3060),
    "dmm_method": (SOAK_s + 100.0 + 10 * 17 * 135.0, 10 * 17),  # 15 points of the table and one level again
    "fog_north": (40.0 + 4 * 4 * 80.0 + 12 * (55.0 + 2 * 4 * 80.0) + 55.0 + 3 * 4 * 80.0, 4 * (4 + 12 * 2 + 3)),
    "fog_north_parameters": (40.0 + 4 * 4 * 80.0 + 2 * (15.0 + 12 * (55.0 + 4 * 80.0)), 4 * (4 + 2 * 12)),
    "gnc_bias": (3 * 25.0 + 3 * 180.0 + 3600.0 + 6 * (600.0 + 600.0), 3 + 1 + 6),
    "gnc_imu_calibration": (6 * 325.0 + 6 * 85.0 + 3 * 2 * (25.0 + 2 * 26.3) + 2 * 30.0, 2 * 6 + 3 * 2 * 2 * 2),
    "gnc_imu_calibration_vertical": (6 * 325.0 + 6 * 85.0 + 3 * 2 * (25.0 + 2 * 26.3), 2 * 6 + 3 * 2 * 2 * 2),
    "gnc_magnetometer": (25.0 + 15.0 + 180.0 + 10.0 + 7 * (25.0 + 5.0 + 30.0 + 5.0) + 8 * 26.0, 1 + 7),
    "gnc_unit_test": (5 * (2.0 + 3.0 + 12.0 + 1.0), 0),
    "rlg_backscatter": (6 * 14.0, 6),
    "rlg_lock_in": (3 * (60.0 + 2 * 23.0), 3 * 2),
    "scale_factor_26h": (60 * (90 + 3 * 100 + 138 + 170) + 387 * (113 + 20), 4 * (10 * 9) + 3 * 9),
    "scale_factor_38h": (5 * SOAK_s + 765 * POINT_s, 5 * 10 * 15 + 15),
    "scale_factor_short": (10_350.0, 2 * 3 * 15 + 15),
    "scale_factor_wall": (460.65, 2 * 3 * 15 + 7),  # 2 x (60 + 3) s and 97 times 3.45 s
    "scale_factor_wall_30s": (12.0 + 10 * 1.95, 2 * 5),
    "scale_factor_zero_per_range": (5 * SOAK_s + 985 * POINT_s, 765 + 5 * (6 * 6 + 4 * 2)),
    "time_sync_acceleration": (61.0, 3),
    "time_sync_linear": (61.0, 1),
    "time_sync_sar": (501.0, 6),
    "time_sync_stationary": (61.0, 1),
    "time_sync_turn": (70.0, 3),
    "timeline_example": (142.0, 1),
}


@cache
def shipped(name: str) -> Plan:
    return compile_sequence(name)


@pytest.fixture(scope="module")
def campaign() -> Plan:
    return shipped("scale_factor_38h")


def table_3(channel: int) -> list[tuple[str, float, int, int]]:
    """Order of Table 3: route, current, polarity, index of the level."""
    levels = GYRO_A if channel <= 6 else ACCELEROMETER_A
    points = [("open", 0.0, 0, -1), ("closed", 0.0, 1, -1), ("closed", 0.0, -1, -1)]
    for index, level in enumerate(levels):
        points += [("closed", level, 1, index), ("closed", level, -1, index)]
    return points


def expected_records() -> list[tuple[float, dict[str, Any]]]:
    """Start and conditions of each record of the 38 hours."""
    records, at_s = [], 0.0
    blocks = [(t, tuple(range(1, 11)), 0, 9000.0) for t in TEMPERATURES_DEGC] + [(50.0, (1,), 1, 0.0)]
    for temperature, channels, repeat, slot_s in blocks:
        at_s += slot_s
        for channel in channels:
            for route, current, polarity, index in table_3(channel):
                conditions = {
                    "channel": channel,
                    "kind": "gyro" if channel <= 6 else "accelerometer",
                    "temperature_degC": temperature,
                    "current_A": current,
                    "polarity": polarity,
                    "range_A": 0.0 if route == "open" else min(r for r in RANGES_A if current <= r),
                    "route": route,
                    "level_index": index,
                    "repeat": repeat,
                    "purpose": "measurement",
                    "settle_band_degC": 1.0,
                }
                records.append((at_s + 20.0, conditions))
                at_s += 120.0
    assert at_s == 136_800.0
    return records


def records(plan: Plan) -> list[Step]:
    return [step for step in plan.phase("campaign") if step.kind == "record"]


def test_every_record_is_where_table_3_puts_it(campaign: Plan) -> None:
    found = [(step.at_s, dict(step.conditions)) for step in records(campaign)]
    for _, conditions in found:
        conditions.pop("level_A", None)
    assert found == expected_records()


def test_each_point_is_done_in_the_safe_order(campaign: Plan) -> None:
    steps = campaign.phase("campaign")
    for step in records(campaign):
        first = step.retry_step
        names = [s.name or s.kind for s in campaign.steps[first : step.number]]
        if step.conditions["route"] == "open":
            assert names == ["standby", "open_all", "settle"]
        else:
            assert names == ["standby", "route", "output", "operate", "settle"]
            route, output = campaign.steps[first + 1], campaign.steps[first + 2]
            after = campaign.steps[step.number + 1]
            assert route.arguments == {key: step.conditions[key] for key in ("channel", "polarity")}
            assert output.arguments == {"current": step.conditions["current_A"], "range": "lowest_that_holds"}
            assert (after.kind, after.role, after.name) == ("verify", "calibrator", "operating")
    assert all(step.bus_s <= step.duration_s for step in steps if step.kind == "settle")


def test_before_hour_0_the_wiring_of_every_channel_is_proved(campaign: Plan) -> None:
    prepare = campaign.phase("prepare")
    wiring = [step for step in prepare if step.kind == "record"]
    assert [(s.conditions["channel"], s.conditions["polarity"]) for s in wiring] == [
        (channel, polarity) for channel in range(1, 11) for polarity in (1, -1)
    ]
    assert {(s.purpose, s.conditions["purpose"], s.conditions["current_A"]) for s in wiring} == {
        ("wiring", "wiring", 1e-3)
    }
    prompts = [step.told() for step in prepare if step.kind == "prompt"]
    assert [p.get("low") for p in prompts] == [None, None, 1e6, 1e6, 7200.0, None]
    assert [p.get("high") for p in prompts] == [0.5, 0.5, None, None, 3.6e7, None]
    who, start = [step for step in prepare if step.kind == "unit"]
    assert (who.role, who.name, who.told()) == ("port_b", "identify", {"command": 1, "payload": ()})
    assert (start.role, start.name, start.told()) == ("port_b", "start_stream", {"command": 2, "payload": (0x64,)})


def test_steps_are_numbered_by_time_and_the_chamber_is_back_before_it_is_stopped(campaign: Plan) -> None:
    names = [step.name for step in campaign.phase("finally")]
    assert names == ["standby", "open_all", "soak", "output_off"]
    (back,) = [step for step in campaign.phase("finally") if step.kind == "soak"]
    assert (back.temperature_degC, back.late) == (23.0, "skip")
    ramp_s = 60.0 * (max(TEMPERATURES_DEGC) - 23.0) / back.ramp_degC_min
    assert ramp_s == 3240.0
    assert back.duration_s >= ramp_s + 3 * 120.0  # the air follows with two minutes of lag
    assert [step.number for step in campaign.steps] == list(range(len(campaign.steps)))
    for phase in ("prepare", "campaign", "finally"):
        at_s = 0.0
        for step in campaign.phase(phase):
            assert step.at_s == pytest.approx(at_s, abs=1e-6)
            at_s += step.duration_s
    assert all(step.where.startswith("scale_factor_38h.yaml:") for step in campaign.steps)


def test_every_shipped_sequence_is_named() -> None:
    assert sorted(PLANS) == SHIPPED


@pytest.mark.parametrize("name", PLANS)
def test_shipped_sequences_pass_the_static_check_and_last_as_long_as_meant(name: str) -> None:
    plan = shipped(name)
    assert (check_plan(plan), summarise(plan).slips) == ([], ())
    assert (plan.duration_s, plan.record_count) == PLANS[name]


def test_values_that_are_set_reach_plan_world_and_hash() -> None:
    plain, again = (compile_sequence("scale_factor_short").sha256 for _ in range(2))
    assert plain == again
    assert compile_sequence("scale_factor_short", overrides={"dwell": "20 s"}).sha256 != plain
    assert compile_sequence("scale_factor_short", overrides={"world.noise": "off"}).sha256 == plain
    plan = compile_sequence("scale_factor_short", overrides={"dwell": "20 s", "world.master_error_ppm": "50"})
    assert {step.duration_s for step in records(plan)} == {20.0}
    assert check_plan(plan) == []
    options = shipped("scale_factor_short").station.world_options
    assert plan.station.world_options == {**options, "master_error_ppm": "50"}
    assert "master_error_ppm" not in options
    assert shipped("scale_factor_short").campaign["uut"] == {"model": "NGU", "serial": "SIM-1"}
    assert compile_sequence("scale_factor_short", overrides={"serial": "0042"}).campaign["uut"]["serial"] == "0042"


def test_summary_names_time_disk_and_hazards(campaign: Plan) -> None:
    summary = summarise(campaign)
    assert (summary.duration_s, summary.finally_s) == (136_800.0, 3600.0)
    assert summary.finish_utc_ns == (946_684_800 + 136_800 + 3600 + int(campaign.prepare_s)) * 10**9
    raw_bytes = (57 * 100 + 28 * 10) * (136_800 + 3600)
    assert raw_bytes < summary.disk_bytes < 1.2 * raw_bytes
    assert "calibrator: up to 200 mA, switched on 734 times" in summary.hazards  # 51 x 14 points and 20 wiring points
    assert "chamber: -10 degC to 50 degC" in summary.hazards
    assert "chamber: after the campaign 23 degC for 3600 s; only then may it be opened" in summary.hazards
    assert "supply: on until it is made safe at the end" in summary.hazards
    assert not any("raw commands" in hazard for hazard in summary.hazards)
    assert any("raw commands" in hazard for hazard in summarise(shipped("timeline_example")).hazards)


@pytest.mark.parametrize(
    ("name", "seconds", "counts"),
    [
        ("bias_ramp_25h", 100.0, (72, 360, 36, 360, 72)),
        ("bias_ramp_25h_integrated", 100.0, (72, 360, 36, 360, 72)),
        ("bias_ramp_short", 20.0, (60, 120, 120, 120, 120)),
    ],
)
def test_bias_campaigns_are_one_chain_of_windows(name: str, seconds: float, counts: tuple[int, ...]) -> None:
    plan = shipped(name)
    branches = ("hold_start", "up", "hold_top", "down", "hold_end")
    expected = [(branch, k) for branch, count in zip(branches, counts, strict=True) for k in range(count)]
    found = records(plan)
    assert [(s.conditions["branch"], s.conditions["window_index"]) for s in found] == expected
    assert [s.at_s for s in found] == [seconds * k for k in range(sum(counts))]
    assert [s.follows for s in found] == [False] + [True] * (len(found) - 1)
    assert {s.pulse_timing for s in found} == {"integrated" not in name}
    assert plan.duration_s == seconds * sum(counts) == (10_800.0 if "short" in name else 90_000.0)
    assert {s.kind for s in plan.phase("campaign")} == {"record", "call"}
    assert {frozenset(s.conditions) for s in found} == {frozenset({"route", "branch", "window_index", "purpose"})}


@pytest.mark.parametrize("name", ["bias_ramp_25h", "bias_ramp_25h_integrated", "bias_ramp_short"])
def test_each_ramp_fills_its_branch(name: str) -> None:
    """The chamber is sent off right before a branch and arrives when the branch ends."""
    plan = shipped(name)
    steps = plan.phase("campaign")
    (before,) = [s for s in plan.phase("prepare") if s.kind == "soak"]
    now_degC = float(before.temperature_degC)
    for branch in ("up", "down"):
        first = next(s for s in steps if s.conditions.get("branch") == branch)
        length_s = sum(s.duration_s for s in steps if s.conditions.get("branch") == branch)
        call, run = plan.steps[first.number - 2 : first.number]
        assert (call.name, run.name, call.at_s) == ("set_temperature", "run", first.at_s)
        ramp_s = 60.0 * abs(call.arguments["temperature"] - now_degC) / call.arguments["ramp"]
        assert ramp_s == pytest.approx(length_s)
        now_degC = call.arguments["temperature"]
    assert now_degC == before.temperature_degC


@pytest.fixture(scope="module")
def units_plan() -> Plan:
    return shipped("scale_factor_units")


def changed_units(folder: Path, *changes: tuple[str, str]) -> Path:
    """The shipped sequence, cut down, with texts replaced."""
    path = folder / "units_tiny.yaml"
    path.write_text(reworded(cut("scale_factor_units", [*OF_SEVERAL, *CUTS]), *changes))
    return path


def codes_of_units(path: Path, serials: str = "SIM-1,SIM-2,SIM-3,SIM-4") -> set[str]:
    """Codes of all mistakes."""
    try:
        return {error.code for error in check_plan(compile_sequence(path, None, {"serials": serials}))}
    except InputErrors as errors:
        return {error.code for error in errors.errors}


def test_four_units_take_three_times_as_long_as_one_and_the_ramp_no_longer(units_plan: Plan) -> None:
    """The soaks are shared, the calibrator is not; open inputs are recorded at once. By planned time, all phases."""

    def length_s(units_plan: Plan) -> float:
        return units_plan.prepare_s + units_plan.duration_s + units_plan.finally_s

    one, ramp, ramps = (shipped(name) for name in ("scale_factor_38h", "bias_ramp_25h", "bias_ramp_units"))
    assert check_plan(units_plan) == []
    assert check_plan(ramps) == []
    assert units_plan.duration_s == 5 * (9000 + 4 * 150 * 120) + 4 * 15 * 120
    assert 2.9 < length_s(units_plan) / length_s(one) <= 3.1
    assert units_plan.duration_s / one.duration_s <= 3.1
    assert length_s(ramps) / length_s(ramp) <= 1.05
    assert (units_plan.record_count, ramps.record_count) == (4 * one.record_count, 4 * ramp.record_count)


def test_an_empty_slot_is_left_alone() -> None:
    units_plan = compile_sequence("scale_factor_units", None, {"serials": "X1,,X3"})
    assert [(unit.slot, unit.serial) for unit in units_plan.units] == [("A", "X1"), ("C", "X3")]
    assert {rule.of for rule in units_plan.interlocks if rule.signal == "link_age"} == {"a_port_a", "c_port_a"}
    hot = {rule.name: rule.of for rule in units_plan.interlocks if rule.signal == "unit_temperature"}
    assert hot == {"unit_hot_a": "a_port_a", "unit_hot_c": "c_port_a"}
    assert check_plan(units_plan) == []


def test_records_outside_the_loop_are_taken_together() -> None:
    units_plan = shipped("bias_ramp_units")
    records = [step for step in units_plan.phase("campaign") if isinstance(step, PlannedRecord)]
    for first in range(0, 40, 4):
        group = records[first : first + 4]
        assert [record.together for record in group] == [False, True, True, True]
        assert [record.duration_s for record in group] == [100.0, 0.0, 0.0, 0.0]
        assert [record.conditions[UNIT] for record in group] == ["SIM-1", "SIM-2", "SIM-3", "SIM-4"]
        assert [record.follows for record in group] == [first > 0] * 4
    assert steps_of(plan_json(units_plan.steps)) == units_plan.steps


def test_a_wiring_record_looks_at_every_unit(units_plan: Plan) -> None:
    records = [step for step in units_plan.steps if isinstance(step, PlannedRecord) and step.purpose == "wiring"]
    assert len(records) == 4 * 10 * 2 * 4
    group = records[:4]
    assert [record.conditions[UNIT] for record in group] == ["SIM-2", "SIM-3", "SIM-4", "SIM-1"]
    assert [record.conditions.get("beside") for record in group] == ["A", "A", "A", None]


def test_what_says_for_no_unit_is_refused(tmp_path: Path) -> None:
    path = changed_units(tmp_path, ("      - supply.output_on\n", "  - supply.output_on\n"))
    assert codes_of_units(path) >= {"B-PLAN-141"}
    decided = (
        "  - function_generator.output_on\n  - if: {reading: rail_dmm.measure_voltage, above: 1 V}\n    then: []\n"
    )
    path = changed_units(tmp_path, ("  - function_generator.output_on\n", decided.replace("[]", "[{settle: 1 s}]")))
    assert "B-PLAN-141" in codes_of_units(path)
    twice = "          - for: unit\n            in: units\n            do: [wiring_point: {polarity: +}]\n"
    path = changed_units(tmp_path, ("          - wiring_point: {polarity: +}\n", twice))
    assert "B-PLAN-141" in codes_of_units(path)


def test_slots_that_do_not_fit_units_that_nothing_proves_and_foreign_routes_are_refused(tmp_path: Path) -> None:
    tiny = changed_units(tmp_path)
    assert codes_of_units(tiny, "A1,A2,A3,A4,A5") == {"B-PLAN-140"}
    assert codes_of_units(tiny, ",,") >= {"B-PLAN-140"}
    assert "B-PLAN-025" in codes_of_units(tiny, "A1,A1")
    assert "B-PLAN-025" in codes_of_units(tiny, "A 1,A2")
    assert "B-PLAN-025" in codes_of_units(tiny, "A/1,A_1")  # one folder
    assert codes_of_units(tiny, "A/1,A2") == set()
    assert "B-PLAN-140" in codes_of_units(changed_units(tmp_path, ("port_b: ngu_b}", "port_b: ngu_b, port_c: ngu_b}")))
    assert "B-PLAN-140" in codes_of_units(changed_units(tmp_path, ("\nuut:\n", "\nearly: {after: 1 h}\nuut:\n")))
    asked = "      - unit: {port_b: identify}            # is it the serial number of this slot?\n"
    assert codes_of_units(changed_units(tmp_path, (asked, ""))) == {"B-PLAN-142"}
    assert codes_of_units(changed_units(tmp_path, ("          - wiring_point: {polarity: -}\n", ""))) == {"B-PLAN-142"}
    assert codes_of_units(changed_units(tmp_path, ('card: "{unit.card}"', "card: 2"))) == {"B-PLAN-076"}
