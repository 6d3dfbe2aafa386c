"""The 38-hour ramp of the project tckit, read without edits, against what its own columns say by other means."""

import csv
import json
import os
import sys
from collections.abc import Callable
from contextlib import redirect_stdout
from io import StringIO
from pathlib import Path
from typing import Any

import fit_simulation as sim
import numpy as np
import pytest
from rehearsal import ROOT, Inside, main_of
from scipy import stats

from bench.analysis import Analysis, Estimates, Material, Planned, Table
from bench.systems.af_converter.group_fit import UNKNOWN_SLOPE_ppm_degC
from bench.systems.af_converter.scale_factor.analysis import analyse
from bench.systems.af_converter.scale_factor.estimates import determine
from bench.systems.af_converter.scale_factor.predicted import predicted
from bench.systems.af_converter.wording import say

MAPPING = ROOT / "docs" / "mappings" / "tckit_1v_ramp.yaml"
FOLDER = Path(os.environ.get("BENCH_REAL_DATA", ROOT.parent / "shared" / "data")) / "tckit"
FILES = sorted(FOLDER.glob("*tcsweep_1vdc*.dsv"))
pytestmark = [pytest.mark.real, pytest.mark.skipif(not FILES, reason=f"no recording in {FOLDER}")]


@pytest.fixture(scope="module")
def session(tmp_path_factory: pytest.TempPathFactory) -> Path:
    out = tmp_path_factory.mktemp("tckit")
    with pytest.MonkeyPatch.context() as patch, redirect_stdout(said := StringIO()):
        assert main_of(patch, "import", str(MAPPING), str(FILES[0]), "--out", str(out)) == 0
    assert "6311 rows, 1 with an overload, 0 cannot be read" in said.getvalue().replace("\n", " ")
    return out / "20241020T011845Z_tckit_1v_ramp_unknown"


@pytest.fixture(scope="module")
def results(session: Path) -> dict[str, Any]:
    return json.loads((session / "results.json").read_text(encoding="utf-8"))


def values(results: dict[str, Any], quantity: str, reading: str = "hp34420a_5") -> list[dict[str, Any]]:
    entries = results["estimates"]
    return [one for one in entries if one["quantity"] == quantity and one["conditions"]["reading"] == reading]


def table(session: Path, title: str) -> Table:
    from bench.session.service import read_view
    from bench.session.view import analyse_view

    return next(one for one in analyse_view(read_view(session), "drift")[1].tables if one.title == title)


def test_two_rows_are_excluded_and_the_others_count(results: dict[str, Any]) -> None:
    """The one with an overload, and the one behind it, in which all references are 5 ppm off their neighbours."""
    assert {(one["n"], one["dropped"]) for one in results["estimates"]} == {(6309, 2)}
    assert results["provenance"]["simulated"] is False


def test_lengths_of_the_ramps_and_holds_are_those_given_with_the_file(session: Path) -> None:
    totals = {row[0]: row[2] for row in table(session, "Time up, holding and down").rows}
    assert totals["up"] == pytest.approx(9.3, rel=0.02)
    assert totals["hold"] == pytest.approx(13.9, rel=0.02)
    assert totals["down"] == pytest.approx(14.9, rel=0.02)


@pytest.mark.parametrize("reading", ["hp34420a_5", "hp34420a_6"])
def test_what_the_drift_model_leaves(results: dict[str, Any], reading: str) -> None:
    (one,) = values(results, "up_minus_down_after_drift", reading)
    assert one["value"] == pytest.approx(-1.76, abs=0.3)
    assert 0.3 < one["expanded_uncertainty"] < 1.2


