"""Ramps simulated as ``bench plan`` has shortened that of 25 hours, held against their truth and in wrong worlds."""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable
from functools import cache

import doubt_bias_ramp as wrong
import numpy as np
import pytest
from doubt_classes import DOUBTED, REFUSED, WRONG, Seen, Switch, sorted_classes, worst_bias
from ramp_spread import Place, place, stated_errors
from scipy import stats
from shorter_ramp import SHORTEST, problem, simulated_as, written

from bench.analysis import is_sound
from bench.session.planned import planned_of
from bench.session.predicted import predicted
from bench.systems.af_converter.bias_ramp.design.campaign import LEAST_POWER, Candidate
from bench.systems.af_converter.constants import read_campaign

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
    expected = {place(entry): entry["std_uncertainty"] for entry in predicted(written()).estimates}
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
    """Seeds 0 to 6. Each rhythm puts the first coefficient by its ramp 1.5 U off."""
    rhythm = Switch("rhythm", RhythmFromTen, (size,))
    with simulated_as(written(candidate)):
        ramps = [wrong.seen(seed, rhythm, size) for seed in range(7)]
        off = worst_bias(wrong.seen(0, rhythm, size, noise_free=True), wrong.seen(0, None, 0.0))["bias_tc1"]
    told = [not all(map(is_sound, ramp.entries)) for ramp in ramps]
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
