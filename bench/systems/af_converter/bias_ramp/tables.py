"""Tables of the report on a bias campaign: what lag does to the usual comparison, the fits, the budget."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from typing import Any

import numpy as np

from bench.analysis import Table
from bench.maths.verdict import coverage_factor
from bench.systems.af_converter.bias_ramp.estimates import bias_parts, on_sensor, temperatures
from bench.systems.af_converter.bias_ramp.fit import ChannelFit
from bench.systems.af_converter.constants import Campaign
from bench.systems.af_converter.estimators.hysteresis.fit import HALF_WIDTH, LAG
from bench.systems.af_converter.estimators.hysteresis.loop import width_at
from bench.systems.af_converter.estimators.hysteresis.model import WIDTH

_nA = 1e9


def tables(fits: Sequence[ChannelFit], campaign: Campaign) -> list[Table]:
    """Return all tables that have rows, in the order of the report."""
    return [table for table in (_fits(fits), _widths(fits), _budget(fits, campaign)) if table.rows]


def _fits(fits: Iterable[ChannelFit]) -> Table:
    rows = []
    for channel in (channel for channel in fits if channel.there_and_back):
        fit, k = channel.fit, coverage_factor()
        half = [_text(fit.value(HALF_WIDTH), 2), _text(k * fit.std(HALF_WIDTH), 2)]
        rows.append(
            [
                channel.readings.channel.number,
                ", ".join(f"{name} {count}" for name, count in channel.readings.estimators.items()),
                _text(fit.value(LAG) / 60.0, 2),
                _text(k * fit.std(LAG) / 60.0, 2),
                *(half if fit.half_width_determined else ["not determined", ""]),
                _text(fit.value(WIDTH) * _nA, 2),
                _text(k * fit.std(WIDTH) * _nA, 2),
                _text(channel.offset_degC, 3),
                channel.masked,
                _text(fit.reduced_chi2, 3),
            ]
        )
    caption = (
        "U at 95 %. Sensor: mean of the unit's own sensor minus the lagged temperature of the fit. Crossing: "
        "windows of the ramps after a reversal in which the play has not been crossed yet"
    )
    headers = [
        "channel", "windows by estimator", "lag, min", "U", "half-width r, degC", "U", "width, nA", "U",
        "sensor, degC", "crossing", "reduced chi-square",
    ]  # fmt: skip
    return Table("Joint fit of bias, hysteresis and thermal lag", caption, headers, rows)


def _widths(fits: Iterable[ChannelFit]) -> Table:
    rows = []
    for channel in (channel for channel in fits if channel.there_and_back):
        at_degC = np.array(temperatures(channel))
        air, sensor = channel.naive(channel.air_degC, at_degC), channel.naive(channel.sensor_degC, at_degC)
        for index, at in enumerate(at_degC.tolist()):
            value, std = width_at(channel.fit, at - channel.offset_degC)
            numbers = (value * _nA, coverage_factor() * std * _nA, air[index] * _nA, sensor[index] * _nA)
            rows.append([channel.readings.channel.number, at, *(_text(number, 2) for number in numbers)])
    return Table(
        "Hysteresis width: joint fit beside separate polynomials of the branches",
        "Falling minus rising, nA. A cubic for each branch against the chamber's air takes the lag of the unit for "
        "hysteresis, 2 x rate x lag x slope of the bias; against the unit's own sensor little of that is left. "
        "Windows in which the play still crosses are masked there. The loop closes at its ends",
        ["channel", "degC", "joint fit", "U", "cubics against the air", "cubics against the sensor"],
        rows,
    )


def _budget(fits: Iterable[ChannelFit], campaign: Campaign) -> Table:
    rows = []
    for channel in fits:
        coefficients, _ = on_sensor(channel)
        parts = bias_parts(channel, np.eye(coefficients.size)[0], campaign)
        rows += [[channel.readings.channel.number, name, f"{value * _nA:.3g}"] for name, value in parts.items()]
    reference = campaign.reference_temperature_degC
    title = f"Components of the bias at {reference:g} degC"
    caption = "Standard uncertainty, nA. The bias is the mean over the campaign of what walks at random"
    return Table(title, caption, ["channel", "component", "u, nA"], rows)


def components(fits: Iterable[ChannelFit], campaign: Campaign) -> list[dict[str, Any]]:
    """Budget of the bias at the reference temperature per kind: largest standard uncertainty over the channels."""
    largest: dict[tuple[str, str], float] = {}
    for channel in fits:
        coefficients, _ = on_sensor(channel)
        parts = bias_parts(channel, np.eye(coefficients.size)[0], campaign)
        parts["combined"] = float(np.linalg.norm(list(parts.values())))
        for name, value in parts.items():
            place = channel.readings.channel.kind, name
            largest[place] = max(largest.get(place, 0.0), value)
    return [
        {
            "kind": kind,
            "quantity": "bias",
            "component": name,
            "evaluation": "" if name == "combined" else "B",
            "distribution": "normal",
            "std_uncertainty_nA": value * _nA,
        }
        for (kind, name), value in largest.items()
    ]


def _text(value: float, digits: int) -> str:
    return f"{value:.{digits}f}" if np.isfinite(value) else "–"
