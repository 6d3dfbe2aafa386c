"""Noise of the bias: Allan deviation of what the joint fit leaves, and the noise terms in it.

White noise, bias instability and random walk are fitted; the readings hold next to no quantisation and the fit has
taken any ramp out, so of these two only an upper limit is given, from a fit of all five. Fitted together, five terms
share the few averaging times of a day so that white noise and walk are now and then read as quantisation and ramp.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from bench.analysis import Estimates, Figure, Floats, Table, estimate, series, significant
from bench.maths.allan import AllanDeviation, allan_deviation
from bench.maths.allan_terms import TERMS, UNITS, NoiseTerm, NoiseTerms, fit_noise_terms
from bench.model.errors import FitError
from bench.systems.af_converter.bias_ramp.fit import ChannelFit
from bench.systems.af_converter.bias_ramp.records import RampRecords
from bench.systems.af_converter.budget_tables import figures
from bench.systems.af_converter.wording import say

_nA = 1e9
_FITTED = ("white_noise", "bias_instability", "random_walk")
_CLEAR = 5.0  # standard uncertainties; a bias instability of 4 turned up in 2 of 10 channels that had none
_PER_ROOT_HOUR = 60.0  # from ampere per root second
_TAKEN = 0.14  # share of a random walk that the joint fit takes for temperature (simulated ramps, 0.3 nA after an hour)


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


def _series(channel: ChannelFit, records: RampRecords) -> tuple[Floats, float]:
    """Residuals on the grid of windows, NaN where one is missing, and the time from window to window."""
    pulses = records.pulses
    frames = int(np.median(pulses.frames + pulses.lost))
    place = (pulses.first_counter - pulses.first_counter[0]) // frames
    series = np.full(int(place[-1]) + 1, np.nan)
    series[place[channel.readings.used]] = channel.fit.residual
    return series, frames * float(np.median(pulses.frame_s))


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
    headers = [say(f"noise.head.{head}") for head in ("channel", "term", "unit", "coefficient", "u", "upper")]
    return Table(say("noise.title"), say("noise.caption"), headers, rows)


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
