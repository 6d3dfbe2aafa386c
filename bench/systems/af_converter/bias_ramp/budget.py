"""Uncertainty budgets of the biases of a ramp, and what they have in common.

The components are those of which ``bias_estimates`` makes the totals of results.json. The unit has one temperature
sensor, so its error moves the biases of all channels together.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from bench.analysis import Table
from bench.maths.budget import Component, combine_all
from bench.systems.af_converter.bias_ramp.estimates import DSF_STD, bias_parts, on_sensor
from bench.systems.af_converter.bias_ramp.fit import ChannelFit
from bench.systems.af_converter.budget_tables import budget_table, correlation_table
from bench.systems.af_converter.constants import Campaign

_nA, _PPM = 1e9, 1e6


def bias_budgets(fits: Sequence[ChannelFit], campaign: Campaign) -> list[Table]:
    """Budget of the bias at the reference temperature for the first channel of each kind, and the correlations.

    Source: JCGM 100:2008 sections 5.1 and 5.2; equal labels are one error (bench.maths.budget).
    """
    if not fits:
        return []
    combined = combine_all({_name(channel): bias_components(channel, campaign) for channel in fits})
    first = {channel.readings.channel.kind: channel for channel in reversed(fits)}
    at = f"{campaign.reference_temperature_degC:g} degC"
    tables = [
        budget_table(
            f"Uncertainty budget of the bias at {at}, channel {_name(channel)} ({kind})",
            "nA",
            float(on_sensor(channel)[0][0]) * _nA,
            combined.budgets[_name(channel)],
        )
        for kind, channel in sorted(first.items())
    ]
    caption = "Caused by the temperature sensor of the unit, which all channels share"
    title = f"Correlation of the bias at {at} between channels"
    return [*tables, correlation_table(title, caption, list(combined.budgets), combined.correlation)]


def bias_components(channel: ChannelFit, campaign: Campaign) -> list[Component]:
    """Return components of the bias of one channel at the reference temperature, in nA."""
    coefficients, _ = on_sensor(channel)
    parts = bias_parts(channel, np.eye(coefficients.size)[0], campaign)
    fit, nominal, sensor = parts
    return [
        Component(fit, parts[fit] * _nA, "nA", source="declared noise, through the fit"),
        Component(
            nominal, DSF_STD * _PPM, "ppm", float(coefficients[0]) * _nA / _PPM, source="design of the converter"
        ),
        Component(
            sensor,
            campaign.sensor_std_degC,
            "degC",
            float(coefficients[1]) * _nA,
            source="campaign file",
            common=sensor,
        ),
    ]


def _name(channel: ChannelFit) -> str:
    return str(channel.readings.channel.number)
