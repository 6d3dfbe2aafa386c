"""Holds what ``bench check`` predicts of a north finder against the spread of analysed campaigns."""

from __future__ import annotations

import json
from dataclasses import replace
from functools import cache
from typing import Any

import numpy as np
import pytest
from north_planned import PlannedNorth
from scipy import signal, stats
from typer.testing import CliRunner

from bench.analysis import PROMPT, Planned
from bench.cli import app
from bench.plan import compile_sequence
from bench.session.predicted import planned_of, predicted, predicted_lines
from bench.systems.north.estimators.formulas import lock_in_noise
from bench.systems.north.predicted import predicted as predict

SHORT = {
    "warm_up": "30 s", "time_constant": "1 s", "settle": "20 s", "record_time": "5 s", "calibration": "1,2,3",
    "heads": "0 deg,50 deg,100 deg,150 deg,200 deg,250 deg,300 deg", "repeats": "1,2", "search": "1,2",
}  # fmt: skip
SETTINGS = {
    "fog_north": SHORT,
    "fog_north_parameters": {name: value for name, value in SHORT.items() if name != "search"} | {"repeats": "1"},
}
RATE_Hz, SEED = 50.0, 5  # frames are thinned out; the declared noise is a density, so that azimuths are as uncertain
WITHOUT_TRUTH = ("azimuth_rms_error",)  # its spread is that about its mean
TIME = "time_to_accuracy"
# What a test sees in white noise: an amplitude that changes; colour of one set or of all; a formula that goes wrong
FALSE_ALARMS = {"least_squares": 0.01, "likelihood": 1.0 - 0.99**2, "quadrant": 0.01}


def thinned(name: str) -> Planned:
    """What an analysis knows of a short form of a sequence, at 50 frames a second."""
    planned = planned_of(compile_sequence(name, None, SETTINGS[name]))
    return replace(planned, campaign={**planned.campaign, "rate_Hz": RATE_Hz})


def key(entry: Any) -> tuple[str, str]:
    return entry["quantity"], json.dumps(entry["conditions"], sort_keys=True)


def true_value(entry: Any, nominal: Any, truth: dict[str, float]) -> float:
    """True value of an estimate of one campaign; of amplitude, noise, bound and time that of the nominal gyroscope."""
    about = entry["conditions"]
    if entry["quantity"] == "azimuth":
        return truth[about["place"]] + float(about["head_deg"])
    if entry["quantity"] == "index_placement":
        return truth["lock_in_1" if about["index"] == "b" else "lock_in_2"]
    return 0.0 if entry["quantity"] == "azimuth_error" else float(nominal["value"])


@cache
def analysed(name: str, count: int, seed: int) -> list[tuple[Any, dict[str, float], set[str]]]:
    """Estimates, truth and false alarms of each campaign."""
    return list(PlannedNorth(thinned(name)).campaigns(count, seed))


def ratios(name: str, count: int, seed: int) -> dict[tuple[str, str], float]:
    """Spread of estimate minus truth over the predicted standard uncertainty, for every estimate that is predicted.

    A time is predicted of campaigns without a false alarm: of these alone.
    """
    nominal = {key(entry): entry for entry in predict(thinned(name)).estimates}
    errors: dict[tuple[str, str], list[float]] = {own: [] for own in nominal}
    for entries, truth, alarms in analysed(name, count, seed):
        for entry in entries:
            if key(entry) in nominal and not (entry["quantity"] == TIME and entry["conditions"]["method"] in alarms):
                off = entry["value"] - true_value(entry, nominal[key(entry)], truth)
                errors[key(entry)].append((off + 180.0) % 360.0 - 180.0 if entry["quantity"] == "azimuth" else off)
    found = {}
    for own, each in errors.items():
        off = np.array(each) - (np.mean(each) if own[0] in WITHOUT_TRUTH else 0.0)
        found[own] = float(np.sqrt(np.mean(off**2)) / nominal[own]["std_uncertainty"])
    print(f"{name}, {count} campaigns, seed {seed}, median {np.median(list(found.values())):.3f}")
    print("\n".join(f"{ratio:.3f} {own[0]} {own[1]}" for own, ratio in found.items()))
    return found


