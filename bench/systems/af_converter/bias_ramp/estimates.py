"""Estimates of a bias campaign: bias, its temperature coefficients, hysteresis, play and lag of every channel.

All temperatures of the estimates are those of the unit's own sensor, which is what a navigation unit compensates by.

What the windows of a bias ramp say against the joint fit of their channel.

Residuals must be no larger than the declared noise, and none of the short list of rivals (step, drift, second thermal
lag, several play operators) may describe the windows better than chance lets it.
Source: docs/decisions/0025-doubt.md.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
from scipy import special

from bench.analysis import LEAST_MOVE, Document, Estimate, Estimates, Evidence, Floats, estimate
from bench.maths.tests import chi2_tail
from bench.maths.verdict import coverage_factor
from bench.systems.af_converter.bias_ramp.fit import ChannelFit
from bench.systems.af_converter.coefficients import compensation_entry
from bench.systems.af_converter.constants import Campaign
from bench.systems.af_converter.estimators.gates import Drive
from bench.systems.af_converter.estimators.hysteresis import rivals
from bench.systems.af_converter.estimators.hysteresis.fit import HALF_WIDTH, LAG, width_at
from bench.systems.af_converter.estimators.hysteresis.model import WIDTH, HysteresisModel, ModelShape
from bench.systems.af_converter.estimators.hysteresis.search import Problem
from bench.systems.af_converter.estimators.oscillator import GENERATOR, OscillatorFit
from bench.systems.af_converter.wording import say

STEP_degC = 15.0  # between the temperatures of the estimates, counted from the reference temperature
DSF_STD = 400e-6  # of a converter whose scale factor is not calibrated (design: drawn with 400 ppm)
HOUR_s = 3600.0
_OPEN_degC = 1.0  # nearer to an end the loop closes by itself, whatever the channel does
_REACH_degC = 0.6  # how far beyond the ends of the loop a polynomial may be read
CHECKS = 5  # of a channel: the misfit and four rivals
_BLOCKS = 12  # of an influence
_LAGS_s = (30.0, 21_600.0)
_nA = 1e9


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
    fit, order = channel.fit, channel.fit.order
    moved = np.array(
        [
            [special.comb(k, j) * (-channel.offset_degC) ** (k - j) if k >= j else 0.0 for k in range(order + 1)]
            for j in range(order + 1)
        ]
    )
    return moved @ fit.parameters[: order + 1], moved @ fit.covariance[: order + 1, : order + 1] @ moved.T


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
        _residual(channel, campaign, about, counts),
    ]


def _bias(channel: ChannelFit, campaign: Campaign, about: Document, counts: Mapping[str, int]) -> Estimates:
    coefficients, _ = on_sensor(channel)
    reference_degC = campaign.reference_temperature_degC
    entries = []
    for at in temperatures(channel):
        weights = (at - reference_degC) ** np.arange(coefficients.size, dtype=np.float64)
        std = float(np.linalg.norm(list(bias_parts(channel, weights, campaign).values())))
        value = float(weights @ coefficients)
        entries.append(estimate("bias", "A", value, std, {**about, "temperature_degC": at}, **counts))
    conditions = {**about, "reference_temperature_degC": reference_degC}
    for order in range(1, coefficients.size):
        weights = np.eye(coefficients.size)[order]
        std = float(np.linalg.norm(list(bias_parts(channel, weights, campaign).values())))
        unit = "A/degC" if order == 1 else f"A/degC{order}"
        entries.append(estimate(f"bias_tc{order}", unit, float(coefficients[order]), std, conditions, **counts))
    return entries


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


def compensated_A(channel: ChannelFit, campaign: Campaign) -> Floats:
    """Reading minus the polynomial against the unit's sensor, (k,): what a navigation unit is left with, ampere."""
    coefficients, _ = on_sensor(channel)
    known = np.isfinite(channel.sensor_degC)
    temperature = np.where(known, channel.sensor_degC, channel.fit.unit_degC + channel.offset_degC)
    x = temperature - campaign.reference_temperature_degC
    return channel.readings.bias_A - np.polynomial.polynomial.polyval(x, coefficients)