@pytest.mark.validates(
    "up minus down of an imported 38-hour ramp after drift: -1.76 ppm",
    against="a real recording of other people, numpy.linalg.lstsq on all of its rows",
)
def test_the_same_by_plain_least_squares_on_the_rows_of_the_file(
    record_property: Callable[[str, object], None], results: dict[str, Any]
) -> None:
    with FILES[0].open(encoding="ascii") as stream:
        rows = list(csv.DictReader(stream, delimiter=";"))[1:]
    column = {name: np.array([float(row[name]) for row in rows]) for name in rows[0] if name and name != "date"}
    stamps = [np.datetime64(f"{r['date'][6:10]}-{r['date'][3:5]}-{r['date'][:2]}T{r['date'][11:]}") for r in rows]
    hours = (np.array(stamps) - stamps[0]) / np.timedelta64(3600, "s")
    ratio = column["vbl5"] / ((column["vbl1"] + column["vbl2"] + column["vbl3"]) / 3.0)
    sensor = (column["val6"] + column["val7"] + column["val8"]) / 3.0 - 23.0
    going = np.sign(np.diff(column["sv_temp"], append=column["sv_temp"][-1]))
    hours -= hours.mean()
    design = np.column_stack([sensor**k for k in range(4)] + [hours, hours**2, going / 2.0])
    left = np.linalg.lstsq(design, (ratio / np.median(ratio) - 1.0) * 1e6, rcond=None)[0][-1]
    assert left == pytest.approx(-1.76, abs=0.005)
    found = values(results, "up_minus_down_after_drift")[0]["value"]
    record_property("obtained", f"{found:.3f} ppm, lstsq {left:.3f} ppm")
    assert found == pytest.approx(left, abs=0.03)


def test_up_minus_down_at_equal_sensor_temperature(session: Path) -> None:
    found = table(session, "hp34420a_5: up minus down")
    at = found.headers.index("sensor_8")
    inner = [row[at] for row in found.rows if isinstance(row[0], float) and 23.0 <= row[0] <= 33.0]
    assert len(inner) == 11
    assert min(inner) == pytest.approx(-4.85, abs=0.1)
    assert max(inner) == pytest.approx(-3.6, abs=0.15)


def test_a_lag_behind_the_sensors_leaves_no_hysteresis(results: dict[str, Any]) -> None:
    """The joint fit says what the drift model cannot: the branches differ because the instrument's inside lags."""
    (width,), (lag,) = values(results, "hysteresis_width"), values(results, "thermal_lag")
    assert abs(width["value"]) < width["expanded_uncertainty"] < 3.0
    assert 60.0 < lag["value"] < 130.0


@pytest.mark.slow
def test_replay_fit_and_report_work_from_the_session_alone(session: Path, inside: Inside) -> None:
    assert "every number is identical" in inside("replay", str(session)).stdout.replace("\n", " ")
    fitted = inside("fit", str(session), "--method", "drift", "--json")
    assert fitted.returncode == 0, fitted.stderr
    assert not values(json.loads(fitted.stdout), "hysteresis_width")
    (session / "report.html").unlink()
    assert inside("report", str(session)).returncode == 0
    page = (session / "report.html").read_text(encoding="utf-8")
    assert "hp34420a 5 up minus down" in page
    assert "that the mapping calls an overload" in page


CAMPAIGNS = 60  # seeds from 0 on
INSIDE = 0.999
CHANGES = ("calibrator_drift", "dsf_n_drift", "dsf_p_drift")
OF_ONE: dict[str, Any] = {"temperatures": (20.0,), "repeat_channel": 1}


def material_of(campaign: sim.SimulatedCampaign) -> Material:
    return Material(campaign.rows, campaign.campaign, campaign.standards)


def planned(campaign: sim.SimulatedCampaign) -> Planned:
    return Planned(campaign.windows, campaign.campaign, campaign.standards)


def scores_of(slope_ppm_degC: float) -> dict[str, list[float]]:
    """Return error over standard uncertainty of each scale factor and change, by quantity; the calibrator is steady."""
    scores: dict[str, list[float]] = {}
    for seed in range(CAMPAIGNS):
        campaign = sim.simulate(seed, sim.Switches(tc1_sigma_ppm_degC=slope_ppm_degC), **OF_ONE)
        for entry in determine(material_of(campaign), "gls").estimates:
            quantity = entry.quantity
            if quantity.startswith("dsf") or quantity in CHANGES:
                truth = 0.0 if quantity in CHANGES else campaign.truth(entry)
                scores.setdefault(quantity, []).append((entry.value - truth) / entry.std_uncertainty)
    return scores


