"""First-order thermal lag of a unit behind the air around it, exact for air measured now and then.

Source: heat balance of one thermal mass, lag dT/dt = air - T; closed form for a drive that is a straight line. What
a gap in the readings of the drive can hide is geometry: between two straight stretches joined by one corner at a
distance a behind the first and b before the second, the chord misses the corner by ds * a * b / (a + b), ds the change
of slope.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.linalg import lapack

from bench.model.errors import FitError

Array = NDArray[np.float64]

_LONGEST_s = 300.0  # a gap that any chamber bridges: readings come once a minute
_SLOPE_s = 900.0  # stretch on either side from which the slopes are taken
_WORST_degC = 0.3
_MEMORY_s = 10_800.0


@dataclass(frozen=True)
class Drive:
    """A temperature that drives the unit, joined by straight lines; outside its times it keeps its end values.

    ``start_degC``: temperature of the unit at the first time, None = that of the drive (they are in equilibrium).
    """

    t_s: Array  # (k,), strictly rising
    degC: Array  # (k,)
    start_degC: float | None = None


def usable_drive(t_s: Array, degC: Array, start_degC: float | None = None) -> Drive:
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


def lagged(t_s: Array, drive_degC: Array, lag_s: float, start_degC: float | None = None) -> Array:
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


def lagged_means(t_s: Array, drive_degC: Array, unit_degC: Array, lag_s: float) -> Array:
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


def _slope(t_s: Array, degC: Array) -> float:
    if t_s.size < 2:
        return 0.0
    centred = t_s - t_s.mean()
    return float(centred @ degC / (centred @ centred))
