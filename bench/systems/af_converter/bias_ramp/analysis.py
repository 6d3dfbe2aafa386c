"""The bias campaign: all channels with open inputs while the temperature goes up and down, and what to know of it.

Source: AF-converter paper section 4; docs/method-af-converter.md.

Tables and figures of the report on a bias campaign: what lag does to the usual comparison, the fits, the budgets.

The components of a budget are those of which ``estimates`` makes the totals of results.json. The unit has one
temperature sensor, so its error moves the biases of all channels together.
"""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from typing import Any

import numpy as np

from bench.analysis import (
    Analysis,
    Figure,
    Floats,
    Material,
    Series,
    Table,
    band,
    evidence_of,
    series,
    unseen_tables,
    worded_figure,
    worded_table,
)
from bench.maths.budget import Component, combine_all
from bench.maths.verdict import coverage_factor
from bench.model.errors import FitError
from bench.systems.af_converter.bias_ramp.departures import searches_of
from bench.systems.af_converter.bias_ramp.estimates import (
    DSF_STD,
    bias_parts,
    channel_estimates,
    compensation,
    master_clock_estimates,
    on_sensor,
    temperatures,
)
from bench.systems.af_converter.bias_ramp.fit import (
    FALLING,
    JOINT,
    METHODS,
    RISING,
    ChannelFit,
    RampRecords,
    channel_readings,
    drive_of,
    fit_channel,
    fit_master_clock,
    ramp_records,
)
from bench.systems.af_converter.bias_ramp.noise import channel_noise, noise_estimates, noise_figures, noise_table
from bench.systems.af_converter.constants import Campaign, read_campaign
from bench.systems.af_converter.estimators.gates import Drive
from bench.systems.af_converter.estimators.hysteresis.fit import HALF_WIDTH, LAG, branch_curves, width_at
from bench.systems.af_converter.estimators.hysteresis.model import WIDTH
from bench.systems.af_converter.estimators.oscillator import OscillatorFit
from bench.systems.af_converter.scale_factor.budgets import budget_table, correlation_table
from bench.systems.af_converter.wording import kind_name, say

_nA, _PPM = 1e9, 1e6
_POINTS = 121
_COMBINED = say("component.combined")
_JOINT = ("channel", "windows", "lag", "U", "half_width", "U", "width", "U", "sensor", "crossing", "chi2")


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
                estimators_of(channel),
                _text(fit.value(LAG) / 60.0, 2),
                _text(k * fit.std(LAG) / 60.0, 2),
                *(half if fit.half_width_determined else [say("joint.undetermined"), ""]),
                _text(fit.value(WIDTH) * _nA, 2),
                _text(k * fit.std(WIDTH) * _nA, 2),
                _text(channel.offset_degC, 3),
                channel.masked,
                _text(fit.reduced_chi2, 3),
            ]
        )
    return worded_table(say, "joint", _JOINT, rows)


def estimators_of(channel: ChannelFit) -> str:
    """Return how many windows each estimator of the current gave."""
    return say.listed(say(f"estimator.{name}", count=count) for name, count in channel.readings.estimators.items())


def _widths(fits: Iterable[ChannelFit]) -> Table:
    rows = []
    for channel in (channel for channel in fits if channel.there_and_back):
        at_degC = np.array(temperatures(channel))
        air, sensor = channel.naive(channel.air_degC, at_degC), channel.naive(channel.sensor_degC, at_degC)
        for index, at in enumerate(at_degC.tolist()):
            value, std = width_at(channel.fit, at - channel.offset_degC)
            numbers = (value * _nA, coverage_factor() * std * _nA, air[index] * _nA, sensor[index] * _nA)
            rows.append([channel.readings.channel.number, f"{at:g}", *(_text(number, 2) for number in numbers)])
    return worded_table(say, "widths", ["channel", "degC", "joint", "U", "air", "sensor"], rows)


