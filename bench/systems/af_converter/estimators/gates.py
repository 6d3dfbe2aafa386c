"""Covariance of a series of readings of one channel, as a whitening that costs a few operations per reading.

Gates that follow each other cut the same charge: what the first misses the second has, so their quantisation errors
telescope, e_k = (rho_(k+1) - rho_k) / t, with the variance (q / t)^2 / 6 and the lag-1 correlation -1/2. White noise
is independent from gate to gate, the random walk of the bias adds up over the whole series. Differences of
neighbouring readings depend on nothing farther than two gates away, so their covariance has five diagonals.
Source: docs/method-af-converter.md (quantisation, white noise, random walk); Golub and Van Loan, Matrix Computations,
section 4.3 (banded Cholesky factor).

First-order thermal lag of a unit behind the air around it, exact for air measured now and then.

Source: heat balance of one thermal mass, lag dT/dt = air - T; closed form for a drive that is a straight line. What
a gap in the readings of the drive can hide is geometry: between two straight stretches joined by one corner at a
distance a behind the first and b before the second, the chord misses the corner by ds * a * b / (a + b), ds the change
of slope.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike
from scipy.linalg import LinAlgError, cholesky_banded, lapack

from bench.maths.arrays import Flags, Floats
from bench.model.errors import FitError

_PARABOLIC = "omega"
_WHITE = {False: 1.0, True: 1.2}  # mean square of the weight over a gate: flat, parabola
_WALK = {False: 1.0 / 3.0, True: 13.0 / 35.0}  # variance of the mean of a walk over a gate, in gates
_LONGEST_s = 300.0  # a gap that any chamber bridges: readings come once a minute
_SLOPE_s = 900.0  # stretch on either side from which the slopes are taken
_WORST_degC = 0.3
_MEMORY_s = 10_800.0


@dataclass(frozen=True)
class Whitener:
    """V^-1/2 of a series of m readings: the inverse of the lower Cholesky factor of V, never formed.

    ``factor``: lower diagonals (3, m) of the Cholesky factor of the covariance of [y_0, y_1 - y_0, ...].
    """

    factor: Floats

    def whiten(self, x: Floats) -> Floats:
        """V^-1/2 x for x of (m,) or (m, p), in the unit of x over that of the readings; linear in x."""
        steps = np.diff(x, axis=0, prepend=np.zeros_like(x[:1]))
        white, _ = lapack.dtbtrs(self.factor, steps, uplo="L")
        return np.asarray(white, dtype=np.float64).reshape(x.shape)

    def turn(self, x: Floats) -> Floats:
        """Transpose of V^-1/2 times x, (m, p): ``turn(w).T @ y`` is ``w.T @ whiten(y)``."""
        back, _ = lapack.dtbtrs(self.factor, x, uplo="L", trans="T")
        return np.asarray(-np.diff(back, axis=0, append=np.zeros_like(x[:1])))


def series_covariance(
    estimator: ArrayLike,
    times_s: Floats,
    gate_s: ArrayLike,
    q_C: ArrayLike,
    white_A_rtHz: float,
    walk_A_rth: float,
    contiguous: ArrayLike = True,
) -> Whitener:
    """Covariance of the readings of one channel: quantisation, white noise and a random walk from the first gate on.

    Args:    estimator: name of each, "gated", "omega" or "reciprocal", (m,) or one for all. The quantisation of
             "omega" is independent from reading to reading, that of the others telescopes where contiguous.
             times_s: middle of each averaging interval, (m,), rising, any origin.   gate_s: its length, (m,) or one.
             q_C: effective quantum, (m,) or one: the variance of the quantisation is (q / gate)^2 / 6; K_0 for a
             gated count, |current| times frame for a reciprocal; ``RecordRates.quantum_C`` holds it for all three.
             white_A_rtHz: one-sided density.   walk_A_rth: standard deviation of the walk after one hour.
             contiguous: True where a reading begins with the very cut that ended the one before it, (m,) or one for
             all; the first one of the series counts as False. Missing readings are left out: a gap is seen in times.
    Returns: Whitener: ``whiten(x)`` for (m,) or (m, p).
    Raises:  FitError B-FIT-025 if the times do not rise or a gate is not positive; B-FIT-002 if nothing is uncertain.
    Source:  see the module.
    """
    times = np.asarray(times_s, dtype=np.float64)
    gate, quantum, joined, parabolic = (
        np.broadcast_to(column, times.shape)
        for column in (
            np.asarray(gate_s, dtype=np.float64),
            np.asarray(q_C, dtype=np.float64),
            np.asarray(contiguous, dtype=np.bool_),
            np.asarray(estimator) == _PARABOLIC,
        )
    )
    _check(times, gate)
    linked = joined[1:] & ~parabolic[1:] & ~parabolic[:-1]
    band = _quantisation_and_white(gate, quantum, linked, white_A_rtHz * np.sqrt(_choose(_WHITE, parabolic)))
    band += _walk(times, gate, _choose(_WALK, parabolic), walk_A_rth**2 / 3600.0)
    return Whitener(_factor(band))


def _choose(by_shape: dict[bool, float], parabolic: Flags) -> Floats:
    return np.where(parabolic, by_shape[True], by_shape[False])


def _quantisation_and_white(gate_s: Floats, quantum_C: Floats, linked: Flags, white_A_rtHz: Floats) -> Floats:
    """Band of the differences of readings whose own covariance has a diagonal and one neighbour on each side."""
    edge = quantum_C / gate_s / np.sqrt(12.0)
    own = 2.0 * edge**2 + white_A_rtHz**2 / (2.0 * gate_s)
    beside = -edge[1:] * edge[:-1] * linked
    band = np.zeros((3, own.size))
    band[0] = own
    band[0, 1:] += own[:-1] - 2.0 * beside
    band[1, :-1] = beside - own[:-1]
    band[1, 1:-1] += beside[:-1]
    band[2, :-2] = -beside[:-1]
    # second differences: cov(y_k+2 - y_k+1, y_k - y_k-1) = -cov(y_k+1, y_k)
    return band


def _walk(times_s: Floats, gate_s: Floats, inside: Floats, rate_A2_s: float) -> Floats:
    """Band of the differences of gate means of a walk: what is left of the gate before, the gap, and the own part."""
    gap_s = np.maximum(np.diff(times_s) - (gate_s[1:] + gate_s[:-1]) / 2.0, 0.0)
    own = inside * gate_s
    rest = own  # variance of (whole increment - mean): L - 2 L / 2 + inside L
    band = np.zeros((3, times_s.size))
    band[0] = own
    band[0, 1:] += gap_s + rest[:-1]
    band[1, :-1] = gate_s[:-1] / 2.0 - own[:-1]
    return rate_A2_s * band


def _check(times_s: Floats, gate_s: Floats) -> None:
    if not (np.all(np.diff(times_s) > 0) and np.all(gate_s > 0)):
        raise FitError(
            "B-FIT-025",
            f"the {times_s.size} readings of a series are not in order of time, or one of them has no length",
            next_step="sort the records by their counter and leave those without a gate out",
        )


def _factor(band: Floats) -> Floats:
    try:
        return np.asarray(cholesky_banded(band, lower=True), dtype=np.float64)
    except (LinAlgError, ValueError):
        raise FitError(
            "B-FIT-002",
            "the covariance of the readings is not positive definite",
            next_step="check the uncertainties in the standards register and the converter noise of the campaign",
        ) from None


@dataclass(frozen=True)
class Drive:
    """A temperature that drives the unit, joined by straight lines; outside its times it keeps its end values.

    ``start_degC``: temperature of the unit at the first time, None = that of the drive (they are in equilibrium).
    """

    t_s: Floats  # (k,), strictly rising
    degC: Floats  # (k,)
    start_degC: float | None = None


def usable_drive(t_s: Floats, degC: Floats, start_degC: float | None = None) -> Drive:
    """A drive from readings, some of which may be missing (NaN) or come twice.

    Args:    t_s, degC: (k,), in any order.   start_degC: see Drive.
    Raises:  FitError B-FIT-020 if fewer than two readings are left.
    Source:  see the module.
    """
    known = np.isfinite(t_s) & np.isfinite(degC)
    times, index = np.unique(t_s[known], return_index=True)
    if times.size < 2:
        raise FitError(
            "B-FIT-020",
            f"{times.size} usable temperatures of the drive; a thermal lag needs a series",
            next_step="check that the environment log of the session holds the temperature asked for, or use "
            "the other drive (method joint or joint_unit_sensor)",
        )
    return Drive(times, degC[known][index], start_degC)


def lagged(t_s: Floats, drive_degC: Floats, lag_s: float, start_degC: float | None = None) -> Floats:
    """Return temperature of the unit at the times of the drive, exact for straight lines between them.

    Args:    t_s, drive_degC: (k,), times rising, second.   lag_s: first-order lag, 0 = none, second.
             start_degC: temperature of the unit at the first time, None = that of the drive.
    Returns: (k,), degC.
    Source:  T1 = a T0 + u1 - a u0 - s lag (1 - a) with a = exp(-dt / lag), slope s; the solution of the heat balance.
    """
    first = float(drive_degC[0]) if start_degC is None else start_degC
    if lag_s <= 0:
        return np.concatenate(([first], drive_degC[1:]))
    step_s = np.diff(t_s)
    gone = -np.expm1(-step_s / lag_s)  # 1 - a, keeps its digits for a short step
    rise = np.diff(drive_degC)
    pull = gone * drive_degC[:-1] + rise * (1.0 - gone * lag_s / step_s)
    band = np.ones((2, t_s.size), order="F")  # T1 - a T0 = pull, a triangle of two diagonals
    band[1, :-1] = gone - 1.0
    unit, _ = lapack.dtbtrs(band, np.concatenate(([first], pull))[:, None], uplo="L", diag="U")
    return np.asarray(unit[:, 0])


def lagged_means(t_s: Floats, drive_degC: Floats, unit_degC: Floats, lag_s: float) -> Floats:
    """Return mean of the unit's temperature between neighbouring times, (k - 1,), exact.

    Args:    as for ``lagged``; unit_degC: its answer.
    Source:  the heat balance integrated: mean(T) = mean(u) - lag (T1 - T0) / dt.
    """
    mean = (drive_degC[:-1] + drive_degC[1:]) / 2.0
    return np.asarray(mean - lag_s * np.diff(unit_degC) / np.diff(t_s)) if lag_s > 0 else np.asarray(mean)


def require_known(drive: Drive, from_s: float) -> Drive:
    """The drive itself, if no gap of its readings can hide a corner of the temperature.

    Args:    drive: readings, joined by straight lines.   from_s: start of what is fitted; a gap that ended
             3 h before it does not count, the unit has forgotten it.
    Raises:  FitError B-FIT-024 naming the gap, if the readings before and after it do not lie on its chord within
             0.3 degC: lag and hysteresis of the time after it would rest on an invented temperature.
    Source:  see the module.
    """
    for k in np.flatnonzero(np.diff(drive.t_s) > _LONGEST_s):
        if drive.t_s[k + 1] > from_s - _MEMORY_s and hidden_degC(drive, int(k)) > _WORST_degC:
            raise FitError(
                "B-FIT-024",
                f"the temperature that drives the unit is unknown from {drive.t_s[k] - from_s:.0f} s to "
                f"{drive.t_s[k + 1] - from_s:.0f} s of the campaign, and it turned there",
                next_step="use the other drive (method joint or joint_unit_sensor), or take the ramp again",
            )
    return drive


def hidden_degC(drive: Drive, k: int) -> float:
    """Return how far the drive may have been from the chord between its readings k and k + 1, degC.

    Source: see the module; a and b follow from how far each side's line misses the other end of the gap.
    """
    t_s, degC = drive.t_s, drive.degC
    gap_s = float(t_s[k + 1] - t_s[k])
    before = (t_s <= t_s[k]) & (t_s >= t_s[k] - _SLOPE_s)
    after = (t_s >= t_s[k + 1]) & (t_s <= t_s[k + 1] + _SLOPE_s)
    rise_degC = float(degC[k + 1] - degC[k])
    misses = [abs(rise_degC - gap_s * _slope(t_s[part], degC[part])) for part in (before, after)]
    return misses[0] * misses[1] / max(sum(misses), 1e-12)


def _slope(t_s: Floats, degC: Floats) -> float:
    if t_s.size < 2:
        return 0.0
    centred = t_s - t_s.mean()
    return float(centred @ degC / (centred @ centred))
