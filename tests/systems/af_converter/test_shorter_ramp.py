"""The bias ramp that ``bench plan`` makes of that of 25 hours: its rules, ramps simulated by it, and wrong worlds."""

import sys
import tempfile
from collections import Counter
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import replace
from functools import cache
from itertools import accumulate
from pathlib import Path
from typing import Any

import bias_simulation
import doubt_bias_ramp as wrong
import numpy as np
import pytest
from bias_simulation import Place, place, stated_errors
from doubt_classes import DOUBTED, REFUSED, WRONG, Seen, Switch, sorted_classes, worst_bias
from rehearsal import ROOT
from scipy import stats

from bench.analysis import search
from bench.design import LEAST_POWER, default_targets, designed, reached
from bench.design.shortest import misses
from bench.model.errors import InputError
from bench.plan import Plan, PlannedCall, PlannedRecord, check_plan, compile_sequence
from bench.session.designed import problem_of
from bench.session.predicted import planned_of, predicted
from bench.systems.af_converter.bias_ramp.departures import SECOND_LAG, Rows
from bench.systems.af_converter.bias_ramp.design.campaign import Candidate, Ramps
from bench.systems.af_converter.constants import read_campaign

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


@contextmanager
def simulated_as(plan: Plan) -> Iterator[None]:
    """Give the ramps of ``bias_simulation`` the windows of a plan and the rates of its chamber."""
    steps = plan.phase("campaign")
    counted = Counter(str(step.conditions["branch"]) for step in steps if isinstance(step, PlannedRecord))
    points = [step.set_point for step in steps if isinstance(step, PlannedCall) and step.set_point is not None]
    up_h, down_h = (1.0 / point.ramp_degC_min for point in points)  # 60 degC
    counts = [counted[branch] for branch, _ in bias_simulation.BRANCHES]
    hours = [count * bias_simulation.GATE_s / 3600.0 for count in counts]
    begin_h, up, _, down, _, end_h = accumulate(hours, initial=bias_simulation.PREPARATION_h)
    corners_h = [*bias_simulation.CORNERS_h[:2], begin_h, up, up + up_h, down, down + down_h, end_h]
    branches = tuple((name, count) for (name, _), count in zip(bias_simulation.BRANCHES, counts, strict=True))
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(bias_simulation, "CORNERS_h", np.array(corners_h))
        patch.setattr(bias_simulation, "BRANCHES", branches)
        bias_simulation.heat.cache_clear()
        try:
            yield
        finally:
            bias_simulation.heat.cache_clear()


GIVEN = problem().today[0]
BLIND = Candidate((10, 13), (60, 42, 60))  # the shortest without the rule on rhythms, 22.2 h
SHOWN = ("bias", "bias_residual", "hysteresis_width", "play_half_width", "thermal_lag")
SWITCHES = {switch.name: switch for switch in wrong.SWITCHES}
Record = Callable[[str, object], None]
RAMPS = pytest.mark.parametrize("ramps", [20, pytest.param(100, marks=pytest.mark.sweep)])


@cache
def stated(ramps: int) -> dict[Place, np.ndarray]:
    """Return error and expanded uncertainty of each quantity in ramps of the seeds from 2000 on, (ramps, 2)."""
    plan = written()
    constants = read_campaign(planned_of(plan).campaign)
    kinds = {channel.kind: channel.typical for channel in constants.channels if channel.typical is not None}
    with simulated_as(plan):
        found = [stated_errors(seed, kinds, constants.thermal_lag_s or 0.0) for seed in range(2000, 2000 + ramps)]
    shown = [where for where in found[0] if where[0] in SHOWN or where[0].startswith("bias_tc")]
    return {where: np.array([errors[where] for errors in found]) for where in shown}


@pytest.mark.slow
@pytest.mark.validates(
    "uncertainties predicted of the shorter ramp",
    against="the spread about the truth of 20 ramps simulated from heat and charge, in the sweep of 100",
)
@RAMPS
def test_the_shorter_ramp_is_as_good_as_predicted(record_property: Record, ramps: int) -> None:
    """Each ratio in its 99.9 % band of chi-square."""
    expected = {place(entry): entry.std_uncertainty for entry in predicted(written()).estimates}
    low, high = np.sqrt(stats.chi2.ppf([0.0005, 0.9995], ramps) / ramps)
    ratios = {
        where: float(np.sqrt(np.mean(errors[:, 0] ** 2))) / expected[where] for where, errors in stated(ramps).items()
    }
    print(f"seeds 2000 to {1999 + ramps}: {low:.3f} to {high:.3f} are due: {ratios}")
    figure = f"{ramps} ramps: {min(ratios.values()):.2f} to {max(ratios.values()):.2f} of {len(ratios)}"
    record_property("obtained", figure)
    assert {quantity for quantity, *_ in ratios} >= set(SHOWN)
    assert {where: ratio for where, ratio in ratios.items() if not low < ratio < high} == {}


