"""Holds predicted values of plain readings against the spread of simulated campaigns, and what is named as missing."""

from __future__ import annotations

import json
import shutil
from pathlib import Path

import numpy as np
import pytest
from rehearsal import ROOT
from scipy import stats
from spread_study import Study, key_of

from bench.analysis import Material, Reading, judged_values
from bench.plan import Plan, compile_sequence
from bench.session.planned import planned_of
from bench.session.predicted import predicted
from bench.systems.readings.analysis import analyse

BEGIN_UTC_s = 9.5e8  # three months behind the calibration of the meter
SCATTER_V, ROUNDS, FIRST = 2e-3, 6, 300
STATED = {"relative": 35e-6, "floor": 50e-6}  # of the 10 V range, 95 %
READ = "rail_meter.measure_voltage:\n            expect: {{name: {name}, within: [4.9 V, 5.1 V]{more}}}"
HEAD = "sequence: sample\nstation: unit_bench_sim\nanalysis: readings\nuut: {model: SC-1, serial: S1}\n"


def plan_of(tmp_path: Path, readings: str, more: str = "") -> Plan:
    """Six rounds of readings at each of two loads, on the bench of the example."""
    shutil.copytree(ROOT / "examples/own_checks/stations", tmp_path / "stations", dirs_exist_ok=True)
    path = tmp_path / "sequences/sample.yaml"
    path.parent.mkdir(exist_ok=True)
    record = f"      - record:\n          seconds: 60 s\n          every: 10 s\n          readings:\n{readings}"
    path.write_text(f"{HEAD}{more}steps:\n  - for: load\n    in: [1, 2]\n    do:\n{record}")
    return compile_sequence(path)


def reading(name: str, more: str = "") -> str:
    return f"          - {READ.format(name=name, more=more)}\n"


def rail(tmp_path: Path) -> Plan:
    return plan_of(tmp_path, reading("rail", f", scatter: {1e3 * SCATTER_V} mV"))


def study(plan: Plan, campaigns: int) -> Study:
    """A meter is off by its specification, the same in all readings of a campaign, each of which scatters."""
    planned = planned_of(plan, BEGIN_UTC_s)
    found = Study(predicted(plan, BEGIN_UTC_s))
    for seed in range(FIRST, FIRST + campaigns):
        rng = np.random.default_rng(seed)
        true_V = rng.uniform(4.95, 5.05)
        off_V = (STATED["relative"] * true_V + STATED["floor"]) / 2.0 * rng.standard_normal()
        drawn = [_drawn(one, k, true_V + off_V + SCATTER_V * rng.standard_normal())
                 for k, one in enumerate(planned.readings)]  # fmt: skip
        material = Material((), planned.campaign, planned.standards, readings=drawn, utc_offset_s=BEGIN_UTC_s)
        estimates = [*judged_values(material).estimates, *analyse(material).estimates]
        truth = {key_of(entry): SCATTER_V if "repeat" in entry.quantity else true_V for entry in estimates}
        found.add(estimates, truth)
    print(f"seeds {FIRST} to {FIRST + campaigns - 1}", *found.lines(), sep="\n")
    return found


def _drawn(one: Reading, step: int, volt: float) -> Reading:
    return Reading(one.t_s, step, one.role, one.name, volt, one.conditions, one.arguments)


@pytest.mark.parametrize("campaigns", [40, pytest.param(500, marks=pytest.mark.sweep)])
def test_values_scatter_as_predicted(tmp_path: Path, campaigns: int) -> None:
    found = study(rail(tmp_path), campaigns)
    assert found.prediction.missing == []
    assert len(found.scores) == len(found.prediction.estimates) == 3  # at two loads, and the repeatability
    assert found.outside() == {}
    assert found.median() == pytest.approx(1.0, abs=0.03 * np.sqrt(500.0 / campaigns))
    assert min(stats.binomtest(held, campaigns, 0.95).pvalue for held in found.counts().values()) > 1e-3


def test_a_value_is_known_as_its_meter_and_its_scatter_say(tmp_path: Path) -> None:
    """By hand: half of the specification, and the scatter over the root of six readings; of twelve for its own size."""
    found = predicted(rail(tmp_path), BEGIN_UTC_s)
    free = 2.0 * ROUNDS - 2.0
    std = {json.dumps(entry.conditions): entry.std_uncertainty for entry in found.estimates}
    due_V = np.hypot((STATED["relative"] * 5.0 + STATED["floor"]) / 2.0, SCATTER_V / np.sqrt(ROUNDS))
    assert std == {
        '{"load": 1}': pytest.approx(due_V, rel=1e-9),
        '{"load": 2}': pytest.approx(due_V, rel=1e-9),
        "{}": pytest.approx(SCATTER_V * stats.chi.std(free) / np.sqrt(free), rel=2e-3),
    }


def test_of_an_instrument_without_specification_no_interval_is_promised(tmp_path: Path) -> None:
    """The result is doubtful then; the scatter alone would promise an interval without the error of the meter."""
    station = tmp_path / "stations/unit_bench_sim.yaml"
    known = rail(tmp_path)
    text = station.read_text()
    before, meter, after = text.partition("  rail_meter:")
    other = after.replace("measure_voltage, range: 10 V, relative: 35 ppm, floor: 50 uV",
                          "measure_resistance, range: 10 ohm, relative: 35 ppm, floor: 50 uohm", 1)  # fmt: skip
    station.write_text(before + meter + other)
    without = compile_sequence(tmp_path / "sequences/sample.yaml")
    assert "rail" in {entry.quantity for entry in predicted(known, BEGIN_UTC_s).estimates}
    found = predicted(without, BEGIN_UTC_s)
    assert {entry.quantity for entry in found.estimates} == {"rail_repeatability"}
    assert found.missing
    assert all("no specification of rail_meter.measure_voltage" in sentence for sentence in found.missing)


def test_a_reply_is_named_as_what_gave_it(tmp_path: Path) -> None:
    """An instrument is no unit: what it replies has digits that only a recording shows."""
    plan = rail(tmp_path)
    path = tmp_path / "sequences/sample.yaml"
    asked = "      - send: {rail_meter: 'MEAS:VOLT:DC?'}\n        expect: {name: asked, unit: V, uncertainty: 1 mV}\n"
    path.write_text(path.read_text() + asked)
    assert predicted(plan, BEGIN_UTC_s).missing == []
    (sentence,) = predicted(compile_sequence(path), BEGIN_UTC_s).missing
    assert sentence.startswith("asked: not predicted, as the digits of a reply")


@pytest.mark.parametrize(
    ("readings", "more", "told"),
    [
        (reading("rail"), "", "rail: not predicted, as readings that are repeated"),
        (reading("rail").replace("within: [4.9 V, 5.1 V]", "min: 4.9 V"), "", "rail: not predicted, as what an instru"),
        (reading("rail", ", scatter: 1 mV"), "fits:\n  - {name: line, of: rail, against: load, degree: 1}\n",
         "fits line: not predicted"),
    ],
)  # fmt: skip
def test_what_is_not_predicted_is_named(tmp_path: Path, readings: str, more: str, told: str) -> None:
    (sentence,) = predicted(plan_of(tmp_path, readings, more), BEGIN_UTC_s).missing
    assert sentence.startswith(told)
