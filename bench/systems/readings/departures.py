"""What the points of a fit say against its polynomial: one search for what departs from it.

Rows are the means of the points with the scatter of their readings; floors of the instruments are another error at each
point, of which only the largest size is known, and one error of all, as gains are.
Source: docs/decisions/0052-departures.md; docs/decisions/0031-values-without-programming.md.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import Any

import numpy as np

from bench.analysis import (
    Estimate,
    Labels,
    Residuals,
    Searched,
    Words,
    departures_of,
    search,
    unit_text,
)
from bench.maths.arrays import Floats
from bench.maths.verdict import coverage_factor
from bench.systems.readings.estimators.polynomial import Points
from bench.systems.readings.fits import NONLINEARITY, Fitted
from bench.systems.readings.wording import say

_HIGHER = 2  # powers beyond those of the polynomial
_PERCENT = 0.01


def departures_of_fit(fit: Fitted, entries: Sequence[Estimate], share: float) -> list[Searched]:
    """Return the search of a fit. ``entries``: its estimates.   ``share``: of the chance of a false doubt.

    There is none where a sequence judges the largest departure: that is a result then, of the best polynomial.
    """
    stated = [entry for entry in entries if entry.expanded_uncertainty and not entry.quantity.endswith(NONLINEARITY)]
    noise, dof = _noise(fit)
    if NONLINEARITY in fit.asked["expected"] or not noise.all() or not stated:
        return []
    found = search(_residuals(fit, stated, noise, dof), departures_of(_labels(fit)), share)
    return [Searched(found, stated, _words(fit))]


def _noise(fit: Fitted) -> tuple[Floats, float]:
    """Return standard deviation of each point by scatter, (m,), at least that of all, and its degrees of freedom.

    By the floors of the instruments, where nothing scatters; 0 where nothing was read repeatedly, so that nobody knows.
    """
    assert fit.curve is not None
    x, y = fit.fitted_points
    single = np.divide(y.scatter, y.std, out=np.sqrt(y.n), where=y.std > 0.0) ** -2.0  # of independent readings
    dof = np.where(y.n > 1, 1.0 / single - 1.0, 0.0)
    if not y.std.any():
        return _floor(x, y, fit.curve.slope) * dof.any(), math.inf
    pooled = np.sqrt(np.sum(dof * np.where(dof > 0.0, y.scatter, 0.0) ** 2) / dof.sum())
    return np.hypot(np.maximum(y.std, pooled * np.sqrt(single)), fit.curve.slope * x.std), float(dof.sum())


def _floor(x: Points, y: Points, slope: Floats) -> Floats:
    return np.hypot(y.floor, slope * x.floor)


def _residuals(fit: Fitted, stated: Sequence[Estimate], noise: Floats, dof: float) -> Residuals:
    """Return the points as rows, common errors of the instruments last."""
    assert fit.curve is not None
    curve, (x, y) = fit.curve, fit.fitted_points
    held = np.column_stack([y.gain, y.floor, curve.slope * x.gain, curve.slope * x.floor])

    def whiten(columns: Floats) -> Floats:
        return np.vstack([columns / noise[:, None], np.zeros((held.shape[1], columns.shape[1]))])

    powers = (x.mean[:, None] / np.abs(x.mean).max()) ** np.array(curve.powers)
    design = whiten(np.column_stack([powers, held]))
    design[noise.size :, powers.shape[1] :] = np.eye(held.shape[1])
    operator = np.array([fit.operator_of(entry) for entry in stated])
    return Residuals(
        readings=y.mean,
        white=whiten(curve.departure[:, None])[:, 0],
        design=design,
        scatter=whiten(np.diag(_floor(x, y, curve.slope)))[:, : noise.size * math.isfinite(dof)],
        whiten=whiten,
        operator=operator,
        expanded=np.array([entry.expanded_uncertainty for entry in stated]),
        noise=coverage_factor() * np.sqrt(operator**2 @ noise**2),
        on_curve=True,
        noise_dof=dof,
    )


def _labels(fit: Fitted) -> Labels:
    """Return the labels of the points; what departs is in the unit of y itself."""
    assert fit.curve is not None
    (x, _), slope, number = fit.fitted_points, fit.functions[1].slope(fit.y.mean), np.arange(fit.x.mean.size)
    highest = fit.curve.powers[-1] + _HIGHER
    further = [power for power in range(1, highest + 1) if power not in fit.curve.powers]
    return Labels(
        kinds={"point": number},
        hours=fit.time_s / 3600.0,
        visit=number,
        scales={"x": (x.mean / np.abs(x.mean).max(), further)},
        carriers={
            "offset": (unit_text(fit.asked["units"][NONLINEARITY]), slope),
            "gain": ("%", _PERCENT * slope * fit.y.mean),
        },
        steps_within=False,
    )


def _words(fit: Fitted) -> Words:
    """Return how a person names the labels of a fit."""
    unit = unit_text(fit.asked["against"]["unit"])

    def words(label: str, value: Any) -> str:
        if label == "point":
            return f"{fit.name_of_x} {fit.x.mean[int(value)]:g} {unit}"
        return {"offset": fit.title, "gain": say("departs.gain", title=fit.title), "x": fit.name_of_x}[label]

    return words
