"""What the truth lists ask of a simulated unit of AF converters."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any, Protocol

import numpy as np
from numpy.typing import NDArray

from bench.model.ports import RecordWindow

REFERENCE_TEMPERATURE_DEGC = 20.0
_POINTS_PER_WINDOW = 11


class UnitTruth(Protocol):
    """True parameters of the unit under test; channels are numbered from 1."""

    af_clock_error_ppm: float
    kinds: Sequence[str]  # of each channel
    half_width_degC: NDArray[np.float64]  # play of each channel's hysteresis
    hysteresis_A: NDArray[np.float64]  # falling minus rising branch of each channel's bias

    def dsf_n_ppm(self, channel: Any, unit_degC: Any) -> Any:
        """Scale-factor error of the N pulses (positive currents), ppm."""

    def dsf_p_ppm(self, channel: Any, unit_degC: Any) -> Any:
        """Scale-factor error of the P pulses, ppm."""

    def tc_ppm(self, channel: int, polarity: str, about_degC: float) -> tuple[float, float]:
        """Return coefficients of side "n" or "p" about a temperature: ppm/degC and ppm/degC²."""

    def bias_A(self, channel: Any, unit_degC: Any, t_s: Any, play_offset_degC: Any = 0.0) -> Any:
        """i_AFbias, ampere: the correction added to the reading, negative of the open-input reading."""

    def bias_tc_A(self, channel: int, order: int) -> float:
        """Coefficient of (T - 20 degC)^order of the bias between the branches, A/degC^order."""

    def master_error_ppm(self, unit_degC: Any) -> Any:
        """Relative error of the master oscillator, ppm."""

    def master_tc_ppm(self, order: int) -> float:
        """Coefficient of (T - 20 degC)^order of that error, ppm/degC^order."""


def per_degC(unit: str, order: int) -> str:
    """Unit of the coefficient of (T - T_ref)^order."""
    return unit if order == 0 else f"{unit}/degC{order if order > 1 else ''}"


def times_ns(windows: Sequence[RecordWindow]) -> NDArray[np.int64]:
    """Bench times spread evenly over the windows."""
    return np.concatenate([np.linspace(w.t_start_ns, w.t_end_ns, _POINTS_PER_WINDOW).astype(np.int64) for w in windows])
