"""Covariance of a series of readings of one channel, as a whitening that costs a few operations per reading.

Gates that follow each other cut the same charge: what the first misses the second has, so their quantisation errors
telescope, e_k = (rho_(k+1) - rho_k) / t, with the variance (q / t)^2 / 6 and the lag-1 correlation -1/2. White noise
is independent from gate to gate, the random walk of the bias adds up over the whole series. Differences of
neighbouring readings depend on nothing farther than two gates away, so their covariance has five diagonals.
Source: docs/decisions/0004 (quantisation, white noise, random walk); Golub and Van Loan, Matrix Computations,
section 4.3 (banded Cholesky factor).
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy.linalg import LinAlgError, cholesky_banded, lapack

from bench.model.errors import FitError

Array = NDArray[np.float64]
_PARABOLIC = "omega"
_WHITE = {False: 1.0, True: 1.2}  # mean square of the weight over a gate: flat, parabola
_WALK = {False: 1.0 / 3.0, True: 13.0 / 35.0}  # variance of the mean of a walk over a gate, in gates


@dataclass(frozen=True)
class Whitener:
    """V^-1/2 of a series of m readings: the inverse of the lower Cholesky factor of V, never formed.

    ``factor``: lower diagonals (3, m) of the Cholesky factor of the covariance of [y_0, y_1 - y_0, ...].
    """

    factor: Array

    def whiten(self, x: Array) -> Array:
        """V^-1/2 x for x of (m,) or (m, p), in the unit of x over that of the readings; linear in x."""
        steps = np.diff(x, axis=0, prepend=np.zeros_like(x[:1]))
        white, _ = lapack.dtbtrs(self.factor, steps, uplo="L")
        return np.asarray(white, dtype=np.float64).reshape(x.shape)


def series_covariance(
    estimator: ArrayLike,
    times_s: Array,
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


def _choose(by_shape: dict[bool, float], parabolic: NDArray[np.bool_]) -> Array:
    return np.where(parabolic, by_shape[True], by_shape[False])


def _quantisation_and_white(gate_s: Array, quantum_C: Array, linked: NDArray[np.bool_], white_A_rtHz: Array) -> Array:
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


def _walk(times_s: Array, gate_s: Array, inside: Array, rate_A2_s: float) -> Array:
    """Band of the differences of gate means of a walk: what is left of the gate before, the gap, and the own part."""
    gap_s = np.maximum(np.diff(times_s) - (gate_s[1:] + gate_s[:-1]) / 2.0, 0.0)
    own = inside * gate_s
    rest = own  # variance of (whole increment - mean): L - 2 L / 2 + inside L
    band = np.zeros((3, times_s.size))
    band[0] = own
    band[0, 1:] += gap_s + rest[:-1]
    band[1, :-1] = gate_s[:-1] / 2.0 - own[:-1]
    return rate_A2_s * band


def _check(times_s: Array, gate_s: Array) -> None:
    if not (np.all(np.diff(times_s) > 0) and np.all(gate_s > 0)):
        raise FitError(
            "B-FIT-025",
            f"the {times_s.size} readings of a series are not in order of time, or one of them has no length",
            next_step="sort the records by their counter and leave those without a gate out",
        )


def _factor(band: Array) -> Array:
    try:
        return np.asarray(cholesky_banded(band, lower=True), dtype=np.float64)
    except (LinAlgError, ValueError):
        raise FitError(
            "B-FIT-002",
            "the covariance of the readings is not positive definite",
            next_step="check the uncertainties in the standards register and the converter noise of the campaign",
        ) from None