def outside(found: dict[tuple[str, str], float], count: int) -> list[tuple[str, str, float]]:
    """What is not in the 99.9 % interval of a chi-square."""
    low, high = np.sqrt(stats.chi2.ppf([0.0005, 0.9995], count) / count)
    return [(*own, ratio) for own, ratio in found.items() if not low <= ratio <= high]


def test_predicted_is_the_spread_of_campaigns() -> None:
    """Thirty campaigns catch an uncertainty that is wrong by a half."""
    found = ratios("fog_north", 30, SEED)
    assert outside(found, 30) == []
    assert np.median(list(found.values())) == pytest.approx(1.0, abs=0.15)


def test_what_is_stated_is_what_was_predicted() -> None:
    """The error of three calibrations, taken for noise, made azimuths by the lock-ins 3.4 % more uncertain."""
    nominal = {key(entry): entry["std_uncertainty"] for entry in predict(thinned("fog_north")).estimates}
    stated = [
        entry["std_uncertainty"] / nominal[key(entry)]
        for entries, *_ in analysed("fog_north", 30, SEED)
        for entry in entries
        if entry["quantity"] == "azimuth" and entry["conditions"]["method"] == "least_squares"
    ]
    print(f"stated over predicted {np.sqrt(np.mean(np.square(stated))):.3f}")
    assert np.sqrt(np.mean(np.square(stated))) == pytest.approx(1.0, abs=0.025)


@pytest.mark.sweep
@pytest.mark.parametrize("name", list(SETTINGS))
def test_predicted_is_the_spread_of_500_campaigns(name: str) -> None:
    found = ratios(name, 500, SEED)
    assert outside(found, 500) == []
    assert np.median(list(found.values())) == pytest.approx(1.0, abs=0.03)


@pytest.mark.sweep
@pytest.mark.parametrize("method", list(FALSE_ALARMS))
def test_the_time_of_500_campaigns(method: str) -> None:
    """Of all campaigns, those of false alarms among them, 95 % of the intervals hold the true time."""
    (true_s,) = (
        entry["value"]
        for entry in predict(thinned("fog_north")).estimates
        if entry["quantity"] == TIME and entry["conditions"]["method"] == method
    )
    campaigns = analysed("fog_north", 500, SEED)
    times = [
        entry
        for entries, *_ in campaigns
        for entry in entries
        if entry["quantity"] == TIME and entry["conditions"]["method"] == method
    ]
    held = sum(abs(entry["value"] - true_s) <= entry["expanded_uncertainty"] for entry in times)
    alarms = sum(method in alarmed for *_, alarmed in campaigns)
    print(f"{method}, seed {SEED}: {held} of {len(times)} intervals hold {true_s:.2f} s; {alarms} false alarms")
    for seen, count, share in ((held, len(times), 0.95), (alarms, len(campaigns), FALSE_ALARMS[method])):
        low, high = stats.binom.interval(0.999, count, share)
        assert low <= seen <= high
    assert len(times) >= 0.98 * len(campaigns)  # the others may find that the calibration is too little


def test_it_is_printed_beside_the_bound() -> None:
    output = CliRunner().invoke(app, ["check", "fog_north", "--json"])
    assert output.exit_code == 0, output.output
    document = json.loads(output.stdout)["predicted"]
    ratio = {bound["conditions"]["method"]: bound["ratio"] for bound in document["bounds"]}
    bound_deg = np.rad2deg(np.sqrt(2.0 / 80_000) * 0.5**0.5)  # the paper's noise, 80 s at 1 kHz, amplitude 1 V
    assert document["bounds"][0]["bound"] == pytest.approx(bound_deg, rel=2e-3)
    assert ratio["likelihood"] == pytest.approx(1.0, abs=1e-4)
    assert ratio["least_squares"] == pytest.approx(np.sqrt(80.0 * 5.0 / (32.0 * 3.0) / 4.0), abs=3e-3)  # 32 T/5 each
    assert ratio["quadrant"] > 1.5
    assert ["literal" in sentence for sentence in document["missing"]] == [True]
    assert {entry["quantity"] for entry in document["estimates"]} >= {"azimuth", "azimuth_error", "index_placement"}


