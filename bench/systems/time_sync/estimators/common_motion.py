"""Time offset between two streams that saw one motion, from the motion alone: no model of the vehicle, no noise stated.

Both signals are laid over each other at the shift of the largest correlation; from there shift, scale and zero of each
signal follow by least squares, the first stream as a cubic spline. Before, both are smoothed alike, over an eighth of
the width of the correlation: that moves neither, and keeps noise out of the slope that the shift is found by. What is
left hangs together in time, so the covariance comes from blocks of the recording that pull by themselves. In half of a
recording few blocks hold motion, and such a covariance is too small by chance: there what is left of the whole tells it
too, by its autocovariance, and the larger one counts.

Source: Knapp and Carter, IEEE Trans. ASSP 24 (1976) 320 (delay by the largest correlation); Liang and Zeger, Biometrika
73 (1986) 13 (covariance by blocks), times B / (B - 1); Hannan, Multiple Time Series (1970), ch. VII (of least squares
with stationary noise).
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy import interpolate, ndimage

from bench.maths.arrays import Floats, Integers
from bench.model.errors import FitError

BLOCKS = 20
LEAST_CORRELATION = 0.5
_FEWEST = 10 * BLOCKS  # samples that overlap
_SHARE = 0.5  # of the shorter stream: how far the search shifts
_STEPS, _SETTLED = 25, 1e-9  # of the fit; of the interval between samples
_SMOOTHED = 8.0  # parts of the half width of the correlation: the Gaussian that both signals are smoothed by
_REACH = 4.0  # standard deviations of it
_APART = 3.0  # widths of the peak at which another one is looked for


@dataclass(frozen=True)
class CommonMotion:
    """Offset of one stream's clock: stamps of ``one`` minus those of ``other``, positive = ``one`` is ahead.

    Attributes:
        offset_s: and ``std_s``, with ``dof`` degrees of freedom: whole recording.   correlation: at the offset.
        rival: largest correlation at another shift, over that at the offset.   rival_s: its shift.
        halves_s, halves_std_s: (2,) of the first and the second half.   samples: that were compared.
        t_s: (n,) stamps of ``other``, even; motion_one, motion_other: (n, k) over each other; left: (n, k) residuals.
    """

    offset_s: float
    std_s: float
    dof: int
    correlation: float
    rival: float
    rival_s: float
    halves_s: Floats
    halves_std_s: Floats
    samples: int
    t_s: Floats
    motion_one: Floats
    motion_other: Floats

    @property
    def left(self) -> Floats:
        """What the common motion leaves, (n, k), unit of the signals."""
        return self.motion_other - self.motion_one


def common_motion(one_s: Floats, one: Floats, other_s: Floats, other: Floats) -> CommonMotion:
    """Return the offset at which two streams show one motion.

    Args:    one_s: stamps, (n,), rising.   one: signals, (n, k), any unit.   other_s, other: (m,), (m, k), the same
             signals of the other stream, in the same units or up to a factor.
    Returns: CommonMotion.
    Raises:  FitError B-SYNC-012 if the streams hardly overlap, a signal stands still, or no shift makes them alike.
    Source:  see the head of this file.
    """
    if min(one_s.size, other_s.size) < _FEWEST or not min(np.ptp(one).item(), np.ptp(other).item()) > 0.0:
        raise _alone(f"{one_s.size} and {other_s.size} samples, {_FEWEST} that move are the least of each stream")
    step_s = float(min(np.median(np.diff(one_s)), np.median(np.diff(other_s))))
    peak = _search(step_s, *_even(one_s, one, step_s), *_even(other_s, other, step_s))
    if peak.correlation < LEAST_CORRELATION:
        raise _alone(
            f"the signals are alike to {peak.correlation:.2f} at the best shift of {peak.shift_s:.3g} s, "
            f"{LEAST_CORRELATION:g} is the least"
        )
    wide = max(peak.width / _SMOOTHED, 1.0)
    (grid_s, a), (t_s, b) = (_even(at_s, signal, step_s, wide) for at_s, signal in ((one_s, one), (other_s, other)))
    spline = interpolate.CubicSpline(grid_s, a)
    inside = (t_s + peak.shift_s > grid_s[0]) & (t_s + peak.shift_s < grid_s[-1])
    t_s, seen = t_s[inside], b[inside]
    whole = _fit(spline, t_s, seen, peak.shift_s)
    middle = t_s.size // 2
    halves = [_fit(spline, t_s[part], seen[part], whole.shift_s) for part in (slice(0, middle), slice(middle, None))]
    left = seen - whole.scaled
    return CommonMotion(
        offset_s=whole.shift_s,
        std_s=whole.std_s,
        dof=BLOCKS - 1,
        correlation=peak.correlation,
        rival=peak.rival,
        rival_s=peak.rival_s,
        halves_s=np.array([half.shift_s for half in halves]),
        halves_std_s=np.array([max(half.std_s, _std_by_noise(half.columns, left)) for half in halves]),
        samples=t_s.size,
        t_s=t_s,
        motion_one=whole.scaled,
        motion_other=seen,
    )


@dataclass(frozen=True)
class _Peak:
    """Largest correlation: its shift, its half width in samples, and the next peak relative to it."""

    shift_s: float
    correlation: float
    width: int
    rival: float
    rival_s: float


def _even(at_s: Floats, signal: Floats, step_s: float, wide: float = 0.0) -> tuple[Floats, Floats]:
    """Return a signal (n, k) at even times, smoothed by a Gaussian of so many steps; what its ends touch is cut off."""
    grid_s = np.arange(at_s[0], at_s[-1], step_s)
    values = np.stack([np.interp(grid_s, at_s, column) for column in signal.T], axis=1)
    if wide == 0.0:
        return grid_s, values
    ends = slice(round(_REACH * wide), -round(_REACH * wide))
    return grid_s[ends], np.asarray(ndimage.gaussian_filter1d(values, wide, axis=0, truncate=_REACH))[ends]


def _search(step_s: float, one_s: Floats, one: Floats, other_s: Floats, other: Floats) -> _Peak:
    """Return the shift of the largest correlation of two streams at even times, step_s apart."""
    least = max(_FEWEST, round(_SHARE * min(one_s.size, other_s.size)))
    lags = np.arange(least - other_s.size, one_s.size - least + 1)
    alike = np.mean([_correlations(x, y, lags) for x, y in zip(one.T, other.T, strict=True)], axis=0)
    best = int(np.argmax(alike))
    shifts_s = lags * step_s + one_s[0] - other_s[0]
    low = np.flatnonzero(alike < 0.5 * alike[best])
    width = int(np.abs(low - best).min()) if low.size else lags.size // _FEWEST
    apart = np.abs(np.arange(lags.size) - best) > _APART * width
    second = int(np.argmax(np.where(apart, alike, -1.0)))
    rival = float(alike[second] / alike[best]) if apart.any() else 0.0
    return _Peak(float(shifts_s[best]), float(alike[best]), width, rival, float(shifts_s[second]))


def _correlations(a: Floats, b: Floats, lags: Integers) -> Floats:
    """Return correlation coefficients of a[k + lag] and b[k] over the part in which both are, by lag."""
    size = 1 << int(a.size + b.size).bit_length()
    one, other = np.ones(a.size), np.ones(b.size)
    a, b = a - a.mean(), b - b.mean()

    def product(x: Floats, y: Floats) -> Floats:
        return np.fft.irfft(np.fft.rfft(x, size) * np.conj(np.fft.rfft(y, size)), size)[lags]

    count = np.rint(product(one, other))
    sums = product(a, other), product(one, b)
    cross = product(a, b) - sums[0] * sums[1] / count
    squares = (product(a * a, other) - sums[0] ** 2 / count) * (product(one, b * b) - sums[1] ** 2 / count)
    return cross / np.sqrt(np.maximum(squares, np.finfo(float).tiny))


@dataclass(frozen=True)
class _Fit:
    """Shift, its uncertainty by blocks; the first stream scaled to the second one, (n, k); ``columns``: (n k, p)."""

    shift_s: float
    std_s: float
    scaled: Floats
    columns: Floats


def _fit(spline: interpolate.CubicSpline, t_s: Floats, seen: Floats, shift_s: float) -> _Fit:
    n, k = seen.shape
    slope = spline.derivative()
    settled_s = _SETTLED * float(np.median(np.diff(t_s)))
    for _ in range(_STEPS):
        model, rate = spline(t_s + shift_s), slope(t_s + shift_s)
        factors = [
            np.linalg.lstsq(np.column_stack((model[:, i], np.ones(n))), seen[:, i], rcond=None)[0] for i in range(k)
        ]
        scaled = np.column_stack([model[:, i] * factors[i][0] + factors[i][1] for i in range(k)])
        columns = _columns(model, rate, np.array([factor[0] for factor in factors]))
        residual = (seen - scaled).T.ravel()
        step_s = float(np.linalg.lstsq(columns, residual, rcond=None)[0][0])
        shift_s += step_s
        if abs(step_s) < settled_s:
            break
    block = np.tile(np.minimum(np.arange(n) * BLOCKS // n, BLOCKS - 1), k)
    pulls = np.stack([columns[block == b].T @ residual[block == b] for b in range(BLOCKS)])
    inverse = np.linalg.pinv(columns.T @ columns)
    covariance = inverse @ (pulls.T @ pulls) @ inverse * BLOCKS / (BLOCKS - 1)
    return _Fit(shift_s, float(np.sqrt(covariance[0, 0])), scaled, columns)


def _std_by_noise(columns: Floats, left: Floats) -> float:
    """Return the standard uncertainty of the shift if what is left, (m, k), hangs together alike at all times.

    ``columns``: derivatives of a fit to n of the m samples, (n k, p), the shift first.
    """
    m, k = left.shape
    size = 1 << int(2 * m).bit_length()
    spectrum = np.abs(np.fft.rfft(left - left.mean(axis=0), size, axis=0)) ** 2 / m
    covariance, inverse = np.zeros((columns.shape[1],) * 2), np.linalg.pinv(columns.T @ columns)
    for i, part in enumerate(np.split(columns, k)):
        seen = np.fft.rfft(part, size, axis=0)
        together = np.fft.irfft(spectrum[:, [i]] * seen, size, axis=0)[: len(part)]
        covariance += part.T @ together
    return float(np.sqrt((inverse @ covariance @ inverse)[0, 0]))


def _columns(model: Floats, rate: Floats, factor: Floats) -> Floats:
    """Return derivatives by the shift, then by scale and zero of each signal, (n k, 1 + 2 k)."""
    n, k = model.shape
    columns = np.zeros((n * k, 1 + 2 * k))
    for i in range(k):
        rows = slice(i * n, (i + 1) * n)
        columns[rows, 0] = factor[i] * rate[:, i]
        columns[rows, 1 + 2 * i] = model[:, i]
        columns[rows, 2 + 2 * i] = 1.0
    return columns


def _alone(why: str) -> FitError:
    return FitError(
        "B-SYNC-012",
        f"the streams show no motion that both saw: {why}",
        next_step="map the same signal of both units, such as a rate of turn; record a manoeuvre of both",
    )
