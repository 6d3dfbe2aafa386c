"""The bias ramp that ``bench plan`` makes of that of 25 hours: its rules, and what it reaches."""

import sys
import tempfile
from collections.abc import Callable
from dataclasses import replace
from functools import cache
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from rehearsal import ROOT
from scipy import stats

from bench.analysis import search
from bench.design import LEAST_POWER, default_targets, designed, reached
from bench.design.shortest import misses
from bench.model.errors import InputError
from bench.plan import Plan, check_plan, compile_sequence
from bench.session.designed import problem_of
from bench.session.predicted import predicted
from bench.systems.af_converter.bias_ramp.departures import SECOND_LAG, Rows
from bench.systems.af_converter.bias_ramp.design import Candidate, Ramps

SEQUENCE = "bias_ramp_25h"
SHORTEST = Candidate((10, 12), (78, 42, 60))  # what 'bench plan bias_ramp_25h' finds, in 23.3 h


@cache
def given() -> Plan:
    return compile_sequence(SEQUENCE, None, {})


@cache
def problem() -> Ramps:
    return problem_of(given(), None)


@cache
def written(candidate: Candidate = SHORTEST) -> Plan:
    """Return a ramp as it is written and compiled again."""
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "shorter.yaml"
        path.write_text(problem().written(candidate, problem().today[1], "shorter", ["Shorter."]), encoding="utf-8")
        return compile_sequence(path, None, {})


WINDOW_s = 100.0
NEAR = Candidate((10, 11), (78, 36, 66))


def test_what_the_search_sees_of_today_is_what_is_compiled() -> None:
    candidate, window_s = problem().today
    assert candidate == Candidate((10, 10), (72, 36, 72))
    assert problem().duration_s(candidate, window_s) == given().duration_s == 90_000.0
    ours, theirs = reached(problem().estimates(candidate, window_s)), reached(predicted(given()).estimates)
    for key, U in ours.items():
        assert theirs[key] == pytest.approx(U, rel=1e-9), key


@pytest.mark.validates(
    "bias ramp of 25 h in 23.3 h: bias, first coefficient, width, half-width and lag no worse",
    against="the prediction of the fit for the compiled sequence",
)
def test_what_is_written_compiles_and_reaches_what_the_given_one_does(
    record_property: Callable[[str, object], None],
) -> None:
    shorter = written()
    assert check_plan(shorter) == []
    assert shorter.duration_s == problem().duration_s(SHORTEST, WINDOW_s) == 84_000.0
    record_property("obtained", f"{shorter.duration_s / 3600.0:.1f} h")
    known = reached(problem().estimates(*problem().today))
    found = reached(predicted(shorter).estimates)
    for key, U in reached(problem().estimates(SHORTEST, WINDOW_s)).items():
        assert found[key] == pytest.approx(U, rel=1e-9), key
    targets = default_targets(problem().wanted, known)
    assert len(targets) == 10
    sys.stdout.write(f"{ {target.key.name: round(target.reached(found) / target.U, 3) for target in targets} }\n")
    assert misses(targets, found) == []


@pytest.mark.parametrize("every", [8, pytest.param(1, marks=pytest.mark.sweep)])
def test_the_search_goes_on_from_a_ramp_that_is_nearly_the_shortest(
    monkeypatch: pytest.MonkeyPatch, every: int
) -> None:
    """``every``: which of the others beside the shortest are tried."""
    moves = Ramps.moves
    tried = lambda *of: [one for at, one in enumerate(moves(*of)) if at % every == 0 or one == SHORTEST]  # noqa: E731
    monkeypatch.setattr(Ramps, "moves", tried)
    monkeypatch.setattr(Ramps, "starts", [NEAR])
    targets = default_targets(problem().wanted, reached(problem().estimates(*problem().today)))
    assert designed(problem(), targets).candidate == SHORTEST


