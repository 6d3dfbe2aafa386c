"""Hard and soft iron of the magnetometer from records in many attitudes, or the reason why there are none.

Source: ``estimators.magnetometer.ellipsoid``; the GNC-module paper stops at the plane of its figure 7.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field
from typing import Any

import numpy as np

from bench.analysis import Figure, curve, estimate
from bench.model.errors import FitError
from bench.systems.gnc.estimators.magnetometer.ellipsoid import EllipsoidFit, fit_ellipsoid
from bench.systems.gnc.rows import AXES, SampledRow

ITEM = "attitudes"
_MOST_SAMPLES = 20_000  # an even choice of more says nothing that these do not
_CIRCLE_SAMPLES = 2_000


@dataclass(frozen=True)
class Sphere:
    """What records in many attitudes say; all empty where there are none of them."""

    estimates: list[dict[str, Any]] = field(default_factory=list)
    notes: list[str] = field(default_factory=list)
    missing: list[str] = field(default_factory=list)
    figures: list[Figure] = field(default_factory=list)


def sphere_of(rows: Sequence[SampledRow]) -> Sphere:
    """Hard iron (gauss) and symmetric soft iron of all records with the item ``attitudes`` together.

    Readings that do not determine the ellipsoid are named as missing, with the direction they lack.
    """
    rows = [row for row in rows if row.item == ITEM]
    if not rows:
        return Sphere(
            notes=["A turn about Z determines X and Y only; offset and gain of Z need records in many attitudes."]
        )
    readings = np.concatenate([row.values("magnetometer") for row in rows])
    chosen = readings[:: max(1, -(-len(readings) // _MOST_SAMPLES))]
    try:
        fit = fit_ellipsoid(chosen)
    except FitError as error:
        return Sphere(missing=[f"hard and soft iron of the magnetometer: {error.message} ({error.code})"])
    notes = [f"Hard and soft iron: {sentence}." for sentence in fit.coverage.sentences]
    return Sphere(_estimates(fit, len(chosen)), notes, [], [_figure(fit, chosen)])


def _estimates(fit: EllipsoidFit, n: int) -> list[dict[str, Any]]:
    kind = {"kind": "magnetometer", "method": "ellipsoid"}
    std = np.sqrt(np.diag(fit.hard_iron_covariance))
    entries = [
        estimate("mag_hard_iron", "gauss", float(fit.hard_iron[k]), float(std[k]), kind | {"axis": axis}, n=n)
        for k, axis in enumerate(AXES)
    ]
    for row, name in enumerate(AXES):
        for column in range(row + 1):
            value, step = float(fit.symmetric[row, column]), float(fit.symmetric_std[row, column])
            place = kind | {"row": name, "column": AXES[column]}
            entries.append(estimate("mag_soft_iron", "1", value, step, place, n=n))
    return entries


def _figure(fit: EllipsoidFit, readings: np.ndarray[Any, np.dtype[np.float64]]) -> Figure:
    shown = readings[:: max(1, len(readings) // _CIRCLE_SAMPLES)]
    before = 1e3 * np.linalg.norm(shown, axis=1)
    after = 1e3 * np.linalg.norm(fit.corrected(shown), axis=1)
    number = np.arange(len(shown), dtype=np.float64)
    title = "Size of the field in all attitudes"
    caption = f"As read and without hard and soft iron; {1e3 * fit.noise:.2f} mgauss of noise are left."
    parts = [curve("before", number, before, "points"), curve("after", number, after, "points")]
    return Figure(title, caption, "reading, in the order of the records", "field, mgauss", parts)
