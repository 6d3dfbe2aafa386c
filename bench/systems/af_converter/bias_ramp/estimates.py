"""Estimates of a bias campaign: bias, its temperature coefficients, hysteresis, play and lag of every channel.

All temperatures of the estimates are those of the unit's own sensor, which is what a navigation unit compensates by.
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping, Sequence
from typing import Any

import numpy as np
from scipy import special

from bench.analysis import Document, Estimate, Estimates, Floats, estimate
from bench.systems.af_converter.bias_ramp.fit import ChannelFit
from bench.systems.af_converter.coefficients import compensation_entry, per_degC
from bench.systems.af_converter.constants import Campaign
from bench.systems.af_converter.estimators.hysteresis.fit import HALF_WIDTH, LAG, width_at, width_weights
from bench.systems.af_converter.estimators.hysteresis.model import WIDTH
from bench.systems.af_converter.estimators.oscillator import OscillatorFit
from bench.systems.af_converter.wording import say

STEP_degC = 15.0  # between the temperatures of the estimates, counted from the reference temperature
DSF_STD = 400e-6  # of a converter whose scale factor is not calibrated (design: drawn with 400 ppm)
HOUR_s = 3600.0
_OPEN_degC = 1.0  # nearer to an end the loop closes by itself, whatever the channel does
_PARAMETERS = {  # of the fit, and how many of its unit are one of the estimate's
    "hysteresis_width": (WIDTH, 1.0),
    "play_half_width": (HALF_WIDTH, 1.0),
    "thermal_lag": (LAG, 60.0),
}
QUANTITIES = ("bias", "bias_tc1", "bias_tc2", "bias_tc3", "bias_residual", *_PARAMETERS)  # that follow from a joint fit
_REACH_degC = 0.6  # how far beyond the ends of the loop a polynomial may be read


def temperatures(channel: ChannelFit) -> list[float]:
    """Temperatures at which estimates are given: the reference and every 15 degC from it, as far as the ramp reached.

    A ramp that reaches none of them has one in its middle, to a whole degree.
    """
    reference_degC = channel.fit.reference_degC
    low, high = (end + channel.offset_degC for end in channel.fit.loop_degC)
    first = math.ceil((low - _REACH_degC - reference_degC) / STEP_degC)
    last = math.floor((high + _REACH_degC - reference_degC) / STEP_degC)
    return [reference_degC + STEP_degC * k for k in range(first, last + 1)] or [float(round((low + high) / 2.0))]


def on_sensor(channel: ChannelFit) -> tuple[Floats, Floats]:
    """Return coefficients (order + 1,) of the centre curve against the unit's sensor, and their covariance of the fit.

    The sensor reads ``offset_degC`` more than the temperature of the fit: b(T) = sum c_k (T - offset - T_ref)^k.
    """
    moved = _to_sensor(channel)
    fit, of_curve = channel.fit, slice(len(moved))
    return moved @ fit.parameters[of_curve], moved @ fit.covariance[of_curve, of_curve] @ moved.T


def _to_sensor(channel: ChannelFit) -> Floats:
    """Return how the coefficients against the sensor, (order + 1,), follow those of the fit."""
    orders = range(channel.fit.order + 1)
    offset_degC = -channel.offset_degC
    return np.array([[special.comb(k, j) * offset_degC ** (k - j) if k >= j else 0.0 for k in orders] for j in orders])


def bias_parts(channel: ChannelFit, weights: Floats, campaign: Campaign) -> dict[str, float]:
    """Independent parts of the standard uncertainty of ``weights @ coefficients`` of the centre curve, by name."""
    coefficients, covariance = on_sensor(channel)
    moves = np.arange(1, weights.size) * coefficients[1:]  # d c_k for a sensor that is off by 1 degC
    per_degC = abs(float(weights[:-1] @ moves))
    of_slot = {say("component.gradient"): per_degC * campaign.gradient_std_degC} if campaign.gradient_std_degC else {}
    return {
        say("component.readings"): float(np.sqrt(weights @ covariance @ weights)),
        say("component.nominal"): abs(float(weights @ coefficients)) * DSF_STD,
        say("component.sensor"): per_degC * campaign.sensor_std_degC,
        **of_slot,
    }


def channel_estimates(channel: ChannelFit, campaign: Campaign, dropped: int) -> Estimates:
    """Return all estimates of one channel."""
    about = {"channel": channel.readings.channel.number, "kind": channel.readings.channel.kind}
    n = channel.readings.bias_A.size
    counts = {"n": n, "dropped": dropped + int(np.count_nonzero(~channel.readings.used))}
    return [
        *_bias(channel, campaign, about, counts),
        *_hysteresis(channel, campaign, about, counts),
        _residual(channel, about, counts),
    ]


def _bias(channel: ChannelFit, campaign: Campaign, about: Document, counts: Mapping[str, int]) -> Estimates:
    coefficients, _ = on_sensor(channel)
    reference_degC, orders = campaign.reference_temperature_degC, range(1, coefficients.size)
    entries = []
    for quantity, unit, weights, where in _along("bias", "A", temperatures(channel), reference_degC, orders):
        std = float(np.linalg.norm(list(bias_parts(channel, weights, campaign).values())))
        entries.append(estimate(quantity, unit, float(weights @ coefficients), std, {**about, **where}, **counts))
    return entries


def _along(
    name: str, unit: str, at_degC: Sequence[float], reference_degC: float, orders: range
) -> Iterator[tuple[str, str, Floats, Document]]:
    """Yield of a polynomial its value at temperatures and its coefficients: quantity, unit, weights, conditions."""
    for at in at_degC:
        weights = (at - reference_degC) ** np.arange(orders.stop, dtype=np.float64)
        yield name, unit, weights, {"temperature_degC": at}
    for order in orders:
        where = {"reference_temperature_degC": reference_degC}
        yield f"{name}_tc{order}", per_degC(unit, order), np.eye(orders.stop)[order], where


def _hysteresis(channel: ChannelFit, campaign: Campaign, about: Document, counts: Mapping[str, int]) -> Estimates:
    fit = channel.fit
    if not channel.there_and_back:
        return []
    places: list[tuple[dict[str, float], float, float]] = [
        ({"reference_temperature_degC": campaign.reference_temperature_degC}, fit.value(WIDTH), fit.std(WIDTH))
    ]
    low, high = (end + channel.offset_degC for end in fit.loop_degC)
    inside = [at for at in temperatures(channel) if low + _OPEN_degC < at < high - _OPEN_degC]
    places += [({"temperature_degC": at}, *width_at(fit, at - channel.offset_degC)) for at in inside]
    entries = [
        estimate("hysteresis_width", "A", value, float(np.hypot(std, value * DSF_STD)), {**about, **at}, **counts)
        for at, value, std in places
    ]
    if fit.half_width_determined:
        half = fit.value(HALF_WIDTH), fit.std(HALF_WIDTH)
        entries.append(estimate("play_half_width", "degC", *half, about, **counts))
    if fit.lag_determined:
        entries.append(estimate("thermal_lag", "min", fit.value(LAG) / 60.0, fit.std(LAG) / 60.0, about, **counts))
    return entries


def parameter_weights(channel: ChannelFit, entry: Estimate) -> Floats:
    """Return how an estimate of ``QUANTITIES`` follows each parameter of the fit, (n,)."""
    fit, where = channel.fit, entry.conditions
    weights = np.zeros(fit.parameters.size)
    of_curve, moved = weights[: fit.order + 1], _to_sensor(channel)
    if entry.quantity == "hysteresis_width" and "temperature_degC" in where:
        return width_weights(fit, where["temperature_degC"] - channel.offset_degC)
    if entry.quantity in _PARAMETERS:
        name, unit = _PARAMETERS[entry.quantity]
        weights[fit.names.index(name)] = 1.0 / unit
    elif entry.quantity == "bias":
        of_curve[:] = (where["temperature_degC"] - fit.reference_degC) ** np.arange(of_curve.size) @ moved
    elif entry.quantity == "bias_residual":
        of_curve[:] = -_worst_hour(channel)[0] @ np.vander(_rest_degC(channel), of_curve.size, increasing=True) @ moved
    else:
        of_curve[:] = moved[int(entry.quantity[-1])]
    return weights


def reading_weights(channel: ChannelFit, entry: Estimate) -> Floats:
    """Return how an estimate of ``QUANTITIES`` follows the readings themselves, (m,)."""
    of_hour = entry.quantity == "bias_residual"
    return _worst_hour(channel)[0] if of_hour else np.zeros(channel.readings.bias_A.size)


def _rest_degC(channel: ChannelFit) -> Floats:
    """Return the temperature that a navigation unit compensates by above that of reference, (k,)."""
    known = np.isfinite(channel.sensor_degC)
    temperature = np.where(known, channel.sensor_degC, channel.fit.unit_degC + channel.offset_degC)
    return temperature - channel.fit.reference_degC


def compensated_A(channel: ChannelFit) -> Floats:
    """Reading minus the polynomial against the unit's sensor, (k,): what a navigation unit is left with, ampere."""
    coefficients, _ = on_sensor(channel)
    return channel.readings.bias_A - np.polynomial.polynomial.polyval(_rest_degC(channel), coefficients)


