"""Determines fits, drift of the calibrator and estimates from the records of a scale-factor campaign."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING

from bench.analysis import Estimates, Material
from bench.systems.af_converter.constants import Campaign, read_campaign
from bench.systems.af_converter.group_fit import Fitted, fit_groups
from bench.systems.af_converter.groups import campaign_rows, group_rows
from bench.systems.af_converter.register import Standards, read_standards
from bench.systems.af_converter.scale_factor.calibrator_drift import (
    CalibratorDrift,
    calibrator_drift,
    drift_estimates,
    repeats,
)
from bench.systems.af_converter.scale_factor.estimates import (
    bias_estimates,
    change_estimates,
    clock_estimates,
    coefficient_estimates,
    residual_estimates,
    scale_factor_estimates,
)

if TYPE_CHECKING:
    from bench.record import RecordRow


@dataclass(frozen=True)
class Determined:
    """Fits and estimates of a campaign. ``standards``: with the drift of the calibrator that it leaves possible."""

    constants: Campaign
    standards: Standards
    rows: Sequence[RecordRow]
    fitted: Fitted
    drift: CalibratorDrift
    estimates: Estimates


def determine(material: Material, method: str) -> Determined:
    """Return fits and estimates of a campaign, without what explains them. Raises: as ``analysis.analyse``."""
    constants, declared = read_campaign(material.campaign), read_standards(material.standards)
    rows = campaign_rows(material.rows)
    fitted = fit_groups(group_rows(rows, constants.master_Hz), constants, declared, method)
    again = repeats(fitted, constants, declared, method)
    drift = calibrator_drift(again, fitted, rows, material.readings)
    standards = drift.applied_to(declared)
    entries: Estimates = []
    for visit in fitted.groups:
        if visit.group.repeat == 0:
            entries += scale_factor_estimates(visit, fitted, constants, standards)
            entries += bias_estimates(visit, fitted, constants)
    entries += residual_estimates(fitted, constants, standards)
    entries += coefficient_estimates(fitted, constants, standards)
    entries += clock_estimates(rows, constants, standards)
    entries += drift_estimates(again, fitted, constants) + drift.estimates
    entries += change_estimates(entries, constants)
    return Determined(constants, standards, rows, fitted, drift, entries)
