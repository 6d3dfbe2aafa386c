"""Agreement of the DMM method with the calibrator method on the same records, what both share being left out.

Both count the same pulses, and a register may say that both standards were calibrated with the same one.
Source: docs/decisions/0036-standards-once.md; ISO/IEC 17043 for E_n.
"""

from __future__ import annotations

import math
from collections.abc import Iterable
from typing import Any

import numpy as np

from bench.analysis import Material, Table, covariance_by_standards
from bench.maths.verdict import coverage_factor
from bench.model.errors import FitError
from bench.systems.af_converter.constants import Campaign
from bench.systems.af_converter.dmm_method.estimates import DmmFit, shared_by_standards
from bench.systems.af_converter.estimators.readings import noise_parts
from bench.systems.af_converter.estimators.scale_factor import ScaleFactor, fit_scale_factor, usable_rows
from bench.systems.af_converter.group_fit import QUANTITIES
from bench.systems.af_converter.register import CALIBRATOR, Standards, common_errors, read_standards
from bench.systems.af_converter.wording import say

_HEADS = ("channel", "quantity", "degC", "dmm", "calibrator", "difference", "U", "E_n")


def agreement_table(fits: Iterable[DmmFit], material: Material, campaign: Campaign) -> list[Table]:
    """Return differences to the calibrator method, where the register holds the calibrator and both have a result."""
    if CALIBRATOR not in material.standards:
        return []
    standards = read_standards(material.standards)
    rows: list[list[Any]] = []
    for fitted in fits:
        converter = campaign.converter(fitted.group.channel)
        try:
            other = fit_scale_factor(fitted.group.closed, converter, standards.ranges)
        except FitError:
            continue  # the DMM method stands by itself
        for index, name in enumerate(QUANTITIES):
            if name not in fitted.fit.value_ppm:
                continue
            value_ppm, other_ppm = fitted.fit.value_ppm[name], float(other.dsf_ppm[index])
            std_ppm = difference_std_ppm(fitted, other, index, campaign, standards)
            expanded = coverage_factor() * std_ppm
            place = [fitted.group.channel, name, fitted.group.temperature_degC]
            difference = value_ppm - other_ppm
            rows.append([*place, value_ppm, other_ppm, difference, expanded, difference / expanded])
    if not rows:
        return []
    largest = max(abs(row[-1]) for row in rows)
    headers = [say(f"agreement.head.{head}") for head in _HEADS]
    return [Table(say("agreement.title"), say("agreement.caption", largest=largest), headers, rows)]


def difference_std_ppm(
    fitted: DmmFit, other: ScaleFactor, index: int, campaign: Campaign, standards: Standards
) -> float:
    """Return the standard uncertainty of DSF_N (index 0) or DSF_P (1) by the meter minus the same by the calibrator.

    Args:    fitted: of the DMM method.   other: of the calibrator method, by the same closed rows.
    Returns: ppm.
    Raises:  nothing.
    Source:  JCGM 100:2008 equation (16), with the covariance by the counts and by what the standards share.
    """
    name, rows = QUANTITIES[index], fitted.group.closed
    usable = usable_rows(rows)
    of_counts = np.sum(list(noise_parts(rows.take(usable), campaign.converter(fitted.group.channel)).values()), axis=0)
    by_counts = other.operator_ppm[index][usable] @ of_counts @ fitted.fit.operators_ppm[name][usable]
    parts = {label: float(effect_ppm[index]) for label, effect_ppm in other.standard_ppm.items()}
    by_standards = covariance_by_standards(
        {"common": common_errors(standards.register, CALIBRATOR, parts, {})},
        {"common": shared_by_standards(fitted, name, standards.register)},
    )
    of_calibrator = math.fsum(part**2 for part in parts.values()) + standards.drift_ppm**2
    variance = fitted.fit.std_ppm[name] ** 2 + float(other.noise_ppm2[index, index]) + of_calibrator
    return math.sqrt(max(variance - 2.0 * (float(by_counts) + by_standards), 0.0))
