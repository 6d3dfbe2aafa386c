"""Whether the temperature that drives a unit is known well enough where its readings have a gap.

Source: geometry. Between two straight stretches joined by one corner at a distance a behind the first and b before the
second, the chord misses the corner by ds * a * b / (a + b), ds the change of slope.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from bench.model.errors import FitError
from bench.systems.af_converter.estimators.thermal_lag import Drive

Array = NDArray[np.float64]

LONGEST_s = 300.0  # a gap that any chamber bridges: readings come once a minute
_SLOPE_s = 900.0  # stretch on either side from which the slopes are taken
_WORST_degC = 0.3
_MEMORY_s = 10_800.0


def require_known(drive: Drive, from_s: float) -> Drive:
    """The drive itself, if no gap of its readings can hide a corner of the temperature.

    Args:    drive: readings, joined by straight lines.   from_s: start of what is fitted; a gap that ended
             3 h before it does not count, the unit has forgotten it.
    Raises:  FitError B-FIT-024 naming the gap, if the readings before and after it do not lie on its chord within
             0.3 degC: lag and hysteresis of the time after it would rest on an invented temperature.
    Source:  see the module.
    """
    for k in np.flatnonzero(np.diff(drive.t_s) > LONGEST_s):
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
