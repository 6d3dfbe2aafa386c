"""Length of a soak by the thermal lag of the unit, in place of one slot for all steps of temperature."""

from __future__ import annotations

import math

WHOLE_s = 60.0  # a slot is a whole number of minutes


def slot_s(step_degC: float, ramp_degC_min: float, within_degC: float, for_s: float, lag_s: float) -> float:
    """Return the slot after which a unit has been inside the band for as long as it must, second.

    Args:    step_degC: from the temperature before to the target.   ramp_degC_min: of the set-point.   within_degC,
             for_s: half-width of the band, and how long the unit must be in it.   lag_s: of the unit behind the
             set-point.
    Source:  first-order lag behind a ramp: it trails by rate times lag, and what is left decays with the lag.
    """
    ramp_s = 60.0 * abs(step_degC) / ramp_degC_min
    behind_degC = ramp_degC_min / 60.0 * lag_s * -math.expm1(-ramp_s / lag_s)
    settled_s = lag_s * math.log(max(behind_degC / within_degC, 1.0))
    return WHOLE_s * math.ceil((ramp_s + settled_s + for_s) / WHOLE_s)
