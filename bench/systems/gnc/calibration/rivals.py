"""How surely a calibration would show what else could be true: each listed rival, at the size that costs 1 U.

A rival is put into the samples of a nominal unit; the fits themselves say how far it moves the results, how large their
chi-square becomes, and how far the second set then is from the first. All grow with the size, chi-square with its
square, which gives the one that costs 1 U. It is seen where a fit finds its residuals improbable, and widens its
intervals, or where the sets differ.
Source: docs/decisions/0049-the-shortest-plan.md; noncentral chi-square: Scheffé, The Analysis of Variance (1959), 2.8.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, replace

import numpy as np
from scipy import special

from bench.analysis import FALSE_DOUBT, Document, Estimates, Floats
from bench.design import Power
from bench.systems.gnc.calibration.analysis import estimates_of, fit_positions, fit_turns
from bench.systems.gnc.calibration.report import Calibration, sets_of
from bench.systems.gnc.estimators.triad import TriadFit
from bench.systems.gnc.limits import limits_of
from bench.systems.gnc.predicted import noise_of
from bench.systems.gnc.rows import SENSORS, SampledRow

FOUND = ("scale_error", "cross_coupling", "bias")  # of both triads: what a calibration is made for
_IMPROBABLE = 1e-3  # of a chi-square: below it a fit widens its intervals
_CHECKS, _SIDES, _ELEMENTS = 6, 2, 9  # of a calibration; of a difference; of a matrix
_NO_MOVE = 1e-4  # expanded uncertainties, of a rival as large as it is tried


@dataclass(frozen=True)
class Rival:
    """``error``: of the samples of a record, (n, 3) in their unit, from values and times (-1 to 1 over all records).
    ``costs``: what it may move; a bias is that of its records, so that no drift is an error of it.
    """

    name: str
    kind: str
    costs: Sequence[str]
    error: Callable[[Floats, Floats], Floats]


def _drift(size: float) -> Callable[[Floats, Floats], Floats]:
    return lambda _values, time: size * np.repeat(time[:, None], 3, axis=1)


_RIVALS = (
    Rival("accelerometer biases that drift steadily", "accelerometer", FOUND[:2], _drift(1e-6)),
    Rival("square of the acceleration", "accelerometer", FOUND, lambda values, _: 1e-6 * values**2),
    Rival("gyro biases that drift steadily", "gyro", FOUND[:2], _drift(1e-4)),
    Rival("scale factors of gyros that change with the rate", "gyro", FOUND, lambda w, _: 1e-9 * np.abs(w) * w),
)


def rival_powers(rows: Sequence[SampledRow], base: Calibration, campaign: Document) -> list[Power]:
    """Return how surely each rival would be seen that moves a result. ``rows``, ``base``: of a nominal unit."""
    known = estimates_of(base, limits_of(campaign))
    powers = []
    for rival in _RIVALS:
        parts = _fitted_with(rival, rows, base, campaign)
        for quantity, moved in _moves(known, estimates_of(parts, limits_of(campaign)), rival):
            if moved > _NO_MOVE:
                powers.append(Power(rival.name, quantity, _power(*_fits(parts, rival.kind), 1.0 / moved)))
    return powers


def _fitted_with(rival: Rival, rows: Sequence[SampledRow], base: Calibration, campaign: Document) -> Calibration:
    item, field = ("position" if rival.kind == "accelerometer" else "rotation"), SENSORS[rival.kind]
    chosen = [row for row in rows if row.item == item]
    first_ns, last_ns = chosen[0].samples.t_ns[0], chosen[-1].samples.t_ns[-1]
    wrong = []
    for row in chosen:
        time = 2.0 * (row.samples.t_ns - first_ns) / (last_ns - first_ns) - 1.0
        values = row.values(rival.kind)
        columns = {**row.samples.columns, field: values + rival.error(values, time)}
        wrong.append(replace(row, samples=replace(row.samples, columns=columns)))
    parts = Calibration(sets_of(wrong), base.clock, base.power_on)
    fit = fit_positions if rival.kind == "accelerometer" else fit_turns
    fit(parts, campaign, noise_of(campaign, rival.kind, []))
    return parts


def _moves(known: Estimates, wrong: Estimates, rival: Rival) -> Iterator[tuple[str, float]]:
    """Yield each quantity and how far its values move at most, in their expanded uncertainties."""
    of_kind = [entry for entry in known if entry.conditions["kind"] == rival.kind]
    prefix = SENSORS[rival.kind]
    for name in rival.costs:
        yield (
            f"{prefix}_{name}",
            max(
                abs(moved.value - entry.value) / entry.expanded_uncertainty
                for entry, moved in zip(of_kind, wrong, strict=True)
                if entry.quantity == f"{prefix}_{name}"
            ),
        )


def _fits(parts: Calibration, kind: str) -> tuple[TriadFit, TriadFit]:
    if kind == "accelerometer":
        first, second = parts.accelerometer, parts.accelerometer_check
    else:
        first, second = (each if each is None else each.triad for each in (parts.gyro, parts.gyro_check))
    assert first is not None  # a calibration that is planned has both sets
    assert second is not None
    return first, second


def _power(first: TriadFit, second: TriadFit, size: float) -> float:
    """Return the probability that a rival is seen that is ``size`` times as large: by the check that sees it best."""
    powers = [
        1.0 - special.chndtr(special.chdtri(fit.residual_dof, _IMPROBABLE), fit.residual_dof, fit.chi2 * size**2)
        for fit in (first, second)
    ]
    apart = np.abs(second.matrix - np.eye(3)) / np.hypot(first.matrix_std, second.matrix_std)
    least = -special.stdtrit(min(first.dof, second.dof), FALSE_DOUBT / (_CHECKS * _SIDES * _ELEMENTS))
    return float(max(*powers, special.ndtr(apart.max() * size - least)))
