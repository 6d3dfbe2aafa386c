"""The shortest bias ramp: what ``bench plan`` makes of that of 25 hours, and its rules."""

from __future__ import annotations

import sys
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from rehearsal import ROOT
from scipy import stats
from shorter_ramp import GIVEN, SHORTEST, given, problem, written

from bench.analysis import FALSE_DOUBT
from bench.design import LEAST_POWER, default_targets, designed, reached
from bench.design.shortest import misses
from bench.maths.verdict import coverage_factor
from bench.model.errors import InputError
from bench.plan import check_plan, compile_sequence
from bench.session.designed import problem_of
from bench.session.predicted import predicted
from bench.systems.af_converter.bias_ramp.design.campaign import Candidate, Ramps
from bench.systems.af_converter.bias_ramp.estimates import CHECKS, listed_rivals
from bench.systems.af_converter.estimators.hysteresis.model import WIDTH
from bench.systems.af_converter.estimators.hysteresis.rivals import SECOND_LAG, Noise, compare

WINDOW_s = 100.0
NEAR = Candidate((10, 12), (72, 42, 66))


def test_what_the_search_sees_of_today_is_what_is_compiled() -> None:
    candidate, window_s = problem().today
    assert candidate == Candidate((10, 10), (72, 36, 72))
    assert problem().duration_s(candidate, window_s) == given().duration_s == 90_000.0
    ours, theirs = reached(problem().estimates(candidate, window_s)), reached(predicted(given()).estimates)
    for key, U in ours.items():
        assert theirs[key] == pytest.approx(U, rel=1e-9), key


@pytest.mark.validates(
    "bias ramp of 25 h in 23.2 h: bias, first coefficient, width, half-width and lag no worse",
    against="the prediction of the fit for the compiled sequence",
)
def test_what_is_written_compiles_and_reaches_what_the_given_one_does(
    record_property: Callable[[str, object], None],
) -> None:
    shorter = written()
    assert check_plan(shorter) == []
    assert shorter.duration_s == problem().duration_s(SHORTEST, WINDOW_s) == 83_400.0
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
        "hold_start of 54 windows": Candidate((10, 12), (54, 42, 60)),
        "hold_top of 30 windows": Candidate((10, 12), (72, 30, 60)),
        "0.21 degC/min": Candidate((10, 21), (60, 42, 60)),
        "0.32 degC short of an end": Candidate((14, 14), (60, 36, 60)),
        "a daily rhythm (gyro), begun at hour 10, that puts a result 1.5 U off": Candidate((10, 13), (60, 42, 60)),
        "second thermal lag (gyro) that costs 1 U of hysteresis_width": Candidate((10, 20), (60, 42, 60)),
    }
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


def test_a_lag_below_the_declared_one_is_refused_and_a_longer_one_asks_for_longer_holds() -> None:
    with pytest.raises(InputError, match="the unit alone, 25 min") as error:
        problem_of(given(), 1.0)
    assert error.value.code == "B-DES-001"
    start_60 = replace(SHORTEST, holds=(60, *SHORTEST.holds[1:]))
    said = "hold_start of 60 windows"
    assert not any(said in sentence for sentence in problem().broken(start_60, WINDOW_s))
    longer: Any = problem_of(given(), 27.0 * 60.0)  # four lags: 64.8 windows of 100 s
    assert any(said in sentence for sentence in longer.broken(start_60, WINDOW_s))


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
