"""The DMM method as an analysis: the current meter's readings beside the records are the reference.

Source: AF-converter paper section 3.1.2; docs/decisions/0007-dmm-method.md.
"""

from __future__ import annotations

from collections.abc import Iterable
from typing import Any

from bench.analysis import Analysis, Material
from bench.model.errors import FitError
from bench.systems.af_converter.constants import METER, Campaign, read_campaign, read_ranges, read_traceability
from bench.systems.af_converter.dmm_method.agreement import agreement_table
from bench.systems.af_converter.dmm_method.estimates import (
    DmmFit,
    bias_estimates,
    budget,
    conditions_of,
    leakage_estimates,
    scale_factor_estimates,
    shift_estimates,
)
from bench.systems.af_converter.dmm_method.notes import notes, zero_table
from bench.systems.af_converter.dmm_method.readings import MeterLog
from bench.systems.af_converter.estimators.dmm_method import METHODS as FIT_METHODS
from bench.systems.af_converter.estimators.dmm_method import fit_dmm_method
from bench.systems.af_converter.estimators.noise import RangeSpecification
from bench.systems.af_converter.group_fit import reasons
from bench.systems.af_converter.groups import Group, campaign_rows, group_rows, place_name
from bench.systems.af_converter.missing import missing_groups

METHODS: tuple[str, ...] = FIT_METHODS
_OF_ONE_GROUP = ("B-FIT-001", "B-FIT-005", "B-FIT-012", "B-FIT-050")
_UNTRACED = "The uncertainty of the meter is relative to its own calibration; that one is not included."
Refused = list[tuple[Group, FitError]]


def analyse(material: Material, method: str = "joint") -> Analysis:
    """Return estimate scale-factor errors against the current meter, and test that nothing moved between its readings.

    Args:    material: records, readings of the role "dmm", sections of the session manifest.
             method: "joint" (differential and common-mode rows) or "as_printed" (equation (18), the mean only).
    Returns: Analysis. Groups that are not determined have no estimate and are named in ``missing`` and ``notes``; that
             "as_printed" refuses K_N and K_P apart is a note with the rank.
    Raises:  FitError B-FIT-003, -004, -007, -008, -009; B-FIT-001, -005, -012 or -050 if no group is determined.
    Source:  AF-converter paper section 3.1.2; docs/decisions/0007-dmm-method.md.
    """
    constants, register = read_campaign(material.campaign), read_ranges(material.standards, METER)
    chosen = campaign_rows(material.rows)
    groups, log = group_rows(chosen, constants.master_Hz), MeterLog(chosen, material.readings)
    traceability = read_traceability(material.standards, METER)
    fits, refused = _fit_all(groups, log, constants, register, method, traceability or 0.0)
    if not fits:
        raise refused[0][1]
    entries: list[dict[str, Any]] = []
    for fitted in fits:
        entries += scale_factor_estimates(fitted, constants) + bias_estimates(fitted, constants)
        entries += leakage_estimates(fitted, constants)
    entries += shift_estimates(fits, [group for group in groups if group.repeat], log, constants, register)
    first_visits = [row for row in chosen if not row.window.conditions.get("repeat")]
    missing = missing_groups(first_visits, {fitted.group.place for fitted in fits}, refused, constants)
    return Analysis(
        campaign=constants.analysis,
        method=method,
        uut=dict(constants.uut),
        estimates=entries,
        components=budget(fits, constants),
        groups=[_quality(fitted, constants) for fitted in fits],
        notes=[
            *(f"No result: {sentence}" for sentence in missing),
            *notes(fits, groups, entries, constants),
            *([_UNTRACED] if traceability is None else []),
        ],
        missing=missing,
        tables=[*agreement_table(fits, material, constants), *zero_table(log)],
    )


def _fit_all(
    groups: Iterable[Group], log: MeterLog, campaign: Campaign, register: dict[float, RangeSpecification], method: str,
    traceability: float,
) -> tuple[list[DmmFit], Refused]:  # fmt: skip
    fits: list[DmmFit] = []
    refused: Refused = []
    for group in groups:
        if group.repeat:
            continue
        try:
            fits.append(_fit_one(group, log, campaign, register, method, traceability))
        except FitError as error:
            if error.code not in _OF_ONE_GROUP:
                raise
            error.where = place_name(group.place)
            refused.append((group, error))
    return fits, refused


def _fit_one(
    group: Group, log: MeterLog, campaign: Campaign, register: dict[float, RangeSpecification], method: str,
    traceability: float,
) -> DmmFit:  # fmt: skip
    if not group.closed.gate_s.size:
        raise FitError(
            "B-FIT-012",
            f"no record with the route closed may enter the fit (left out: {reasons(group)})",
            next_step="see the quality of the records in the report; take the group again",
        )
    meter = log.meter(group.numbers)
    fit = fit_dmm_method(group.closed, meter, campaign.converter(group.channel), register, method, traceability)
    return DmmFit(group, meter, fit)


def _quality(fitted: DmmFit, campaign: Campaign) -> dict[str, Any]:
    reduced = fitted.fit.chi2 / fitted.fit.dof if fitted.fit.dof else float("nan")
    counted = {"dof": fitted.fit.dof, "n": fitted.fit.n, "dropped": fitted.group.dropped + fitted.fit.dropped}
    return conditions_of(fitted, campaign) | {"repeat": 0, "reduced_chi2": reduced} | counted
