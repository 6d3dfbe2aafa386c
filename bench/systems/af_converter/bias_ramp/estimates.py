"""Estimates of a bias campaign: bias, its temperature coefficients, hysteresis, play and lag of every channel.

All temperatures of the estimates are those of the unit's own sensor, which is what a navigation unit compensates by.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
from scipy import special

from bench.analysis import Floats, estimate
from bench.systems.af_converter.bias_ramp.fit import ChannelFit
from bench.systems.af_converter.coefficients import compensation_entry
from bench.systems.af_converter.constants import Campaign
from bench.systems.af_converter.estimators.hysteresis.fit import HALF_WIDTH, LAG, width_at
from bench.systems.af_converter.estimators.hysteresis.model import WIDTH
from bench.systems.af_converter.estimators.oscillator import OscillatorFit

STEP_degC = 15.0  # between the temperatures of the estimates, counted from the reference temperature
DSF_STD = 400e-6  # of a converter whose scale factor is not calibrated (design: drawn with 400 ppm)
HOUR_s = 3600.0
_OPEN_degC = 1.0  # nearer to an end the loop closes by itself, whatever the channel does
_REACH_degC = 0.6  # how far beyond the ends of the loop a polynomial may be read


def temperatures(one: ChannelFit) -> list[float]:
    """Temperatures at which estimates are given: the reference and every 15 degC from it, as far as the ramp reached.

    A ramp that reaches none of them has one in its middle, to a whole degree.
    """
    reference_degC = one.fit.reference_degC
    low, high = (end + one.offset_degC for end in one.fit.loop_degC)
    first = math.ceil((low - _REACH_degC - reference_degC) / STEP_degC)
    last = math.floor((high + _REACH_degC - reference_degC) / STEP_degC)
    return [reference_degC + STEP_degC * k for k in range(first, last + 1)] or [float(round((low + high) / 2.0))]


def on_sensor(one: ChannelFit) -> tuple[Floats, Floats]:
    """Return coefficients (order + 1,) of the centre curve against the unit's sensor, and their covariance of the fit.

    The sensor reads ``offset_degC`` more than the temperature of the fit: b(T) = sum c_k (T - offset - T_ref)^k.
    """
    order = one.fit.order
    moved = np.array(
        [
            [special.comb(k, j) * (-one.offset_degC) ** (k - j) if k >= j else 0.0 for k in range(order + 1)]
            for j in range(order + 1)
        ]
    )
    return moved @ one.fit.parameters[: order + 1], moved @ one.fit.covariance[: order + 1, : order + 1] @ moved.T


def bias_parts(one: ChannelFit, weights: Floats, campaign: Campaign) -> dict[str, float]:
    """Independent parts of the standard uncertainty of ``weights @ coefficients`` of the centre curve, by name."""
    coefficients, covariance = on_sensor(one)
    moves = np.arange(1, weights.size) * coefficients[1:]  # d c_k for a sensor that is off by 1 degC
    return {
        "readings, random walk and fit": float(np.sqrt(weights @ covariance @ weights)),
        "scale factor taken as nominal": abs(float(weights @ coefficients)) * DSF_STD,
        "temperature sensor of the unit": abs(float(weights[:-1] @ moves)) * campaign.sensor_std_degC,
    }


def channel_estimates(one: ChannelFit, campaign: Campaign, dropped: int, limit_A: float | None) -> list[dict[str, Any]]:
    """Return all estimates of one channel; ``limit_A`` judges what the compensation leaves."""
    channel = {"channel": one.readings.channel.number, "kind": one.readings.channel.kind}
    n = one.readings.bias_A.size
    counts = {"n": n, "dropped": dropped + int(np.count_nonzero(~one.readings.used))}
    return [
        *_bias(one, campaign, channel, counts),
        *_hysteresis(one, campaign, channel, counts),
        _residual(one, campaign, channel, counts, limit_A),
    ]


def _bias(
    one: ChannelFit, campaign: Campaign, channel: Mapping[str, Any], counts: Mapping[str, int]
) -> list[dict[str, Any]]:
    coefficients, _ = on_sensor(one)
    reference_degC = campaign.reference_temperature_degC
    found = []
    for at in temperatures(one):
        weights = (at - reference_degC) ** np.arange(coefficients.size, dtype=np.float64)
        std = float(np.linalg.norm(list(bias_parts(one, weights, campaign).values())))
        value = float(weights @ coefficients)
        found.append(estimate("bias", "A", value, std, {**channel, "temperature_degC": at}, **counts))
    conditions = {**channel, "reference_temperature_degC": reference_degC}
    for order in range(1, coefficients.size):
        weights = np.eye(coefficients.size)[order]
        std = float(np.linalg.norm(list(bias_parts(one, weights, campaign).values())))
        unit = "A/degC" if order == 1 else f"A/degC{order}"
        found.append(estimate(f"bias_tc{order}", unit, float(coefficients[order]), std, conditions, **counts))
    return found


def _hysteresis(
    one: ChannelFit, campaign: Campaign, channel: Mapping[str, Any], counts: Mapping[str, int]
) -> list[dict[str, Any]]:
    fit = one.fit
    if not one.there_and_back:
        return []
    places: list[tuple[dict[str, float], float, float]] = [
        ({"reference_temperature_degC": campaign.reference_temperature_degC}, fit.value(WIDTH), fit.std(WIDTH))
    ]
    low, high = (end + one.offset_degC for end in fit.loop_degC)
    inside = [at for at in temperatures(one) if low + _OPEN_degC < at < high - _OPEN_degC]
    places += [({"temperature_degC": at}, *width_at(fit, at - one.offset_degC)) for at in inside]
    found = [
        estimate("hysteresis_width", "A", value, float(np.hypot(std, value * DSF_STD)), {**channel, **at}, **counts)
        for at, value, std in places
    ]
    if fit.half_width_determined:
        half = fit.value(HALF_WIDTH), fit.std(HALF_WIDTH)
        found.append(estimate("play_half_width", "degC", *half, channel, **counts))
    if fit.lag_determined:
        found.append(estimate("thermal_lag", "min", fit.value(LAG) / 60.0, fit.std(LAG) / 60.0, channel, **counts))
    return found


def compensated_A(one: ChannelFit, campaign: Campaign) -> Floats:
    """Reading minus the polynomial against the unit's sensor, (k,): what a navigation unit is left with, ampere."""
    coefficients, _ = on_sensor(one)
    known = np.isfinite(one.sensor_degC)
    temperature = np.where(known, one.sensor_degC, one.fit.unit_degC + one.offset_degC)
    x = temperature - campaign.reference_temperature_degC
    return np.asarray(one.readings.bias_A - np.polynomial.polynomial.polyval(x, coefficients))


