"""Determines fits and estimates from the records and readings of a campaign by the DMM method."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from dataclasses import dataclass

from bench.analysis import Estimates, Material
from bench.model.errors import FitError
from bench.systems.af_converter.constants import Campaign, read_campaign
from bench.systems.af_converter.dmm_method.estimates import (
    DmmFit,
    bias_estimates,
    leakage_estimates,
    scale_factor_estimates,
    shift_estimates,
)
from bench.systems.af_converter.dmm_method.evidence import without_odd_level
from bench.systems.af_converter.dmm_method.readings import MeterLog
from bench.systems.af_converter.estimators.dmm_method import fit_dmm_method
from bench.systems.af_converter.estimators.readings import RangeSpecification
from bench.systems.af_converter.group_fit import missing_groups, require_closed
from bench.systems.af_converter.groups import Group, campaign_rows, group_rows, place_name
from bench.systems.af_converter.register import METER, read_ranges

_OF_ONE_GROUP = ("B-FIT-001", "B-FIT-005", "B-FIT-012", "B-FIT-050")
Refused = list[tuple[Group, FitError]]


@dataclass(frozen=True)
class Determined:
    """Fits and estimates of a campaign. ``missing``: a sentence for each group without a result."""

    fits: list[DmmFit]
    groups: list[Group]
    log: MeterLog
    estimates: Estimates
    missing: list[str]


def determine(material: Material, method: str) -> Determined:
    """Return fits and estimates of a campaign, without what explains them. Raises: as ``analysis.analyse``."""
    constants, register = read_campaign(material.campaign), read_ranges(material.standards, METER)
    chosen = campaign_rows(material.rows)
    groups, log = group_rows(chosen, constants.master_Hz), MeterLog(chosen, material.readings)
    fits, refused = _fit_all(groups, log, constants, register, method)
    if not fits:
        raise refused[0][1]
    entries: Estimates = []
    for fitted in fits:
        entries += scale_factor_estimates(fitted, constants, material.standards) + bias_estimates(fitted, constants)
        entries += leakage_estimates(fitted, constants)
    entries += shift_estimates(fits, [group for group in groups if group.repeat], log, constants, register)
    first_visits = [row for row in chosen if not row.window.conditions.get("repeat")]
    missing = missing_groups(first_visits, {fitted.group.place for fitted in fits}, refused, constants)
    return Determined(fits, groups, log, entries, missing)


def _fit_all(
    groups: Iterable[Group], log: MeterLog, campaign: Campaign, register: dict[float, RangeSpecification], method: str
) -> tuple[list[DmmFit], Refused]:
    fits: list[DmmFit] = []
    refused: Refused = []
    for group in groups:
        if group.repeat:
            continue
        try:
            fits.append(_fit_one(group, log, campaign, register, method))
        except FitError as error:
            if error.code not in _OF_ONE_GROUP:
                raise
            error.where = place_name(group.place)
            refused.append((group, error))
    return fits, refused


def _fit_one(
    group: Group, log: MeterLog, campaign: Campaign, register: Mapping[float, RangeSpecification], method: str
) -> DmmFit:
    require_closed(group)
    meter = log.meter(group.numbers)
    converter = campaign.converter(group.channel)
    fit = fit_dmm_method(group.closed, meter, converter, register, method)
    even, meter = without_odd_level(group, meter, converter, register, fit)
    if even is not group:
        fit = fit_dmm_method(even.closed, meter, converter, register, method)
    return DmmFit(even, meter, fit)
