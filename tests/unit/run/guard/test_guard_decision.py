"""When the guard acts: the edges of silence, limits and goodbyes."""

from __future__ import annotations

import math

import pytest
from hypothesis import given
from hypothesis import strategies as st

from bench.model.clock import NS
from bench.run.guard.decision import Action, Watched, decide

LIMITS = {"chamber_air_degC": 65.0, "unit_degC": 70.0}


def watched(**changes: object) -> Watched:
    state = Watched(LIMITS, silence_s=2.0, heard_ns=100 * NS)
    for name, value in changes.items():
        setattr(state, name, value)
    return state


def test_silence_counts_from_its_limit_on() -> None:
    assert decide(watched(), 102 * NS - 1) is None
    found = decide(watched(), 102 * NS)
    assert (found.reason, found.heat_off) == ("silent", False)
    assert "2.00 s" in found.text


def test_a_limit_is_crossed_where_it_is_reached() -> None:
    below = watched(values={"chamber_air_degC": math.nextafter(65.0, 0.0), "unit_degC": 69.9})
    assert decide(below, 100 * NS) is None
    found = decide(watched(values={"chamber_air_degC": 65.0}), 100 * NS)
    assert found == Action("limit", "chamber_air_degC is 65, the hard limit is 65", heat_off=True)


def test_each_quantity_has_its_own_limit() -> None:
    found = decide(watched(values={"chamber_air_degC": 60.0, "unit_degC": 71.25}), 100 * NS)
    assert found.text == "unit_degC is 71.25, the hard limit is 70"


@pytest.mark.parametrize("values", [{}, {"chamber_air_degC": math.nan}, {"lab_degC": 1000.0}])
def test_what_is_not_known_crosses_nothing(values: dict[str, float]) -> None:
    assert decide(watched(values=values), 100 * NS) is None


def test_a_controller_that_is_gone_is_not_waited_for() -> None:
    found = decide(watched(gone=True), 100 * NS)
    assert (found.reason, found.heat_off) == ("gone", False)


def test_a_hot_chamber_that_nobody_controls_any_more_is_switched_off() -> None:
    found = decide(watched(gone=True, values={"chamber_air_degC": 66.0}), 100 * NS)
    assert found.heat_off


@given(
    gone=st.booleans(),
    now_s=st.floats(0.0, 1e6),
    values=st.dictionaries(st.sampled_from(sorted(LIMITS)), st.floats(allow_nan=True)),
)
def test_after_a_goodbye_nothing_is_done(gone: bool, now_s: float, values: dict[str, float]) -> None:
    assert decide(watched(goodbye={}, gone=gone, values=values), round(now_s * NS)) is None


def test_what_a_controller_left_behind_is_gone_on_with_whatever_else_is_wrong() -> None:
    found = decide(watched(goodbye={"calibrator": "unreachable"}, gone=True, values={"chamber_air_degC": 99.0}), NS)
    assert (found.reason, found.left, found.heat_off) == ("left", ("calibrator",), False)
    assert "calibrator unreachable" in found.text


@given(air=st.floats(allow_nan=False), unit=st.floats(allow_nan=False), silent_s=st.floats(0.0, 10.0))
def test_it_acts_exactly_when_something_is_wrong(air: float, unit: float, silent_s: float) -> None:
    found = decide(watched(values={"chamber_air_degC": air, "unit_degC": unit}), 100 * NS + round(silent_s * NS))
    hot = air >= 65.0 or unit >= 70.0
    assert (found is not None) == (hot or round(silent_s * NS) >= 2 * NS)
    if found is not None:
        assert found.heat_off == hot
