"""Joint fit of every channel of a bias campaign with the separate polynomials it is shown beside, and the fit of the
master oscillator over temperature from the same windows.

Records of a bias campaign as series: which belong to it, the readings of each channel, and when they were taken.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from bench.analysis import Document, Floats, Trace, count_problem
from bench.maths.arrays import Flags
from bench.model.errors import FitError
from bench.record import UNIT_TEMPERATURE
from bench.systems.af_converter.constants import FUNCTION_GENERATOR, Campaign, Channel, read_dof, read_generator
from bench.systems.af_converter.estimators.gates import Drive, Whitener, require_known, series_covariance, usable_drive
from bench.systems.af_converter.estimators.hysteresis.fit import (
    HALF_WIDTH,
    LAG,
    HysteresisFit,
    branch_difference,
    crossed_over,
    fit_hysteresis,
)
from bench.systems.af_converter.estimators.hysteresis.model import Gates, ModelShape, mean_of_walk
from bench.systems.af_converter.estimators.hysteresis.search import Bounds
from bench.systems.af_converter.estimators.oscillator import OscillatorFit, OscillatorWindows, fit_oscillator
from bench.systems.af_converter.estimators.readings import PulseConverters, PulseRecords, stack_records
from bench.systems.af_converter.estimators.record_rate import RecordRates, record_rates
from bench.systems.af_converter.wording import say

JOINT, JOINT_UNIT_SENSOR = "joint", "joint_unit_sensor"
METHODS = (JOINT, JOINT_UNIT_SENSOR)
RISING, FALLING = "up", "down"
_WIDEST_SHARE = 0.15  # of the temperature span: a loop must be much wider than the play, or there is no branch left
_WIDEST_degC = 9.0
_LAG_s = {JOINT: (120.0, 5400.0), JOINT_UNIT_SENSOR: (1.0, 1800.0)}  # the sensor may be as slow as the converters
_CLOCK_ORDER = 3
_FEWEST = 30  # readings of a channel
_NARROWEST_degC = 0.05  # half-width; a loop that opens within so little is a step
FOLLOWS_degC = 2.0  # root mean square; a sensor 10 min ahead of the converters differs by 1 degC at 0.1 degC/min


if TYPE_CHECKING:
    from bench.record import RecordRow

_PURPOSE = "measurement"


@dataclass(frozen=True)
class RampRecords:
    """Usable windows in order of time, (m,) each; ``left_out``: reason -> windows that are not among them.

    ``unit_degC``: reading of the unit's own sensor, NaN where there is none.
    """

    start_s: Floats
    branch: NDArray[np.str_]
    unit_degC: Floats
    fg_count: Floats
    pulses: PulseRecords
    left_out: Mapping[str, int]

    @property
    def dropped(self) -> int:
        """Windows that enter no fit."""
        return sum(self.left_out.values())


@dataclass(frozen=True)
class ChannelReadings:
    """Readings i_AFbias of one channel, (k,), with their intervals and noise; ``used``: which of the windows, (m,)."""

    channel: Channel
    used: Flags
    bias_A: Floats
    gates: Gates
    noise: Whitener
    white_A: Floats  # standard uncertainty of each by itself, without the random walk
    estimators: Mapping[str, int]  # name -> windows


def ramp_records(rows: Sequence[RecordRow], master_Hz: float) -> RampRecords:
    """Sort out the windows of the ramp: measuring records with the input open, on a branch, of all channels at once.

    Raises: FitError B-FIT-022 if there is none, or none is usable.
    """
    chosen = sorted((row for row in rows if _belongs(row.window.conditions)), key=lambda row: row.window.t_start_ns)
    problems = [count_problem(row) for row in chosen]
    left_out = Counter(problem for problem in problems if problem)
    good = [row for row, problem in zip(chosen, problems, strict=True) if not problem]
    if not good:
        reasons = ", ".join(f"{count} {reason}" for reason, count in left_out.items()) or "none on a branch"
        raise FitError(
            "B-FIT-022",
            f"no usable record of a bias ramp among {len(rows)} ({reasons})",
            next_step="check with 'bench recover' what the session holds; the records of a ramp carry the conditions "
            "'route: open' and 'branch'",
        )
    return RampRecords(
        start_s=np.array([row.window.t_start_ns for row in good]) * 1e-9,
        branch=np.array([str(row.window.conditions["branch"]) for row in good]),
        unit_degC=np.array([float(row.context.get(UNIT_TEMPERATURE, np.nan)) for row in good]),
        fg_count=np.array([float(row.sums.get("fg_count", 0)) for row in good]),
        pulses=stack_records(
            [(row.window.first_counter, row.frames, row.lost) for row in good],
            [row.sums for row in good],
            [row.timing for row in good],
            master_Hz,
        ),
        left_out=left_out,
    )


def _belongs(conditions: Document) -> bool:
    open_input = conditions.get("route") == "open" and "channel" not in conditions
    return open_input and "branch" in conditions and conditions.get("purpose", _PURPOSE) == _PURPOSE


def channel_readings(records: RampRecords, campaign: Campaign) -> dict[int, ChannelReadings]:
    """Return readings of every declared channel that the records hold, by number.

    The estimator of each window is the one with the least stated uncertainty (estimators.record_rate).
    """
    columns = records.pulses.n.count.shape[1]
    channels = {channel.number: channel for channel in campaign.channels if channel.number <= columns}
    charge, white = np.ones(columns), np.ones(columns)
    for number, channel in channels.items():
        charge[number - 1], white[number - 1] = channel.k0_C, channel.noise.white_A_rtHz
    rates = record_rates(records.pulses, PulseConverters(charge, charge, white, campaign.af_clock_Hz))
    return {number: _readings(records, rates, channel) for number, channel in channels.items()}


def _readings(records: RampRecords, rates: RecordRates, channel: Channel) -> ChannelReadings:
    at = channel.number - 1
    std = rates.std_uncertainty_A[:, at]
    used = np.isfinite(rates.current_A[:, at]) & np.isfinite(std) & (rates.length_s[:, at] > 0)
    beside = np.concatenate(([False], used[:-1]))
    gates = Gates((records.start_s + rates.start_s[:, at])[used], (records.start_s + rates.end_s[:, at])[used])
    estimator = rates.estimator[used, at]
    noise = series_covariance(
        estimator,
        gates.middle_s,
        gates.end_s - gates.start_s,
        rates.quantum_C[used, at],
        channel.noise.white_A_rtHz,
        channel.noise.walk_A_rth,
        (rates.joined[:, at] & beside)[used],
    )
    return ChannelReadings(
        channel, used, -rates.current_A[used, at], gates, noise, std[used], Counter(str(name) for name in estimator)
    )


@dataclass(frozen=True)
class ChannelFit:
    """Fit of one channel; per window (k,): the unit's sensor and the chamber's air (NaN = unknown), and the branch.

    ``bounds``: of the search for lag and half-width.   ``sensor_problem``: why the sensor is not used (it is NaN then),
    "" if it is.
    """

    readings: ChannelReadings
    fit: HysteresisFit
    sensor_degC: Floats
    air_degC: Floats
    branch: NDArray[np.str_]
    bounds: Bounds
    sensor_problem: str = ""

    @property
    def offset_degC(self) -> float:
        """Mean of sensor minus lagged temperature; what turns a temperature of the sensor into one of the fit."""
        known = np.isfinite(self.sensor_degC)
        return float(np.mean((self.sensor_degC - self.fit.unit_degC)[known])) if known.any() else 0.0

    def naive(self, temperature_degC: Floats, at_degC: Floats) -> Floats:
        """Falling minus rising cubic against a temperature (k,), at temperatures; NaN where a branch does not reach.

        NaN everywhere if the temperatures do not determine a cubic; the joint fit stands without this comparison.
        Windows in which the play still crosses after a reversal are left out.
        """
        kept = np.isfinite(temperature_degC) & crossed_over(self.fit)
        rising, falling = (kept & (self.branch == name) for name in (RISING, FALLING))
        try:
            return branch_difference(temperature_degC, self.readings.bias_A, rising, falling, at_degC)
        except FitError:
            return np.full(at_degC.shape, np.nan)

    @property
    def there_and_back(self) -> bool:
        """Whether the ramp was taken in both directions; from one alone, lag and half-width are told apart too well.

        Of 40 ramps that ended after the way up, intervals of width, half-width and lag held 34, 33 and 32.
        """
        return bool(np.isin((RISING, FALLING), self.branch).all())

    @property
    def masked(self) -> int:
        """Windows of the ramps in which the play still crosses."""
        return int(np.count_nonzero(~crossed_over(self.fit) & np.isin(self.branch, (RISING, FALLING))))


def drive_of(trace: Trace, records: RampRecords, method: str) -> Drive:
    """Return the temperature that drives the unit by the method's name, the preparation included.

    The unit's sensor is taken from the records where the environment log has none.

    Raises: FitError B-FIT-020 if there is no temperature to drive with, B-FIT-024 if it turned unseen.
    """
    return require_known(_readings_of_drive(trace, records, method), float(records.start_s[0]))


def _readings_of_drive(trace: Trace, records: RampRecords, method: str) -> Drive:
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

    Raises: FitError B-FIT-023 for too few readings, B-FIT-001 if they do not determine the model, or if lag or
            half-width comes out at a limit of its search: width and slope of the bias take over what that may not.
    """
    if readings.bias_A.size < _FEWEST:
        raise FitError(
            "B-FIT-023",
            f"{readings.bias_A.size} usable readings; a ramp needs at least {_FEWEST}",
            next_step="take the ramp again, or look in the report why its records were left out",
        )
    gates = readings.gates
    widest_degC = max(0.6, min(_WIDEST_degC, _WIDEST_SHARE * float(np.ptp(drive.degC))))
    bounds = Bounds(lag_s=_LAG_s[method], half_width_degC=(_NARROWEST_degC, widest_degC))
    fit = fit_hysteresis(
        readings.bias_A,
        gates,
        drive,
        readings.noise.whiten,
        shape=ModelShape(reference_degC=campaign.reference_temperature_degC),
        bounds=bounds,
        level=mean_of_walk(gates.start_s, gates.end_s, readings.channel.noise.walk_A_rth),
    )
    _require_inside(fit, bounds)
    known = np.isfinite(trace.air_degC)
    air = np.interp(gates.middle_s, trace.t_s[known], trace.air_degC[known]) if known.any() else gates.middle_s * np.nan
    sensor, problem = _usable_sensor(records.unit_degC[readings.used], fit)
    return ChannelFit(readings, fit, sensor, air, records.branch[readings.used], bounds, problem)


