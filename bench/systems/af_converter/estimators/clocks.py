"""Clock corrections from the pulses counted in the same gate as the readings.

Source: AF-converter paper equation (1) and section 4.1, corrected as in docs/decisions/0004.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]


def clock_ratio(af_count: Array, gate_s: Array, af_clock_Hz: float) -> Array:
    """Return ratio r = (1 + dMSTR) / (1 + dAF) = f_AF0 * t_INT0 / n_AF, which turns counted rates into current.

    Args:    af_count: AF-clock pulses counted in each gate, (m,).   gate_s: nominal gate t_INT0 = master pulses over
             nominal master frequency, (m,), second.   af_clock_Hz: nominal AF clock, hertz.
    Returns: r, (m,), near 1; NaN where no AF pulse was counted.
    Source:  AF-converter paper equation (1); docs/decisions/0004.
    """
    counted = np.where(af_count > 0, af_count, np.nan)
    return np.asarray(af_clock_Hz * gate_s / counted)


def master_clock_error(fg_count: Array, gate_s: Array, fg_Hz: float) -> Array:
    """Relative error dMSTR of the master clock: 1 + dMSTR = f_FG * t_INT0 / n_FG; positive = runs fast.

    Args:    fg_count: function-generator pulses counted in each gate, (m,).   gate_s: nominal gate, (m,), second.
             fg_Hz: frequency of the function generator, hertz.
    Returns: dMSTR, (m,), dimensionless; NaN where the generator was off.
    Source:  AF-converter paper section 4.1; docs/decisions/0004.
    """
    counted = np.where(fg_count > 0, fg_count, np.nan)
    return np.asarray(fg_Hz * gate_s / counted - 1.0)


def count_noise(count: Array) -> Array:
    """Relative standard uncertainty of a gated count, (m,): difference of two uniform residues over the count.

    Source: docs/decisions/0004 (quantisation); two uniform residues of one pulse have the variance 1/6.
    """
    return np.asarray(1.0 / (np.sqrt(6.0) * np.where(count > 0, count, np.nan)))