def _budget(fits: Iterable[ChannelFit], campaign: Campaign) -> Table:
    rows = []
    for channel in fits:
        coefficients, _ = on_sensor(channel)
        parts = bias_parts(channel, np.eye(coefficients.size)[0], campaign)
        rows += [[channel.readings.channel.number, name, f"{value * _nA:.3g}"] for name, value in parts.items()]
    reference = campaign.reference_temperature_degC
    return worded_table(say, "components", ["channel", "component", "u"], rows, degC=reference)


def components(fits: Iterable[ChannelFit], campaign: Campaign) -> list[dict[str, Any]]:
    """Budget of the bias at the reference temperature per kind: largest standard uncertainty over the channels."""
    largest: dict[tuple[str, str], float] = {}
    for channel in fits:
        coefficients, _ = on_sensor(channel)
        parts = bias_parts(channel, np.eye(coefficients.size)[0], campaign)
        parts[_COMBINED] = float(np.linalg.norm(list(parts.values())))
        for name, value in parts.items():
            place = channel.readings.channel.kind, name
            largest[place] = max(largest.get(place, 0.0), value)
    return [
        {
            "kind": kind_name(kind),
            "quantity": "bias",
            "component": name,
            "evaluation": "" if name == _COMBINED else "B",
            "distribution": say("budget.normal"),
            "std_uncertainty_nA": value * _nA,
        }
        for (kind, name), value in largest.items()
    ]


def _text(value: float, digits: int) -> str:
    return f"{value:.{digits}f}" if np.isfinite(value) else "–"


def bias_budgets(fits: Sequence[ChannelFit], campaign: Campaign) -> list[Table]:
    """Budget of the bias at the reference temperature for the first channel of each kind; correlations, if several.

    Source: JCGM 100:2008 sections 5.1 and 5.2; equal labels are one error (bench.maths.budget).
    """
    if not fits:
        return []
    combined = combine_all({_number(channel): bias_components(channel, campaign) for channel in fits})
    first = {channel.readings.channel.kind: channel for channel in reversed(fits)}
    at = campaign.reference_temperature_degC
    tables = [
        budget_table(
            say("bias.budget_title", degC=at, channel=_number(channel), kind=kind_name(kind)),
            "nA",
            float(on_sensor(channel)[0][0]) * _nA,
            combined.budgets[_number(channel)],
        )
        for kind, channel in sorted(first.items(), key=lambda example: example[1].readings.channel.number)
    ]
    if len(fits) == 1:
        return tables
    title, caption = say("bias.correlation_title", degC=at), say("bias.correlation_caption")
    return [*tables, correlation_table(title, caption, list(combined.budgets), combined.correlation)]


def bias_components(channel: ChannelFit, campaign: Campaign) -> list[Component]:
    """Return components of the bias of one channel at the reference temperature, in nA."""
    coefficients, _ = on_sensor(channel)
    parts = bias_parts(channel, np.eye(coefficients.size)[0], campaign)
    fit, nominal, sensor, *gradient = parts
    return [
        Component(fit, parts[fit] * _nA, "nA", source=say("source.noise")),
        Component(nominal, DSF_STD * _PPM, "ppm", float(coefficients[0]) * _nA / _PPM, source=say("source.design")),
        Component(
            sensor,
            campaign.sensor_std_degC,
            "degC",
            float(coefficients[1]) * _nA,
            source=say("source.campaign"),
            common=sensor,
        ),
        *(
            Component(
                name,
                campaign.gradient_std_degC,
                "degC",
                float(coefficients[1]) * _nA,
                source=say("source.slot"),
                common=name,
            )
            for name in gradient
        ),
    ]


def _number(channel: ChannelFit) -> str:
    return str(channel.readings.channel.number)


def figures(fits: Sequence[ChannelFit]) -> list[Figure]:
    """Per channel: bias over temperature with both branches of the fit, what the fit leaves, width over temperature."""
    return [draw(channel) for draw in (_loop, _residual, _width) for channel in fits]


def _name(channel: ChannelFit) -> str:
    return say("channel", channel=channel.readings.channel.number)


