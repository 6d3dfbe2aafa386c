"""A soak that the lag of the unit has ended, on the page: the end of the run comes nearer by what was left out."""

from __future__ import annotations

from dataclasses import replace

import pytest
from feed_plan import MANIFEST, START_S, small_plan

from bench.model.events import Phase, ThermalLag
from bench.plan import PlannedSoak
from bench.run.feed.planned import early_s
from bench.run.feed.state import RunState

LEAST_s = 400.0


def by_lag() -> RunState:
    """Second 0 of the campaign is START_S; its first step is a soak of 1000 s that may end after 400 s."""
    steps = [
        replace(step, residual_degC=0.1, least_s=LEAST_s) if isinstance(step, PlannedSoak) else step
        for step in small_plan()
    ]
    state = RunState(steps, MANIFEST, source="replay")
    state.on_event(Phase(name="campaign", t_start_ns=0), START_S)
    return state


def noted(saved_s: float, step: int) -> ThermalLag:
    return ThermalLag(step=step, lag_s=1500.0, share=0.01, residual_degC=0.05, bound_degC=0.09, saved_s=saved_s)


def test_what_a_soak_may_leave_out_makes_the_earliest_end() -> None:
    state = by_lag()
    for seconds, early in ((10.0, 600.0), (300.0, 600.0), (700.0, 300.0)):
        state.at_planned("campaign", seconds)
        eta = state.document(START_S + seconds)["eta"]
        assert eta["likely_utc_s"] - eta["earliest_utc_s"] == pytest.approx(early)
    state.at_planned("campaign", 1020.0)
    eta = state.document(START_S + 1020.0)["eta"]
    assert eta["likely_utc_s"] == eta["earliest_utc_s"]
    soaks = [step for step in small_plan() if isinstance(step, PlannedSoak)]
    assert early_s(soaks, soaks[0], 0.0) == 0.0  # without 'done'


def test_the_end_comes_nearer_by_what_was_left_out() -> None:
    state = by_lag()
    state.at_planned("campaign", 500.0)
    before = state.document(START_S + 500.0)
    soak = next(step.number for step in small_plan() if isinstance(step, PlannedSoak))
    state.on_event(noted(500.0, soak + 3), START_S + 500.0)  # of a soak that is done again, on the way back
    assert state.document(START_S + 500.0)["eta"] == before["eta"]
    state.on_event(noted(500.0, soak), START_S + 500.0)
    after = state.document(START_S + 500.5)
    assert after["eta"]["likely_utc_s"] == pytest.approx(before["eta"]["likely_utc_s"] - 500.0)
    assert "the last 8 min of the slot are left out" in after["log"][0]["text"]
