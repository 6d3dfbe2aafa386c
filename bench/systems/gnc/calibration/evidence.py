"""What the records of a calibration say against its matrices and biases.

Every sensor answers mainly to its own axis, the equations that are more than needed hold within the noise, the second
set of records finds what the first one found, and a sensor that has noise elsewhere does not stand still.
Source: docs/decisions/0025-doubt.md.
"""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np

from bench.analysis import Evidence
from bench.maths.tests import SMALLEST, chi2_tail, f_tail, of_many, t_both
from bench.maths.verdict import coverage_factor
from bench.systems.gnc.calibration.report import Calibration
from bench.systems.gnc.estimators.sample_checks import FROZEN
from bench.systems.gnc.estimators.triad import AXES, TriadFit
from bench.systems.gnc.limits import Limits
from bench.systems.gnc.rows import CheckedRow
from bench.systems.gnc.wording import channel_name, say

_PLAUSIBLE = 0.1  # scale-factor error and coupling
_NOISE_DOF = 15.0  # of noise inside of and between the records, at least
_UNITS = {"accel": "g", "gyro": "deg/s"}


def evidence(parts: Calibration, checked: Sequence[CheckedRow], limits: Limits) -> list[Evidence]:
    """Return what every check says of both triads, those that found nothing included."""
    found = []
    gyro = None if parts.gyro is None else parts.gyro.triad
    gyro_check = None if parts.gyro_check is None else parts.gyro_check.triad
    for prefix, fit, check in (
        ("accel", parts.accelerometer, parts.accelerometer_check),
        ("gyro", gyro, gyro_check),
    ):
        if fit is not None:
            found += [*_plausible(prefix, fit), *_lack_of_fit(prefix, fit, limits[f"{prefix}_bias_stability"])]
        if fit is not None and check is not None:
            found += [
                *_lack_of_fit(prefix, check, limits[f"{prefix}_bias_stability"], second=True),
                _repeats(prefix, fit, check),
            ]
    return [*found, *_stands_still(checked)]


def _of(prefix: str) -> tuple[str, ...]:
    return tuple(f"{prefix}_{name}" for name in ("matrix", "bias", "scale_error", "cross_coupling"))


def _all_of(prefix: str) -> tuple[str, ...]:
    return (*_of(prefix), *_of_both_sets(prefix))


def _of_both_sets(prefix: str) -> tuple[str, ...]:
    return f"{prefix}_coupling_compensated", f"{prefix}_scale_repeatability"


def _plausible(prefix: str, fit: TriadFit) -> list[Evidence]:
    """Return a refusal where a sensor does not answer mainly to its own axis."""
    off = np.abs(fit.sensitivity - np.eye(3))
    worst = float(off.max())
    if worst <= _PLAUSIBLE:
        return []
    row, column = np.unravel_index(int(np.argmax(off)), off.shape)
    text = say(
        "evidence.axis",
        sensor=AXES[row],
        triad=say(f"triad.{prefix}"),
        axis=AXES[column],
        answer=float(fit.sensitivity[row, column]),
        due=float(row == column),
        off=100 * worst,
        bound=100 * _PLAUSIBLE,
    )
    return [Evidence("implausible_axis", text, worst, 0.0, quantities=_all_of(prefix), refuses=True)]


def _lack_of_fit(prefix: str, fit: TriadFit, stability: float, *, second: bool = False) -> list[Evidence]:
    """Return whether the equations beyond those needed hold within the noise and what the bias may wander.

    From pose to pose a bias wanders more than the noise inside of the records tells; the intervals are widened for it.
    Beyond the bias stability of the specification (``stability``, unit of the residuals) it is no bias.
    """
    if fit.residual_dof <= 0:
        return []
    ratio = fit.chi2 / fit.residual_dof
    wander = float(np.sum(fit.residual**2)) / stability**2
    probability = max(f_tail(ratio, fit.residual_dof, _NOISE_DOF), chi2_tail(wander, fit.residual_dof))
    triad = say(f"triad.{prefix}")
    text = say(
        "evidence.equations",
        triad=say("triad.second", triad=triad) if second else triad,
        rms=float(np.sqrt(np.mean(fit.residual**2))),
        unit=_UNITS[prefix],
        stability=stability,
    )
    quantities = _of_both_sets(prefix) if second else (*_of(prefix), f"{prefix}_scale_repeatability")
    return [Evidence("lack_of_fit", text, ratio, probability, math.inf, quantities)]


def _repeats(prefix: str, fit: TriadFit, check: TriadFit) -> Evidence:
    """Return whether the second set, after compensation by the first, shows scale factors of one and no coupling."""
    left = check.matrix - np.eye(3)
    score = np.abs(left) / np.sqrt(np.maximum(check.matrix_std**2 + fit.matrix_std**2, SMALLEST))
    probability = of_many(t_both(float(score.max()), min(fit.dof, check.dof)), score.size)
    move = float(np.max(np.abs(left) / np.maximum(coverage_factor() * fit.matrix_std, SMALLEST)))
    row, column = np.unravel_index(int(np.argmax(score)), score.shape)
    text = say(
        "evidence.sets",
        triad=say(f"triad.{prefix}"),
        sensor=AXES[row],
        axis=AXES[column],
        apart=float(1e6 * left[row, column]),
        score=float(score.max()),
    )
    return Evidence("sets_differ", text, float(score.max()), probability, move, _of(prefix))


def _stands_still(checked: Sequence[CheckedRow]) -> list[Evidence]:
    """Return each sensor that stands still through a record and has noise in another one of the same kind."""
    found = []
    for item, prefix in (("position", "accel"), ("rotation", "gyro")):
        rows = [seen for seen in checked if seen.row.item == item]
        for axis in AXES:
            channel = f"{'accelerometer' if prefix == 'accel' else 'gyro'} {axis}"
            still = [seen.row.number for seen in rows if _frozen(seen, channel)]
            if 0 < len(still) < len(rows):
                text = say("evidence.still", sensor=channel_name(channel), records=", ".join(map(str, still)))
                found.append(Evidence("stands_still", text, float(len(still)), 0.0, quantities=_all_of(prefix)))
    return found


def _frozen(seen: CheckedRow, channel: str) -> bool:
    return any(finding.kind == FROZEN and finding.channel == channel for finding in seen.checks.findings)
