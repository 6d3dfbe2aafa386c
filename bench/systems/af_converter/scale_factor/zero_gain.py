"""What zeros in every range of the calibrator are worth: the same rows fitted again with one zero pair."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from bench.analysis import Table
from bench.model.errors import FitError
from bench.systems.af_converter.constants import Campaign, Standards
from bench.systems.af_converter.estimators.noise import Readings
from bench.systems.af_converter.estimators.scale_factor import Referral, fit_scale_factor
from bench.systems.af_converter.group_fit import Fitted, GroupFit


def zero_gain_table(fitted: Fitted, campaign: Campaign, standards: Standards, method: str) -> list[Table]:
    """Standard uncertainty of the fit per kind, before the calibrator's gain is added: with all zeros, with one pair.

    Empty for a campaign with zeros in one range, and for methods that subtract zeros instead of weighting them.
    """
    pairs: dict[str, list[tuple[float, float]]] = {}
    for visit in fitted.groups:
        kept = one_zero_pair(visit.group.closed)
        if method != "gls" or visit.group.repeat or kept.all():
            continue
        alone = _without(visit, kept, fitted, campaign, standards)
        if alone is not None:
            kind = campaign.channel(visit.group.channel).kind
            pairs.setdefault(kind, []).append((_largest_ppm(visit.fit.covariance_ppm2), alone))
    rows = [[kind, *(float(np.sqrt(np.mean(np.square(side)))) for side in zip(*differences, strict=True))]
            for kind, differences in pairs.items()]  # fmt: skip
    if not rows:
        return []
    title = "Zeros in every range of the calibrator"
    caption = (
        "Standard uncertainty of the fit of dsf_n and dsf_p before the calibrator's gain is added, root "
        "mean square over channels and temperatures: as measured, and with the zeros of the lowest range only."
    )
    headers = ["kind", "zeros in every range, ppm", "one pair of zeros, ppm"]
    return [Table(title, caption, headers, rows)]


def zero_gain_notes(tables: list[Table]) -> list[str]:
    """Return the table in a sentence."""
    said = [f"{kind} {every:.2f} ppm instead of {pair:.2f} ppm" for table in tables for kind, every, pair in table.rows]
    return [f"Zeros in every range: standard uncertainty of the fit {', '.join(said)} with one pair."] if said else []


def one_zero_pair(rows: Readings) -> NDArray[np.bool_]:
    """Mask (m,) that leaves out the zeros of all ranges but the lowest that has any."""
    zeros = rows.level_A == 0
    lowest_A = rows.range_A[zeros].min(initial=np.inf)
    return np.asarray(~zeros | (rows.range_A == lowest_A))


def _without(
    visit: GroupFit, kept: NDArray[np.bool_], fitted: Fitted, campaign: Campaign, standards: Standards
) -> float | None:
    at_degC = visit.fit.unit_temperature_degC
    referral = Referral(at_degC, fitted.slopes_ppm_degC(visit.group.channel, at_degC))
    rows = visit.group.closed.take(kept)
    try:
        fit = fit_scale_factor(rows, campaign.converter(visit.group.channel), standards.ranges, "gls", referral)
    except FitError:
        return None
    return _largest_ppm(fit.covariance_ppm2)


def _largest_ppm(covariance_ppm2: NDArray[np.float64]) -> float:
    return float(np.sqrt(np.diag(covariance_ppm2).max()))
