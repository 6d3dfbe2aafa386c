"""An interlock at the edges of its levels, its dwell and its time-out."""

from __future__ import annotations

import math
from typing import Any

import numpy as np
import pytest

from bench.model.clock import NS
from bench.plan.language.interlocks import InterlockRule
from bench.run.watch.interlocks import InterlockState


def rule(**changes: Any) -> InterlockRule:
    values: dict[str, Any] = {
        "name": "air", "signal": "lab_air", "of": "logger", "channel": 101, "unit": "degC", "high": 24.0, "low": 22.0,
        "release_high": 23.8, "release_low": 22.2, "dwell_s": 10.0, "release_after_s": 20.0, "stale_s": None,
        "action": "hold", "where": "station.yaml:1:1",
    }  # fmt: skip
    return InterlockRule(**(values | changes))


def feed(state: InterlockState, *readings: tuple[float, float | None]) -> list[str | None]:
    return [state.take(round(t_s * NS), value) for t_s, value in readings]


def test_a_value_on_its_trip_level_is_not_beyond_and_the_next_float_is() -> None:
    for level, beyond in ((24.0, math.nextafter(24.0, 99)), (22.0, math.nextafter(22.0, 0))):
        assert feed(InterlockState(rule(dwell_s=0.0), 0), (1, level)) == [None]
        assert feed(InterlockState(rule(dwell_s=0.0), 0), (1, beyond)) == ["tripped"]


def test_it_trips_when_the_dwell_is_over_and_not_before() -> None:
    assert feed(InterlockState(rule(), 0), (5, 25), (14.999999999, 25), (15, 25)) == [None, None, "tripped"]


def test_a_good_value_in_between_begins_the_dwell_again() -> None:
    assert feed(InterlockState(rule(), 0), (0, 25), (9, 23), (10, 25), (19, 25), (20, 25)) == [None] * 4 + ["tripped"]


def test_it_releases_on_the_release_level_after_its_time_and_not_between_the_levels() -> None:
    state = InterlockState(rule(dwell_s=0.0), 0)
    assert feed(state, (0, 25)) == ["tripped"]
    assert feed(state, (1, 23.9), (60, 23.9)) == [None, "lasting"]
    assert state.tripped
    assert feed(state, (61, 23.8), (80.9, 23.8), (81, 23.8)) == [None, None, "released"]
    assert not state.tripped


def test_a_value_beyond_the_release_level_begins_the_release_again() -> None:
    state = InterlockState(rule(dwell_s=0.0), 0)
    found = feed(state, (0, 25), (1, 23), (20, 23.81), (21, 23), (40, 23), (41, 23))
    assert [one for one in found if one != "lasting"] == ["tripped", None, None, None, "released"]


def test_no_reading_neither_trips_nor_releases_by_itself() -> None:
    for missing in (None, math.nan, math.inf, -math.inf):
        well = InterlockState(rule(), 0)
        assert feed(well, (1, missing), (1e6, missing)) == [None, None]
        state = InterlockState(rule(dwell_s=0.0, release_after_s=10.0), 0)
        feed(state, (0, 25))
        found = feed(state, (1, 23), (8, missing), (11, 23), (20, 23), (21, 23))
        assert [one for one in found if one != "lasting"][-1] == "released"
        assert "released" not in found[:-1]


def test_a_gap_in_the_readings_does_not_hide_a_value_that_is_beyond() -> None:
    assert feed(InterlockState(rule(), 0), (0, 25), (5, None), (10, 25)) == [None, None, "tripped"]


def test_readings_that_stay_away_trip_after_their_own_time() -> None:
    state = InterlockState(rule(stale_s=60.0), 0)
    assert feed(state, (1, 23), (61, None), (61.1, None), (62, None)) == [None, None, "stale", None]
    assert math.isnan(state.value)
    assert feed(state, (63, 23), (83, 23))[-1] == "released"


def test_a_reading_that_never_came_is_stale_too() -> None:
    assert feed(InterlockState(rule(stale_s=60.0), 5 * NS), (65, None), (65.001, None)) == [None, "stale"]


def test_lasting_comes_once_after_another_dwell_of_two_seconds_at_least() -> None:
    state = InterlockState(rule(dwell_s=0.0), 0)
    assert feed(state, (0, 25), (1.9, 25), (2, 25), (9, 25)) == ["tripped", None, "lasting", None]
    state = InterlockState(rule(dwell_s=10.0), 0)
    assert feed(state, (0, 25), (10, 25), (19, 25), (20, 25)) == [None, "tripped", None, "lasting"]


@pytest.mark.parametrize("seed", range(20))
def test_every_trip_and_release_is_what_the_readings_of_its_time_say(seed: int) -> None:
    """Against the definition, evaluated anew at every moment from the whole history."""
    print(f"seed {seed}")
    rng = np.random.default_rng(seed)
    one = rule(dwell_s=float(rng.integers(0, 5)), release_after_s=float(rng.integers(0, 5)))
    values = np.round(23.0 + np.cumsum(rng.normal(0, 0.25, 400)) * 0.3, 2)
    state, tripped = InterlockState(one, 0), False
    since = 0  # the readings before the last change count no more
    for t_s, value in enumerate(values):
        found = state.take(t_s * NS, float(value))
        history = values[since : t_s + 1]
        wanted = [one.back(x) if tripped else one.beyond(x) for x in history]
        length = next((n for n, ok in enumerate(reversed(wanted)) if not ok), len(wanted))
        due = one.release_after_s if tripped else one.dwell_s
        changes = length > 0 and length - 1 >= due
        assert (found in ("tripped", "released")) == changes, t_s
        if changes:
            tripped, since = not tripped, t_s + 1
        assert state.tripped == tripped
