"""Figures of the report on a bias campaign."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from bench.analysis import Figure, Floats, Series, band, series
from bench.maths.verdict import coverage_factor
from bench.systems.af_converter.bias_ramp.fit import FALLING, RISING, ChannelFit
from bench.systems.af_converter.estimators.hysteresis.loop import branch_curves, width_at
from bench.systems.af_converter.estimators.oscillator import OscillatorFit

_nA = 1e9
_POINTS = 121


def figures(fits: Sequence[ChannelFit]) -> list[Figure]:
    """Per channel: bias over temperature with both branches of the fit, what the fit leaves, width over temperature."""
    return [draw(channel) for draw in (_loop, _residual, _width) for channel in fits]


def _name(channel: ChannelFit) -> str:
    return f"channel {channel.readings.channel.number}"


def _loop(channel: ChannelFit) -> Figure:
    at = np.linspace(*channel.fit.loop_degC, _POINTS)
    rising, falling = branch_curves(channel.fit, at)
    measured = [
        _points(
            f"measured, {name}",
            channel.fit.unit_degC[channel.branch == name],
            channel.readings.bias_A[channel.branch == name],
        )
        for name in (RISING, FALLING)
    ]
    caption = "Bias (correction added to the reading) over the lagged temperature, with the joint fit."
    parts = [*measured, _line("fit, rising", at, rising), _line("fit, falling", at, falling)]
    return Figure(_name(channel), caption, "lagged temperature, degC", "bias, nA", parts, group="bias over temperature")


def _residual(channel: ChannelFit) -> Figure:
    hours = (channel.readings.gates.middle_s - channel.readings.gates.start_s[0]) / 3600.0
    caption = "What the joint fit leaves: noise of the windows and the random walk of the bias."
    parts = [_points("residual", hours, channel.fit.residual)]
    return Figure(_name(channel), caption, "time, h", "residual, nA", parts, group="residuals of the joint fit")


def _width(channel: ChannelFit) -> Figure:
    at = np.linspace(*channel.fit.loop_degC, _POINTS)
    width, std = (np.array(column) for column in zip(*(width_at(channel.fit, float(x)) for x in at), strict=True))
    reach = coverage_factor() * std
    naive = {"against the air": channel.air_degC, "against the sensor": channel.sensor_degC}
    lines = [_line(f"cubics {name}", at, channel.naive(temperature, at)) for name, temperature in naive.items()]
    caption = "Hysteresis width (falling minus rising): joint fit, and separate polynomials of the branches."
    parts = [
        band("95 %", at, (width - reach) * _nA, (width + reach) * _nA),
        _line("joint fit", at, width),
        *(line for line in lines if line.x),
    ]
    return Figure(_name(channel), caption, "temperature, degC", "width, nA", parts, group="hysteresis width")


def master_clock_figure(fit: OscillatorFit, unit_degC: Floats) -> Figure:
    """Error of the master oscillator over temperature: what the cubic leaves."""
    known = np.isfinite(fit.residual_ppm)
    title = "Master oscillator: residual of the cubic"
    caption = f"Root mean square {fit.rms_ppm:.2g} ppm; the generator's own error is common to all windows."
    parts = [series("windows", unit_degC[known], fit.residual_ppm[known], "points")]
    return Figure(title, caption, "temperature of the unit, degC", "residual, ppm", parts)


def _points(label: str, x: Floats, y_A: Floats) -> Series:
    return series(label, x, y_A * _nA, "points")


def _line(label: str, x: Floats, y_A: Floats) -> Series:
    known = np.isfinite(y_A)
    return series(label, x[known], y_A[known] * _nA)
