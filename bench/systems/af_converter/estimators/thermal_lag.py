"""First-order thermal lag of a unit behind the air around it, exact for air measured now and then.

Source: heat balance of one thermal mass, lag dT/dt = air - T; closed form for a drive that is a straight line.
"""

from __future__ import annotations

from dataclasses import dataclass
from itertools import accumulate

import numpy as np
from numpy.typing import NDArray

from bench.model.errors import FitError

Array = NDArray[np.float64]


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
    parts = zip((1.0 - gone).tolist(), pull.tolist(), strict=True)
    unit = accumulate(parts, lambda before, part: part[0] * before + part[1], initial=first)
    return np.fromiter(unit, np.float64, t_s.size)


def lagged_means(t_s: Array, drive_degC: Array, unit_degC: Array, lag_s: float) -> Array:
    """Return mean of the unit's temperature between neighbouring times, (k - 1,), exact.

    Args:    as for ``lagged``; unit_degC: its answer.
    Source:  the heat balance integrated: mean(T) = mean(u) - lag (T1 - T0) / dt.
    """
    mean = (drive_degC[:-1] + drive_degC[1:]) / 2.0
    return np.asarray(mean - lag_s * np.diff(unit_degC) / np.diff(t_s)) if lag_s > 0 else np.asarray(mean)
