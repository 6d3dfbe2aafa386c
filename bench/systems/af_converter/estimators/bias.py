"""Bias of a converter from rows taken with the input open.

Source: AF-converter paper equations (1), (3) and section 3.3; sign as in docs/decisions/0004.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from bench.systems.af_converter.estimators.noise import Converter, Readings, quantisation_A2, white_A2
from bench.systems.af_converter.estimators.scale_factor import pulse_currents_A


@dataclass(frozen=True)
class Bias:
    """i_AFbias in ampere: the correction added to the reading (the IEEE bias is its negative)."""

    value_A: float
    std_uncertainty_A: float
    unit_temperature_degC: float


def open_input_bias(row: Readings, converter: Converter, dsf_ppm: tuple[float, float] = (0.0, 0.0)) -> Bias:
    """Bias from rows with the input open: i_AFbias = -(K_N C_N - K_P C_P), the negative of the reading.

    Args:    row: open rows, (m,), m >= 1.   converter: declared constants.   dsf_ppm: scale-factor errors (N, P).
    Returns: Bias, the mean over the rows.
    Source:  AF-converter paper equation (1) with i_SEN = 0.
    """
    n_A, p_A = pulse_currents_A(row, converter)
    reading_A = n_A * (1.0 + 1e-6 * dsf_ppm[0]) - p_A * (1.0 + 1e-6 * dsf_ppm[1])
    variance = quantisation_A2(row, converter) + white_A2(row, converter)
    return Bias(
        value_A=-float(np.mean(reading_A)),
        std_uncertainty_A=float(np.sqrt(np.sum(variance)) / variance.size),
        unit_temperature_degC=float(np.mean(row.unit_temperature_degC)),
    )
