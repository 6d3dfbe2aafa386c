"""Joint fit of every channel of a bias campaign, and the separate polynomials it is shown beside."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from bench.campaigns.bias_records import ChannelReadings, RampRecords
from bench.campaigns.constants import Campaign
from bench.campaigns.material import Trace
from bench.fit.branches import branch_difference
from bench.fit.hysteresis import HysteresisFit, fit_hysteresis
from bench.fit.hysteresis_loop import crossed_over
from bench.fit.hysteresis_model import ModelShape
from bench.fit.hysteresis_search import Bounds
from bench.fit.level import mean_of_walk
from bench.fit.thermal_lag import Drive, usable_drive
from bench.model.errors import FitError

Floats = NDArray[np.float64]
JOINT, JOINT_UNIT_SENSOR = "joint", "joint_unit_sensor"
METHODS = (JOINT, JOINT_UNIT_SENSOR)
RISING, FALLING = "up", "down"
_WIDEST_SHARE = 0.15  # of the temperature span: a loop must be much wider than the play, or there is no branch left
_WIDEST_degC = 9.0
_LAG_s = {JOINT: (120.0, 5400.0), JOINT_UNIT_SENSOR: (1.0, 1800.0)}  # the sensor may be as slow as the converters
_FEWEST = 30  # readings of a channel


@dataclass(frozen=True)
class ChannelFit:
    """Fit of one channel; per window (k,): the unit's sensor and the chamber's air (NaN = unknown), and the branch."""

    readings: ChannelReadings
    fit: HysteresisFit
    sensor_degC: Floats
    air_degC: Floats
    branch: NDArray[np.str_]

    @property
    def offset_degC(self) -> float:
        """Mean of sensor minus lagged temperature; what turns a temperature of the sensor into one of the fit."""
        known = np.isfinite(self.sensor_degC)
        return float(np.mean((self.sensor_degC - self.fit.unit_degC)[known])) if known.any() else 0.0

    def naive(self, temperature_degC: Floats, at_degC: Floats, *, masked: bool = True) -> Floats:
        """Falling minus rising cubic against a temperature (k,), at temperatures; NaN where a branch does not reach.

        ``masked``: windows in which the play still crosses after a reversal are left out.
        """
        kept = np.isfinite(temperature_degC) & (crossed_over(self.fit) if masked else True)
        rising, falling = (kept & (self.branch == name) for name in (RISING, FALLING))
        return branch_difference(temperature_degC, self.readings.bias_A, rising, falling, at_degC)

    @property
    def masked(self) -> int:
        """Windows of the ramps in which the play still crosses."""
        return int(np.count_nonzero(~crossed_over(self.fit) & np.isin(self.branch, (RISING, FALLING))))


def drive_of(trace: Trace, records: RampRecords, method: str) -> Drive:
    """The temperature that drives the unit by the method's name, the preparation included.

    The unit's sensor is taken from the records where the environment log has none.

    Raises: FitError B-FIT-004 for an unknown method, B-FIT-020 if there is no temperature to drive with.
    """
    if method not in METHODS:
        raise FitError(
            "B-FIT-004",
            f"unknown method {method!r} of the bias ramp",
            next_step=f"use one of: {', '.join(METHODS)}",
        )
    if method == JOINT:
        known = trace.unit_degC[np.isfinite(trace.unit_degC)]
        return usable_drive(trace.t_s, trace.air_degC, float(known[0]) if known.size else None)
    if np.isfinite(trace.unit_degC).any():
        return usable_drive(trace.t_s, trace.unit_degC)
    pulses = records.pulses
    middle_s = records.start_s + (pulses.frames + pulses.lost) * pulses.frame_s / 2.0
    return usable_drive(middle_s, records.unit_degC)


def fit_channel(
    readings: ChannelReadings, records: RampRecords, trace: Trace, drive: Drive, campaign: Campaign, method: str
) -> ChannelFit:
    """Joint fit of one channel.

    Raises: FitError B-FIT-023 for too few readings, B-FIT-001 if they do not determine the model.
    """
    if readings.bias_A.size < _FEWEST:
        raise FitError(
            "B-FIT-023",
            f"{readings.bias_A.size} usable readings; a ramp needs at least {_FEWEST}",
            next_step="take the ramp again, or look in the report why its records were left out",
        )
    gates = readings.gates
    fit = fit_hysteresis(
        readings.bias_A,
        gates,
        drive,
        readings.noise.whiten,
        shape=ModelShape(reference_degC=campaign.reference_temperature_degC),
        bounds=Bounds(lag_s=_LAG_s[method], half_width_degC=(0.3, _widest(drive))),
        level=mean_of_walk(gates.start_s, gates.end_s, readings.channel.noise.walk_A_rth),
    )
    known = np.isfinite(trace.air_degC)
    air = np.interp(gates.middle_s, trace.t_s[known], trace.air_degC[known]) if known.any() else gates.middle_s * np.nan
    return ChannelFit(readings, fit, records.unit_degC[readings.used], air, records.branch[readings.used])


def _widest(drive: Drive) -> float:
    return max(0.6, min(_WIDEST_degC, _WIDEST_SHARE * float(np.ptp(drive.degC))))
