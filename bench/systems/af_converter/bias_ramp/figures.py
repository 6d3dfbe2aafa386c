"""Figures of the report on a bias campaign."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

from bench.maths.verdict import coverage_factor
from bench.systems.af_converter.bias_ramp.fit import FALLING, RISING, ChannelFit
from bench.systems.af_converter.estimators.hysteresis.loop import branch_curves, width_at
from bench.systems.af_converter.estimators.oscillator import OscillatorFit

Floats = NDArray[np.float64]
Figure = dict[str, Any]
_nA = 1e9
_POINTS = 121


def figures(fits: Sequence[ChannelFit]) -> list[Figure]:
    """Per channel: bias over temperature with both branches of the fit, what the fit leaves, width over temperature."""
    return [draw(one) for draw in (_loop, _residual, _width) for one in fits]


def _name(one: ChannelFit) -> str:
    return f"channel {one.readings.channel.number}"


def _loop(one: ChannelFit) -> Figure:
    at = np.linspace(*one.fit.loop_degC, _POINTS)
    rising, falling = branch_curves(one.fit, at)
    measured = [
        _points(f"measured, {name}", one.fit.unit_degC[one.branch == name], one.readings.bias_A[one.branch == name])
        for name in (RISING, FALLING)
    ]
    return {
        "title": _name(one),
        "caption": "Bias (correction added to the reading) over the lagged temperature, with the joint fit.",
        "x_label": "lagged temperature, degC",
        "y_label": "bias, nA",
        "series": [*measured, _line("fit, rising", at, rising), _line("fit, falling", at, falling)],
        "group": "bias over temperature",
    }


def _residual(one: ChannelFit) -> Figure:
    hours = (one.readings.gates.middle_s - one.readings.gates.start_s[0]) / 3600.0
    return {
        "title": _name(one),
        "caption": "What the joint fit leaves: noise of the windows and the random walk of the bias.",
        "x_label": "time, h",
        "y_label": "residual, nA",
        "series": [_points("residual", hours, one.fit.residual)],
        "group": "residuals of the joint fit",
    }


def _width(one: ChannelFit) -> Figure:
    at = np.linspace(*one.fit.loop_degC, _POINTS)
    width, std = (np.array(column) for column in zip(*(width_at(one.fit, float(x)) for x in at), strict=True))
    reach = coverage_factor() * std
    band = {"label": "95 %", "x": _list(at), "low": _list((width - reach) * _nA), "high": _list((width + reach) * _nA)}
    naive = {"against the air": one.air_degC, "against the sensor": one.sensor_degC}
    lines = [_line(f"cubics {name}", at, one.naive(temperature, at)) for name, temperature in naive.items()]
    return {
        "title": _name(one),
        "caption": "Hysteresis width (falling minus rising): joint fit, and separate polynomials of the branches.",
        "x_label": "temperature, degC",
        "y_label": "width, nA",
        "series": [
            band | {"style": "band"},
            _line("joint fit", at, width),
            *(one for one in lines if one["x"]),
        ],
        "group": "hysteresis width",
    }


def master_clock_figure(fit: OscillatorFit, unit_degC: Floats) -> Figure:
    """Error of the master oscillator over temperature: what the cubic leaves."""
    known = np.isfinite(fit.residual_ppm)
    return {
        "title": "Master oscillator: residual of the cubic",
        "caption": f"Root mean square {fit.rms_ppm:.2g} ppm; the generator's own error is common to all windows.",
        "x_label": "temperature of the unit, degC",
        "y_label": "residual, ppm",
        "series": [
            {"label": "windows", "x": _list(unit_degC[known]), "y": _list(fit.residual_ppm[known]), "style": "points"}
        ],
    }


def _points(label: str, x: Floats, y_A: Floats) -> dict[str, Any]:
    return {"label": label, "x": _list(x), "y": _list(y_A * _nA), "style": "points"}


def _line(label: str, x: Floats, y_A: Floats) -> dict[str, Any]:
    known = np.isfinite(y_A)
    return {"label": label, "x": _list(x[known]), "y": _list(y_A[known] * _nA), "style": "line"}


def _list(values: Floats) -> list[float]:
    return [float(one) for one in values]