def _worst_hour(channel: ChannelFit) -> tuple[Floats, float, float]:
    """Return the weights (k,) of the readings in the hour that is compensated worst, its mean and its noise, ampere."""
    gates = channel.readings.gates
    gate_s = gates.end_s - gates.start_s
    hour = ((gates.middle_s - gates.start_s[0]) // HOUR_s).astype(np.int64)
    length_s = np.bincount(hour, gate_s)
    full = np.flatnonzero(length_s >= 0.5 * length_s.max())
    means = np.bincount(hour, compensated_A(channel) * gate_s)[full] / length_s[full]
    noise = np.sqrt(np.bincount(hour, (channel.readings.white_A * gate_s) ** 2)[full]) / length_s[full]
    worst = int(np.argmax(np.abs(means)))
    weights = gate_s * (hour == full[worst]) / length_s[full[worst]]
    return weights, float(means[worst]), float(noise[worst])


def _residual(
    channel: ChannelFit,
    about: Document,
    counts: Mapping[str, int],
) -> Estimate:
    """Largest mean over an hour of what the polynomial leaves; hysteresis and random walk are in it, as in use."""
    _, mean_A, noise_A = _worst_hour(channel)
    std = float(np.hypot(noise_A, mean_A * DSF_STD))
    conditions = {**about, "averaging_h": HOUR_s / 3600.0, "compensation": say("compensation.sensor")}
    return estimate(
        "bias_residual",
        "A",
        mean_A,
        std,
        conditions,
        **counts,
        limit=channel.readings.channel.bias_stability_limit_A,
    )


def master_clock_estimates(fit: OscillatorFit, at_degC: Sequence[float], dropped: int) -> Estimates:
    """master_clock_error at temperatures, and its coefficients _tc0 ... about the reference temperature."""
    counts = {"n": fit.n_used, "dropped": fit.n_dropped + dropped}
    orders, entries = range(fit.coefficients_ppm.size), []
    for quantity, unit, weights, where in _along("master_clock_error", "ppm", at_degC, fit.reference_degC, orders):
        value_ppm, std_ppm = float(weights @ fit.coefficients_ppm), fit.std_ppm(weights)
        entries.append(estimate(quantity, unit, value_ppm, std_ppm, where, **counts, dof=fit.dof(weights)))
    return entries


def compensation(fits: Sequence[ChannelFit], clock: OscillatorFit | None) -> list[dict[str, Any]]:
    """Return the entries for coefficients.json: the biases against the unit's own sensor, and the master oscillator."""
    entries = [
        compensation_entry(
            "bias",
            (channel.readings.channel.number, channel.readings.channel.kind),
            channel.fit.reference_degC,
            on_sensor(channel)[0],
            [end + channel.offset_degC for end in channel.fit.loop_degC],
        )
        for channel in fits
        if not channel.sensor_problem
    ]
    if clock is not None:
        whole = (None, None), clock.reference_degC, clock.coefficients_ppm, list(clock.span_degC)
        entries.append(compensation_entry("master_clock", *whole))
    return entries
