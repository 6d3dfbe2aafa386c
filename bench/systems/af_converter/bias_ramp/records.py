"""Records of a bias campaign as series: which belong to it, the readings of each channel, and when they were taken."""

from __future__ import annotations

from collections import Counter
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from bench.analysis import Floats, count_problem
from bench.model.errors import FitError
from bench.record import UNIT_TEMPERATURE
from bench.systems.af_converter.constants import Campaign, Channel
from bench.systems.af_converter.estimators.gates import Whitener, series_covariance
from bench.systems.af_converter.estimators.hysteresis.model import Gates
from bench.systems.af_converter.estimators.pulses import PulseConverters, PulseRecords, stack_records
from bench.systems.af_converter.estimators.record_rate import RecordRates, record_rates

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
    used: NDArray[np.bool_]
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


def _belongs(conditions: Mapping[str, Any]) -> bool:
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
