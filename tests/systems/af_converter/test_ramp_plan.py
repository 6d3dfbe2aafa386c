"""The shortest bias ramp: what ``bench plan`` makes of that of 25 hours, its rules, and truth of simulated ramps."""

from __future__ import annotations

import sys
from collections.abc import Callable
from dataclasses import replace
from functools import cache
from pathlib import Path
from typing import Any

import bias_simulation
import numpy as np
import pytest
from ramp_spread import Place, errors_of, place
from rehearsal import ROOT
from scipy import stats

from bench.analysis import FALSE_DOUBT
from bench.design import LEAST_POWER, default_targets, designed, reached
from bench.design.targets import misses
from bench.maths.verdict import coverage_factor
from bench.model.errors import InputError
from bench.plan import Plan, check_plan, compile_sequence
from bench.session.designed import problem_of
from bench.session.planned import planned_of
from bench.session.predicted import predicted
from bench.systems.af_converter.bias_ramp.design.campaign import Candidate, Ramps
from bench.systems.af_converter.bias_ramp.evidence import CHECKS, listed_rivals
from bench.systems.af_converter.constants import read_campaign
from bench.systems.af_converter.estimators.hysteresis.model import WIDTH
from bench.systems.af_converter.estimators.hysteresis.rivals import SECOND_LAG, Noise, compare

GIVEN = "bias_ramp_25h"
WINDOW_s = 100.0
SHORTEST = Candidate((10, 13), (60, 42, 60))  # what 'bench plan bias_ramp_25h' finds, in 22.2 h
NEAR = Candidate((10, 12), (60, 42, 60))
SHOWN = ("bias", "hysteresis_width", "play_half_width", "thermal_lag")


@cache
def given() -> Plan:
    return compile_sequence(GIVEN, None, {})


@cache
def problem() -> Ramps:
    found: Any = problem_of(given(), None)
    return found


@cache
def written(folder: Path) -> Plan:
    path = folder / "shorter.yaml"
    path.write_text(problem().written(SHORTEST, WINDOW_s, "shorter", ["Shorter."]), encoding="utf-8")
    return compile_sequence(path, None, {})


@pytest.fixture(scope="module")
def shorter(tmp_path_factory: pytest.TempPathFactory) -> Plan:
    return written(tmp_path_factory.mktemp("shorter"))


def test_what_the_search_sees_of_today_is_what_is_compiled() -> None:
    candidate, window_s = problem().today
    assert candidate == Candidate((10, 10), (72, 36, 72))
    assert problem().duration_s(candidate, window_s) == given().duration_s == 90_000.0
    ours, theirs = reached(problem().estimates(candidate, window_s)), reached(predicted(given()).estimates)
    for key, U in ours.items():
        assert theirs[key] == pytest.approx(U, rel=1e-9), key


@pytest.mark.validates(
    "bias ramp of 25 h in 22.2 h: bias, first coefficient, width, half-width and lag no worse",
    against="the prediction of the fit for the compiled sequence",
)
def test_what_is_written_compiles_and_reaches_what_the_given_one_does(
    shorter: Plan, record_property: Callable[[str, object], None]
) -> None:
    assert check_plan(shorter) == []
    assert shorter.duration_s == problem().duration_s(SHORTEST, WINDOW_s) == 79_900.0
    record_property("obtained", f"{shorter.duration_s / 3600.0:.1f} h")
    known = reached(problem().estimates(*problem().today))
    found = reached(predicted(shorter).estimates)
    for key, U in reached(problem().estimates(SHORTEST, WINDOW_s)).items():
        assert found[key] == pytest.approx(U, rel=1e-9), key
    targets = default_targets(problem().wanted, known)
    assert len(targets) == 10
    sys.stdout.write(f"{ {target.key.name: round(target.reached(found) / target.U, 3) for target in targets} }\n")
    assert misses(targets, found) == []


