"""The analysis of plain readings, and its predictions against the spread of simulated campaigns."""

import json
import math
import shutil
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from one_estimate import every
from rehearsal import ROOT
from scipy import stats
from spread_study import Study, key_of

from bench.analysis import Analysis, Evidence, Limits, Material, Reading, judged_values, weigh
from bench.maths.arrays import Floats
from bench.model.errors import FitError
from bench.plan import Plan, compile_sequence
from bench.session.predicted import planned_of, predicted
from bench.systems.readings.analysis import analyse
from bench.systems.readings.polynomial import Curve, Points, fit_polynomial, function_of

LINE = {"reads": "measure_voltage", "unit": "V", "relative": 0.0, "floor": 1e-3}


def material(read: dict[tuple[float, float], list[float]], **fit: Any) -> Material:
    """Readings by (level_V, temperature_degC), and a fit over level."""
    entries, readings = [], []
    for (level_V, degC), volts in read.items():
        conditions = {"level_V": level_V, "temperature_degC": degC}
        entries.append({"quantity": "output", "unit": "V", "conditions": conditions})
        named = {**conditions, "quantity": "output"}
        readings += [Reading(len(readings) + k, len(readings) + k, "meter", "measure_voltage", volt, named)
                     for k, volt in enumerate(volts)]  # fmt: skip
    asked = {"name": "gain", "of": "output", "degree": 1, "per": [], "expected": {}, **fit,
             "units": {"c0": "V", "c1": "1", "nonlinearity": "V"},
             "against": {"condition": "level_V", "unit": "V", "uncertainty": 2e-3}}  # fmt: skip
    return Material(
        rows=(),
        campaign={"analysis": "x", "uut": {"model": "SC", "serial": "1"}, "expected": entries, "fits": [asked]},
        standards={"meter": {"calibrated": "2000-01-01", "specifications": [LINE]}},
        readings=readings,
        utc_offset_s=1e9,
    )


def test_repeatability_is_pooled_over_conditions() -> None:
    volts = {(1.0, 20.0): [1.0, 1.2], (2.0, 20.0): [2.0, 2.1, 2.4], (3.0, 20.0): [3.0]}
    (entry,) = every(analyse(material(volts)), "output_repeatability")
    squares = 0.02 + float(np.sum((np.array(volts[2.0, 20.0]) - np.mean(volts[2.0, 20.0])) ** 2))
    assert entry.value == pytest.approx(math.sqrt(squares / 3.0))
    assert (entry.n, entry.dof) == (5, 3.0)


@pytest.mark.parametrize("free", [1, 3, 10, 60])
def test_intervals_of_a_repeatability_hold_the_truth(free: int) -> None:
    """By the distribution of chi-square itself: of the estimates that a scatter gives, 95 % are within U of it."""
    (entry,) = every(analyse(material({(1.0, 20.0): list(range(free + 1))})), "output_repeatability")
    share = entry.expanded_uncertainty / entry.value
    least, most = 1.0 / (1.0 + share), 1.0 / (1.0 - share) if share < 1.0 else math.inf
    held = float(np.diff(stats.chi2.cdf([free * least**2, free * most**2], free))[0])
    print(f"{free} degrees of freedom: U {share:.3f} of the value, {held:.4f} hold")
    assert held == pytest.approx(0.95, abs=2e-3)
    assert entry.coverage_factor * entry.std_uncertainty == pytest.approx(entry.expanded_uncertainty)


def test_a_fit_for_each_temperature_by_the_uncertainty_of_the_set_points() -> None:
    read = {(level, degC): [(1.0 + degC / 1000.0) * level] * 2 for degC in (20.0, 60.0) for level in (1.0, 2.0, 4.0)}
    slopes = every(analyse(material(read, per=["temperature_degC"])), "gain_c1")
    assert [entry.conditions for entry in slopes] == [{"temperature_degC": 20.0}, {"temperature_degC": 60.0}]
    assert [entry.value for entry in slopes] == pytest.approx([1.02, 1.06])
    spread = math.sqrt(float(np.sum((np.array([1.0, 2.0, 4.0]) - 7.0 / 3.0) ** 2)))
    own = math.hypot(5e-4, 1.02 * 1e-3) / spread  # half of both: the floor of the meter, the stated 2 mV of the level
    assert slopes[0].std_uncertainty == pytest.approx(own, rel=1e-6)


