"""Calibrations as ``bench plan`` shortens the given one, held against the truth of simulated units and wrong worlds."""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable
from functools import cache

import doubt_gnc as wrong
import pytest
from doubt_classes import WRONG, Seen, newly_believed, sorted_classes
from gnc_campaigns import at_rate, calibration_study, form_of, given, written
from spread_study import Study

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
    """A tenth of a degree, which is 4 standard deviations, seeds 0 and 1: what hides is the same."""
    by_plan = believed("one_turn_short", 0.1, range(2))
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