def test_the_search_goes_on_from_a_ramp_that_is_nearly_the_shortest(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(Ramps, "starts", [NEAR])
    targets = default_targets(problem().wanted, reached(problem().estimates(*problem().today)))
    design = designed(problem(), targets)
    assert design is not None
    assert design.candidate == SHORTEST


def test_the_rules_hold_and_break() -> None:
    assert problem().broken(SHORTEST, WINDOW_s) == []
    blind = {
        "hold_start of 54 windows": Candidate((10, 13), (54, 42, 60)),
        "hold_top of 30 windows": Candidate((10, 13), (60, 30, 60)),
        "21 degC/min": Candidate((10, 21), (60, 42, 60)),
        "0.32 degC short of an end": Candidate((14, 14), (60, 36, 60)),
        "second thermal lag (gyro) that costs 1 U of hysteresis_width": Candidate((10, 20), (60, 42, 60)),
    }
    blind = {word.replace("21 degC", "0.21 degC"): each for word, each in blind.items()}
    for word, each in blind.items():
        assert any(word in sentence for sentence in problem().broken(each, WINDOW_s)), word


def test_every_rival_that_the_given_ramp_shows_is_seen() -> None:
    before, after = (
        {(power.rival, power.quantity): power.power for power in problem().powers(*each)}
        for each in (problem().today, (SHORTEST, WINDOW_s))
    )
    shown = {where for where, power in before.items() if power >= LEAST_POWER}
    assert len(before) == 40
    assert len(shown) == 17
    assert min(after[where] for where in shown) >= LEAST_POWER


@pytest.mark.validates(
    "power against a second thermal lag of a bias ramp", against="the check itself on 100 draws of noise for each lag"
)
def test_a_rival_is_seen_as_often_as_its_power_says(record_property: Callable[[str, object], None]) -> None:
    """Seed 49. A second lag that moves the width by its U, at each place of the list; the rarest is what is stated."""
    ramp = problem()._fitted(problem().today[0])
    channel = ramp.fits["gyro"]
    U_A = coverage_factor() * channel.fit.std(WIDTH)
    base, listed = listed_rivals(channel, ramp.drive)
    (rival,) = (rival for rival in listed if rival.name == SECOND_LAG)
    whiten = channel.readings.noise.whiten
    white, colour = whiten(base.columns), np.linalg.inv(whiten(np.eye(base.residual.size)))
    scale = np.linalg.norm(white, axis=0)
    at = base.names.index(WIDTH)
    rng, draws, often = np.random.default_rng(49), 100, []
    for column in rival.candidates:
        moved_A = np.linalg.lstsq(white / scale, whiten(column[:, 0]), rcond=1e-10)[0][at] / scale[at]
        effect_A = column[:, 0] * U_A / moved_A
        seen = 0
        for _ in range(draws):
            readings = replace(base, residual=colour @ rng.standard_normal(effect_A.size) + effect_A)
            (outcome,) = compare(readings, [rival], [Noise(whiten)])
            seen += outcome.probability <= FALSE_DOUBT / (CHECKS * 10)
        often.append(seen / draws)
    (power,) = (
        power.power
        for power in problem().powers(*problem().today)
        if (power.rival, power.quantity) == (f"{SECOND_LAG} (gyro)", "hysteresis_width")
    )
    record_property("obtained", f"{min(often):.2f}, stated {power:.3f}")
    sys.stdout.write(f"seed 49: {often}, stated {power:.4f}\n")
    low, high = stats.binom.interval(0.999, draws, power)
    assert low <= draws * min(often) <= high


@pytest.mark.slow
@pytest.mark.validates(
    "uncertainties predicted of the shorter ramp",
    against="the spread about the truth of 20 ramps simulated from heat and charge, in the sweep of 100",
)
@pytest.mark.parametrize("ramps", [20, pytest.param(100, marks=pytest.mark.sweep)])
def test_the_shorter_ramp_is_as_good_as_predicted(
    monkeypatch: pytest.MonkeyPatch, shorter: Plan, record_property: Callable[[str, object], None], ramps: int
) -> None:
    """Seeds from 2000 on; each ratio in its 99.9 % band of chi-square."""
    counts = (60, 360, 42, 277, 60)
    ramps_h = 10.0, 60.0 / 0.13 / 60.0
    ends_h = bias_simulation.PREPARATION_h + np.cumsum(counts) / 36.0
    corners = [0.0, 1.1, bias_simulation.PREPARATION_h, ends_h[0], ends_h[0] + ramps_h[0]]
    corners += [ends_h[2], ends_h[2] + ramps_h[1], ends_h[4]]
    monkeypatch.setattr(bias_simulation, "CORNERS_h", np.array(corners))
    branches = tuple(zip((name for name, _ in bias_simulation.BRANCHES), counts, strict=True))
    monkeypatch.setattr(bias_simulation, "BRANCHES", branches)
    bias_simulation.heat.cache_clear()
    constants = read_campaign(planned_of(shorter).campaign)
    kinds = {channel.kind: channel.typical for channel in constants.channels if channel.typical is not None}
    expected = {place(entry): entry["std_uncertainty"] for entry in predicted(shorter).estimates}
    found: dict[Place, list[float]] = {}
    try:
        for seed in range(2000, 2000 + ramps):
            for where, error in errors_of(seed, kinds, constants.thermal_lag_s or 0.0).items():
                found.setdefault(where, []).append(error)
    finally:
        bias_simulation.heat.cache_clear()
    low, high = np.sqrt(stats.chi2.ppf([0.0005, 0.9995], ramps) / ramps)
    ratios = {
        where: float(np.sqrt(np.mean(np.square(errors)))) / expected[where]
        for where, errors in found.items()
        if where[0] in SHOWN or where[0].startswith("bias_tc")
    }
    sys.stdout.write(f"{low:.3f} to {high:.3f} are due: {ratios}\n")
    record_property("obtained", f"{min(ratios.values()):.2f} to {max(ratios.values()):.2f} of {len(ratios)}")
    assert {quantity for quantity, *_ in ratios} >= set(SHOWN)
    assert {where: ratio for where, ratio in ratios.items() if not low < ratio < high} == {}


def test_a_lag_below_the_declared_one_is_refused_and_a_longer_one_asks_for_longer_holds() -> None:
    with pytest.raises(InputError, match="the unit alone, 25 min") as error:
        problem_of(given(), 1.0)
    assert error.value.code == "B-DES-001"
    longer: Any = problem_of(given(), 27.0 * 60.0)  # four lags: 64.8 windows of 100 s
    assert any("hold_start of 60 windows" in sentence for sentence in longer.broken(SHORTEST, WINDOW_s))


@pytest.mark.parametrize(
    ("old", "new", "code"),
    [
        ("  thermal_lag: 25 min ", "  # no lag: ", "B-DES-004"),
        ("branch: hold_top}", "branch: up}", "B-DES-005"),
        ("windows: 360, follows", "windows: 359, follows", "B-DES-005"),
    ],
)
def test_a_ramp_that_cannot_be_planned_is_refused(tmp_path: Path, old: str, new: str, code: str) -> None:
    text = (ROOT / "sequences" / f"{GIVEN}.yaml").read_text(encoding="utf-8")
    lines = [line for line in text.splitlines() if not line.startswith(("duration:", "records:"))]
    path = tmp_path / "other.yaml"
    path.write_text("\n".join(lines).replace(old, new).replace(f"sequence: {GIVEN}", "sequence: other"))
    with pytest.raises(InputError) as error:
        problem_of(compile_sequence(path, None, {}), None)
    assert error.value.code == code