def _residual(
    one: ChannelFit,
    campaign: Campaign,
    channel: Mapping[str, Any],
    counts: Mapping[str, int],
    limit_A: float | None,
) -> dict[str, Any]:
    """Largest mean over an hour of what the polynomial leaves; hysteresis and random walk are in it, as in use."""
    left = compensated_A(one, campaign)
    middle_s, gate_s = one.readings.gates.middle_s, one.readings.gates.end_s - one.readings.gates.start_s
    hour = ((middle_s - one.readings.gates.start_s[0]) // HOUR_s).astype(np.int64)
    length_s = np.bincount(hour, gate_s)
    full = length_s >= 0.5 * length_s.max()
    means = np.bincount(hour, left * gate_s)[full] / length_s[full]
    noise = np.sqrt(np.bincount(hour, (one.readings.white_A * gate_s) ** 2)[full]) / length_s[full]
    worst = int(np.argmax(np.abs(means)))
    std = float(np.hypot(noise[worst], means[worst] * DSF_STD))
    conditions = {**channel, "averaging_h": HOUR_s / 3600.0, "compensation": "polynomial against the unit's sensor"}
    return estimate("bias_residual", "A", float(means[worst]), std, conditions, **counts, limit=limit_A)


def master_clock_estimates(fit: OscillatorFit, at_degC: Sequence[float], dropped: int) -> list[dict[str, Any]]:
    """master_clock_error at temperatures, and its coefficients _tc0 ... about the reference temperature."""
    counts = {"n": fit.n_used, "dropped": fit.n_dropped + dropped}
    name = "master_clock_error"
    found = [
        estimate(name, "ppm", fit.value_ppm(at), fit.std_ppm(at), {"temperature_degC": at}, **counts) for at in at_degC
    ]
    reference = {"reference_temperature_degC": fit.reference_degC}
    for order, value in enumerate(fit.coefficients_ppm):
        unit = "ppm" + ("", "/degC")[order] if order < 2 else f"ppm/degC{order}"
        std = fit.coefficient_std_ppm(order)
        found.append(estimate(f"{name}_tc{order}", unit, float(value), std, reference, **counts))
    return found


def compensation(fits: Sequence[ChannelFit], clock: OscillatorFit | None) -> list[dict[str, Any]]:
    """Return the entries for coefficients.json: the biases against the unit's own sensor, and the master oscillator."""
    found = [
        compensation_entry(
            "bias",
            (one.readings.channel.number, one.readings.channel.kind),
            one.fit.reference_degC,
            on_sensor(one)[0],
            [end + one.offset_degC for end in one.fit.loop_degC],
        )
        for one in fits
        if not one.sensor_problem
    ]
    if clock is not None:
        whole = (None, None), clock.reference_degC, clock.coefficients_ppm, list(clock.span_degC)
        found.append(compensation_entry("master_clock", *whole))
    return found
