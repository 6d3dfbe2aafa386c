"""What is expected of what a unit says: numbers in its frames, its answers, replies of instruments; in a timeline."""

from __future__ import annotations

import json
import math
import re
import struct
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import yaml
from typer.testing import CliRunner

from bench.cli import app
from bench.model.errors import InputErrors
from bench.plan import PlannedCommand, PlannedRecord, PlannedSend, check_plan, compile_sequence
from bench.record import SessionReader
from bench.session.makeup import make_up_sequence
from bench.session.record_states import MISSING, RecordState

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


def command(*words: object) -> str:
    done = CliRunner().invoke(app, [str(word) for word in words], catch_exceptions=False)
    return done.output


def written(folder: Path, text: str = SEQUENCE) -> Path:
    path = folder / "unit_says.yaml"
    path.write_text(text)
    return path


def run(folder: Path, text: str = SEQUENCE) -> Path:
    path = written(folder, text)
    command("run", path, "--clock", "virtual", "--seed", 1, "--out", folder / "out")
    (session,) = (folder / "out").glob("*_unit_says_*")
    return session


def values(session: Path) -> dict[str, dict[str, Any]]:
    estimates = json.loads((session / "results.json").read_text())["estimates"]
    return {entry["quantity"]: entry for entry in estimates}


@pytest.fixture(scope="module")
def session(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return run(tmp_path_factory.mktemp("unit_says"))


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


def test_it_is_the_same_from_the_session_alone(session: Path) -> None:
    assert "every number is identical" in command("replay", session)
    assert "identical" in command("report", session, "--verify")


def test_what_is_not_as_expected_fails_or_is_missing(tmp_path: Path) -> None:
    text = SEQUENCE.replace("equals: SIM-1", "equals: SIM-2").replace("within: [17.5 V", "within: [18.1 V")
    text = text.replace("pattern: '[0-9.]+$'", "pattern: 'rev ([0-9]+)'")
    session = run(tmp_path, text)
    found = values(session)
    assert [found[name]["verdict"] for name in ("identity", "supply_voltage")] == ["fail", "fail"]
    assert "firmware" not in found
    assert "firmware was not read" in command("fit", session)


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