def _residual(
    channel: ChannelFit,
    campaign: Campaign,
    about: Document,
    counts: Mapping[str, int],
) -> Estimate:
    """Largest mean over an hour of what the polynomial leaves; hysteresis and random walk are in it, as in use."""
    left = compensated_A(channel, campaign)
    middle_s, gate_s = channel.readings.gates.middle_s, channel.readings.gates.end_s - channel.readings.gates.start_s
    hour = ((middle_s - channel.readings.gates.start_s[0]) // HOUR_s).astype(np.int64)
    length_s = np.bincount(hour, gate_s)
    full = length_s >= 0.5 * length_s.max()
    means = np.bincount(hour, left * gate_s)[full] / length_s[full]
    noise = np.sqrt(np.bincount(hour, (channel.readings.white_A * gate_s) ** 2)[full]) / length_s[full]
    worst = int(np.argmax(np.abs(means)))
    std = float(np.hypot(noise[worst], means[worst] * DSF_STD))
    conditions = {**about, "averaging_h": HOUR_s / 3600.0, "compensation": say("compensation.sensor")}
    return estimate(
        "bias_residual",
        "A",
        float(means[worst]),
        std,
        conditions,
        **counts,
        limit=channel.readings.channel.bias_stability_limit_A,
    )


def master_clock_estimates(fit: OscillatorFit, at_degC: Sequence[float], dropped: int) -> Estimates:
    """master_clock_error at temperatures, and its coefficients _tc0 ... about the reference temperature."""
    counts = {"n": fit.n_used, "dropped": fit.n_dropped + dropped}
    name = "master_clock_error"
    entries = []
    for at in at_degC:
        std = fit.std_ppm(at)
        dof = fit.dof(std, fit.components_ppm(at)[GENERATOR])
        entries.append(estimate(name, "ppm", fit.value_ppm(at), std, {"temperature_degC": at}, **counts, dof=dof))
    reference = {"reference_temperature_degC": fit.reference_degC}
    for order, value in enumerate(fit.coefficients_ppm):
        unit = "ppm" + ("", "/degC")[order] if order < 2 else f"ppm/degC{order}"
        std = fit.coefficient_std_ppm(order)
        dof = fit.dof(std, fit.coefficient_components_ppm(order)[GENERATOR])
        entries.append(estimate(f"{name}_tc{order}", unit, float(value), std, reference, **counts, dof=dof))
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


def evidence(fits: Sequence[ChannelFit], drive: Drive) -> list[Evidence]:
    """Return what every check of every channel says, those that found nothing included."""
    return [seen for channel in fits for seen in _of_channel(channel, drive)]


def listed_rivals(channel: ChannelFit, drive: Drive) -> tuple[rivals.Base, list[rivals.Rival]]:
    """Return the fit of a channel in first order, and the rivals it is held against."""
    fit, readings = channel.fit, channel.readings
    shape = ModelShape(reference_degC=fit.reference_degC, order=fit.order)
    problem = Problem(HysteresisModel(readings.gates, drive, shape), readings.bias_A, readings.noise.whiten)
    base = rivals.base_of(problem, fit.value(LAG), fit.value(HALF_WIDTH), (LAG, HALF_WIDTH))
    middle_s = readings.gates.middle_s
    lag_s = fit.value(LAG)
    listed = [
        *(rivals.steps(middle_s), rivals.drift(middle_s)),
        *(rivals.second_lag(problem, lag_s, _LAGS_s), rivals.several_plays(problem, lag_s)),
    ]
    return base, listed


def _of_channel(channel: ChannelFit, drive: Drive) -> list[Evidence]:
    base, listed = listed_rivals(channel, drive)
    outcomes = rivals.compare(base, listed, [rivals.Noise(channel.readings.noise.whiten)])
    return [_misfit(channel, base), *(_rival(channel, outcome) for outcome in outcomes)]


def _about(channel: ChannelFit) -> dict[str, Any]:
    return {"channel": channel.readings.channel.number}


def moves(channel: ChannelFit, shift: Mapping[str, float]) -> dict[str, float]:
    """Return by how much of its expanded uncertainty of the fit each quantity moves with the parameters.

    What is not stated does not move; the bias moves as its worst coefficient does.
    """
    fit = channel.fit
    moved = {name: abs(shift[name]) / (coverage_factor() * fit.std(name)) for name in shift if fit.std(name) > 0.0}
    found = {"bias": max(moved.get(f"b{k}", 0.0) for k in range(fit.order + 1))}
    found["bias_residual"] = found["bias"]
    if channel.there_and_back:
        found["hysteresis_width"] = moved.get(WIDTH, 0.0)
    if fit.lag_determined:
        found["thermal_lag"] = moved.get(LAG, 0.0)
    if fit.half_width_determined:
        found["play_half_width"] = moved.get(HALF_WIDTH, 0.0)
    return found


def _misfit(channel: ChannelFit, base: rivals.Base) -> Evidence:
    """Return whether the residuals are larger than declared, and how far one stretch of time carries the result."""
    fit = channel.fit
    probability = chi2_tail(fit.chi2, fit.dof)
    worst = _carried(channel, base)
    sentence = say("evidence.misfit", channel=channel.readings.channel.number, chi2=fit.reduced_chi2)
    return Evidence(
        "lack_of_fit", sentence, fit.reduced_chi2, probability, max(worst.values()),
        _bearing(worst, everything=True), _about(channel),
    )  # fmt: skip


def _carried(channel: ChannelFit, base: rivals.Base) -> dict[str, float]:
    """Return the largest move of each quantity when one of twelve stretches of time is left out."""
    whiten = channel.readings.noise.whiten
    worst: dict[str, float] = {}
    for block in np.array_split(np.arange(base.residual.size), _BLOCKS):
        left_out = np.zeros((base.residual.size, block.size))
        left_out[block, np.arange(block.size)] = 1.0  # a column of its own takes each reading out
        design = whiten(np.column_stack((base.columns, left_out)))
        scale = np.linalg.norm(design, axis=0)
        scale = np.where(scale > 0, scale, 1.0)
        solved = np.linalg.lstsq(design / scale, whiten(base.residual), rcond=1e-10)[0] / scale
        shift = dict(zip(base.names, solved[: len(base.names)].tolist(), strict=True))
        for name, moved in moves(channel, shift).items():
            worst[name] = max(worst.get(name, 0.0), moved)
    return worst


def _bearing(moved: dict[str, float], *, everything: bool = False) -> tuple[str, ...]:
    """Return the quantities that move enough to be doubted; all of them if none does, or if they share a misfit."""
    enough = tuple(name for name, move in moved.items() if move > LEAST_MOVE)
    return tuple(moved) if everything or not enough else enough


def _rival(channel: ChannelFit, outcome: rivals.Outcome) -> Evidence:
    moved = moves(channel, outcome.shift)
    code, width_nA = rivals.code_of(outcome.name), _nA * (channel.fit.value(WIDTH) + outcome.shift[WIDTH])
    sentence = say(
        "evidence.rival",
        name=say(code, place=outcome.place),
        channel=channel.readings.channel.number,
        gain=outcome.gain,
        width=width_nA,
    )
    return Evidence(
        code, sentence, outcome.gain,
        outcome.probability, max(moved.values()), _bearing(moved), _about(channel),
    )  # fmt: skip