def drifts(estimates: Estimates) -> dict[str, Any]:
    return {entry.quantity: entry for entry in estimates if entry.quantity in CHANGES}


@pytest.mark.validates(
    "changes between visits and scale factors of a campaign of one temperature",
    against="60 simulated campaigns of units that warm by 0.43 degC, coefficients of 8 ppm/degC",
)
def test_intervals_hold_the_truth_while_the_unit_warms(record_property: Callable[[str, object], None]) -> None:
    """At least as many as chance leaves of 95 %: before, 0.48 to 0.62 of the changes and 0.05 of the asymmetries."""
    held = {name: [abs(score) <= 1.96 for score in each] for name, each in scores_of(8.0).items()}
    said = ", ".join(f"{name} {np.mean(each):.3f} of {len(each)}" for name, each in held.items())
    sys.stdout.write(f"seeds 0 to {CAMPAIGNS - 1}: {said}\n")
    record_property("obtained", said)
    assert held.keys() >= {*CHANGES, "dsf_n", "dsf_p", "dsf_asymmetry"}
    for name, each in held.items():
        assert sum(each) >= stats.binom.ppf(1.0 - INSIDE, len(each), 0.95), name


def test_uncertainties_are_those_of_the_coefficients_that_they_count() -> None:
    """Of units drawn with coefficients as large as nobody's, the scatter is the stated one, neither less nor more."""
    for name, each in scores_of(UNKNOWN_SLOPE_ppm_degC).items():
        low, high = stats.chi2.ppf([(1 - INSIDE) / 2, (1 + INSIDE) / 2], len(each)) / len(each)
        sys.stdout.write(f"{name}: {np.mean(np.square(each)):.3f}, {low:.3f} to {high:.3f}\n")
        if name not in ("dsf_n", "dsf_p"):  # their largest part is the calibrator's gain, which both kinds share
            assert low < np.mean(np.square(each)) < high, name


def run(drift_ppm: float, *, lag: bool) -> Analysis:
    """Return the analysis of a campaign whose calibrator delivers more in the repeat."""
    campaign = sim.simulate(4, sim.Switches(lag=lag), **OF_ONE)
    return analyse(Material(sim.repeated_off(campaign, drift_ppm), campaign.campaign, campaign.standards))


def component_ppm(analysis: Analysis) -> float:
    parts = (one for one in analysis.components if one["component"] == "calibrator drift over the campaign")
    return max((one["std_uncertainty_ppm"] for one in parts), default=0.0)


def test_a_steady_unit_shows_a_drift_and_it_counts() -> None:
    found = run(4.0, lag=False)
    drift = drifts(found.estimates)["calibrator_drift"]
    assert drift.value == pytest.approx(4.0, abs=drift.expanded_uncertainty)
    assert drift.expanded_uncertainty < 1.0
    assert component_ppm(found) > 2.0
    assert any("this is the drift of the calibrator in the budget" in note for note in found.notes)


def test_what_warming_can_explain_bounds_no_drift_and_says_so() -> None:
    found = run(4.0, lag=True)
    assert drifts(found.estimates)["calibrator_drift"].expanded_uncertainty > 20.0
    assert component_ppm(found) == 0.0
    (note,) = [note for note in found.notes if "cannot be told apart" in note]
    assert "temperature differed by +0.24 degC" in note
    assert any("a drift over the campaign is not included" in note for note in found.notes)
    assert component_ppm(run(100.0, lag=True)) > 50.0, "no coefficient makes as much of so little warming"


def test_the_prediction_names_what_warming_may_be() -> None:
    campaign = sim.simulate(4, **OF_ONE)
    found = predicted(planned(campaign))
    assert drifts(found.estimates) == {}
    assert {"dsf_n", "dsf_asymmetry", "bias"} <= {entry.quantity for entry in found.estimates}
    assert found.missing == [say("predicted.untold", place="channel 1 at 20 degC, repeat 1", step=1.0)]
    assert found.assumed == [say("predicted.steady", step=1.0)]
    several = predicted(planned(sim.simulate(4, temperatures=(5.0, 20.0), repeat_channel=1)))
    assert drifts(several.estimates).keys() == set(CHANGES)
    assert (several.missing, several.assumed) == ([], [])
