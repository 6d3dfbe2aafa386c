"""Drift between rests: bias and level from one rest, strapdown through the motion, level and standstill at the next.

Source: Tedaldi, Pretto and Menegatti, ICRA 2014, section III, for gravity that is carried from rest to rest; zero
velocity at a rest: Groves, Principles of GNSS, Inertial, and Multisensor Integrated Navigation Systems, section 15.3.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from itertools import pairwise

import numpy as np
from numpy.typing import NDArray

from bench.systems.gnc.estimators.rest_drift.between_rests import carried, side_by_side
from bench.systems.gnc.estimators.rest_drift.fit import LATITUDE_deg, run_from_rest
from bench.systems.gnc.estimators.static_intervals import StaticIntervals

Array = NDArray[np.float64]
_TILTED_deg = 20.0  # a turn that tips gravity by less says little of the size of the turn
_SEARCH = (0.25, 4.0)


@dataclass(frozen=True)
class BetweenRests:
    """One row per motion between two rests that no gap interrupts.

    ``rest`` (k,): number of the rest before.   ``bias_s``, ``motion_s`` (k,): length of that rest and of the motion.
    ``tilted_deg`` (k,): angle between both levels in the body.   ``level_error_deg`` (k,): between the level carried on
    and that measured.   ``velocity_error_m_s`` (k, 3): at the begin of the next rest, where it is zero in truth.
    """

    rest: NDArray[np.int64]
    bias_s: Array
    motion_s: Array
    tilted_deg: Array
    level_error_deg: Array
    velocity_error_m_s: Array

    @property
    def level_rms_deg(self) -> float:
        """Root mean square over the motions."""
        return float(np.sqrt(np.mean(self.level_error_deg**2)))

    @property
    def velocity_rms_m_s(self) -> float:
        """Root mean square of the length over the motions."""
        return float(np.sqrt(np.mean(np.sum(self.velocity_error_m_s**2, axis=1))))


def drift_between_rests(
    accel: Array,
    gyro_rad_s: Array,
    rests: StaticIntervals,
    rate_Hz: float,
    breaks: NDArray[np.int64],
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
    begin, end = rests.begin.tolist(), rests.end.tolist()
    calm = [(begin[k], end[k]) for k in pairs]
    moving = [(end[k], begin[k + 1]) for k in pairs]
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
    residual_deg: float


def turn_scale(accel: Array, gyro: Array, rests: StaticIntervals, rate_Hz: float) -> TurnScale | None:
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
    spans = list(pairwise(zip(rests.begin.tolist(), rests.end.tolist(), strict=True)))
    turned = [(gyro[spans[k][0][1] : spans[k][1][0]] - 0.5 * (rest[k] + rest[k + 1])) / rate_Hz for k in chosen]
    lengths = np.array([np.linalg.norm(one, axis=1).sum() for one in turned])
    rough = float(np.median(tilted[chosen] / lengths))  # a path is never shorter than the tilt: true scale is larger
    increments = side_by_side(turned) * rough

    def misses(scale: float) -> Array:
        return np.asarray((carried(increments * scale, unit[chosen]) - unit[chosen + 1]).ravel())

    ladder = np.geomspace(*_SEARCH, 60)
    best = float(ladder[np.argmin([misses(one) @ misses(one) for one in ladder])])
    found = optimize.least_squares(lambda x: misses(float(x[0])), [best], x_scale=0.1)
    slope, square = float(np.linalg.norm(found.jac)), float(found.fun @ found.fun)
    dof = 2 * len(chosen) - 1  # a direction has two free components
    std = math.sqrt(square / dof) / slope
    residual_deg = math.degrees(math.sqrt(square / len(chosen)))
    return TurnScale(rough * float(found.x[0]), rough * std, len(chosen), residual_deg)


def _pairs(rests: StaticIntervals, breaks: NDArray[np.int64]) -> list[int]:
    """Rests behind which another one follows without a gap."""
    spans = zip(rests.end[:-1], rests.begin[1:], strict=True)
    return [k for k, (a, b) in enumerate(spans) if not np.any((breaks >= a) & (breaks <= b))]


def _directions(accel: Array, rests: StaticIntervals) -> Array:
    means = rests.means(accel)
    return np.asarray(means / np.linalg.norm(means, axis=1)[:, None])


def _angles_deg(one: Array, other: Array) -> Array:
    """(k,) between vectors of any length."""
    across = np.linalg.norm(np.cross(one, other), axis=1)
    return np.asarray(np.degrees(np.arctan2(across, np.sum(one * other, axis=1))))
