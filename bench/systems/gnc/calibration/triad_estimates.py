"""Estimates of a calibrated triad, in the units that the results carry."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

from bench.analysis import Estimates, estimate
from bench.systems.gnc.estimators.triad import TriadFit
from bench.systems.gnc.rows import AXES


@dataclass(frozen=True)
class Triad:
    """How the estimates of a triad are named. ``bias_factor``: from the unit of the fit to ``bias_unit``."""

    prefix: str
    kind: str
    bias_unit: str
    bias_factor: float


ACCELEROMETER = Triad("accel", "accelerometer", "g", 1.0)
GYRO = Triad("gyro", "gyro", "deg/h", 3600.0)


def triad_estimates(fit: TriadFit, triad: Triad, count: int) -> Estimates:
    """Matrix K (true input per indicated), bias, scale-factor errors and couplings of S = K^-1; none of them judged.

    Bias of gyros: w = K N - bias; of accelerometers: a = K N + bias. ``count``: samples that went into it.
    """
    found: Estimates = []
    common: dict[str, Any] = {"n": count, "dof": fit.dof}
    for row, name in enumerate(AXES):
        for column, other in enumerate(AXES):
            place = {"kind": triad.kind, "row": name, "column": other}
            value, std = fit.matrix[row, column], fit.matrix_std[row, column]
            found.append(estimate(f"{triad.prefix}_matrix", "1", value, std, place, **common))
    for row, name in enumerate(AXES):
        place = {"kind": triad.kind, "axis": name}
        value, std = triad.bias_factor * fit.bias[row], triad.bias_factor * fit.bias_std[row]
        found.append(estimate(f"{triad.prefix}_bias", triad.bias_unit, value, std, place, **common))
        value, std = fit.scale_error_ppm[row], fit.scale_error_std_ppm[row]
        found.append(estimate(f"{triad.prefix}_scale_error", "ppm", value, std, place, **common))
    return found + _coupling(fit, triad, f"{triad.prefix}_cross_coupling", None, common)


def checked_coupling(check: TriadFit, calibration: TriadFit, triad: Triad, limit: float) -> Estimates:
    """Coupling that an independent set of records shows after compensation, against the limit of the specification.

    Its uncertainty is that of the check; the error of the calibration itself is what is being looked for.
    """
    count = check.residual_dof + 12
    common: dict[str, Any] = {"n": count, "dof": min(check.dof, calibration.dof)}
    return _coupling(check, triad, f"{triad.prefix}_coupling_compensated", limit, common)


def _coupling(fit: TriadFit, triad: Triad, quantity: str, limit: float | None, common: dict[str, Any]) -> Estimates:
    return [
        estimate(
            quantity, "1", fit.cross_coupling[row, column], fit.cross_coupling_std[row, column],
            {"kind": triad.kind, "row": AXES[row], "column": AXES[column]}, limit=limit, **common,
        )
        for row in range(3)
        for column in range(3)
        if row != column
    ]  # fmt: skip
