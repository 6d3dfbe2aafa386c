"""The scale-factor campaign: from records to estimates, residuals, budget and notes.

Source: AF-converter paper section 3; docs/decisions/0004-scale-factor-equations.md.
"""

from __future__ import annotations

from collections.abc import Iterable
from typing import Any

from bench.analysis import Analysis, Material
from bench.systems.af_converter.coefficients import scale_factor_compensation
from bench.systems.af_converter.constants import Campaign
from bench.systems.af_converter.estimators.scale_factor import METHODS as FIT_METHODS
from bench.systems.af_converter.group_fit import (
    Fitted,
    GroupFit,
    conditions_of,
    missing_groups,
)
from bench.systems.af_converter.scale_factor.budgets import budget_tables, components
from bench.systems.af_converter.scale_factor.estimates import determine
from bench.systems.af_converter.scale_factor.evidence import evidence
from bench.systems.af_converter.scale_factor.notes import notes, zero_gain_notes, zero_gain_table
from bench.systems.af_converter.wording import say

METHODS: tuple[str, ...] = FIT_METHODS


def analyse(material: Material, method: str = "gls") -> Analysis:
    """Return estimate scale-factor errors, their temperature coefficients, biases and clock errors of a campaign.

    Args:    material: records with their counts and conditions, sections of the session manifest.
             method: "gls", "paper" (equation 11) or "ols" (equation 10).
    Returns: Analysis. Groups that are not determined have no estimate and are named in ``missing`` and ``notes``.
    Raises:  FitError B-FIT-003 to B-FIT-009; B-FIT-001, -005, -006 or -012 if no group at all is determined.
    Source:  AF-converter paper section 3; docs/decisions/0004.
    """
    known = determine(material, method)
    constants, register, fitted, chosen = known.constants, known.standards, known.fitted, known.rows
    entries, zero_gain = known.estimates, zero_gain_table(fitted, constants, register, method)
    missing = missing_groups(chosen, {visit.group.place for visit in fitted.groups}, fitted.refused, constants)
    return Analysis(
        campaign=constants.analysis,
        method=method,
        uut=constants.uut,
        estimates=entries,
        evidence=evidence(fitted, entries, constants, register, method, material),
        residuals=residuals(fitted.groups, constants),
        components=components(fitted, constants, register),
        groups=_quality_of_fit(fitted, constants),
        notes=[
            *(say("note.no_result", what=sentence) for sentence in missing),
            *notes(fitted, constants, register, chosen),
            *known.drift.notes,
            *zero_gain_notes(zero_gain),
        ],
        missing=missing,
        tables=[*budget_tables(fitted, constants, register, method), *zero_gain],
        compensation=scale_factor_compensation(fitted, constants),
    )


def _quality_of_fit(fitted: Fitted, campaign: Campaign) -> list[dict[str, Any]]:
    return [
        conditions_of(visit.group, visit.fit.unit_temperature_degC, campaign)
        | {
            "repeat": visit.group.repeat,
            "reduced_chi2": visit.fit.reduced_chi2,
            "dof": visit.fit.dof,
            "n": visit.fit.n,
            "dropped": visit.group.dropped + visit.fit.dropped,
        }
        for visit in fitted.groups
    ]


def residuals(groups: Iterable[GroupFit], campaign: Campaign) -> list[dict[str, Any]]:
    """One entry per closed row of the first visits and repeats: what the fit left over, ampere and ppm of the level.

    ``current_A`` is signed; ``residual_ppm`` and ``std_ppm`` are NaN for zero rows.
    """
    entries = []
    for visit in groups:
        conditions = conditions_of(visit.group, visit.fit.unit_temperature_degC, campaign)
        rows = visit.group.closed
        for index, number in enumerate(visit.group.numbers):
            level_A = float(rows.level_A[index])
            to_ppm = 1e6 / level_A if level_A else float("nan")
            entries.append(
                {
                    "number": number,
                    "channel": visit.group.channel,
                    "kind": conditions["kind"],
                    "temperature_degC": visit.group.temperature_degC,
                    "repeat": visit.group.repeat,
                    "current_A": float(rows.polarity[index]) * level_A,
                    "range_A": float(rows.range_A[index]),
                    "residual_A": float(visit.fit.residual_A[index]),
                    "residual_ppm": float(visit.fit.residual_A[index]) * to_ppm,
                    "std_ppm": float(visit.fit.std_A[index]) * to_ppm,
                }
            )
    return entries
