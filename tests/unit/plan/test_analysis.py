"""What an analysis asks of the records is asked before the run: a mistake in it costs days otherwise."""

from __future__ import annotations

from pathlib import Path

import plan_sample
import pytest

from bench.analysis import analysis_module
from bench.model.systems import analyses
from bench.plan import check_plan, compile_sequence, load_station

ROOT = Path(__file__).resolve().parents[3]
REGISTER_LINE = (
    "        - {range: 10 mA, relative: 20 ppm, floor: 50 nA, specification: relative, age: 8760 h, "
    "certificate_U: 10 ppm, common_with: SIM-0007}\n"
)


def mistakes(folder: Path, shipped: str, *changes: tuple[str, str]) -> list[tuple[str, str]]:
    """Codes and messages that the check finds in a shipped sequence with changes."""
    text = (ROOT / "sequences" / f"{shipped}.yaml").read_text()
    for old, new in changes:
        assert old in text
        text = text.replace(old, new)
    path = folder / f"{shipped}.yaml"
    path.write_text(text)
    return [(one.code, one.message) for one in plan_sample.mistakes(path)]


@pytest.mark.parametrize("name", analyses())
def test_what_is_declared_is_what_the_analysis_has(name: str) -> None:
    assert analyses()[name][0].methods == analysis_module(name).METHODS


@pytest.mark.parametrize(
    ("name", "says"),
    [("bias_rmp", "did you mean 'bias_ramp'"), ("spectrum", "known: bias_ramp"), ("temperature_ramp", "imported logs")],
)
def test_an_analysis_that_a_sequence_cannot_have_b_plan_077(tmp_path: Path, name: str, says: str) -> None:
    found = mistakes(tmp_path, "bias_ramp_short", ("analysis: bias_ramp", f"analysis: {name}"))
    assert [code for code, _ in found] == ["B-PLAN-077"]
    assert says in found[0][1]


@pytest.mark.parametrize(
    ("shipped", "old", "new", "says"),
    [
        ("bias_ramp_short", "branch: up", "brnch: up", "condition branch"),
        ("bias_ramp_short", "branch: up", "branch: upwards", "no branch 'upwards'"),
        ("bias_ramp_short", "route: open, branch: up", "branch: up", "condition route"),
        ("bias_ramp_short", "route: open, branch: up", "route: open, channel: 1, branch: up", "all channels at once"),
        ("bias_ramp_short", "analysis: bias_ramp", "analysis: scale_factor", "channel, temperature_degC"),
        ("dmm_method", "analysis: dmm_method", "analysis: bias_ramp", "condition branch"),
        ("scale_factor_short", '            current: "{current}"\n', "", "condition current_A"),
        ("dmm_method", "- dmm.measure_current", "- verify: calibrator.operating", "readings of the meter"),
        ("time_sync_linear", "frame: {imu: imu_200, egi: egi_50}", "frame: {imu: imu_200}", "link 'egi' beside"),
        ("time_sync_linear", "imu: imu_200, egi: egi_50", "egi: egi_50, imu: imu_200", "link 'egi' beside"),
    ],
)
def test_records_that_the_analysis_would_leave_out_b_plan_078(
    tmp_path: Path, shipped: str, old: str, new: str, says: str
) -> None:
    found = mistakes(tmp_path, shipped, (old, new))
    assert any(code == "B-PLAN-078" and says in message for code, message in found), found


def test_a_limit_that_nothing_can_keep_b_plan_093(tmp_path: Path) -> None:
    ((code, message),) = mistakes(tmp_path, "time_sync_linear", ("stamps_difference: 5 ms", "stamps_difference: -5 ms"))
    assert (code, "-5 ms is not above zero" in message) == ("B-PLAN-093", True)


@pytest.mark.parametrize(
    ("shipped", "old", "new", "code", "says"),
    [
        ("scale_factor_short", "uut:", "uut:\n  limits: {supply_voltage: 5 V}", "B-PLAN-093", "'scale_factor' has no"),
        ("time_sync_linear", "stamps_difference: 5 ms", "stamps_difference: 5 A", "B-PLAN-093", "5 A"),
        ("time_sync_linear", "analysis: time_sync", "analysis: none", "B-PLAN-093", "nothing judges the limit"),
        (
            "scale_factor_short",
            "analysis: scale_factor",
            "analysis: none\ndecision: {rule: simple}",
            "B-PLAN-098",
            "rule",
        ),
    ],
)
def test_what_nothing_judges_or_can_judge_is_a_mistake(
    tmp_path: Path, shipped: str, old: str, new: str, code: str, says: str
) -> None:
    found = mistakes(tmp_path, shipped, (old, new))
    assert any(one == code and says in message for one, message in found), found


def test_a_range_of_the_meter_needs_an_uncertainty_b_plan_066(tmp_path: Path) -> None:
    station = (ROOT / "stations" / "af_bench_sim.yaml").read_text()
    assert REGISTER_LINE in station
    (tmp_path / "af_bench_sim.yaml").write_text(station.replace(REGISTER_LINE, ""))
    bench = load_station(tmp_path / "af_bench_sim.yaml")
    (found,) = check_plan(compile_sequence(ROOT / "sequences" / "dmm_method.yaml", bench))
    assert found.code == "B-PLAN-066"
    assert "dmm: the plan uses 10 mA" in found.message


def test_a_range_of_the_meter_must_hold_the_level_b_plan_079(tmp_path: Path) -> None:
    point = "      - point: {current: 10 mA, polarity: +, meter: 10 mA, repeat: 1}"
    found = mistakes(tmp_path, "dmm_method", (point, point.replace("meter: 10 mA", "meter: 1 mA")))
    assert {code for code, _ in found} == {"B-PLAN-079"}
    assert all("0.001 A range and cannot read the 0.01 A of calibrator" in message for _, message in found)
