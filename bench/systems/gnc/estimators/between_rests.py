"""From rest to rest: drift of an inertial unit, and its gyroscope triad fitted without a table.

Drift: bias and level from one rest, strapdown through the motion, level and standstill at the next.

Fit: between two rests the gyroscopes must turn gravity from one pose into the next. The nine elements of K come from
the turns; the output at no turn is, for each of them, the mean of the two rests around it. The published method takes
that of the first rest for all, but the zero of such sensors depends on the pose: on the recording published with the
method the residual angle is 0.94 degrees here and 1.31 degrees with the first rest alone. The frame is that of the
accelerometers.

Source: Tedaldi, Pretto and Menegatti, ICRA 2014, section III (equation (13)), for gravity that is carried from rest to
rest; zero velocity at a rest: Groves, Principles of GNSS, Inertial, and Multisensor Integrated Navigation Systems,
section 15.3.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from itertools import pairwise

import numpy as np

from bench.maths.arrays import Floats, Integers, rms
from bench.model.errors import FitError
from bench.systems.gnc.estimators.rest_drift import LATITUDE_deg, run_from_rest
from bench.systems.gnc.estimators.static_intervals import StaticIntervals

_TILTED_deg = 20.0  # a turn that tips gravity by less says little of the size of the turn
_SEARCH = (0.25, 4.0)
_LEAST_TURNS = 8
_CONDITION_LIMIT = 30.0
_TRIALS = 120  # 12 steps: from a rough scale within a few per cent it takes 5
_LARGEST_DEG = 10.0  # beyond it the search has ended elsewhere


@dataclass(frozen=True)
class BetweenRests:
    """One row per motion between two rests that no gap interrupts.

    ``rest`` (k,): number of the rest before.   ``bias_s``, ``motion_s`` (k,): length of that rest and of the motion.
    ``tilted_deg`` (k,): angle between both levels in the body.   ``level_error_deg`` (k,): between the level carried on
    and that measured.   ``velocity_error_m_s`` (k, 3): at the begin of the next rest, where it is zero in truth.
    """

    rest: Integers
    bias_s: Floats
    motion_s: Floats
    tilted_deg: Floats
    level_error_deg: Floats
    velocity_error_m_s: Floats

    @property
    def level_rms_deg(self) -> float:
        """Root mean square over the motions."""
        return rms(self.level_error_deg)

    @property
    def velocity_rms_m_s(self) -> float:
        """Root mean square of the length over the motions."""
        return float(np.sqrt(np.mean(np.sum(self.velocity_error_m_s**2, axis=1))))


def drift_between_rests(
    accel: Floats,
    gyro_rad_s: Floats,
    rests: StaticIntervals,
    rate_Hz: float,
    breaks: Integers,
    latitude_deg: float = LATITUDE_deg,
) -> BetweenRests | None:
    """Strapdown from every rest through the motion to the next one.

    Args:    accel: (n, 3) any unit.   gyro_rad_s: (n, 3).   rests, rate_Hz: as found.   breaks: samples in front of
             which others are missing; a motion across one is left out.   latitude_deg: of the site.
    Returns: BetweenRests; None if no motion is left.
    Source:  see the head of this file.
    """
    pairs = _pairs(rests, breaks)
    if not pairs:
        return None
    spans = rests.spans
    calm = [spans[k] for k in pairs]
    moving = [(spans[k][1], spans[k + 1][0]) for k in pairs]
    run = run_from_rest(accel, gyro_rad_s, calm, moving, rate_Hz, latitude_deg)
    unit = _directions(accel, rests)
    before, after = unit[pairs], unit[[k + 1 for k in pairs]]
    up = np.einsum("kij,kj->ki", run.C, after)
    return BetweenRests(
        rest=np.array(pairs),
        bias_s=np.array([b - a for a, b in calm]) / rate_Hz,
        motion_s=np.array([b - a for a, b in moving]) / rate_Hz,
        tilted_deg=_angles_deg(before, after),
        level_error_deg=_angles_deg(up, np.broadcast_to([0.0, 0.0, -1.0], up.shape)),
        velocity_error_m_s=run.v,
    )


@dataclass(frozen=True)
class TurnScale:
    """``scale``: what the angles of all turns have to be multiplied by, so that gravity is carried best; ``std``.

    Near 1 if rate and unit of the log are right; near 2 if the samples came at half the rate that is stated.
    """

    scale: float
    std: float
    turns: int


def turn_scale(accel: Floats, gyro: Floats, rests: StaticIntervals, rate_Hz: float) -> TurnScale | None:
    """Return one factor on all angles, by the level before and behind each motion.

    Args:    accel, gyro: (n, 3), any units; the gyroscopes' factor may be anything.   rests, rate_Hz: as found.
    Returns: TurnScale, degrees per unit of the gyroscopes and second; None with fewer than three motions that tip
             gravity by 20 degrees.
    Source:  see the head of this file.
    """
    from scipy import optimize

    unit = _directions(accel, rests)
    tilted = _angles_deg(unit[:-1], unit[1:])
    chosen = np.flatnonzero(tilted > _TILTED_deg)
    if len(chosen) < 3:
        return None
    rest = rests.means(gyro)
    spans = list(pairwise(rests.spans))
    turned = [(gyro[spans[k][0][1] : spans[k][1][0]] - 0.5 * (rest[k] + rest[k + 1])) / rate_Hz for k in chosen]
    lengths = np.array([np.linalg.norm(path, axis=1).sum() for path in turned])
    rough = float(np.median(tilted[chosen] / lengths))  # a path is never shorter than the tilt: true scale is larger
    increments = side_by_side(turned) * rough

    def misses(scale: float) -> Floats:
        return (carried(increments * scale, unit[chosen]) - unit[chosen + 1]).ravel()

    ladder = np.geomspace(*_SEARCH, 60)
    best = float(ladder[np.argmin([misses(scale) @ misses(scale) for scale in ladder])])
    solution = optimize.least_squares(lambda x: misses(float(x[0])), [best], x_scale=0.1)
    slope, square = float(np.linalg.norm(solution.jac)), float(solution.fun @ solution.fun)
    dof = 2 * len(chosen) - 1  # a direction has two free components
    std = math.sqrt(square / dof) / slope
    return TurnScale(rough * float(solution.x[0]), rough * std, len(chosen))


def _pairs(rests: StaticIntervals, breaks: Integers) -> list[int]:
    """Rests behind which another one follows without a gap."""
    spans = zip(rests.end[:-1], rests.begin[1:], strict=True)
    return [k for k, (a, b) in enumerate(spans) if not np.any((breaks >= a) & (breaks <= b))]


def _directions(accel: Floats, rests: StaticIntervals) -> Floats:
    means = rests.means(accel)
    return np.asarray(means / np.linalg.norm(means, axis=1)[:, None])


def _angles_deg(first: Floats, second: Floats) -> Floats:
    """(k,) between vectors of any length."""
    across = np.linalg.norm(np.cross(first, second), axis=1)
    return np.asarray(np.degrees(np.arctan2(across, np.sum(first * second, axis=1))))


@dataclass(frozen=True)
class BetweenRestsFit:
    """``matrix`` (3, 3): w = K (N - zero), deg/s per indicated unit, in the frame of the accelerometers.
    ``zero`` (3,): mean indicated output of the rests.
    """

    matrix: Floats
    zero: Floats


def fit_between_rests(
    step_s: Floats, gyro: Floats, rests: StaticIntervals, force: Floats, counts_per_deg_s: float
) -> BetweenRestsFit:
    """Fit K to the turns between rests by Levenberg and Marquardt's method.

    Args:    step_s: (n,) time to the sample before.   gyro: (n, 3) indicated.   rests: k intervals.
             force: (k, 3) calibrated specific force of each rest (``NormFit.apply``), any length.
             counts_per_deg_s: rough scale to begin with, within a few per cent.
    Returns: BetweenRestsFit.
    Raises:  FitError B-FIT-085 for fewer than 8 turns or turns that leave an element open; B-FIT-086 if gravity
             carried on is off by more than 10 degrees.
    Source:  Tedaldi et al. 2014, equations (11) to (14).
    """
    unit = force / np.linalg.norm(force, axis=1)[:, None]
    middle = (rests.begin + rests.end) // 2  # rests are integrated too: they turn nothing but the noise
    spans = [slice(int(a), int(b)) for a, b in pairwise(middle)]
    if len(spans) < _LEAST_TURNS:
        raise FitError("B-FIT-085", f"{len(spans)} turns between rests, {_LEAST_TURNS} are needed", next_step=_TURNS)
    rest = rests.means(gyro)
    increments = [
        (gyro[span] - 0.5 * (rest[k] + rest[k + 1])) * step_s[span, None] / counts_per_deg_s
        for k, span in enumerate(spans)
    ]
    return BetweenRestsFit(_search(side_by_side(increments), unit) / counts_per_deg_s, rest.mean(axis=0))


def _search(padded: Floats, unit: Floats) -> Floats:
    """Return K relative to the rough scale, of the smallest sum of squares."""
    from scipy import optimize

    def residual(x: Floats) -> Floats:
        return (carried(padded @ x.reshape(3, 3).T, unit[:-1]) - unit[1:]).ravel()

    solution = optimize.least_squares(
        residual, np.eye(3).ravel(), method="lm", xtol=1e-10, ftol=1e-10, max_nfev=_TRIALS
    )
    rms_deg = float(np.degrees(np.sqrt(solution.fun @ solution.fun / len(padded))))
    if not rms_deg < _LARGEST_DEG:
        raise FitError(
            "B-FIT-086",
            f"gravity carried on between the rests is off by {rms_deg:.3g} deg, limit {_LARGEST_DEG:g} deg",
            next_step="check the rough scale of the gyroscopes, their time stamps and the order of the axes",
        )
    condition = float(np.linalg.cond(solution.jac))
    if not condition < _CONDITION_LIMIT:
        raise FitError(
            "B-FIT-085",
            f"{len(padded)} turns do not determine the matrix: condition {condition:.3g}, limit {_CONDITION_LIMIT:g}",
            next_step=_TURNS,
        )
    return np.asarray(solution.x.reshape(3, 3))


_TURNS = "turn the unit between rests about each axis in both directions, by 90 degrees or so"


def side_by_side(increments: list[Floats]) -> Floats:
    """Stretches of different length as one array.

    Args:    increments: (m_i, 3) each, degrees.
    Returns: (k, m, 3), zeros behind the end of each, m a power of two.
    Source:  none; a turn of zero turns nothing.
    """
    longest = max(len(stretch) for stretch in increments)
    padded = np.zeros((len(increments), 1 << (longest - 1).bit_length(), 3))
    for place, stretch in enumerate(increments):
        padded[place, : len(stretch)] = stretch
    return padded


def carried(increment: Floats, vector: Floats) -> Floats:
    """A vector that stands still, in the body after all increments: product of exp(-[increment x]), last one first.

    Args:    increment: (k, m, 3) degrees, m a power of two.   vector: (k, 3) in the body before.
    Returns: (k, 3) in the body behind.
    Source:  Tedaldi et al. 2014, equation (11), by products of quaternions in pairs.
    """
    turns = _quaternions(-np.radians(increment))
    while turns.shape[1] > 1:
        turns = _product(turns[:, 1::2], turns[:, 0::2])
    scalar, axis = turns[:, 0, :1], turns[:, 0, 1:]
    twice = 2.0 * np.cross(axis, vector)
    return vector + scalar * twice + np.cross(axis, twice)


def _quaternions(rotation: Floats) -> Floats:
    """(..., 4) scalar first, of rotation vectors (..., 3) in radians."""
    half = 0.5 * np.linalg.norm(rotation, axis=-1, keepdims=True)
    return np.concatenate([np.cos(half), 0.5 * rotation * np.sinc(half / np.pi)], axis=-1)


def _product(p: Floats, q: Floats) -> Floats:
    """Hamilton product p q: first q, then p."""
    p0, q0, pv, qv = p[..., :1], q[..., :1], p[..., 1:], q[..., 1:]
    scalar = p0 * q0 - np.sum(pv * qv, axis=-1, keepdims=True)
    cross = pv[..., [1, 2, 0]] * qv[..., [2, 0, 1]] - pv[..., [2, 0, 1]] * qv[..., [1, 2, 0]]  # numpy's takes longer
    return np.concatenate([scalar, p0 * qv + q0 * pv + cross], axis=-1)