@pytest.mark.parametrize(
    ("left_out", "sentence"),
    [("fog", "declare 'fog'"), ("configure", "write 'lock_in_1.configure'")],
)
def test_what_is_not_declared_is_named(left_out: str, sentence: str) -> None:
    planned = thinned("fog_north")
    campaign = {name: value for name, value in planned.campaign.items() if name != left_out}
    readings = [reading for reading in planned.readings if reading.name != left_out]
    found = predict(replace(planned, campaign=campaign, readings=readings))
    assert found.estimates == []
    assert sentence in found.missing[0]


def test_a_table_that_stands_is_named() -> None:
    planned = thinned("fog_north")
    windows = [replace(window, conditions={**window.conditions, "rate_deg_s": 0.0}) for window in planned.windows]
    readings = [replace(reading, conditions={**reading.conditions, "rate_deg_s": 0.0}) for reading in planned.readings]
    found = predict(replace(planned, windows=windows, readings=readings))
    assert found.estimates == []
    assert "which rate" in found.missing[0]


def test_without_a_calibration_the_plan_says_so() -> None:
    planned = thinned("fog_north")
    windows = [window for window in planned.windows if window.conditions["item"] != "calibration"]
    readings = [reading for reading in planned.readings if reading.conditions.get("item") != "calibration"]
    found = predict(replace(planned, windows=windows, readings=readings))
    assert any(sentence.startswith("calibration at a known azimuth: none") for sentence in found.missing)
    assert "index_placement" not in {entry["quantity"] for entry in found.estimates}


def test_lines_name_the_bound() -> None:
    plan = compile_sequence("fog_north", None, SETTINGS["fog_north"])
    lines = list(predicted_lines(plan, predicted(plan)))
    assert any("of the Cramér-Rao bound" in line for line in lines)
    assert any(reading.name == PROMPT for reading in planned_of(plan).readings)


@pytest.mark.parametrize(("poles", "bandwidth"), [(1, 1 / 4), (2, 1 / 8), (3, 3 / 32), (4, 5 / 64)])
def test_noise_behind_a_lock_in(poles: int, bandwidth: float) -> None:
    """Equivalent noise bandwidths of the SR830's manual, in 1/T; and a filter that is run."""
    due = 0.7 * np.sqrt(2.0 * bandwidth / 3.0 / 1000.0)
    assert lock_in_noise(0.7, 1000.0, 3.0, poles) == pytest.approx(due, rel=1e-4)
    impulse = np.zeros(4000)
    impulse[0] = 1.0
    for _ in range(poles):
        impulse = signal.lfilter([1.0 - np.exp(-0.01)], [1.0, -np.exp(-0.01)], impulse)
    behind_mean = np.convolve(impulse, np.full(100, 0.01))
    found = lock_in_noise(1.0, 100.0, 1.0, poles, mean_s=1.0)
    assert found == pytest.approx(np.sqrt(np.sum(behind_mean**2)), rel=6e-3)


def test_what_an_amplitude_that_varies_changes_is_named() -> None:
    found = predict(thinned("fog_north_parameters"))
    assert any(sentence.startswith("Where parameters vary (TVP)") for sentence in found.missing)
    named = {(entry["quantity"], entry["conditions"].get("source")) for entry in found.estimates}
    assert named == {("azimuth", None), ("azimuth_error", None), ("index_placement", None), ("scale", "lock_in_1"),
                     ("scale", "lock_in_2")}  # fmt: skip