def test_what_gives_no_fit_is_missing_and_the_rest_is_given() -> None:
    few = analyse(material({(1.0, 20.0): [1.0, 1.1]}))
    assert few.missing == ["gain: 1 points do not determine c0, c1"]
    assert every(few, "output_repeatability")
    read = {(level, 20.0): [volt] * 2 for level, volt in ((1.0, 1.0), (2.0, 0.0), (4.0, 3.0))}
    analysis = analyse(material(read, function="log"))
    assert analysis.missing == ["gain: a value has no logarithm or no reciprocal"]
    assert not every(analysis, "gain_c0")


def test_a_value_is_read_back_with_its_interval() -> None:
    """A line through exact points: at 3 V, and the uncertainty of the line there."""
    read = {(level, 20.0): [2.0 * level] * 2 for level in (1.0, 2.0, 4.0)}
    asked = [{"quantity": "at_three", "at": 3.0, "unit": "V", "low": 5.9, "high": 6.1}]
    (entry,) = every(analyse(material(read, read_back=asked)), "at_three")
    assert (entry.value, entry.limits) == (pytest.approx(6.0), Limits(low=5.9, high=6.1))
    own = math.hypot(5e-4, 2.0 * 1e-3)  # half of both: the floor of the meter, the stated 2 mV of the level
    levels = np.array([1.0, 2.0, 4.0])
    leverage = 1.0 / 3.0 + (3.0 - levels.mean()) ** 2 / np.sum((levels - levels.mean()) ** 2)
    assert entry.std_uncertainty == pytest.approx(own * math.sqrt(1.0 + leverage), rel=1e-6)  # it counts twice


def test_nothing_read_is_refused() -> None:
    with pytest.raises(FitError, match=r"B-FIT-160: .*no reading of the session has a value"):
        analyse(material({}))


def points(
    mean: np.ndarray, std: float | np.ndarray = 0.0, *, gain: float = 0.0, floor: float = 0.0, n: int = 5
) -> Points:
    every = np.ones_like(mean)
    scatter = std * np.sqrt(n) * every
    return Points(mean, std * every, scatter, gain * mean, floor * every, n * every)


def test_without_errors_of_x_it_is_numpys_polyfit() -> None:
    x, y = np.linspace(-2.0, 9.0, 9), np.array([3.1, 2.0, 1.7, 1.2, 2.4, 3.3, 5.9, 8.2, 12.4])
    curve = fit_polynomial(points(x), points(y, 0.05), (0, 1, 2))
    assert curve.coefficients[::-1] == pytest.approx(np.polyfit(x, y, 2), rel=1e-9)
    _, covariance = np.polyfit(x, y, 2, cov=True)
    assert curve.covariance[::-1, ::-1] == pytest.approx(covariance, rel=1e-6)  # its chi-square is above 1


@pytest.mark.validates("line through points with errors on both axes", against="Pearson's data with York's weights")
def test_errors_of_x_against_york(record_property: Callable[[str, object], None]) -> None:
    """Weights follow the slope from turn to turn here, and the slope follows the weights in York's exact solution."""
    x = np.array([0.0, 0.9, 1.8, 2.6, 3.3, 4.4, 5.2, 6.1, 6.5, 7.4])
    y = np.array([5.9, 5.4, 4.4, 4.6, 3.5, 3.7, 2.8, 2.8, 2.4, 1.5])
    x_weight = np.array([1000.0, 1000.0, 500.0, 800.0, 200.0, 80.0, 60.0, 20.0, 1.8, 1.0])
    y_weight = np.array([1.0, 1.8, 4.0, 8.0, 20.0, 20.0, 70.0, 70.0, 100.0, 500.0])
    curve = fit_polynomial(points(x, x_weight**-0.5), points(y, y_weight**-0.5), (0, 1))
    off = (curve.coefficients - [5.47991022, -0.480533407]) / [0.29497, 0.05798]
    record_property("obtained", f"{np.max(np.abs(off)):.2g} standard uncertainties off")
    assert np.max(np.abs(off)) < 0.4


