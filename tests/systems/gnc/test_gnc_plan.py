"""The shortest calibration of a GNC module that ``bench plan`` finds, held against the truth of simulated modules."""

from collections import Counter
from collections.abc import Callable
from dataclasses import replace
from functools import cache
from pathlib import Path
from typing import Any

import doubt_gnc as wrong
import numpy as np
import pytest
from doubt_classes import WRONG, Seen, newly_believed, sorted_classes
from gnc_campaigns import GIVEN, SHORTEST, at_rate, calibration_study, form_of, given, rewritten, written
from scipy import stats
from spread_study import Study

from bench.analysis import FALSE_DOUBT
from bench.design import reached
from bench.design.shortest import misses
from bench.model.errors import InputError
from bench.plan import check_plan, compile_sequence
from bench.session.designed import Asked, Proposal, problem_of, proposed
from bench.session.predicted import predicted
from bench.systems.gnc.calibration.design import Calibrations


@cache
def found() -> Proposal:
    return proposed(given(), Asked([], None, None))


def problem() -> Calibrations:
    return found().problem


@pytest.mark.validates(
    "calibration of a GNC module in less time: both triads no worse",
    against="the prediction of the fit for both compiled sequences",
)
def test_the_written_plan_is_what_was_found_and_reaches_the_targets(tmp_path: Path, record_property: Any) -> None:
    path = tmp_path / "shorter.yaml"
    path.write_text(found().text("shorter"), encoding="utf-8")
    plan = compile_sequence(path, None, {})
    assert check_plan(plan) == []
    design, before = found().design, given()
    assert (design.candidate, design.length_s) == SHORTEST
    record_property("obtained", f"{plan.duration_s:.0f} s in place of {before.duration_s:.0f} s")
    assert plan.duration_s == pytest.approx(design.duration_s, abs=1e-6)
    assert plan.duration_s < 0.95 * before.duration_s
    known, after = (reached(predicted(each).estimates) for each in (before, plan))
    assert len(found().targets) == 6
    assert all(pytest.approx(known[target.key], rel=1.1e-3) == target.U for target in found().targets)
    assert misses(found().targets, after) == []
    for key in after:
        assert found().found[key] == pytest.approx(after[key], rel=1e-6), key


def test_bounds_are_bounds() -> None:
    for candidate, length_s in (problem().today, (found().design.candidate, 60.0)):
        known = reached(problem().estimates(candidate, length_s))
        for key, U in problem().at_least(candidate, length_s).items():
            assert 0.95 * known[key] < U <= known[key], key


def test_broken_rules_are_named() -> None:
    candidate, length_s = found().design.candidate, found().design.length_s
    assert problem().broken(candidate, length_s) == []
    blind = {
        "6 turns take 9 s": (replace(candidate, turns=6, turn_s=30.0), length_s),
        "5 turns hide": (replace(candidate, turns=5), length_s),
        "less than 7 s of rest": (replace(candidate, turn_s=11.5), length_s),
        "the call of a turn may take 14 s": (replace(candidate, turns=1, turn_s=13.0), length_s),
        "a position of 5 s": (candidate, 5.0),
        "a repeated position of 1 s": (replace(candidate, check_s=1.0), length_s),
    }
    for words, each in blind.items():
        assert any(words in sentence for sentence in problem().broken(*each)), words


def test_more_turns_hide_by_how_much_one_ends_off_its_angle() -> None:
    """It moves a scale factor by half of its share, since the turn back is right; the sets differ by that."""
    leasts_deg = []
    for turns in (1, 2, 3, 5):
        parts = problem().nominal(replace(found().design.candidate, turns=turns, turn_s=20.5), 300.0)[1]
        assert parts.gyro is not None
        assert parts.gyro_check is not None
        stds = (each.triad.matrix_std[0, 0] for each in (parts.gyro, parts.gyro_check))
        leasts_deg.append(2.0 * 360.0 * turns * float(np.hypot(*stds)))
    print(f"one standard deviation of an error of one turn of 1, 2, 3 and 5, degree: {np.round(leasts_deg, 4)}")
    assert leasts_deg == sorted(leasts_deg)
    assert leasts_deg[-1] > 1.2 * leasts_deg[-2]


def test_a_repeat_that_cannot_be_judged_is_named(tmp_path: Path) -> None:
    """A limit of 100 ppm on the coupling leaves 10 ppm for the second set."""
    plan = rewritten(tmp_path, GIVEN, ("accel_cross_coupling: 1000 ppm", "accel_cross_coupling: 100 ppm"))
    strict = problem_of(plan, None)
    assert any("accel_coupling_compensated" in sentence for sentence in strict.broken(*strict.today))


def test_the_power_against_a_square_of_the_acceleration_is_that_of_its_formula(tmp_path: Path) -> None:
    """k f^2 moves each bias by k / 3 and leaves residuals of 4 / 3 k^2 per sensor and set; noise is white and alike.

    The bias has the variance s^2 / 6 of the 300 s of the first set, the residuals s^2 each, and 5 s^2 in the 60 s of
    the second, so that 1 U of the bias has the noncentrality 3 * 4 / 3 * 9 * (1 + 1 / 5) * U^2 / s^2. Its threshold is
    shared by some hundred columns, of which the number matters little.
    """
    slow = "accelerometer_wandering: [{size: 6 ug, over: 10 s}, {size: 6 ug, over: 100 s}, {size: 6 ug, over: 1000 s}],"
    white = problem_of(rewritten(tmp_path, GIVEN, (slow, "")), None)
    powers = {(each.rival, each.quantity): each.power for each in white.powers(*white.today)}
    limits = stats.f.isf(FALSE_DOUBT / 4.0 / np.array([1000, 100]), 1, 6 * 19)  # 20 means of each position
    least, most = stats.ncx2.sf(limits, 1, 7.2 * 1.96**2)
    obtained = powers["square of the acceleration", "accel_bias"]
    print(f"power {obtained:.3f}, by the formula {least:.3f} to {most:.3f}")
    assert least < obtained < most