@pytest.mark.slow
@pytest.mark.validates(
    "shorter bias ramp: stated intervals hold the truth",
    against="20 ramps simulated from heat and charge, in the sweep 100",
)
@RAMPS
def test_stated_intervals_of_the_shorter_ramp_hold_the_truth(record_property: Record, ramps: int) -> None:
    """Each quantity, kind and temperature counts once a ramp; the 99.9 % band of the binomial distribution is due."""
    held = {where: int(np.sum(np.abs(errors[:, 0]) <= errors[:, 1])) for where, errors in stated(ramps).items()}
    low, high = stats.binom.interval(0.999, ramps, 0.95)
    print(f"seeds 2000 to {1999 + ramps}: {low:g} to {high:g} are due: {held}")
    record_property("obtained", f"{min(held.values())} to {max(held.values())} of {ramps}")
    assert {where: count for where, count in held.items() if not low <= count <= high} == {}


@cache
def right_world(candidate: Candidate, seed: int) -> Seen:
    return wrong.seen(seed, None, 0.0)


def classes(candidate: Candidate, switch: Switch, size: float, seeds: range) -> list[Counter[str]]:
    """Return how many estimates of each ramp in a wrong world are in each class."""
    with simulated_as(written(candidate)):
        found = [sorted_classes(wrong.seen(seed, switch, size), right_world(candidate, seed)) for seed in seeds]
    total = problem().duration_s(candidate, 100.0) / 3600.0, dict(sum(found, Counter()))
    print(f"{switch.name} {size:g}, seeds {seeds[0]} to {seeds[-1]}, {total[0]:.1f} h: {total[1]}")
    return found


class RhythmFromTen(wrong.World):
    """The bias follows the hour of the day; it is ten when the windows begin."""

    def added_A(self, at: wrong.Course) -> wrong.Array:
        return self.size * at.unit.width_A * np.sin(2.0 * np.pi * (at.hours + 10.0) / 24.0)


@pytest.mark.parametrize(
    ("candidate", "size", "sees"), [(GIVEN, 0.166, True), (SHORTEST, 0.148, True), (BLIND, 0.122, False)]
)
def test_a_daily_rhythm_that_puts_a_result_off_is_told(candidate: Candidate, size: float, sees: bool) -> None:
    """Seeds 0 to 3. Each rhythm puts the first coefficient by its ramp 1.5 U off."""
    rhythm = Switch("rhythm", RhythmFromTen, (size,))
    with simulated_as(written(candidate)):
        ramps = [wrong.seen(seed, rhythm, size) for seed in range(4)]
        off = worst_bias(wrong.seen(0, rhythm, size, noise_free=True), wrong.seen(0, None, 0.0))["bias_tc1"]
    told = [any(entry.quality != "sound" for entry in ramp.entries) for ramp in ramps]
    power = problem().rhythm_powers(candidate, 100.0)["gyro", 10]
    print(
        f"{off:.2f} U off; power {power:.2f} where ten channels share the chance of a false doubt; of one told: {told}"
    )
    assert off == pytest.approx(1.5, abs=0.2)
    assert all(told) == sees
    assert (power >= LEAST_POWER) == sees


@pytest.mark.sweep
@pytest.mark.validates(
    "shorter bias ramp: wrong worlds are believed no more often than by the given ramp",
    against="wrong worlds of known truth in 10 ramps of each size by both plans",
)
@pytest.mark.parametrize("name", SWITCHES)
def test_no_wrong_world_is_believed_more_often_than_by_the_given_ramp(name: str) -> None:
    """Seeds 0 to 9. What the given ramp tells in all, the shorter one does. The noise of a ramp of another length is
    another, so that the exact test of Fisher compares in how many ramps a number is confidently wrong.
    """
    ramps = range(10)
    for size in SWITCHES[name].sizes:
        counted = [classes(candidate, SWITCHES[name], size, ramps) for candidate in (GIVEN, SHORTEST)]
        told, now_told = (sum(each[DOUBTED] + each[REFUSED] > 0 for each in one) for one in counted)
        before, now = (sum(each[WRONG] > 0 for each in one) for one in counted)
        print(f"ramps that tell it: {told} before, {now_told} now; with a number believed: {before}, {now}")
        assert now_told == len(ramps) or told < len(ramps)
        table = [[now, len(ramps) - now], [before, len(ramps) - before]]
        assert stats.fisher_exact(table, alternative="greater").pvalue > 0.01


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
        "a daily rhythm (gyro), begun at hour 10, that puts a result 1.5 U off": Candidate((10, 12), (72, 42, 60)),
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
    assert len(before) == 50
    assert len(shown) == 19
    assert min(after[where] for where in shown) >= LEAST_POWER


@pytest.mark.validates(
    "power against a second lag of a bias ramp",
    against="search on 40 draws, sweep 100",
)
@pytest.mark.parametrize("draws", [40, pytest.param(100, marks=pytest.mark.sweep)])
def test_a_rival_is_seen_as_often_as_its_power_says(record_property: Record, draws: int) -> None:
    """Seed 49. A second lag that moves the width by its U, at the place where it is seen the least."""
    ramp = problem()._fitted(problem().today[0])
    rows = Rows(ramp.fits["gyro"], ramp.drive)
    residuals, stated = rows.residuals(problem().estimates(*problem().today))
    widths = np.array([entry.quantity == "hysteresis_width" and entry.conditions.get("temperature_degC", 20.0) == 20.0
                       for entry in stated])  # fmt: skip
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