def _loop(channel: ChannelFit) -> Figure:
    at = np.linspace(*channel.fit.loop_degC, _POINTS)
    rising, falling = branch_curves(channel.fit, at)
    measured = [
        _points(
            say(f"loop.measured_{name}"),
            channel.fit.unit_degC[channel.branch == name],
            channel.readings.bias_A[channel.branch == name],
        )
        for name in (RISING, FALLING)
    ]
    parts = [*measured, _line(say("loop.fit_up"), at, rising), _line(say("loop.fit_down"), at, falling)]
    x, y = say("loop.x"), say("loop.y")
    return Figure(_name(channel), say("loop.caption"), x, y, parts, group="bias over temperature")


def _residual(channel: ChannelFit) -> Figure:
    hours = (channel.readings.gates.middle_s - channel.readings.gates.start_s[0]) / 3600.0
    parts = [_points(say("left.series"), hours, channel.fit.residual)]
    x, y = say("left.x"), say("left.y")
    return Figure(_name(channel), say("left.caption"), x, y, parts, group="residuals of the joint fit")


def _width(channel: ChannelFit) -> Figure:
    at = np.linspace(*channel.fit.loop_degC, _POINTS)
    width, std = (np.array(column) for column in zip(*(width_at(channel.fit, float(x)) for x in at), strict=True))
    reach = coverage_factor() * std
    naive = {"air": channel.air_degC, "sensor": channel.sensor_degC}
    lines = [
        _line(say(f"widths.head.{name}"), at, channel.naive(temperature, at)) for name, temperature in naive.items()
    ]
    parts = [
        band("95 %", at, (width - reach) * _nA, (width + reach) * _nA),
        _line(say("widths.head.joint"), at, width),
        *(line for line in lines if line.x),
    ]
    x, y = say("width.x"), say("width.y")
    return Figure(_name(channel), say("width.caption"), x, y, parts, group="hysteresis width")


def master_clock_figure(fit: OscillatorFit, unit_degC: Floats) -> Figure:
    """Error of the master oscillator over temperature: what the cubic leaves."""
    known = np.isfinite(fit.residual_ppm)
    parts = [series(say("oscillator.windows"), unit_degC[known], fit.residual_ppm[known], "points")]
    return worded_figure(say, "oscillator", ("oscillator.x", "oscillator.y"), parts, rms=fit.rms_ppm)


def _points(label: str, x: Floats, y_A: Floats) -> Series:
    return series(label, x, y_A * _nA, "points")


def _line(label: str, x: Floats, y_A: Floats) -> Series:
    known = np.isfinite(y_A)
    return series(label, x[known], y_A[known] * _nA)


def analyse(material: Material, method: str = METHODS[0]) -> Analysis:
    """Bias, hysteresis and thermal lag of every channel, and the master oscillator, over temperature.

    Args:    material: records of the ramp, temperatures of the run (preparation included), constants.
             method: "joint" (driven by the chamber's air) or "joint_unit_sensor" (driven by the unit's own sensor).
    Returns: Analysis. Channels that are not determined have no estimate and are named in ``missing`` and ``notes``.
    Raises:  FitError B-FIT-008, -020, -022; that of the first channel if no channel at all is determined.
    Source:  docs/method-af-converter.md.
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
        campaign.analysis,
        method,
        campaign.uut,
        entries,
        components=components(fits, campaign),
        groups=_quality_of_fit(fits, records),
        notes=[
            *(say("note.no_result", what=sentence) for sentence in missing),
            *notes(fits, records, campaign, method),
        ],
        missing=missing,
        figures=figures(fits)
        + noise_figures(noise)
        + ([] if clock is None else [master_clock_figure(clock, records.unit_degC)]),
        tables=[*tables(fits, campaign), *bias_budgets(fits, campaign), noise_table(noise), *unseen_tables(searches)],
        compensation=compensation(fits, clock),
        evidence=evidence_of(searches),
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
