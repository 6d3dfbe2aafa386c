"""Uncertainties that the estimates of a session were to have, by its own plan, and will have at its end."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING

from bench.analysis import Estimate, Estimates, by_foreseen_name, expected_at_end
from bench.model.clock import NS
from bench.model.errors import BenchError
from bench.model.quantities import key_of_value
from bench.model.systems import declared_by
from bench.plan import Plan, plan_of_texts, values_not_due
from bench.session.predicted import predicted

if TYPE_CHECKING:
    from bench.session.view import SessionView

Name = tuple[str, str, int]


@dataclass(frozen=True)
class Expected:
    """An estimate as the whole plan predicts it. ``at_end_U``: expanded uncertainty it will have, None if unknown."""

    predicted: Estimate
    at_end_U: float | None


def predicted_of(session: SessionView, method: str) -> Estimates:
    """Return estimates as the plan of a session predicts them, to hold those of a method against.

    None where the run has not ended, by another method than the first, which predictions are by, and where the session
    has no plan or nothing is predicted.
    """
    declared = declared_by(session.manifest["campaign"])
    if session.incomplete or declared is None or method != declared.methods[0]:
        return []
    plan = _plan_of(session)
    return [] if plan is None else predicted(plan, _begin_utc_s(session)).estimates


def expectations(session: SessionView, known: Mapping[Name, Estimate]) -> dict[Name, Expected]:
    """Return what each estimate will come to, by its name, for a session that is still being recorded.

    Args: known: estimates of the records so far, as they are stated, by their names.
    """
    plan = _plan_of(session)
    whole = [] if plan is None else predicted(plan, _begin_utc_s(session)).estimates
    if plan is None or not whole:
        return {}
    not_due = values_not_due(plan.steps, (event for _, event in session.events))
    last = max((row.window.step for row in session.rows), default=-1)
    until_now = replace(plan, steps=plan.steps[: last + 1])
    part = predicted(until_now, _begin_utc_s(session)).estimates if session.rows else []
    so_far = by_foreseen_name(part)
    return {
        name: Expected(entry, _at_end_U(known.get(name), so_far.get(name), entry))
        for name, entry in by_foreseen_name(whole).items()
        if key_of_value(entry.quantity, entry.conditions) not in not_due
    }


def _begin_utc_s(session: SessionView) -> float | None:
    """Return UTC at the begin of the preparation, the first event of a run, by the clock of the bench; None if unknown.

    That clock counts from anywhere, as from the start of the computer.
    """
    if session.utc_offset_ns is None or not session.events:
        return None
    return (session.utc_offset_ns + session.events[0][0]) / NS


def _at_end_U(known: Estimate | None, so_far: Estimate | None, whole: Estimate) -> float | None:
    """Return the expanded uncertainty at the end: as predicted for what the records so far do not determine."""
    known_U = None if known is None else known.expanded_uncertainty
    if known is not None and known_U is None:
        return None  # it is doubtful: nobody knows what it will come to
    if not known_U or so_far is None or not so_far.expanded_uncertainty:
        return whole.expanded_uncertainty
    return expected_at_end(known_U, so_far.expanded_uncertainty, whole.expanded_uncertainty)


def _plan_of(session: SessionView) -> Plan | None:
    """Return the plan of a session whose analysis predicts soon; None if the session does not hold it whole."""
    declared = declared_by(session.manifest.get("campaign", {}))
    if declared is None or not declared.predicted or declared.predicts_long or not session.plan_steps:
        return None
    try:
        return plan_of_texts(Path(session.manifest["session"]), session.manifest, session.texts, session.plan_steps)
    except BenchError:  # imported, of other software, or damaged: its results are the same without a prediction
        return None
