"""Options of the simulated bench of AF converters: the world's own, and those of its unit."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

from sim_instruments.worlds.common.options import any_text

OPTIONS = {
    "calibrator_gain": "common gain error of the calibrator, N(0, 10 ppm)",
    "calibrator_floor": "range offsets and level errors of the calibrator, N(0, floor/2) of Table 2",
    "dmm_errors": "gain, zero and linearity of the multimeter's current ranges",
}
NUMBERS = {
    "calibrator_drift_ppm": ("rise of the calibrator's gain per day", -1000.0, 1000.0),
    "time_constants": (
        "divides the lags of chamber and unit and the settling of the calibrator, 1 to 1000", 1.0, 1000.0),
}  # fmt: skip
TEXTS = {  # the unit reads them itself
    "noise": ("noise of the unit, on or off", any_text),
    "hysteresis": ("of its bias over temperature, on or off", any_text),
    "master_error_ppm": ("error of its master oscillator at 20 degC", any_text),
    "af_clock_error_ppm": ("error of its AF clock", any_text),
    "unit_seed": ("whose constants it has: a unit that comes back; the seed of the run if not given", any_text),
    "check_standard": ("channel that has the constants of another unit, and its seed: 7:12", any_text),
}


def apart(options: Mapping[str, Any]) -> tuple[Mapping[str, Any], Mapping[str, str]]:
    """Return the world's own options, with all switches, and those that its unit reads itself."""
    texts = {key: value for key, value in options.items() if key in TEXTS}
    return dict.fromkeys(OPTIONS, True) | {key: options[key] for key in options if key not in TEXTS}, texts
