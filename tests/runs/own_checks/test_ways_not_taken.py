"""What a run promises after its decisions: no value of a way that was not taken, and what a loop waits for."""

from __future__ import annotations

import json
import shutil
from pathlib import Path

import pytest
from typer.testing import CliRunner

from bench.cli import app

LAB = Path(__file__).resolve().parents[3] / "examples/own_checks"
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


@pytest.fixture
def lab(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """A copy of the folder outside of the repository, and a shell in it."""
    copy = shutil.copytree(LAB, tmp_path / "our_lab")
    monkeypatch.chdir(copy)
    return copy


def run(steps: str, *settings: str) -> tuple[int, list[str], list[str]]:
    """Run a sequence with these steps; returns exit status, what is missing, and the quantities of the results."""
    Path("sequences/ways.yaml").write_text(HEAD + steps + TAIL)
    words = ["run", "ways", "--clock", "virtual", "--seed", "1", "--out", "out"]
    words += [word for setting in settings for word in ("--set", setting)]
    done = CliRunner().invoke(app, words, catch_exceptions=False)
    _, _, told = done.output.partition("MISSING: ")
    missing = [line.strip() for line in told.splitlines()[1:] if line.startswith("  ")]
    (folder,) = Path("out").glob("*_ways_*")
    estimates = json.loads((folder / "results.json").read_text())["estimates"]
    return done.exit_code, missing, [entry["quantity"] for entry in estimates]


def test_a_loop_that_ends_promises_no_turn_more(lab: Path) -> None:
    assert run(WAITS) == (0, [], ["rail_meter_voltage", "current"])


def test_a_loop_that_goes_on_without_what_it_waits_for_says_so(lab: Path) -> None:
    status, missing, names = run(WAITS, "world.rail_V=4.2")
    assert (status, names) == (1, ["rail_meter_voltage", "current", "rail_meter_voltage", "rail_meter_voltage"])
    assert missing == ["rail_meter.measure_voltage is 4.20003 V after the last turn, still below 4.9 V"]
    (folder,) = Path("out").glob("*_ways_*")
    again = CliRunner().invoke(app, ["fit", str(folder)], catch_exceptions=False)
    assert (again.exit_code, missing[0] in again.output) == (1, True)


def test_a_branch_that_is_not_taken_promises_nothing(lab: Path) -> None:
    """Neither a call, nor the readings of a record, nor what a person measures."""
    assert run(IF) == (0, [], ["rail_meter_voltage", "current"])


def test_a_branch_that_is_taken_promises_its_values(lab: Path) -> None:
    status, missing, names = run(IF, "world.rail_V=4.2")
    assert (status, missing) == (0, [])
    assert {"low_rail_output", "low_rail_input", "fuse"} <= {*names}


@pytest.mark.parametrize("rail", ["4.2", "5.2"])
def test_a_value_of_two_branches_is_that_of_the_one_taken(lab: Path, rail: str) -> None:
    assert run(CHOOSE, f"world.rail_V={rail}") == (0, [], ["rail_meter_voltage", "current", "both"])
