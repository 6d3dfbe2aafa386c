"""Estimates of a bias ramp before its first hour: its own fit of the windows that a typical unit gives without noise.

Noise is the declared one, which the fit uses anyway. Width, half-width and lag of a unit without any are not
determined by any ramp, so those of the unit are declared, and what is predicted holds for such a one.
Source: docs/method-uncertainty.md.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np

from bench.analysis import Estimates, Floats, Planned, Prediction
from bench.model.clock import NS
from bench.model.errors import FitError
from bench.model.ports import RecordWindow
from bench.record import RecordRow
from bench.systems.af_converter.bias_ramp.estimates import channel_estimates, master_clock_estimates, temperatures
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
from bench.systems.af_converter.bias_ramp.noise import declared_noise, noise_estimates
from bench.systems.af_converter.constants import Campaign, Typical, read_campaign
from bench.systems.af_converter.estimators.gates import Drive, usable_drive
from bench.systems.af_converter.estimators.hysteresis.model import Gates, HysteresisModel, ModelShape
from bench.systems.af_converter.estimators.readings import TIMING
from bench.systems.af_converter.nominal import Counted, columns, nominal_row, pulses_in, window_s
from bench.systems.af_converter.wording import kind_name, say

_nA = 1e9
_OF_THE_CURVE = ("master_clock_error_tc1", "master_clock_error_tc2", "master_clock_error_tc3")
_OF_BOTH_BRANCHES = ("play_half_width", "thermal_lag")
_NOISE = ("white_noise", "random_walk")
_POLARITIES = ("npp", "ppp")


@dataclass(frozen=True)
class _Unit:
    """A typical unit: what its channels of each kind do, and its lag. ``drive``: planned air."""

    kinds: Mapping[str, Typical]
    lag_s: float
    drive: Drive
    reference_degC: float

    def model(self, gates: Gates) -> HysteresisModel:
        """Return the model of the fit over some gates."""
        return HysteresisModel(gates, self.drive, ModelShape(reference_degC=self.reference_degC))

    def bias_A(self, kind: str, gates: Gates) -> Floats:
        """Return the bias of a kind of channel, mean over each gate, (m,)."""
        typical = self.kinds[kind]
        linear = [typical.bias_A, typical.bias_tc1_A_degC, 0.0, 0.0, typical.hysteresis_width_A]
        return self.model(gates).columns(self.lag_s, typical.play_half_width_degC) @ linear


@dataclass(frozen=True)
class Fitted:
    """One channel of each kind, fitted as it will be; ``drive``: of the fits.   ``missing``: what they do not give."""

    constants: Campaign
    records: RampRecords
    unit: _Unit
    drive: Drive
    fits: Mapping[str, ChannelFit]
    missing: Sequence[str]


def fitted(planned: Planned) -> Fitted | None:
    """Return the fits of what a unit as its data sheet says will give, None if that does not say enough.

    Raises:  FitError as ``analysis.analyse``, where no channel at all is determined.
    """
    constants = read_campaign(planned.campaign)
    kinds = {channel.kind: channel.typical for channel in constants.channels if channel.typical is not None}
    if not kinds or constants.thermal_lag_s is None:
        return None
    planned_air = usable_drive(planned.trace.t_s, planned.trace.air_degC)
    unit = _Unit(kinds, constants.thermal_lag_s, planned_air, constants.reference_temperature_degC)
    records = ramp_records(list(_rows(planned, constants, unit)), constants.master_Hz)
    drive = drive_of(planned.trace, records, JOINT)
    return Fitted(constants, records, unit, drive, *_fit_kinds(planned, records, constants, unit, drive))


def predicted(planned: Planned) -> Prediction:
    """Return estimates with the uncertainties that a ramp will give to a unit as its data sheet says.

    Raises:  FitError as ``analysis.analyse``, where no channel at all is determined.
    """
    ramp = fitted(planned)
    if ramp is None:
        return Prediction([], [say("predicted.no_unit")])
    entries = channels_predicted(ramp)
    if ramp.fits:
        entries += _clock(planned, ramp.records, ramp.constants, temperatures(next(iter(ramp.fits.values()))))
    lost = [name for name in (RISING, FALLING) if name not in ramp.records.branch]
    missing = [*ramp.missing, *(say("missing.branch", name=name) for name in lost)]
    undetermined = _undetermined(ramp.fits, entries)
    missing += [say("predicted.no_curve")] if ramp.fits and ramp.constants.master_curve_ppm is None else []
    return Prediction(entries, [*missing, *undetermined], _assumed(ramp.unit, ramp.constants))


def channels_predicted(ramp: Fitted) -> Estimates:
    """Return what is predicted of all channels of the kinds that are fitted."""
    entries: Estimates = []
    for channel in ramp.constants.channels:
        if channel.kind in ramp.fits:
            fit = ramp.fits[channel.kind]
            of_channel = replace(fit, readings=replace(fit.readings, channel=channel))
            entries += channel_estimates(of_channel, ramp.constants, ramp.records.dropped)
            entries += noise_estimates(declared_noise([of_channel], ramp.records))
    return entries


def _clock(planned: Planned, records: RampRecords, constants: Campaign, at_degC: Sequence[float]) -> Estimates:
    """Return what is predicted of the master oscillator: the error of the sensor counts as its curve is steep."""
    clock, curve_ppm = fit_master_clock(records, constants, planned.standards), constants.master_curve_ppm
    if curve_ppm is not None:
        clock = replace(clock, coefficients_ppm=np.array([0.0, *curve_ppm]))
    known = master_clock_estimates(clock, at_degC, records.dropped)
    return [entry for entry in known if curve_ppm is not None or entry.quantity not in _OF_THE_CURVE]


def _undetermined(fits: Mapping[str, ChannelFit], entries: Estimates) -> Iterator[str]:
    """Yield a sentence on each quantity of a kind that the ramp does not tell."""
    for kind, channel in fits.items():
        told = {entry.quantity for entry in entries if entry.conditions.get("kind") == kind}
        expected = _OF_BOTH_BRANCHES + _NOISE if channel.there_and_back else _NOISE
        for quantity in expected:
            if quantity not in told:
                yield say("predicted.not_told", kind=kind_name(kind), quantity=quantity)


def _fit_kinds(
    planned: Planned, records: RampRecords, constants: Campaign, unit: _Unit, drive: Drive
) -> tuple[dict[str, ChannelFit], list[str]]:
    """Fit one channel of each kind: all channels of a kind are declared alike."""
    first = {channel.kind: channel.number for channel in reversed(constants.channels)}
    readings = channel_readings(records, constants)
    fits: dict[str, ChannelFit] = {}
    missing = []
    for kind, number in first.items():
        if kind not in unit.kinds:
            missing.append(say("predicted.no_kind", kind=kind_name(kind)))
            continue
        exact = replace(readings[number], bias_A=unit.bias_A(kind, readings[number].gates))
        try:
            fits[kind] = fit_channel(exact, records, planned.trace, drive, constants, JOINT)
        except FitError as error:
            missing.append(say("predicted.refused", kind=kind_name(kind), why=error.message, code=error.code))
    return fits, missing


def _rows(planned: Planned, constants: Campaign, unit: _Unit) -> Iterator[RecordRow]:
    """Yield the windows of the ramp as a typical unit gives them, pulses of all its channels timed where planned."""
    windows = [window for window in planned.windows if "branch" in window.conditions]
    if not windows:
        return
    gates = Gates(*(np.array([[window.t_start_ns, window.t_end_ns] for window in windows]).T / NS))
    degC = unit.model(gates).unit_degC(unit.lag_s)
    kinds = {kind: next(channel for channel in constants.channels if channel.kind == kind) for kind in unit.kinds}
    pulses = {kind: _pulses(windows, -unit.bias_A(kind, gates), channel.k0_C) for kind, channel in kinds.items()}
    for index, window in enumerate(windows):
        of_kinds = {kind: of_windows[index] for kind, of_windows in pulses.items()}
        counted = _counted(of_kinds, constants, timed=window.number in planned.timed)
        yield nominal_row(window, counted, float(degC[index]), constants)


def _pulses(windows: Sequence[RecordWindow], current_A: Floats, k0_C: float) -> list[tuple[str, dict[str, int]]]:
    """Return polarity, count and timing of the pulses in each window, whose current is steady, (m,)."""
    grown = np.abs(current_A) / k0_C * [window_s(window) for window in windows]
    before = np.cumsum(grown) - grown
    names = np.where(current_A > 0, "npp", "ppp")
    return [
        (str(name), pulses_in(float(phase), float(more), window))
        for name, phase, more, window in zip(names, before, grown, windows, strict=True)
    ]


def _counted(of_kinds: Mapping[str, tuple[str, Mapping[str, int]]], constants: Campaign, *, timed: bool) -> Counted:
    """Return what all channels count in a window, by the pulses of their kind."""
    sums = {name: np.zeros(columns(constants), dtype=np.int64) for name in _POLARITIES}
    none = np.full(columns(constants), -1, dtype=np.int64)
    timing = {f"{name}.{key}": none.copy() for name in _POLARITIES for key in TIMING}
    for channel in constants.channels:
        if channel.kind in of_kinds:
            name, found = of_kinds[channel.kind]
            sums[name][channel.number - 1] = found["count"]
            for key in TIMING:
                timing[f"{name}.{key}"][channel.number - 1] = found[key]
    return Counted(sums, timing if timed else {})


def _assumed(unit: _Unit, constants: Campaign) -> list[str]:
    """Return a sentence on each kind of channel that the prediction holds for, and one on the master oscillator."""
    curve_ppm = constants.master_curve_ppm
    of_curve = (
        [] if curve_ppm is None else [say("predicted.curve", tc1=curve_ppm[0], tc2=curve_ppm[1], tc3=curve_ppm[2])]
    )
    return of_curve + [
        say(
            "predicted.unit",
            kind=kind_name(kind),
            bias=_nA * typical.bias_A,
            tc1=_nA * typical.bias_tc1_A_degC,
            width=_nA * typical.hysteresis_width_A,
            half=typical.play_half_width_degC,
            lag=unit.lag_s / 60.0,
        )
        for kind, typical in unit.kinds.items()
    ]
