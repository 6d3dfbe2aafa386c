"""Estimates that have a verdict: table 1 of the paper states stability, so it judges what compensation leaves over and
what changed since the calibration before; a scale-factor error itself has no limit.
"""

from __future__ import annotations

from collections.abc import Iterable
from typing import Any

import numpy as np

from bench.analysis import estimate
from bench.systems.af_converter.constants import Campaign, Standards
from bench.systems.af_converter.group_estimates import conditions_of, scale_factor_std_ppm
from bench.systems.af_converter.group_fit import QUANTITIES, Fitted


def residual_estimates(fitted: Fitted, campaign: Campaign, standards: Standards) -> list[dict[str, Any]]:
    """dsf_n_residual, dsf_p_residual: DSF(T) minus its own polynomial at the measured temperature, against the limit.

    The polynomial is what the navigation computer compensates with. What it leaves over is known as well as DSF(T)
    itself: the calibrator's gain counts in full, because the compensation takes it over; the error of the unit's
    temperature sensor does not, because the compensation reads the same sensor. There is no such estimate for a channel
    with as few temperatures as coefficients: the polynomial would pass through every point.
    """
    found = []
    for (quantity, channel), polynomial in fitted.polynomials.items():
        visits = fitted.visits(channel)
        if quantity not in QUANTITIES or len(visits) <= polynomial.coefficients.size:
            continue
        limit = campaign.channel(channel).stability_limit_ppm
        for one, value_ppm in zip(visits, polynomial.residual, strict=True):
            std_ppm = scale_factor_std_ppm(one, standards, QUANTITIES.index(quantity))
            conditions, name = conditions_of(one, campaign), f"{quantity}_residual"
            counted = {"n": one.fit.n, "dropped": one.group.dropped + one.fit.dropped}
            found.append(estimate(name, "ppm", float(value_ppm), std_ppm, conditions, limit=limit, **counted))
    return found


def change_estimates(estimates: Iterable[dict[str, Any]], campaign: Campaign) -> list[dict[str, Any]]:
    """Change against a previous calibration, judged against the stability limit (paper table 1).

    Both uncertainties count in full: nothing says that the two calibrations shared a standard.
    """
    earlier = {_place(one): one for one in campaign.previous if one.get("quantity") in QUANTITIES}
    found = []
    for now in estimates:
        then = earlier.get(_place(now))
        if now["quantity"] not in QUANTITIES or then is None:
            continue
        limit = campaign.channel(now["conditions"]["channel"]).stability_limit_ppm
        std_ppm = float(np.hypot(now["std_uncertainty"], then["std_uncertainty"]))
        change_ppm = now["value"] - then["value"]
        name = f"{now['quantity']}_change"
        found.append(estimate(name, "ppm", change_ppm, std_ppm, now["conditions"], n=now["n"], limit=limit))
    return found


def _place(one: Any) -> tuple[Any, ...]:
    conditions = one.get("conditions", {})
    return one.get("quantity"), conditions.get("channel"), conditions.get("temperature_degC")
