"""All mistakes come at once, none is the echo of another one, and a value says where it was written."""

from __future__ import annotations

from pathlib import Path

import pytest
from plan_sample import FLAT, SEQUENCE, changed, make_bench, mistakes

ROUTE = '      - switch.route: {channel: "{channel}", polarity: "{polarity}"}\n'


def codes(path: Path, overrides: dict[str, str] | None = None) -> list[str]:
    return sorted(error.code for error in mistakes(path, overrides))


@pytest.mark.parametrize(
    ("old", "new", "code"),
    [
        ("settle: 20 s", "settle: 20 V", "B-YAML-012"),
        ("dwell: 10 s", "dwell: 10 V", "B-PLAN-031"),
        ("levels: [1 mA]", "levels: [1 mV]", "B-PLAN-022"),
        ("{channels: 2}", "{channels: 3}", "B-PLAN-020"),
        ("port_b: ngu_b", "port_b: ngu_c", "B-PLAN-045"),
        ("serial: SIM-1", "serial: ../SIM-1", "B-PLAN-025"),
        ("title: a sample", "titel: a sample", "B-YAML-010"),
        ("  temperature_sensor_uncertainty: 0.1 degC\n", "", "B-PLAN-026"),
    ],
)
def test_it_hides_no_misspelt_action_and_no_misspelt_driver(tmp_path: Path, old: str, new: str, code: str) -> None:
    text = changed("- switch.open_all", "- switch.open_al", changed(old, new))
    station = ("driver: hp_3458a", "driver: hp_3459a")
    assert codes(make_bench(tmp_path, text, station)) == sorted([code, "B-PLAN-050", "B-PLAN-011"])


def test_names_in_every_part_of_a_file_that_cannot_be_compiled(tmp_path: Path) -> None:
    text = changed("settle: 20 s", "settle: 20 V")
    for old in ("calibrator.standby", "switch.open_all", "calibrator.output", "calibrator.operating"):
        text = text.replace(old, old + "x")
    found = [error for error in mistakes(make_bench(tmp_path, text)) if error.code == "B-PLAN-050"]
    lines = [text.split("\n")[int(error.where.split(":")[1]) - 1] for error in found]
    assert len(found) == len([line for line in text.split("\n") if "x:" in line or line.endswith("x")]) == 7
    assert all(word in "".join(lines) for word in ("standbyx", "open_allx", "outputx", "operatingx"))
    text = changed("record: 10 s", "record: 10 V", changed("call: switch.open_all", "call: swich.open_all", FLAT))
    assert codes(make_bench(tmp_path, text)) == ["B-PLAN-040", "B-YAML-012"]


def test_mistakes_of_both_files_come_together(tmp_path: Path) -> None:
    text = changed("settle: 20 s", "settle: 20 V", changed("calibrator.operate\n", "calibrator.operat\n"))
    path = make_bench(tmp_path, text, ("limits: {current: [0 A, 220 mA]}", "limits: {current: [0 A, 220 mV]}"))
    assert codes(path) == ["B-PLAN-050", "B-YAML-012", "B-YAML-012"]


@pytest.mark.parametrize(
    ("old", "new", "only"),
    [
        ("slot: 570 s", 'slot: "{slit}"', "B-PLAN-030"),
        ("slot: 570 s", 'slot: "{dwel}"', "B-PLAN-030"),
        ("settle: 20 s", 'settle: "{dwel}"', "B-PLAN-030"),
        ("dwell: 10 s", "dwell: 10 V", "B-PLAN-031"),
        ("      - calibrator.standby\n", "      - calibrator.standy\n", "B-PLAN-050"),
        ("      - calibrator.standby\n", "      - calibratr.standby\n", "B-PLAN-040"),
        (ROUTE, ROUTE.replace("route", "rout"), "B-PLAN-050"),
        (ROUTE, ROUTE.replace('"{polarity}"', "2"), "B-PLAN-052"),
        (ROUTE, ROUTE.replace(', polarity: "{polarity}"', ""), "B-PLAN-051"),
        ("- calibrator.operate\n", "- calibrator.operat\n", "B-PLAN-050"),
        ('output: {current: "{current}"', 'output: {current: "{curent}"', "B-PLAN-030"),
        ("levels: [1 mA]", "levels: [1 mV]", "B-PLAN-022"),
        ("{channels: 2}", "{channels: 3}", "B-PLAN-020"),
        ('in: "{temperatures}"', 'in: "{temperature}"', "B-PLAN-030"),
        ("port_a: ngu_a,", "port_a: ngu_x,", "B-PLAN-045"),
        ('"{temperature}", ramp', '"{temperatur}", ramp', "B-PLAN-030"),
    ],
)
def test_a_mistake_has_no_echo(tmp_path: Path, old: str, new: str, only: str) -> None:
    assert set(codes(make_bench(tmp_path, changed(old, new)))) == {only}