def _require_inside(fit: HysteresisFit, bounds: Bounds) -> None:
    """Refuse a lag that is longer, or a half-width of a loop that is narrower or wider, than what was looked for."""
    if not fit.beyond:
        return
    low, high = bounds.half_width_degC
    sought = f"play half-width of {fit.value(HALF_WIDTH):.2f} degC, looked for from {low:g} to {high:g} degC"
    if fit.beyond == LAG:
        sought = f"thermal lag of {fit.value(LAG) / 60:.0f} min, looked for up to {bounds.lag_s[1] / 60:g} min"
    raise FitError(
        "B-FIT-001",
        f"the readings do not determine bias and hysteresis: they ask for a {sought}",
        next_step="look at the temperatures in the report; the other drive (method joint or joint_unit_sensor) may "
        "be nearer to the unit, and a wider ramp shows a wider loop",
    )


def _usable_sensor(sensor_degC: Floats, fit: HysteresisFit) -> tuple[Floats, str]:
    """The unit's sensor in each window, all NaN and the reason if it does not show the temperature of the unit."""
    known = np.isfinite(sensor_degC)
    if not known.any():
        return sensor_degC, say("sensor.silent")
    apart_degC = float(np.std((sensor_degC - fit.unit_degC)[known]))
    if apart_degC <= FOLLOWS_degC:
        return sensor_degC, ""
    nothing = np.full(sensor_degC.shape, np.nan)
    return nothing, say("sensor.apart", apart=apart_degC)


def fit_master_clock(records: RampRecords, campaign: Campaign, standards: Mapping[str, Document]) -> OscillatorFit:
    """Cubic of dMSTR about the reference temperature. Raises FitError B-FIT-026 if the windows do not determine it."""
    pulses = records.pulses
    length_s = (pulses.frames + pulses.lost) * pulses.frame_s
    fit = fit_oscillator(
        OscillatorWindows(
            times_s=records.start_s + length_s / 2.0,
            gate_s=pulses.gate_s,
            fg_count=records.fg_count,
            unit_degC=records.unit_degC,
            contiguous=pulses.follows,
        ),
        campaign.fg_Hz,
        order=_CLOCK_ORDER,
        reference_degC=campaign.reference_temperature_degC,
        generator_std=read_generator(standards),
        sensor_std_degC=campaign.thermal_std_degC,
    )
    return replace(fit, generator_dof=read_dof(standards, FUNCTION_GENERATOR))