def test_errors_of_the_instruments_reach_the_coefficients() -> None:
    """One gain of the meter is one relative error of both coefficients; more points do not make it smaller."""
    x = np.linspace(1.0, 10.0, 40)
    curve = fit_polynomial(points(x), points(2.0 + 3.0 * x, 1e-9, gain=1e-4), (0, 1))
    assert np.sqrt(np.diag(curve.covariance)) == pytest.approx([2e-4, 3e-4], rel=1e-3)


def test_intervals_cover_the_truth() -> None:
    """Coverage of 95 % intervals, 400 campaigns: gain and offset of both meters drawn, five readings of each level."""
    rng = np.random.default_rng(7)
    levels, inside = np.linspace(1.0, 9.0, 7), np.zeros(2)
    for _ in range(400):
        gains, offsets = 1.0 + rng.normal(0.0, 2e-5, 2), rng.normal(0.0, 2e-4, 2)
        read = [
            np.mean(offset + gain * true + rng.normal(0.0, 1e-4, (5, 7)), axis=0)
            for gain, offset, true in zip(gains, offsets, (levels, 0.1 + 0.5 * levels), strict=True)
        ]
        x, y = (points(mean, 1e-4 / np.sqrt(5), gain=2e-5, floor=2e-4) for mean in read)
        curve = fit_polynomial(x, y, (0, 1))
        inside += np.abs(curve.coefficients - [0.1, 0.5]) <= 1.96 * np.sqrt(np.diag(curve.covariance))
    assert (inside / 400 >= 0.93).all()  # more than 95 %: the floor counts twice, because nobody says which it is


LEVELS = np.linspace(1.0, 8.0, 8)


def heard_of(seed: int, departs: Floats, **fit: Any) -> tuple[Analysis, list[Evidence]]:
    """Return the analysis of five readings of a line at each level, and what is heard against it; floors are drawn."""
    rng = np.random.default_rng(seed)
    means = 1.0 + 2.0 * LEVELS + rng.normal(0.0, 5e-4, 8) + rng.normal(0.0, 2e-3, 8) + departs
    read = {(x, 20.0): (mean + rng.normal(0.0, 1e-3, 5)).tolist() for x, mean in zip(LEVELS, means, strict=True)}
    analysis = analyse(material(read, **fit))
    return analysis, list(weigh(analysis.evidence).against)


def test_points_of_a_line_are_doubted_in_no_right_world() -> None:
    assert [seed for seed in range(200) if heard_of(seed, 0.0 * LEVELS)[1]] == []


@pytest.mark.parametrize(
    ("departs", "told"),
    [
        (0.02 * (LEVELS - 4.5) ** 2, "power 2 of level_V"),
        (0.1 * (LEVELS == 4.0), "at level_V 4 V only"),
        (0.1 * (LEVELS > 4.5), "step between"),
    ],
    ids=["bent", "one point", "a step"],
)
def test_what_departs_from_a_line_is_told(departs: Floats, told: str) -> None:
    """Seeds 0 to 9: coefficients are doubtful, what was read is not; a step at a level is one in time as well."""
    for seed in range(10):
        analysis, against = heard_of(seed, departs)
        assert {seen.code for seen in against} == {"departs"}
        assert any(told in seen.sentence for seen in against), [seen.sentence for seen in against]
        assert {entry.quantity for seen in against for entry in seen.entries} <= {"gain_c0", "gain_c1"}
        assert heard_of(seed, departs, expected={"nonlinearity": {"high": 0.5}})[1] == []  # a result, and no doubt
        (table,) = [table for table in analysis.tables if table.title == "What this campaign cannot show"]
        assert any("drift" in row[0] and row[3] == "never" for row in table.rows)  # levels were read in one direction


# Campbell Scientific, 109SS temperature probe, instruction manual, table C-1: BetaTHERM 10K3MCD1, ohm.
BETATHERM_DEGC = np.arange(-40.0, 1.0, 5.0)
BETATHERM_OHM = np.array(
    [336103.2, 242430.2, 176804.8, 130307.6, 97006.9, 72911.1, 55303.9, 42316.7, 32650.9],
)  # fmt: skip
BETATHERM = [1.129241e-3, 2.341077e-4, 8.775468e-8]  # 1/T = A + B ln R + C (ln R)^3

