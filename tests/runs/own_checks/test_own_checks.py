"""Checks of a fictional unit in a lab folder without a line of Python, and what is expected of what a unit says."""

import json
import math
import re
import shutil
import struct
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import yaml
from typer.testing import CliRunner, Result

from bench.cli import app
from bench.model.errors import InputErrors
from bench.model.texts import quantity_title
from bench.plan import PlannedCommand, PlannedRecord, PlannedSend, check_plan, compile_sequence
from bench.record import SessionReader
from bench.session.makeup import make_up_sequence
from bench.session.record_states import MISSING, RecordState
from sim_instruments.worlds.readings.options import PlainOptions

LAB = Path(__file__).resolve().parents[3] / "examples/own_checks"
CHECKS = ("supply_test", "linearity", "thermistor")
MOST_LINES = 80


@pytest.fixture
def lab(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """A copy of the folder outside of the repository, and a shell in it."""
    copy = shutil.copytree(LAB, tmp_path / "our_lab")
    monkeypatch.chdir(copy)
    return copy


def command(*words: object) -> Result:
    return CliRunner().invoke(app, [str(word) for word in words], catch_exceptions=False)


def run(check: str, *more: object) -> tuple[Result, Path]:
    done = command("run", check, "--clock", "virtual", "--seed", "1", "--out", "out", *more)
    (folder,) = Path("out").glob(f"*_{check}_*")
    return done, folder.resolve()


def results_of(folder: Path) -> dict[str, Any]:
    return json.loads((folder / "results.json").read_text())


def values(folder: Path) -> dict[str, dict[str, Any]]:
    """Return the estimates of a session by quantity, the last of each."""
    return {entry["quantity"]: entry for entry in results_of(folder)["estimates"]}


def test_no_file_is_long_and_none_is_code() -> None:
    files = [path for path in LAB.rglob("*") if path.is_file()]
    assert {path.suffix for path in files} <= {".yaml", ".toml", ".md"}
    assert max(len(path.read_text().splitlines()) for path in files) < MOST_LINES


@pytest.mark.parametrize("check", CHECKS)
def test_verdicts_report_certificate_and_history(check: str, lab: Path) -> None:
    assert command("check", check).exit_code == 0
    done, folder = run(check)
    assert (done.exit_code, "verdicts:" in done.output) == (0, True)
    estimates = results_of(folder)["estimates"]
    verdicts = [entry["verdict"] for entry in estimates]
    assert "pass" in verdicts
    assert set(verdicts) <= {"pass", "none"}
    assert all(entry["quality"] == "sound" for entry in estimates)
    page = (folder / "report.html").read_text()
    assert all(quantity_title("readings", name) in page for name in {entry["quantity"] for entry in estimates})
    specimen = command("certificate", folder, "--specimen", "--laboratory", "laboratory.yaml")
    assert specimen.exit_code == 0, specimen.output
    assert "toleranceLimitUpper" in (folder / "certificate.specimen.xml").read_text()
    shown = command("history", "show", folder.name, "--history", f"sqlite:///{lab}/out/history.sqlite")
    assert (shown.exit_code, "pass" in shown.output) == (0, True)
    assert "identical" in command("replay", folder).output


def test_intervals_hold_the_truth_of_the_simulated_unit(lab: Path) -> None:
    """The physics is that of the world alone: half of the supply, offset, gain and bow; an NTC of 10 kohm."""
    made = PlainOptions()
    supply, linearity, thermistor = (values(run(check)[1]) for check in CHECKS)
    assert abs(supply["rail"]["value"] - made.rail_V) <= supply["rail"]["expanded_uncertainty"]
    assert abs(supply["current"]["value"] - made.idle_A) <= supply["current"]["expanded_uncertainty"]
    bow_V = 1e-6 * made.monitor_bow_ppm * 10.0
    bow, slope = linearity["monitor_nonlinearity"], linearity["monitor_c1"]
    assert bow["value"] <= bow_V + bow["expanded_uncertainty"]
    gain = 0.5 * (1.0 + 1e-6 * made.monitor_gain_ppm)
    assert abs(slope["value"] - gain) <= slope["expanded_uncertainty"] + 4.0 * bow_V / 20.0  # the bow's own slope
    x = -math.log1p(1e-6 * made.thermistor_ppm)  # Vishay's inverse curve; the world has the other one
    due_degC = 1.0 / (3.354016e-3 + 2.569850e-4 * x + 2.620131e-6 * x**2 + 6.383091e-8 * x**3) - 273.15
    nominal = thermistor["nominal_temperature"]
    assert abs(nominal["value"] - due_degC) <= nominal["expanded_uncertainty"]
    assert thermistor["thermistor_c3"]["unit"] == "1/K"


@pytest.mark.parametrize(
    ("check", "option", "failed"),
    [
        ("supply_test", "rail_V=5.2", "rail"),
        pytest.param("supply_test", "idle_A=0.17", "current", marks=pytest.mark.sweep),
        ("linearity", "monitor_bow_ppm=2000", "monitor_c0 monitor_nonlinearity"),
        pytest.param("linearity", "monitor_gain_ppm=5000", "monitor_c1", marks=pytest.mark.sweep),
        ("thermistor", "thermistor_ppm=100000", "nominal_temperature"),
    ],
)
def test_a_unit_that_is_not_right_fails(check: str, option: str, failed: str, lab: Path) -> None:
    done, folder = run(check, "--set", f"world.{option}")
    assert done.exit_code == 1
    assert {entry["quantity"] for entry in results_of(folder)["estimates"] if entry["verdict"] == "fail"} == {
        *failed.split()
    }


@pytest.mark.parametrize(
    ("check", "line"),
    [
        ("supply_test", "rail: 4.9 to 5.1 V, stable within 0.001 V; 0:00:10 and 2 times more (supply_test.yaml:25:9)"),
        ("supply_test", "housing_length: 0.0795 to 0.0805 m; 0:00:00 (supply_test.yaml:16:5)"),
        ("linearity", "monitor: output against input, c0 ± 0.005 V, c1 0.4995 to 0.5005, nonlinearity ≤ 0.002 V; at "
                      "the end"),
        ("thermistor", "thermistor: 1/air_temperature against log(resistance), nonlinearity ≤ 1 degC, "
                       "nominal_temperature 24 to 26 degC; at the end"),
    ],
)  # fmt: skip
def test_the_check_says_what_is_judged_where(check: str, line: str, lab: Path) -> None:
    assert f"expected {line}" in " ".join(command("check", check).output.split())
    assert {"expected"} <= json.loads(command("check", check, "--json").output).keys()


def test_limits_of_a_loop_are_told_from_the_first_to_the_last(lab: Path) -> None:
    sequence = lab / "sequences/linearity.yaml"
    levels = 'expect: {name: input, equals: "{level}", tolerance: 1 %}'
    sequence.write_text(sequence.read_text().replace("expect: {name: input}", levels))
    said = " ".join(command("check", "linearity").output.split())
    assert "input: 7.92 to 8.08 V at level 8 V, to 18.81 to 19.19 V at level 19 V; 0:00:10" in said


def test_a_line_through_a_bent_unit_is_doubted_unless_its_departure_is_judged(lab: Path) -> None:
    sequence = lab / "sequences/linearity.yaml"
    bent = ("--set", "world.monitor_bow_ppm=2000")
    sequence.write_text(sequence.read_text().replace("      nonlinearity: {max: 2 mV}\n", ""))
    done, folder = run("linearity", *bent)
    assert (done.exit_code, "[departs]" in done.output) == (1, True)
    assert values(folder)["monitor_c1"]["verdict"] == "indeterminate"
    assert values(folder)["output"]["quality"] == "sound"


def test_a_meter_without_specification_casts_doubt_on_what_it_reads_and_on_the_fit(lab: Path) -> None:
    station = lab / "stations/unit_bench_sim.yaml"
    text = station.read_text()
    first = text.index("SIM-0303")
    station.write_text(text[:first] + text[first:].replace("specifications: [{reads: measure_voltage, range: 10 V, "
                                                           "relative: 35 ppm, floor: 50 uV}]}", "}", 1))  # fmt: skip
    done, folder = run("linearity")
    found = values(folder)
    assert (done.exit_code, "[no_specification]" in done.output) == (1, True)
    assert [found[name]["quality"] for name in ("output", "monitor_c1", "input")] == ["doubtful", "doubtful", "sound"]


def test_nothing_judged_is_said_once_before_and_after(lab: Path) -> None:
    sequence = lab / "sequences/supply_test.yaml"
    text = sequence.read_text()
    start, stop = text.index("  - prompt:\n"), text.index("  - for:")
    kept = [line for line in (text[:start] + text[stop:]).splitlines() if "expect:" not in line]
    sequence.write_text(
        "\n".join(kept).replace("measure_voltage:", "measure_voltage").replace("measure_current:", "measure_current")
    )
    assert command("check", "supply_test").output.count("not judged") == 1
    done, folder = run("supply_test")
    assert (done.exit_code, done.output.count("not judged")) == (0, 1)
    assert {"rail_meter_voltage", "supply_current"} <= values(folder).keys()


HEAD = """\
sequence: ways
station: unit_bench_sim
analysis: readings
uut: {model: SC, serial: "1"}
steps:
  - supply.configure: {voltage: 12 V, current_limit: 0.5 A, over_voltage: 20 V}
  - supply.output_on
  - settle: 5 s
  - rail_meter.measure_voltage
  - supply.measure_current:
    expect: {name: current, max: 150 mA}
  - settle: 5 s
"""
TAIL = "  - settle: 5 s\nfinally:\n  - supply.output_off\n"
RAIL = "rail_meter.measure_voltage"
WAITS = f"""\
  - while: {{reading: {RAIL}, below: 4.9 V}}
    at_most: 2
    do: [settle: 5 s, {RAIL}]
    else: go_on
"""
IF = f"""\
  - if: {{reading: {RAIL}, below: 4.9 V}}
    then:
      - {{output_meter.measure_voltage: {{}}, expect: {{name: low_rail_output, within: [5.9 V, 6.1 V]}}}}
      - settle: 5 s
      - record:
          seconds: 10 s
          every: 5 s
          readings: [{{input_meter.measure_voltage: {{}}, expect: {{name: low_rail_input, within: [0 V, 13 V]}}}}]
      - prompt: {{text: Measure the fuse., value: {{unit: ohm, low: 0 ohm, high: 1 ohm, quantity: fuse,
                                                  uncertainty: 0.01 ohm}}}}
"""
CHOOSE = f"""\
  - choose: {RAIL}
    cases:
      - {{below: 4.9 V, do: [{{input_meter.measure_voltage: {{}}, expect: {{name: both, max: 13 V}}}}]}}
      - below: 5.5 V
        do:
          - settle: 5 s
          - {{input_meter.measure_voltage: {{}}, expect: {{name: both, max: 13 V}}}}
    else: [{{output_meter.measure_voltage: {{}}, expect: {{name: high_rail, min: 0 V}}}}]
"""


def taken(steps: str, rail_V: float = 5.0) -> tuple[int, list[str], list[str], Path]:
    """Run a sequence with these steps; returns exit status, what is missing, quantities of the results, and session."""
    Path("sequences/ways.yaml").write_text(HEAD + steps + TAIL)
    done, folder = run("ways", "--set", f"world.rail_V={rail_V}")
    _, _, told = done.output.partition("MISSING: ")
    missing = [line.strip() for line in told.splitlines()[1:] if line.startswith("  ")]
    return done.exit_code, missing, [entry["quantity"] for entry in results_of(folder)["estimates"]], folder


@pytest.mark.parametrize(
    ("steps", "rail_V", "more"), [(WAITS, 5.0, []), (IF, 5.0, []), (CHOOSE, 4.2, ["both"]), (CHOOSE, 5.2, ["both"])]
)
def test_a_loop_that_ends_and_a_branch_that_is_not_taken_promise_nothing(
    lab: Path, steps: str, rail_V: float, more: list[str]
) -> None:
    """No turn more; no call, reading of a record or what a person measures; of two branches the value of one."""
    assert taken(steps, rail_V)[:3] == (0, [], ["rail_meter_voltage", "current", *more])


def test_a_loop_that_goes_on_without_what_it_waits_for_says_so(lab: Path) -> None:
    status, missing, names, folder = taken(WAITS, 4.2)
    assert (status, names) == (1, ["rail_meter_voltage", "current", "rail_meter_voltage", "rail_meter_voltage"])
    assert missing == ["rail_meter.measure_voltage is 4.20003 V after the last turn, still below 4.9 V"]
    again = command("fit", folder)
    assert (again.exit_code, missing[0] in again.output) == (1, True)


def test_a_branch_that_is_taken_promises_its_values(lab: Path) -> None:
    status, missing, names, _ = taken(IF, 4.2)
    assert (status, missing) == (0, [])
    assert {"low_rail_output", "low_rail_input", "fuse"} <= {*names}


SEQUENCE = """\
sequence: unit_says
title: What a unit says of itself
station: af_bench_sim
frame: {port_a: ngu_a, port_b: ngu_b}
analysis: readings
uut: {model: NGU, serial: SIM-1}
unit_commands: {start_stream: {code: 2, payload: "64"}, identify: {code: 1}}
timeline:
  - {at: "00:00:00", call: {supply.configure: {voltage: 18 V, current_limit: 2 A, over_voltage: 21 V}}}
  - {at: "00:00:01", call: supply.output_on}
  - {at: "00:00:08", unit: {port_b: start_stream}}
  - at: "00:00:10"
    unit: {port_b: identify}
    expect: {name: identity, pattern: 'NGU (\\S+)', equals: SIM-1}
  - at: "00:00:10"
    unit: {port_b: identify}
    expect: {name: firmware, pattern: '[0-9.]+$', unit: "1", min: 0.9 1}
  - at: "00:00:11"
    send: {function_generator: "FREQ?"}
    expect: {name: frequency, unit: Hz, within: [900 Hz, 1100 Hz], uncertainty: 0.1 Hz}
  - {at: "00:00:12", call: {supply.measure_voltage: , expect: {name: supply, within: [17.8 V, 18.2 V]}}}
  - at: "00:00:13"
    record:
      seconds: 20 s
      expect:
        - {name: board_temperature, signal: "port_b.unit_temperature[1]", within: [15 degC, 30 degC]}
        - {name: supply_voltage, signal: port_b.supply_voltage, within: [17.5 V, 18.5 V], stable: 200 mV}
        - {name: clock, signal: port_a.af_clock, within: [2559 pulse, 2562 pulse]}
"""
HOUSEKEEPING = re.compile(rb"\xeb\x9b\x1c\x01", re.DOTALL)  # sync, length 28, kind 1
VOLT_AT = 4 + 2 + 4 * 2  # behind sync, length and kind, the counter and four temperatures


def written(folder: Path, text: str = SEQUENCE) -> Path:
    path = folder / "unit_says.yaml"
    path.write_text(text)
    return path


def run_text(folder: Path, text: str = SEQUENCE) -> Path:
    path = written(folder, text)
    command("run", path, "--clock", "virtual", "--seed", 1, "--out", folder / "out")
    (session,) = (folder / "out").glob("*_unit_says_*")
    return session


@pytest.fixture(scope="module")
def session(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return run_text(tmp_path_factory.mktemp("unit_says"))


def test_each_is_an_estimate_with_its_verdict(session: Path) -> None:
    found = values(session)
    verdicts = {name: found[name]["verdict"] for name in found if not name.endswith("_repeatability")}
    assert verdicts == {
        "identity": "pass", "firmware": "pass", "frequency": "pass", "supply": "indeterminate",
        "board_temperature": "pass", "supply_voltage": "pass", "supply_voltage_span": "pass", "clock": "pass",
    }  # fmt: skip
    assert found["supply"]["reasons"][0]["code"] == "no_specification"  # the station states none of the supply
    assert (found["identity"]["value"], found["identity"]["limits"]) == (1.0, {"low": 1.0, "high": 1.0})
    assert "1 (NGU SIM-1 1.0)" in (session / "report.html").read_text()
    assert found["firmware"]["value"] == 1.0
    assert found["firmware"]["std_uncertainty"] == pytest.approx(0.1 / math.sqrt(12.0))  # "1.0": its last digit
    assert found["frequency"]["std_uncertainty"] == pytest.approx(0.05, rel=1e-3)
    assert "every number is identical" in command("replay", session).output  # the same from the session alone
    assert "identical" in command("report", session, "--verify").output


def test_a_number_of_the_frames_is_the_mean_of_the_record(session: Path) -> None:
    """Against the bytes of the line, read by the struct module."""
    reader = SessionReader(session)
    events = [message.event() for message in reader.messages() if message.topic == "/event"]
    (record,) = (fields for kind, fields in events if kind == "record")
    assert record["signals"] == ["port_b.unit_temperature[1]", "port_b.supply_voltage", "port_a.af_clock"]
    volts = []
    for message in reader.messages(frozenset({"/link/port_b/rx"})):
        if record["t_start_ns"] < message.t_ns <= record["t_end_ns"]:
            places = [match.start() for match in re.finditer(HOUSEKEEPING, message.payload)]
            volts += [struct.unpack_from(">H", message.payload, at + VOLT_AT)[0] / 1000.0 for at in places]
    assert 150 < len(volts) <= 201
    found = values(session)
    voltage, span = found["supply_voltage"], found["supply_voltage_span"]
    assert voltage["n"] == pytest.approx(200, abs=1)
    assert voltage["value"] == pytest.approx(np.mean(volts), abs=2e-4)
    assert span["value"] == pytest.approx(np.ptp(volts), abs=1e-3)
    white = np.std(volts, ddof=1) / math.sqrt(len(volts))
    assert voltage["std_uncertainty"] == pytest.approx(math.hypot(white, 1e-3 / math.sqrt(12.0)), rel=0.15)
    clock = found["clock"]
    assert (clock["unit"], clock["n"]) == ("pulse", 2000)
    assert clock["value"] == pytest.approx(2560.0, abs=0.2)  # of 256 kHz in 10 ms


def test_what_is_not_as_expected_fails_or_is_missing(tmp_path: Path) -> None:
    text = SEQUENCE.replace("equals: SIM-1", "equals: SIM-2").replace("within: [17.5 V", "within: [18.1 V")
    text = text.replace("pattern: '[0-9.]+$'", "pattern: 'rev ([0-9]+)'")
    session = run_text(tmp_path, text)
    found = values(session)
    assert [found[name]["verdict"] for name in ("identity", "supply_voltage")] == ["fail", "fail"]
    assert "firmware" not in found
    assert "firmware was not read" in command("fit", session).output


def test_a_make_up_reads_the_same(tmp_path: Path) -> None:
    path = written(tmp_path)
    plan = compile_sequence(path)
    (record,) = (step for step in plan.steps if isinstance(step, PlannedRecord))
    text, _, _ = make_up_sequence(plan, [RecordState(record, None, MISSING)])
    path.write_text(text)
    assert "unit_says_make_up" in yaml.safe_load(text)["sequence"]
    again = compile_sequence(path)
    assert check_plan(again) == []
    (made_up,) = (step for step in again.steps if isinstance(step, PlannedRecord))
    assert made_up.signals == record.signals
    asked = [step for step in again.steps if isinstance(step, PlannedCommand | PlannedSend)]
    assert {"identity", "firmware", "frequency"} <= {step.conditions.get("quantity") for step in asked}


REFUSED = {
    "no such field": (("port_b.supply_voltage,", "port_b.suply_voltage,"), "B-PLAN-120", "no number 'suply_voltage'"),
    "no such link": (("signal: port_b.supply", "signal: port_c.supply"), "B-PLAN-120", "there is no link 'port_c'"),
    "not of a frame": (("port_b.supply_voltage,", "bench.air,"), "B-PLAN-120", "no number of a frame"),
    "another unit": (("[17.5 V,", "[17.5 A,"), "B-PLAN-120", "17.5 A is in A"),
    "a text with limits": (("equals: SIM-1", "max: 3 V"), "B-YAML-012", "a number has a 'unit' and limits"),
    "a number without tolerance": (('min: 0.9 1', "equals: 1.0 1"), "B-YAML-012", "belong together"),
    "no pattern": (("NGU (", "NGU (("), "B-YAML-012", "is no regular expression"),
    "two groups": (("NGU (", "(NGU) ("), "B-YAML-012", "has 2 groups"),
    "nothing that replies": (("{at: \"00:00:01\", ", "{at: \"00:00:01\", expect: {name: x, equals: y}, "),
                             "B-YAML-012", "stands beside 'send' and 'unit'"),
}  # fmt: skip


@pytest.mark.parametrize("name", REFUSED)
def test_what_cannot_be_expected(name: str, tmp_path: Path) -> None:
    (old, new), code, words = REFUSED[name]
    assert old in SEQUENCE
    with pytest.raises(InputErrors) as caught:
        compile_sequence(written(tmp_path, SEQUENCE.replace(old, new)))
    assert f"error {code}" in str(caught.value)
    assert words in str(caught.value)
