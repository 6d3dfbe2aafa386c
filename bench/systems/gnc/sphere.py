"""Hard and soft iron of a magnetometer from readings in many attitudes, of records of the bench or of a log.

Source: ``estimators.magnetometer.ellipsoid``.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, field

import numpy as np

from bench.analysis import Estimates, Evidence, Figure, Floats, curve, estimate
from bench.model.errors import FitError
from bench.systems.gnc.estimators.magnetometer.ellipsoid import EllipsoidFit, fit_ellipsoid
from bench.systems.gnc.estimators.magnetometer.wander import Wander
from bench.systems.gnc.field_evidence import plausible_sphere, shown_unit, surface_evidence
from bench.systems.gnc.rows import AXES
from bench.systems.gnc.wording import refused, say

_MOST_SAMPLES = 20_000  # an even choice of more says nothing that these do not
_CIRCLE_SAMPLES = 2_000


@dataclass(frozen=True)
class Sphere:
    """Result of readings in many attitudes; all empty where there are none of them.

    ``wander``, ``wander_dof``: of a sum of readings of the records, as ``widened`` takes them.
    """

    fit: EllipsoidFit | None = None
    every: int = 1  # reading of the records that was taken
    estimates: Estimates = field(default_factory=list)
    evidence: list[Evidence] = field(default_factory=list)
    notes: list[str] = field(default_factory=list)
    missing: list[str] = field(default_factory=list)
    figures: list[Figure] = field(default_factory=list)

    @property
    def wander(self) -> float:
        """Variance of a sum of readings over that of independent noise; 1 where nothing is known of it."""
        if self.fit is None or not self.fit.quadric.wander.blocks:
            return 1.0
        return 1.0 + self.every * (max(self.fit.quadric.wander.factor, 1.0) ** 2 - 1.0)

    @property
    def wander_dof(self) -> float:
        """Degrees of freedom behind it."""
        return math.inf if self.fit is None else float(self.fit.hard_iron_dof.min())


def sphere_of(records: Sequence[Floats], unit: str = "gauss", noise: float | None = None) -> Sphere:
    """Return hard iron and symmetric soft iron of readings in many attitudes.

    Readings that do not determine the ellipsoid are named as missing, with the direction they lack.

    Args: records: (n, 3) readings of each.   unit: of the readings; "1" for counts, of which no field is known.
        noise: of readings that hold none.
    """
    chosen, begins, every = _chosen(records)
    try:
        fit = fit_ellipsoid(chosen, begins=begins, noise=noise)
    except FitError as error:
        return Sphere(missing=[refused(say("iron"), error.message, error.code)])
    notes = [say("note.iron", text=sentence) for sentence in fit.coverage.sentences]
    notes += noise_notes(say("of.attitudes"), fit.quadric.wander, int(fit.odd.sum()), fit.odd.size)
    places = np.searchsorted(np.flatnonzero(~fit.odd), begins).tolist()
    return Sphere(
        fit=fit,
        every=every,
        estimates=_sphere_estimates(fit, unit),
        evidence=[
            *surface_evidence(fit.quadric, chosen[~fit.odd], places, say("attitudes"), {}, unit),
            *plausible_sphere(fit, unit),
        ],
        notes=notes,
        figures=[_sphere_figure(fit, chosen[~fit.odd], unit)],
    )


def _chosen(records: Sequence[Floats]) -> tuple[Floats, list[int], int]:
    """Return readings of all records, (n, 3), thinned alike where they are many, the first of each record, and the
    number of readings from one that was taken to the next.
    """
    every = max(1, -(-sum(map(len, records)) // _MOST_SAMPLES))
    thinned = [readings[::every] for readings in records]
    begins = np.cumsum([0, *(len(readings) for readings in thinned)])
    return np.concatenate(thinned), begins[:-1].tolist(), every


def noise_notes(what: str, wander: Wander, odd: int, count: int) -> list[str]:
    """Return what was left out, and what noise that wanders did to the intervals."""
    notes = []
    if odd:
        notes.append(say("note.odd", what=what, odd=odd, count=count))
    if wander.blocks:
        notes.append(say("note.wander", what=what, blocks=wander.blocks, times=wander.factor))
    return notes


def _sphere_estimates(fit: EllipsoidFit, unit: str) -> Estimates:
    kind = {"kind": "magnetometer", "method": "ellipsoid"}
    n, dropped = int((~fit.odd).sum()), int(fit.odd.sum())
    std = np.sqrt(np.diag(fit.hard_iron_covariance))
    entries = [
        estimate(
            "mag_hard_iron", unit, fit.hard_iron[k], std[k], kind | {"axis": axis}, n=n, dropped=dropped,
            dof=fit.hard_iron_dof[k],
        )
        for k, axis in enumerate(AXES)
    ]  # fmt: skip
    for row, name in enumerate(AXES):
        for column in range(row + 1):
            value, step = float(fit.symmetric[row, column]), float(fit.symmetric_std[row, column])
            place = kind | {"row": name, "column": AXES[column]}
            dof = float(fit.symmetric_dof[row, column])
            entries.append(estimate("mag_soft_iron", "1", value, step, place, n=n, dropped=dropped, dof=dof))
    return entries


def _sphere_figure(fit: EllipsoidFit, readings: Floats, unit: str) -> Figure:
    shown = readings[:: max(1, len(readings) // _CIRCLE_SAMPLES)]
    factor, name = shown_unit(unit)
    before = factor * np.linalg.norm(shown, axis=1)
    after = factor * np.linalg.norm(fit.corrected(shown), axis=1)
    number = np.arange(len(shown), dtype=np.float64)
    caption = say("size.caption", noise=factor * fit.noise, unit=name)
    parts = [curve(say("before"), number, before, "points"), curve(say("after"), number, after, "points")]
    return Figure(say("size.title"), caption, say("size.x"), say("size.y", unit=name), parts)
