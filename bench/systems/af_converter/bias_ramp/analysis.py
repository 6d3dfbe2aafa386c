"""The bias campaign: all channels with open inputs while the temperature goes up and down, and what to know of it.

Source: AF-converter paper section 4; docs/decisions/0006-bias-and-hysteresis.md.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np

from bench.analysis import Analysis, Figure, Material, unseen_table
from bench.model.errors import FitError
from bench.systems.af_converter.bias_ramp.departures import searches_of
from bench.systems.af_converter.bias_ramp.estimates import (
    DSF_STD,
    channel_estimates,
    compensation,
    master_clock_estimates,
    temperatures,
)
from bench.systems.af_converter.bias_ramp.fit import (
    FALLING,
    JOINT,
    RISING,
    ChannelFit,
    RampRecords,
    channel_readings,
    drive_of,
    fit_channel,
    fit_master_clock,
    ramp_records,
)
from bench.systems.af_converter.bias_ramp.fit import METHODS as FIT_METHODS
from bench.systems.af_converter.bias_ramp.noise import channel_noise, noise_estimates, noise_figures, noise_table
from bench.systems.af_converter.bias_ramp.report import (
    bias_budgets,
    components,
    estimators_of,
    figures,
    master_clock_figure,
    tables,
)
from bench.systems.af_converter.constants import Campaign, read_campaign
from bench.systems.af_converter.estimators.gates import Drive
from bench.systems.af_converter.estimators.hysteresis.fit import LAG
from bench.systems.af_converter.estimators.hysteresis.model import WIDTH
from bench.systems.af_converter.estimators.oscillator import OscillatorFit
from bench.systems.af_converter.wording import say

METHODS: tuple[str, ...] = FIT_METHODS


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
    drive = drive_of(material.trace, records, method)
    fits, missing = _fit_all(material, records, campaign, drive, method)
    clock = _master_clock(material, records, campaign, fits, missing)
    entries = [entry for channel in fits for entry in channel_estimates(channel, campaign, records.dropped)]
    noise = channel_noise(fits, records)
    entries += noise_estimates(noise)
    if clock is not None:
        entries += master_clock_estimates(clock, temperatures(fits[0]), records.dropped)
    searches = list(searches_of(fits, drive, entries))
    return Analysis(
        campaign=campaign.analysis,
        method=method,
        uut=campaign.uut,
        estimates=entries,
        components=components(fits, campaign),
        groups=_quality_of_fit(fits, records),
        notes=[
            *(say("note.no_result", what=sentence) for sentence in missing),
            *notes(fits, records, campaign, method),
        ],
        missing=missing,
        figures=figures(fits) + noise_figures(noise) + _clock_figures(clock, records),
        tables=[*tables(fits, campaign), *bias_budgets(fits, campaign), noise_table(noise), unseen_table(searches)],
        compensation=compensation(fits, clock),
        evidence=[seen for searched in searches for seen in searched.evidence],
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
    material: Material, records: RampRecords, campaign: Campaign, drive: Drive, method: str
) -> tuple[list[ChannelFit], list[str]]:
    """Fits of the channels that are determined, and one sentence for every other one."""
    readings = channel_readings(records, campaign)
    missing = [
        say("missing.channel", channel=channel.number)
        for channel in campaign.channels
        if channel.number not in readings
    ]
    lost = [name for name in (RISING, FALLING) if name not in records.branch]
    missing += [say("missing.branch", name=name) for name in lost]
    fits: list[ChannelFit] = []
    refused: list[FitError] = []
    for number, channel_windows in readings.items():
        try:
            fits.append(fit_channel(channel_windows, records, material.trace, drive, campaign, method))
        except FitError as error:
            refused.append(error)
            missing.append(say("missing.refused", channel=number, why=error.message, code=error.code))
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
    for channel in fits:
        if channel.sensor_problem:
            by_problem.setdefault(channel.sensor_problem, []).append(str(channel.readings.channel.number))
    return [
        say("missing.compensation", channels=", ".join(numbers), problem=problem)
        for problem, numbers in by_problem.items()
    ]


def _master_clock(
    material: Material, records: RampRecords, campaign: Campaign, fits: list[ChannelFit], missing: list[str]
) -> OscillatorFit | None:
    if any(channel.sensor_problem and np.isfinite(records.unit_degC).any() for channel in fits):
        missing.append(say("missing.oscillator_sensor"))
        return None
    try:
        return fit_master_clock(records, campaign, material.standards)
    except FitError as error:
        missing.append(say("missing.oscillator", why=error.message, code=error.code))
        return None


def _clock_figures(clock: OscillatorFit | None, records: RampRecords) -> list[Figure]:
    return [] if clock is None else [master_clock_figure(clock, records.unit_degC)]


def notes(fits: Sequence[ChannelFit], records: RampRecords, campaign: Campaign, method: str) -> list[str]:
    """Notes on windows left out, estimators, what was not determined, and what the uncertainties do not hold."""
    driver = say("ramp.driver.air" if method == JOINT else "ramp.driver.sensor")
    notes = [say("ramp.left_out", count=count, reason=reason) for reason, count in sorted(records.left_out.items())]
    without_sensor = any(channel.sensor_problem for channel in fits)
    notes.append(say("ramp.joint" if without_sensor else "ramp.joint_sensor", driver=driver))
    notes += _estimators(fits) + _naive(fits, campaign, method)
    for channel in fits:
        notes += _undetermined(channel)
    notes.append(say("ramp.nominal", ppm=DSF_STD * 1e6))
    if campaign.temperature_sensor_u95_degC is None:
        notes.append(say("note.sensor_not_stated"))
    return notes


def _estimators(fits: Sequence[ChannelFit]) -> list[str]:
    by_use: dict[str, list[int]] = {}
    for channel in fits:
        use = estimators_of(channel)
        by_use.setdefault(use, []).append(channel.readings.channel.number)
    return [say("ramp.estimators", channels=", ".join(map(str, numbers)), use=use) for use, numbers in by_use.items()]


def _naive(fits: Sequence[ChannelFit], campaign: Campaign, method: str) -> list[str]:
    """Say what separate polynomials make of the lag, where it matters most, and how much they leave out."""
    at = np.array([campaign.reference_temperature_degC])
    notes: list[str] = []
    apart = [(channel, float(channel.naive(channel.air_degC, at)[0])) for channel in fits]
    known = [(channel, value) for channel, value in apart if np.isfinite(value)]
    if known:
        channel, value = max(known, key=lambda pair: abs(pair[1] - pair[0].fit.value(WIDTH)))
        told = {"naive": value * 1e9, "channel": channel.readings.channel.number, "degC": at[0],
                "width": channel.fit.value(WIDTH) * 1e9}  # fmt: skip
        lag_min = channel.fit.value(LAG) / 60
        notes.append(say("ramp.naive_lag", lag=lag_min, **told) if method == JOINT else say("ramp.naive", **told))
        masked = sorted({channel.masked for channel in fits})
        span = say("ramp.masked_span", low=masked[0], high=masked[-1])
        notes.append(span if len(masked) > 1 else say("ramp.masked", count=masked[0]))
    return notes


def _undetermined(channel: ChannelFit) -> list[str]:
    number, fit = channel.readings.channel.number, channel.fit
    notes: list[str] = []
    if not fit.half_width_determined:
        width_nA, u_nA = fit.value(WIDTH) * 1e9, fit.std(WIDTH) * 1e9
        notes.append(say("ramp.no_half_width", channel=number, width=width_nA, u=u_nA))
    if not fit.lag_determined:
        notes.append(say("ramp.no_lag", channel=number, lag=fit.value(LAG) / 60, u=fit.std(LAG) / 60))
    return notes
