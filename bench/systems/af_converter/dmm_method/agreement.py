"""Does the DMM method agree with the calibrator method on the same records?"""

from __future__ import annotations

from collections.abc import Iterable
from typing import Any

import numpy as np

from bench.analysis import Material, Table
from bench.model.errors import FitError
from bench.systems.af_converter.constants import CALIBRATOR, Campaign, read_standards
from bench.systems.af_converter.dmm_method.estimates import DmmFit
from bench.systems.af_converter.estimators.scale_factor import fit_scale_factor
from bench.systems.af_converter.group_estimates import common_relative_ppm

_K95 = 1.96


def agreement_table(fits: Iterable[DmmFit], material: Material, campaign: Campaign) -> list[Table]:
    """Differences to the calibrator method, where the register holds the calibrator and both methods have a result.

    Both standards count in full: the difference is one between two chains of traceability. The counts are the same in
    both, so the uncertainty of the difference is, if anything, stated too large.
    """
    if CALIBRATOR not in material.standards:
        return []
    calibrator = read_standards(material.standards)
    common_ppm = common_relative_ppm(calibrator)
    rows: list[list[Any]] = []
    for fitted in fits:
        try:
            other = fit_scale_factor(fitted.group.closed, campaign.converter(fitted.group.channel), calibrator.ranges)
        except FitError:
            continue  # the DMM method stands by itself
        variance = np.diag(other.covariance_ppm2) + other.gain_ppm**2 + common_ppm**2
        for index, name in enumerate(("dsf_n", "dsf_p")):
            if name not in fitted.fit.value_ppm:
                continue
            difference = fitted.fit.value_ppm[name] - float(other.dsf_ppm[index])
            expanded = _K95 * float(np.hypot(fitted.fit.std_ppm[name], variance[index] ** 0.5))
            rows.append(
                [fitted.group.channel, fitted.group.temperature_degC, name, fitted.fit.value_ppm[name],
                 float(other.dsf_ppm[index]), difference, expanded, difference / expanded]
            )  # fmt: skip
    if not rows:
        return []
    headers = ["channel", "degC", "quantity", "DMM method, ppm", "calibrator method, ppm", "difference, ppm",
               "U of the difference, ppm", "E_n"]  # fmt: skip
    largest = max(abs(row[-1]) for row in rows)
    caption = f"The same records against both standards. They agree where |E_n| <= 1; the largest is {largest:.2f}."
    return [Table("DMM method and calibrator method", caption, headers, rows)]
