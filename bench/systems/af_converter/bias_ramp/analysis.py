"""The bias campaign: all channels with open inputs while the temperature goes up and down.

Source: AF-converter paper section 4; docs/decisions/0006-bias-and-hysteresis.md.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np

from bench.analysis import Analysis, Figure, Material
from bench.model.errors import FitError
from bench.systems.af_converter.bias_ramp.budget import bias_budgets
from bench.systems.af_converter.bias_ramp.clock import (
    fit_master_clock,
    master_clock_compensation,
    master_clock_estimates,
)
from bench.systems.af_converter.bias_ramp.estimates import channel_estimates, on_sensor, temperatures
from bench.systems.af_converter.bias_ramp.figures import figures, master_clock_figure
from bench.systems.af_converter.bias_ramp.fit import FALLING, RISING, ChannelFit, drive_of, fit_channel
from bench.systems.af_converter.bias_ramp.fit import METHODS as FIT_METHODS
from bench.systems.af_converter.bias_ramp.noise import channel_noise, noise_estimates, noise_figures, noise_table
from bench.systems.af_converter.bias_ramp.notes import notes
from bench.systems.af_converter.bias_ramp.records import RampRecords, channel_readings, ramp_records
from bench.systems.af_converter.bias_ramp.tables import components, tables
from bench.systems.af_converter.constants import Campaign, read_campaign
from bench.systems.af_converter.estimators.oscillator import OscillatorFit

METHODS: tuple[str, ...] = FIT_METHODS
_NO_LOOP = "; hysteresis width, play half-width and thermal lag are not stated without it"


def analyse(material: Material, method: str = METHODS[0]) -> Analysis:
    """Bias, hysteresis and thermal lag of every channel, and the master oscillator, over temperature.

    Args:    material: records of the ramp, temperatures of the run (preparation included), constants.
             method: "joint" (driven by the chamber's air) or "joint_unit_sensor" (driven by the unit's own sensor).
    Returns: Analysis. Channels that are not determined have no estimate and are named in ``missing`` and ``notes``.
    Raises:  FitError B-FIT-004, -008, -020, -022; that of the first channel if no channel at all is determined.
    Source:  docs/decisions/0006-bias-and-hysteresis.md.
    """
    campaign = read_campaign(material.campaign)
    records = ramp_records(material.rows, campaign.master_Hz)
    fits, missing = _fit_all(material, records, campaign, method)
    clock = _master_clock(material, records, campaign, fits, missing)
    limits = _limits(material.campaign)
    entries = [
        entry
        for channel in fits
        for entry in channel_estimates(channel, campaign, records.dropped, limits.get(channel.readings.channel.number))
    ]
    noise = channel_noise(fits, records)
    entries += noise_estimates(noise)
    if clock is not None:
        entries += master_clock_estimates(clock, temperatures(fits[0]), records.dropped)
    return Analysis(
        campaign=campaign.analysis,
        method=method,
        uut=dict(campaign.uut),
        estimates=entries,
        components=components(fits, campaign),
        groups=_quality_of_fit(fits, records),
        notes=[*(f"No result: {sentence}" for sentence in missing), *notes(fits, records, campaign, method)],
        missing=missing,
        figures=figures(fits) + noise_figures(noise) + _clock_figures(clock, records),
        tables=[*tables(fits, campaign), *bias_budgets(fits, campaign), noise_table(noise)],
        compensation=_compensation(fits, clock),
    )


def _quality_of_fit(fits: list[ChannelFit], records: RampRecords) -> list[dict[str, Any]]:
    return [
        {
            "channel": channel.readings.channel.number,
            "kind": channel.readings.channel.kind,
            "reduced_chi2": channel.fit.reduced_chi2,
            "dof": channel.fit.dof,
            "n": channel.readings.bias_A.size,
            "dropped": records.dropped,
        }
        for channel in fits
    ]


def _fit_all(
    material: Material, records: RampRecords, campaign: Campaign, method: str
) -> tuple[list[ChannelFit], list[str]]:
    """Fits of the channels that are determined, and one sentence for every other one."""
    drive = drive_of(material.trace, records, method)
    readings = channel_readings(records, campaign)
    missing = [f"channel {one.number}: no record" for one in campaign.channels if one.number not in readings]
    lost = [name for name in (RISING, FALLING) if name not in records.branch]
    missing += [f"branch {name}: no usable record{_NO_LOOP}" for name in lost]
    fits: list[ChannelFit] = []
    refused: list[FitError] = []
    for number, one in readings.items():
        try:
            fits.append(fit_channel(one, records, material.trace, drive, campaign, method))
        except FitError as error:
            refused.append(error)
            missing.append(f"channel {number}: {error.message} ({error.code})")
    missing += _without_sensor(fits)
    if not fits:
        raise (
            refused[0]
            if refused
            else FitError(
                "B-FIT-008",
                "the campaign declares no channel that the records hold",
                next_step="check the campaign section of the sequence the session was made with",
            )
        )
    return fits, missing


def _without_sensor(fits: list[ChannelFit]) -> list[str]:
    """Compensation goes by the unit's own sensor, so there is none without it."""
    by_problem: dict[str, list[str]] = {}
    for one in fits:
        if one.sensor_problem:
            by_problem.setdefault(one.sensor_problem, []).append(str(one.readings.channel.number))
    return [
        f"compensation of the bias, channel {', '.join(numbers)}: the unit's own sensor {problem}; temperatures of the "
        "results are the lagged ones of the fit"
        for problem, numbers in by_problem.items()
    ]


def _master_clock(
    material: Material, records: RampRecords, campaign: Campaign, fits: list[ChannelFit], missing: list[str]
) -> OscillatorFit | None:
    if any(one.sensor_problem and np.isfinite(records.unit_degC).any() for one in fits):
        missing.append("master oscillator: the unit's own sensor, over which it is stated, does not follow the unit")
        return None
    try:
        return fit_master_clock(records, campaign, material.standards)
    except FitError as error:
        missing.append(f"master oscillator: {error.message} ({error.code})")
        return None


def _clock_figures(clock: OscillatorFit | None, records: RampRecords) -> list[Figure]:
    return [] if clock is None else [master_clock_figure(clock, records.unit_degC)]


def _limits(campaign: Mapping[str, Any]) -> dict[int, float | None]:
    return {int(one["number"]): one.get("bias_stability_limit_A") for one in campaign["channels"]}


def _compensation(fits: list[ChannelFit], clock: OscillatorFit | None) -> list[dict[str, Any]]:
    found = [
        {
            "channel": one.readings.channel.number,
            "kind": one.readings.channel.kind,
            "parameter": "bias",
            "unit": "A",
            "reference_temperature_degC": one.fit.reference_degC,
            "coefficients": [float(value) for value in on_sensor(one)[0]],
            "valid_degC": [end + one.offset_degC for end in one.fit.loop_degC],
        }
        for one in fits
        if not one.sensor_problem
    ]
    return [*found, master_clock_compensation(clock)] if clock is not None else found