def test_what_rates_of_one_size_cannot_show_is_not_said_to_be_seen() -> None:
    for campaign in (problem().today, (found().design.candidate, found().design.length_s)):
        powers = {(each.rival, each.quantity): each.power for each in problem().powers(*campaign)}
        assert powers["scale factors of gyros that change with the rate", "gyro_scale_error"] < 0.01
        assert powers["gyro biases that drift steadily", "gyro_scale_error"] > 0.9
        assert powers["accelerometer biases that drift steadily", "accel_scale_error"] > 0.9


def test_a_calibration_without_a_second_set_is_refused(tmp_path: Path) -> None:
    second = '  - positions: {time: "{check_position}"}  # the second set checks what the first one gave\n'
    plan = rewritten(tmp_path, GIVEN, (second, ""))
    with pytest.raises(InputError, match=r"B-DES-004.*\+x 1 times"):
        problem_of(plan, None)


FORMS = {"given": form_of(given()), "shorter": form_of(written())}
OF_FIELD = ("bad_reading", "field", "axis_saturates", "magnetised", "steel")  # worlds of the magnetometer
SWITCHES = [switch for switch in wrong.SWITCHES if not switch.name.startswith(OF_FIELD)]
FIRST = 9000
Record = Callable[[str, object], None]
UNITS = pytest.mark.parametrize("units", [3, pytest.param(100, marks=pytest.mark.sweep)])


@cache
def calibrations(units: int) -> Study:
    return calibration_study(at_rate(written()), FIRST, units)


@pytest.mark.validates(
    "uncertainties predicted of the shorter calibration of a GNC module",
    against="the spread about the truth of 3 simulated units, in the sweep of 100",
)
@UNITS
def test_the_shorter_calibration_is_as_good_as_predicted(record_property: Record, units: int) -> None:
    """Each ratio in its 99.9 % band of chi-square."""
    ratios = calibrations(units).ratios()
    record_property("obtained", f"{units} units: {min(ratios.values()):.2f} to {max(ratios.values()):.2f} of 60")
    assert len(ratios) == len(calibrations(units).prediction.estimates) == 60
    assert calibrations(units).outside() == {}


@pytest.mark.validates(
    "shorter calibration of a GNC module: stated intervals hold the truth",
    against="3 simulated units, in the sweep 100",
)
@UNITS
def test_stated_intervals_of_the_shorter_calibration_hold_the_truth(record_property: Record, units: int) -> None:
    """Each of 60 estimates counts once a unit; the 99.9 % band of the binomial distribution is due."""
    counts = calibrations(units).counts()
    record_property("obtained", f"{min(counts.values())} to {max(counts.values())} of {units}")
    assert calibrations(units).uncovered() == {}


@cache
def right_world(plan: str, seed: int) -> Seen:
    return wrong.seen(seed, None, 0.0, form=FORMS[plan])


def believed(name: str, size: float, seeds: range) -> dict[str, int]:
    """Return how many estimates are confidently wrong by each plan; none may be new."""
    (switch,) = (switch for switch in SWITCHES if switch.name == name)
    counted: dict[str, Counter[str]] = {plan: Counter() for plan in FORMS}
    for seed in seeds:
        pairs = [(wrong.seen(seed, switch, size, form=FORMS[plan]), right_world(plan, seed)) for plan in FORMS]
        assert newly_believed(*pairs) == []
        for plan, pair in zip(FORMS, pairs, strict=True):
            counted[plan] += sorted_classes(*pair)
    print(f"{name} {size:g}, seeds {seeds}: {dict(counted['given'])} before, {dict(counted['shorter'])} now")
    return {plan: classes[WRONG] for plan, classes in counted.items()}


def test_one_turn_that_ends_off_its_angle_is_told_as_by_the_given_calibration() -> None:
    """A tenth of a degree, which is 4 standard deviations, seed 0: what hides is the same."""
    by_plan = believed("one_turn_short", 0.1, range(1))
    assert by_plan["shorter"] <= by_plan["given"]


@pytest.mark.sweep
@pytest.mark.validates(
    "shorter calibration of a GNC module: no wrong world is believed that the given one tells",
    against="wrong worlds of known truth, the same seeds by both plans",
)
@pytest.mark.parametrize("name", [switch.name for switch in SWITCHES])
def test_no_wrong_world_is_believed_that_the_given_calibration_tells(name: str) -> None:
    """Seeds 0 and 1 of each size. What no data can show, an assumption names: it puts off what it did before."""
    (switch,) = (switch for switch in SWITCHES if switch.name == name)
    for size in switch.sizes:
        by_plan = believed(name, size, range(2))
        assert by_plan["shorter"] <= by_plan["given"]