def test_the_rules_hold_and_break() -> None:
    assert problem().broken(SHORTEST, WINDOW_s) == []
    blind = {
        "hold_start of 54 windows": Candidate((10, 12), (54, 42, 60)),
        "hold_top of 30 windows": Candidate((10, 12), (72, 30, 60)),
        "0.21 degC/min": Candidate((10, 21), (60, 42, 60)),
        "0.32 degC short of an end": Candidate((14, 14), (60, 36, 60)),
        "1.5 times a daily rhythm begun at hour 10 (gyro) that costs 1 U": Candidate((10, 12), (72, 42, 60)),
        "second thermal lag (gyro) that costs 1 U of bias": Candidate((10, 20), (60, 42, 60)),
    }
    for word, each in blind.items():
        assert any(word in sentence for sentence in problem().broken(each, WINDOW_s)), word


def test_every_rival_that_the_given_ramp_shows_is_seen() -> None:
    before, after = (
        {(power.rival, power.quantity): power.power for power in problem().powers(*each)}
        for each in (problem().today, (SHORTEST, WINDOW_s))
    )
    shown = {where for where, power in before.items() if power >= LEAST_POWER}
    assert len(before) == 50 + 2 * 12
    assert len(shown) == 19 + 7
    assert min(after[where] for where in shown) >= LEAST_POWER


@pytest.mark.validates(
    "power against a second lag of a bias ramp",
    against="search on 40 draws, sweep 100",
)
@pytest.mark.parametrize("draws", [40, pytest.param(100, marks=pytest.mark.sweep)])
def test_a_rival_is_seen_as_often_as_its_power_says(record_property: Callable[[str, object], None], draws: int) -> None:
    """Seed 49. A second lag that moves the width by its U, at the place where it is seen the least."""
    ramp = problem()._fitted(problem().today[0])
    rows = Rows(ramp.fits["gyro"], ramp.drive)
    residuals = rows.residuals(problem().estimates(*problem().today))
    widths = np.array([entry.quantity == "hysteresis_width" and entry.conditions.get("temperature_degC", 20.0) == 20.0
                       for entry in residuals.stated])  # fmt: skip
    (power,) = (
        power.power
        for power in problem().powers(*problem().today)
        if (power.rival, power.quantity) == ("a second thermal lag (gyro)", "hysteresis_width")
    )
    departures = rows.loop.departures()
    lags = np.column_stack([one.effect for one in departures if one.shape == SECOND_LAG])
    effects = residuals.whiten(
        lags / np.abs(residuals.operator[widths] @ lags / residuals.expanded[widths, None]).max(0)
    )
    scale = np.linalg.norm(residuals.design, axis=0)
    design = residuals.design / scale
    left = effects - design @ np.linalg.lstsq(design, effects, rcond=1e-10)[0]
    rarest = effects[:, np.argmin(np.sum(left**2, axis=0))]
    rng = np.random.default_rng(49)
    noise = rng.standard_normal((draws, rarest.size))
    seen = sum(bool(search(replace(residuals, white=rarest + one), departures, 0.1).findings) for one in noise)
    record_property("obtained", f"{seen / draws:.2f}, stated {power:.3f}")
    low, high = stats.binom.interval(0.999, draws, power)
    assert low <= seen <= high


def test_a_lag_below_the_declared_one_is_refused_and_a_longer_one_asks_for_longer_holds() -> None:
    with pytest.raises(InputError, match=r"B-DES-001: .*the unit alone, 25 min"):
        problem_of(given(), 1.0)
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
    text = (ROOT / "sequences" / f"{SEQUENCE}.yaml").read_text(encoding="utf-8")
    lines = [line for line in text.splitlines() if not line.startswith(("duration:", "records:"))]
    path = tmp_path / "other.yaml"
    path.write_text("\n".join(lines).replace(old, new).replace(f"sequence: {SEQUENCE}", "sequence: other"))
    with pytest.raises(InputError) as error:
        problem_of(compile_sequence(path, None, {}), None)
    assert error.value.code == code
