"""Bias ramps of a unit as the sequence declares it: errors of their estimates, for what a prediction is held against.

Physics, truth and counts are those of ``bias_simulation``; here a campaign is drawn (noise, scale factors, error of the
unit's sensor, frequency of the generator) and analysed by the fits alone, without what explains a result.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace
from typing import Any

import numpy as np
from bias_simulation import MASTER_ppm, Ramp, Unit, campaign, heat, ramp, rows

from bench.analysis import Trace
from bench.systems.af_converter.bias_ramp.estimates import channel_estimates, compensated_A, master_clock_estimates
from bench.systems.af_converter.bias_ramp.fit import (
    JOINT,
    ChannelFit,
    channel_readings,
    drive_of,
    fit_channel,
    fit_master_clock,
    ramp_records,
)
from bench.systems.af_converter.bias_ramp.noise import channel_noise, noise_estimates
from bench.systems.af_converter.constants import Campaign, Typical, read_campaign

Place = tuple[str, str, float | None]  # quantity, kind, temperature
SENSOR_STD_degC, DSF_STD, GENERATOR = 0.05, 4e-4, 3e-6  # declared: 95 % of 0.1 degC; design; rectangular
WHITE_A_rts, WALK_A_rth = 2e-9 / np.sqrt(2.0), 3e-10  # two-sided


def place(entry: Mapping[str, Any]) -> Place:
    conditions = entry.conditions
    return entry.quantity, conditions.get("kind", ""), conditions.get("temperature_degC")


def errors_of(seed: int, kinds: Mapping[str, Typical], lag_s: float) -> dict[Place, float]:
    """Return estimate minus truth of every quantity of a campaign: one channel of each kind."""
    return {where: error for where, (error, _) in stated_errors(seed, kinds, lag_s).items()}


def stated_errors(seed: int, kinds: Mapping[str, Typical], lag_s: float) -> dict[Place, tuple[float, float]]:
    """Return estimate minus truth of every quantity of a campaign, and the expanded uncertainty that it states."""
    ramps, records, constants, fits = _fitted(seed, kinds, lag_s)
    pairs: list[tuple[Mapping[str, Any], float]] = []
    for fit, one in zip(fits, ramps, strict=True):
        pairs += [(entry, _truth(entry, fit, one, constants)) for entry in channel_estimates(fit, constants, 0)]
    for entry in noise_estimates(channel_noise(fits, records)):
        pairs.append((entry, {"white_noise": WHITE_A_rts, "random_walk": WALK_A_rth}.get(entry.quantity, 0.0)))
    clock = fit_master_clock(records, constants, {})
    for entry in master_clock_estimates(clock, (-10.0, 20.0, 50.0), 0):
        at = entry.conditions.get("temperature_degC", 20.0)
        order = int(entry.quantity[-1]) if "_tc" in entry.quantity else None
        true_ppm = np.polynomial.polynomial.polyval(at - 20.0, MASTER_ppm) if order is None else MASTER_ppm[order]
        pairs.append((entry, float(true_ppm)))
    return {place(entry): (entry.value - truth, entry.expanded_uncertainty) for entry, truth in pairs}


def _fitted(
    seed: int, kinds: Mapping[str, Typical], lag_s: float
) -> tuple[list[Ramp], Any, Campaign, list[ChannelFit]]:
    """Return the ramps of a campaign, its records, its constants, and the fits to them."""
    rng = np.random.default_rng([seed, 46])
    sensor_degC, generator = rng.normal(0, SENSOR_STD_degC), rng.uniform(-GENERATOR, GENERATOR)
    ramps = {
        number: _ramp(seed, kind, typical, lag_s, float(rng.normal(0, DSF_STD)))
        for number, (kind, typical) in enumerate(kinds.items(), start=1)
    }
    read = {number: replace(one, sensor_degC=one.sensor_degC + sensor_degC) for number, one in ramps.items()}
    found = [_off_nominal(row, generator, sensor_degC, rng) for row in rows(ramps)]  # clocks are of the true unit
    constants = read_campaign(campaign(ramps))
    any_ramp = next(iter(read.values()))
    trace = Trace(any_ramp.trace_t_s, any_ramp.air_degC, any_ramp.sensor_degC)
    records = ramp_records(found, constants.master_Hz)
    drive = drive_of(trace, records, JOINT)
    fits = [
        fit_channel(readings, records, trace, drive, constants, JOINT)
        for readings in channel_readings(records, constants).values()
    ]
    return list(ramps.values()), records, constants, fits


def _ramp(seed: int, kind: str, typical: Typical, lag_s: float, dsf: float) -> Ramp:
    curve = (typical.bias_A, typical.bias_tc1_A_degC, 0.0, 0.0)
    return ramp(seed, unit=Unit(kind, curve, typical.hysteresis_width_A, typical.play_half_width_degC, lag_s, dsf))


def _off_nominal(row: Any, generator: float, sensor_degC: float, rng: np.random.Generator) -> Any:
    """Return a window whose generator and sensor are off, each of its counts cut anywhere."""
    count = np.int64(np.floor(row.sums["fg_count"] * (1.0 + generator) + rng.uniform()))
    context = {name: value + sensor_degC for name, value in row.context.items()}
    return replace(row, sums={**row.sums, "fg_count": count}, context=context)


def _truth(entry: Mapping[str, Any], fit: ChannelFit, one: Ramp, constants: Campaign) -> float:
    quantity, at = entry.quantity, entry.conditions.get("temperature_degC")
    if quantity == "bias":
        curve = (one.unit.polynomial[0] + one.mean_walk_A, *one.unit.polynomial[1:])
        return float(np.polynomial.polynomial.polyval(at - 20.0, curve))
    if quantity.startswith("bias_tc"):
        return one.unit.polynomial[int(quantity[-1])]
    if quantity == "bias_residual":
        return entry.value - _residual_error(fit, one, constants)
    lag_min = one.unit.lag_s / 60.0
    return {"hysteresis_width": one.unit.width_A, "play_half_width": one.unit.half_width_degC, "thermal_lag": lag_min}[
        quantity
    ]


def _residual_error(fit: ChannelFit, one: Ramp, constants: Campaign) -> float:
    """Return the error of the largest mean over an hour: of its readings, for the polynomial is as it is used."""
    gates, t_s = fit.readings.gates, heat(one.unit.lag_s).t_s
    charge = np.concatenate(([0.0], np.cumsum((one.flow.bias_A[1:] + one.flow.bias_A[:-1]) / 2.0 * np.diff(t_s))))
    gate_s = gates.end_s - gates.start_s
    true_A = (np.interp(gates.end_s, t_s, charge) - np.interp(gates.start_s, t_s, charge)) / gate_s
    seen_A = true_A / (1.0 + one.unit.dsf)
    left_A = compensated_A(fit)
    hour = ((gates.middle_s - gates.start_s[0]) // 3600.0).astype(int)
    length_s = np.bincount(hour, gate_s)
    means = np.bincount(hour, left_A * gate_s) / length_s * (length_s >= 1800.0)  # less than half an hour is none
    error_A = fit.readings.bias_A - seen_A - one.unit.dsf * (left_A - fit.readings.bias_A + seen_A)
    inside = hour == np.argmax(np.abs(means))
    return float(np.average(error_A[inside], weights=gate_s[inside]))