# Geokon, 8002-4-1 instruction manual, table 16: U.S. Sensor 103JL1A, ohm; with A to D of 1, ln R, (ln R)^3, (ln R)^5.
US_SENSOR_DEGC = np.arange(-30.0, 101.0, 10.0)
US_SENSOR_OHM = np.array(
    [176974, 97081, 55329, 32650, 19901, 12493, 8057, 5326, 3602, 2488, 1752, 1255, 915.5, 678.6],
)  # fmt: skip
US_SENSOR = [1.12766979300187e-3, 2.34444184128213e-4, 8.47692130592308e-8, 1.17512193579615e-11]


def _exact(mean: Floats, std: float) -> Points:
    every = np.ones_like(mean)
    return Points(mean, std * every, np.nan * every, 0.0 * mean, 0.0 * mean, every)


def fitted(ohm: Floats, degC: Floats, powers: tuple[int, ...]) -> Curve:
    of_x, of_y = function_of("log", "ohm"), function_of("reciprocal", "degC")
    return fit_polynomial(of_x.points(_exact(ohm, 1e-9)), of_y.points(_exact(degC, 1e-3)), powers)


def degC_at(curve: Curve, ohm: Floats) -> Floats:
    return function_of("reciprocal", "degC").back(curve.at(np.log(ohm)))


@pytest.mark.validates("Steinhart-Hart coefficients of a thermistor", against="BetaTHERM's table and coefficients")
def test_betatherm(record_property: Callable[[str, object], None]) -> None:
    """The maker's coefficients are for more than this table, and 2.4 mK off at its cold end."""
    curve = fitted(BETATHERM_OHM, BETATHERM_DEGC, (0, 1, 3))
    off = np.max(np.abs(curve.coefficients / BETATHERM - 1.0))
    published_degC = 1.0 / (np.log(BETATHERM_OHM)[:, None] ** [0, 1, 3] @ BETATHERM) - 273.15
    apart = np.max(np.abs(degC_at(curve, BETATHERM_OHM) - published_degC))
    record_property("obtained", f"coefficients within {1e2 * off:.2f} %, curves within {1e3 * apart:.1f} mK")
    assert off < 1e-3
    assert apart < 3e-3
    assert degC_at(curve, BETATHERM_OHM) == pytest.approx(BETATHERM_DEGC, abs=1e-5)


@pytest.mark.validates("four powers of the logarithm of a thermistor", against="U.S. Sensor's table and coefficients")
def test_us_sensor(record_property: Callable[[str, object], None]) -> None:
    """The digits of the published table alone leave up to 30 mK."""
    curve = fitted(US_SENSOR_OHM, US_SENSOR_DEGC, (0, 1, 3, 5))
    between = np.sqrt(US_SENSOR_OHM[:-1] * US_SENSOR_OHM[1:])
    published_degC = 1.0 / (np.log(between)[:, None] ** [0, 1, 3, 5] @ US_SENSOR) - 273.15
    off = np.max(np.abs(degC_at(curve, between) - published_degC))
    record_property("obtained", f"{1e3 * off:.1f} mK off between the points")
    assert off < 0.03
    assert degC_at(curve, US_SENSOR_OHM) == pytest.approx(US_SENSOR_DEGC, abs=0.03)


def test_errors_go_through_the_functions() -> None:
    """Drawn errors of resistance and temperature scatter the value that is read back as its uncertainty says."""
    rng = np.random.default_rng(5)
    of_x, of_y = function_of("log", "ohm"), function_of("reciprocal", "degC")
    every = np.ones_like(US_SENSOR_DEGC)
    read, stated = [], []
    for _ in range(300):
        ohm = US_SENSOR_OHM * (1.0 + rng.normal(0.0, 1e-3, every.size))
        degC = US_SENSOR_DEGC + rng.normal(0.0, 0.05, every.size)
        x = Points(ohm, 1e-3 * US_SENSOR_OHM, np.nan * every, 0.0 * every, 0.0 * every, every)
        y = Points(degC, 0.05 * every, np.nan * every, 0.0 * every, 0.0 * every, every)
        curve = fit_polynomial(of_x.points(x), of_y.points(y), (0, 1, 3))
        at = np.log([10_000.0])
        read.append(float(of_y.back(curve.at(at))[0]))
        stated.append(float(np.abs(of_y.back_slope(curve.at(at))) @ curve.std_at(at)))
    assert np.mean(read) == pytest.approx(25.0, abs=0.02)
    assert np.std(read) == pytest.approx(np.median(stated), rel=0.2)


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
