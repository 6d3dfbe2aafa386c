"""Noise of the bias: Allan deviation of what the joint fit leaves, and the noise terms in it.

White noise, bias instability and random walk are fitted; the readings hold next to no quantisation and the fit has
taken any ramp out, so of these two only an upper limit is given, from a fit of all five. Fitted together, five terms
share the few averaging times of a day so that white noise and walk are now and then read as quantisation and ramp.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from bench.analysis import Estimates, Figure, Floats, Table, estimate, series, significant, worded_table
from bench.maths.allan import AllanDeviation, allan_deviation
from bench.maths.allan_terms import TERMS, UNITS, NoiseTerm, NoiseTerms, expected_deviation, fit_noise_terms
from bench.model.errors import FitError
from bench.systems.af_converter.bias_ramp.fit import ChannelFit, RampRecords
from bench.systems.af_converter.scale_factor.budgets import figures
from bench.systems.af_converter.wording import say

_nA = 1e9
_FITTED = ("white_noise", "bias_instability", "random_walk")
_CLEAR = 5.0  # standard uncertainties; a bias instability of 4 turned up in 2 of 10 channels that had none
_PER_ROOT_HOUR = 60.0  # from ampere per root second
_TAKEN = 0.11  # share of a random walk that the joint fit takes for temperature (simulated ramps, 0.3 nA after an hour)


@dataclass(frozen=True)
class ChannelNoise:
    """Allan deviation of a channel, the terms fitted to it, and all five together."""

    one: ChannelFit
    curve: AllanDeviation
    terms: NoiseTerms
    all_terms: NoiseTerms

    def term(self, name: str) -> NoiseTerm:
        """Return one of the five terms."""
        return (self.terms if name in _FITTED else self.all_terms)[name]


def channel_noise(fits: Sequence[ChannelFit], records: RampRecords) -> list[ChannelNoise]:
    """Allan deviations of all channels; one whose windows leave too few averaging times is left out."""
    noises = []
    for channel in fits:
        try:
            curve = allan_deviation(*_series(channel, records))
            noises.append(ChannelNoise(channel, curve, fit_noise_terms(curve, _FITTED), fit_noise_terms(curve)))
        except FitError:  # a short or broken ramp still has its bias; the table shows who is missing
            continue
    return noises


def declared_noise(fits: Sequence[ChannelFit], records: RampRecords) -> list[ChannelNoise]:
    """Return what ``channel_noise`` finds on average in windows without a gap that hold the declared noise.

    A bias instability of 0 is above 0 in half of all records, so the others are as uncertain as beside a free one.
    A channel without noise, or with too few windows for its terms, is left out.
    """
    noises = []
    for channel in fits:
        try:
            noises.append(_declared(channel, records))
        except FitError:
            continue
    return noises


def _declared(channel: ChannelFit, records: RampRecords) -> ChannelNoise:
    samples, interval_s = _grid(records)
    noise, gate_s = channel.readings.channel.noise, channel.readings.gates.end_s - channel.readings.gates.start_s
    counted_A2 = channel.readings.white_A**2 - noise.white_A_rtHz**2 / (2.0 * gate_s)
    terms = {
        "quantisation_noise": float(np.sqrt(np.median(np.maximum(counted_A2, 0.0) * gate_s**2) / 2.0)),
        "white_noise": noise.white_A_rtHz / float(np.sqrt(2.0)),
        "random_walk": noise.walk_A_rth / _PER_ROOT_HOUR,
    }
    curve = expected_deviation(terms, samples, interval_s)
    found = fit_noise_terms(curve, _FITTED)
    free = tuple(replace(term, std_uncertainty=term.free_std) for term in found.terms)
    return ChannelNoise(channel, curve, replace(found, terms=free), fit_noise_terms(curve))


def _grid(records: RampRecords) -> tuple[int, float]:
    """Return how many windows there are from the first to the last, missing ones too, and the time between them."""
    frames = _window_frames(records)
    first = records.pulses.first_counter
    return int((first[-1] - first[0]) // frames) + 1, frames * float(np.median(records.pulses.frame_s))


def _window_frames(records: RampRecords) -> int:
    return int(np.median(records.pulses.frames + records.pulses.lost))


def _series(channel: ChannelFit, records: RampRecords) -> tuple[Floats, float]:
    """Residuals on the grid of windows, NaN where one is missing, and the time from window to window."""
    samples, interval_s = _grid(records)
    place = (records.pulses.first_counter - records.pulses.first_counter[0]) // _window_frames(records)
    series = np.full(samples, np.nan)
    series[place[channel.readings.used]] = channel.fit.residual
    return series, interval_s


def noise_estimates(noises: Sequence[ChannelNoise]) -> Estimates:
    """White noise, bias instability and random walk of the channels that show them (IEEE Std 952 coefficients).

    ``white_noise`` is two-sided, as an angle random walk is: 1 / sqrt(2) of a one-sided density.
    """
    entries = []
    for noise in noises:
        channel = noise.one.readings.channel
        conditions = {"channel": channel.number, "kind": channel.kind}
        for term in map(noise.term, _FITTED):
            if _clear(term):
                scale, unit = (_PER_ROOT_HOUR, "A/h^0.5") if term.name == "random_walk" else (1.0, None)
                unit = unit or f"A{UNITS[term.name]}"
                value, std = scale * term.coefficient, scale * term.std_uncertainty
                if term.name == "random_walk":
                    std = float(np.hypot(std, _TAKEN * value))
                entries.append(estimate(term.name, unit, value, std, conditions, n=noise.one.readings.bias_A.size))
    return entries


def _clear(term: NoiseTerm) -> bool:
    return term.significant and term.coefficient > _CLEAR * term.std_uncertainty


def noise_table(noises: Sequence[ChannelNoise]) -> Table:
    """Return all five terms of all channels, those that are not seen with their upper limit."""
    rows = []
    for noise in noises:
        number = noise.one.readings.channel.number
        for term in map(noise.term, TERMS):
            seen = [figures(term.coefficient * _nA), significant(term.std_uncertainty * _nA)]
            shown = seen if term.name in _FITTED and _clear(term) else [say("noise.not_seen"), ""]
            rows.append(
                [
                    number,
                    say(f"noise.term.{term.name}"),
                    f"nA{UNITS[term.name]}",
                    *shown,
                    figures(term.upper_limit * _nA),
                ]
            )
    return worded_table(say, "noise", ["channel", "term", "unit", "coefficient", "u", "upper"], rows)


def noise_figures(noises: Sequence[ChannelNoise]) -> list[Figure]:
    """Allan deviation of each channel with its interval and the fitted terms."""
    return [_figure(noise) for noise in noises]


def _figure(noise: ChannelNoise) -> Figure:
    curve = noise.curve
    deviation, low, high = (_nA * ends for ends in (curve.deviation, curve.low, curve.high))
    return Figure(
        say("channel", channel=noise.one.readings.channel.number),
        say("noise.figure"),
        say("noise.x"),
        say("noise.y"),
        [
            series(say("noise.measured"), curve.tau_s, deviation, "points", low=low, high=high),
            series(say("noise.fitted"), curve.tau_s, _nA * noise.terms.fitted),
        ],
        x_log=True,
        y_log=True,
        group="Allan deviation of the bias",
    )
