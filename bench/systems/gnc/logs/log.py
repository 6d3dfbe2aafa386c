"""Columns of an imported log of an inertial unit: accelerometers and gyros as arrays, stretches by label.

What an imported log of an inertial unit says against the numbers that are found in it.

Each sensor moves as its noise makes it, answers mainly to its own axis, and the rests of a log fit one ellipsoid that
stays where it is. Source: docs/decisions/0025-doubt.md.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from bench.analysis import Document, Estimate, Evidence, Floats, Material
from bench.maths.samples import frozen_runs
from bench.maths.tests import SMALLEST, f_tail, of_many, t_both
from bench.maths.verdict import coverage_factor
from bench.model.errors import FitError
from bench.systems.gnc.estimators.multi_position import NormFit
from bench.systems.gnc.estimators.triad import TriadFit
from bench.systems.gnc.rows import AXES
from bench.systems.gnc.wording import channel_name, quantity_word, say

MOTION_ERRORS = ("level_error", "velocity_error")
_PLAUSIBLE = 0.1  # of an axis's own sensitivity, from the two others


@dataclass(frozen=True)
class ImuLog:
    """``accel``, ``gyro`` (n, 3): as read, in ``accel_unit`` and ``gyro_unit`` ("1": counts); gyro None without one.

    ``gravity``: in m/s2.   ``t_s`` (n,).   ``rate_Hz``: mean rate.   ``segments``: as the mapping names them.
    """

    t_s: Floats
    accel: Floats
    accel_unit: str
    gyro: Floats | None
    gyro_unit: str
    gravity: float
    rate_Hz: float
    segments: tuple[Document, ...]

    def rows(self, segment: Document) -> slice:
        """Return rows of a segment; its last one is included."""
        return slice(int(segment["first"]), int(segment["last"]) + 1)


def imu_log(material: Material) -> ImuLog:
    """Return the log of a session.

    Raises: FitError B-GNC-006 if it has no accelerometer of three axes, no gravity or values that are missing.
    """
    t_s = material.series.get("t_s")
    accel, accel_unit = _triad(material, "accelerometer")
    if t_s is None or accel is None:
        raise _unusable("there is no imported log with accelerometers of three axes")
    gyro, gyro_unit = _triad(material, "gyro")
    whole = np.isfinite(accel).all() and (gyro is None or np.isfinite(gyro).all())
    if len(t_s) < 2 or not whole:
        raise _unusable("a value is missing in the columns of the sensors")
    if not t_s[-1] > t_s[0]:
        raise _unusable("all rows of the log have the same time")
    site = material.campaign.get("site") or {}
    if not site.get("gravity_m_s2"):
        raise _unusable("the mapping does not state the gravity of the site")
    return ImuLog(
        t_s=t_s,
        accel=accel,
        accel_unit=accel_unit,
        gyro=gyro,
        gyro_unit=gyro_unit,
        gravity=float(site["gravity_m_s2"]),
        rate_Hz=float(material.campaign.get("rate_Hz") or (len(t_s) - 1) / (t_s[-1] - t_s[0])),
        segments=tuple(material.campaign.get("segments") or ()),
    )


def _triad(material: Material, role: str) -> tuple[Floats | None, str]:
    columns = {
        str(column.get("axis")): column for column in material.campaign.get("columns", ()) if column.get("role") == role
    }
    if set(columns) != set(AXES):
        return None, ""
    triad = np.column_stack([material.series[str(columns[axis]["name"])] for axis in AXES])
    return triad, str(columns["x"]["unit"])


def _unusable(why: str) -> FitError:
    return FitError(
        "B-GNC-006",
        why,
        next_step="map time, three accelerometers and the gravity of the site (docs/importing.md)",
    )


def stuck_sensors(
    stretches: Mapping[str, Sequence[Floats]], quantities: Mapping[str, Sequence[str]] | None = None
) -> list[Evidence]:
    """Return each sensor that stands still longer than its noise allows, at one chance in a million a stretch.

    Args: stretches: by kind ("accelerometer", "gyro"), parts of the log that are used, (n, 3) each.
          quantities: that depend on a kind; None for all.
    """
    found = []
    for kind, parts in stretches.items():
        for k, axis in enumerate(AXES):
            hung = [place for place, part in enumerate(parts, 1) if frozen_runs(axis, part[:, k])]
            if hung:
                key = "evidence.hung_log" if len(parts) == 1 else "evidence.hung_stretch"
                text = say(key, sensor=channel_name(f"{kind} {axis}"), stretches=", ".join(map(str, hung)))
                bears_on = quantities[kind] if quantities else ()
                found.append(Evidence("stands_still", text, float(len(hung)), 0.0, quantities=bears_on))
    return found


def wide_sizes(entries: Sequence[Estimate]) -> list[Evidence]:
    """Return each error of the motions whose interval is wider than the error itself: too few motions tell its size.

    Args: entries: the estimates of one log; those of motions are ``level_error`` and ``velocity_error``.
    """
    found = []
    for entry in entries:
        name, value, wide = entry.quantity, entry.value, entry.expanded_uncertainty
        if name in MOTION_ERRORS and wide > value:
            text = say(
                "evidence.few_motions",
                quantity=quantity_word(name),
                motions=entry.n,
                value=value,
                wide=wide,
                unit=entry.unit,
            )
            found.append(Evidence("too_few_motions", text, wide / value if value else None, 0.0, quantities=(name,)))
    return found


def own_axes(prefix: str, fit: TriadFit) -> list[Evidence]:
    """Return a refusal where a sensor does not answer mainly to its own axis; sensors may count in any unit."""
    own = fit.sensitivity.diagonal()
    cross = np.abs(fit.sensitivity - np.diag(own)) / np.maximum(np.abs(own), SMALLEST)[:, None]
    worst = float(cross.max())
    if worst <= _PLAUSIBLE and bool(np.all(own > 0.0)):
        return []
    row, column = np.unravel_index(int(np.argmax(cross)), cross.shape)
    text = say(
        "evidence.other_axis" if np.all(own > 0.0) else "evidence.wrong_sign",
        sensor=AXES[row],
        triad=say(f"triad.{prefix}"),
        axis=AXES[column],
        share=100 * worst,
        bound=100 * _PLAUSIBLE,
    )
    return [
        Evidence("implausible_axis", text, worst, 0.0, quantities=(f"{prefix}_matrix", f"{prefix}_bias"), refuses=True)
    ]


def of_rests(fit: NormFit, mean: Floats, time_s: Floats) -> list[Evidence]:
    """Return what could be true instead of one ellipsoid that stays: zeros that drift, sensors that bend, a bad rest.

    Args:   fit: of the rests.   mean: (n, 3) reading of each.   time_s: (n,) middle of each.
    Source: F test of columns added in first order (Draper and Smith, Applied Regression Analysis, section 6.1);
            largest studentised residual, Boole's bound (Cook and Weisberg, Residuals and Influence, 2.2.2).
    """
    jacobian = fit.jacobian(mean)
    by_axis = jacobian[:, 6:]  # change of the length with the zero of each sensor
    height = (mean - fit.zero) * fit.matrix.diagonal() / fit.gravity
    since = (time_s - time_s.mean()) / max(float(np.ptp(time_s)), SMALLEST)
    rivals = (
        ("zeros_drift", by_axis * since[:, None]),
        ("sensors_bend", by_axis * height**3),
    )
    found = [_rival(code, fit, jacobian, columns) for code, columns in rivals]
    return [seen for seen in (*found, _odd_rest(fit, jacobian)) if seen is not None]


def _rival(code: str, fit: NormFit, jacobian: Floats, columns: Floats) -> Evidence | None:
    """Return how odd the lengths are if nothing of a rival is in them, and what it would move."""
    both = np.column_stack([jacobian, columns])
    scale = np.linalg.norm(both, axis=0)
    dof = len(fit.residual) - both.shape[1]
    if dof < 1 or np.linalg.matrix_rank(both / scale) < both.shape[1]:
        return None
    solution = np.linalg.lstsq(both / scale, fit.residual, rcond=None)[0]
    left = float(np.sum((fit.residual - (both / scale) @ solution) ** 2))
    gained = max(float(np.sum(fit.residual**2)) - left, 0.0)
    ratio = gained / columns.shape[1] / max(left / dof, SMALLEST)
    probability = f_tail(ratio, columns.shape[1], dof)
    move = float(np.max(np.abs(solution[:9] / scale[:9]) / _expanded(fit)))
    remains = math.sqrt(left / len(fit.residual))
    text = say("evidence.rival", what=say(f"rival.{code}"), rms=fit.residual_rms, left=remains, move=move)
    return Evidence(code, text, ratio, probability, move)


def _odd_rest(fit: NormFit, jacobian: Floats) -> Evidence | None:
    """Return how odd the rest is that fits worst, and what leaving it out would move."""
    count, dof = len(fit.residual), fit.dof - 1
    if dof < 1:
        return None
    base = np.linalg.qr(jacobian / np.linalg.norm(jacobian, axis=0))[0]
    free = np.maximum(1.0 - np.sum(base**2, axis=1), SMALLEST)
    total = float(np.sum(fit.residual**2))
    without = np.maximum((total - fit.residual**2 / free) / dof, SMALLEST)
    score = np.abs(fit.residual) / np.sqrt(without * free)
    worst = int(np.argmax(score))
    probability = of_many(t_both(float(score[worst]), dof), count)
    step = np.linalg.pinv(jacobian)[:, worst] * fit.residual[worst] / free[worst]
    move = float(np.max(np.abs(step) / _expanded(fit)))
    off, times = float(fit.residual[worst]), float(score[worst])
    text = say("evidence.odd_rest", rest=worst + 1, count=count, off=off, times=times, move=move)
    return Evidence("odd_rest", text, float(score[worst]), probability, move)


def _expanded(fit: NormFit) -> Floats:
    return coverage_factor(fit.dof) * np.maximum(np.sqrt(fit.covariance.diagonal()), SMALLEST)