def test_a_misspelt_standby_hides_no_mistake_before_it(tmp_path: Path) -> None:
    lines = ["call: {switch.route: {channel: 1, polarity: +}}", "call: {calibrator.output: {current: 1 mA}}"]
    lines += ["call: calibrator.operate", "call: switch.open_all", "call: calibrator.standy", "call: switch.open_all"]
    head = FLAT[: FLAT.index("timeline:") + len("timeline:\n")]
    text = head + "".join(f"  - {{at: {10 * i} s, {line}}}\n" for i, line in enumerate(lines))
    assert codes(make_bench(tmp_path, text)) == ["B-PLAN-050", "B-PLAN-070"]


@pytest.mark.parametrize(
    ("old", "new", "overrides", "code", "origin"),
    [
        ("levels: [1 mA]", "levels: [1 mA, 250 mA]", {}, "B-PLAN-055", "from levels[1], line {}"),
        ("[20 degC]", "[20 degC, 61 degC]", {}, "B-PLAN-055", "from parameter temperatures[1], line {}"),
        ('in: "{temperatures}"', "in: [61 degC]", {}, "B-PLAN-055", "from the list, line {}"),
        ("{current: 0 A,", "{current: -1 mA,", {}, "B-PLAN-055", "from argument current, line {}"),
        ("dwell: 10 s", "dwell: 10.005 s", {}, "B-PLAN-042", "from parameter dwell, line {}"),
        ("dwell: 10 s", "dwell: 20 s", {"dwell": "10.005 s"}, "B-PLAN-042", "from --set dwell"),
        ("dwell: 10 s", "dwell: 20 s", {"dwell": "-1 s"}, "B-PLAN-031", "from --set dwell"),
        ("[20 degC]", "[21 degC]", {"temperatures": "20 degC, 99 degC"}, "B-PLAN-055", "from --set temperatures[1]"),
        ("settle: 20 s", 'settle: "{dwell}"', {"dwell": "1 s"}, "B-PLAN-060", "from --set dwell"),
        ("slot: 570 s", 'slot: "{dwell}"', {}, "B-PLAN-043", "from parameter dwell, line"),
    ],
)
def test_a_value_says_where_it_was_written(
    tmp_path: Path, old: str, new: str, overrides: dict[str, str], code: str, origin: str
) -> None:
    text = changed(old, new)
    line = text[: text.index(new)].count("\n") + 1
    found = {error.code: error.message for error in mistakes(make_bench(tmp_path, text), overrides)}
    assert f"({origin.format(line)}" in found[code]


def test_each_wrong_level_of_a_table_is_named(tmp_path: Path) -> None:
    found = mistakes(make_bench(tmp_path, changed("levels: [1 mA]", "levels: [250 mA, 1 mA, 260 mA]")))
    named = [error.message.split("from ")[1] for error in found if error.code == "B-PLAN-055"]
    assert [text.split(",")[0] for text in named] == ["levels[0]", "levels[2]"]


@pytest.mark.parametrize(
    ("old", "what"),
    [
        ("  temperature_sensor_uncertainty: 0.1 degC\n", "temperature_sensor_uncertainty"),
        ("white_noise_per_rtHz: 2 nA, ", "white_noise_per_rtHz"),
        (", bias_walk_per_rth: 0.3 nA", "bias_walk_per_rth"),
    ],
)
def test_declared_noise_has_no_default_b_plan_026(tmp_path: Path, old: str, what: str) -> None:
    found = mistakes(make_bench(tmp_path, changed(old, "")))
    assert [error.code for error in found] == ["B-PLAN-026"]
    assert what in found[0].message
    assert mistakes(make_bench(tmp_path, changed("analysis: scale_factor\n", "", changed(old, "")))) == []


def test_the_analysis_needs_the_data_sheet_of_the_unit_b_plan_026(tmp_path: Path) -> None:
    flat = changed("frame:", "analysis: scale_factor\nframe:", FLAT)
    assert codes(make_bench(tmp_path, flat)) == ["B-PLAN-026"]


def test_more_than_a_hundred_mistakes_are_counted_b_yaml_017(tmp_path: Path) -> None:
    calls = "".join(f"  - nobody{number}.acts\n" for number in range(120))
    found = mistakes(make_bench(tmp_path, changed("prepare:\n", "prepare:\n" + calls)))
    assert len(found) == 101
    assert (found[-1].code, found[-1].message) == ("B-YAML-017", "20 more mistakes are not listed")


@pytest.mark.parametrize("step", ["settle: 1 s", "record: 10 s", "prompt: open the door"])
def test_only_calls_and_a_soak_may_end_a_campaign_b_plan_037(tmp_path: Path, step: str) -> None:
    assert "B-PLAN-037" in codes(make_bench(tmp_path, changed("finally:\n", f"finally:\n  - {step}\n")))
    soak = "soak: {temperature: 23 degC, ramp: 0.5 degC/min, slot: 600 s, stable: {within: 2 degC, for: 1 min}}"
    assert codes(make_bench(tmp_path, changed("finally:\n", f"finally:\n  - {soak}\n"))) == []
    assert SEQUENCE.count("finally:\n") == 1
