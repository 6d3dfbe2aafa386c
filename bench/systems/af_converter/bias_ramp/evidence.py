"""What the windows of a bias ramp say against the joint fit of their channel.

Residuals must be no larger than the declared noise, and none of the short list of rivals (step, drift, second thermal
lag, several play operators) may describe the windows better than chance lets it.
Source: docs/decisions/0025-doubt.md.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
from scipy import special

from bench.analysis import LEAST_MOVE, Evidence
from bench.maths.verdict import coverage_factor
from bench.systems.af_converter.bias_ramp.fit import ChannelFit
from bench.systems.af_converter.estimators.hysteresis import rivals
from bench.systems.af_converter.estimators.hysteresis.fit import HALF_WIDTH, LAG
from bench.systems.af_converter.estimators.hysteresis.model import WIDTH, HysteresisModel, ModelShape
from bench.systems.af_converter.estimators.hysteresis.search import Problem
from bench.systems.af_converter.estimators.thermal_lag import Drive
from bench.systems.af_converter.wording import say

CHECKS = 5  # of a channel: the misfit and four rivals
_BLOCKS = 12  # of an influence
_SMALLEST = 1e-300
_LAGS_s = (30.0, 21_600.0)
_nA = 1e9


def evidence(fits: Sequence[ChannelFit], drive: Drive) -> list[Evidence]:
    """Return what every check of every channel says, those that found nothing included."""
    return [seen for channel in fits for seen in _of_channel(channel, drive)]


def listed_rivals(channel: ChannelFit, drive: Drive) -> tuple[rivals.Base, list[rivals.Rival]]:
    """Return the fit of a channel in first order, and the rivals it is held against."""
    fit, readings = channel.fit, channel.readings
    shape = ModelShape(reference_degC=fit.reference_degC, order=fit.order)
    problem = Problem(HysteresisModel(readings.gates, drive, shape), readings.bias_A, readings.noise.whiten)
    base = rivals.base_of(problem, fit.value(LAG), fit.value(HALF_WIDTH), (LAG, HALF_WIDTH))
    middle_s = readings.gates.middle_s
    lag_s = fit.value(LAG)
    listed = [
        *(rivals.steps(middle_s), rivals.drift(middle_s)),
        *(rivals.second_lag(problem, lag_s, _LAGS_s), rivals.several_plays(problem, lag_s)),
    ]
    return base, listed


def _of_channel(channel: ChannelFit, drive: Drive) -> list[Evidence]:
    base, listed = listed_rivals(channel, drive)
    outcomes = rivals.compare(base, listed, [rivals.Noise(channel.readings.noise.whiten)])
    return [_misfit(channel, base), *(_rival(channel, outcome) for outcome in outcomes)]


def _about(channel: ChannelFit) -> dict[str, Any]:
    return {"channel": channel.readings.channel.number}


def moves(channel: ChannelFit, shift: Mapping[str, float]) -> dict[str, float]:
    """Return by how much of its expanded uncertainty of the fit each quantity moves with the parameters.

    What is not stated does not move; the bias moves as its worst coefficient does.
    """
    fit = channel.fit
    moved = {name: abs(shift[name]) / (coverage_factor() * fit.std(name)) for name in shift if fit.std(name) > 0.0}
    found = {"bias": max(moved.get(f"b{k}", 0.0) for k in range(fit.order + 1))}
    found["bias_residual"] = found["bias"]
    if channel.there_and_back:
        found["hysteresis_width"] = moved.get(WIDTH, 0.0)
    if fit.lag_determined:
        found["thermal_lag"] = moved.get(LAG, 0.0)
    if fit.half_width_determined:
        found["play_half_width"] = moved.get(HALF_WIDTH, 0.0)
    return found


def _misfit(channel: ChannelFit, base: rivals.Base) -> Evidence:
    """Return whether the residuals are larger than declared, and how far one stretch of time carries the result."""
    fit = channel.fit
    probability = float(special.chdtrc(fit.dof, fit.chi2))
    worst = _carried(channel, base)
    sentence = say("evidence.misfit", channel=channel.readings.channel.number, chi2=fit.reduced_chi2)
    return Evidence(
        "lack_of_fit", sentence, fit.reduced_chi2, max(probability, _SMALLEST), max(worst.values()),
        _bearing(worst, everything=True), _about(channel),
    )  # fmt: skip


def _carried(channel: ChannelFit, base: rivals.Base) -> dict[str, float]:
    """Return the largest move of each quantity when one of twelve stretches of time is left out."""
    whiten = channel.readings.noise.whiten
    worst: dict[str, float] = {}
    for block in np.array_split(np.arange(base.residual.size), _BLOCKS):
        left_out = np.zeros((base.residual.size, block.size))
        left_out[block, np.arange(block.size)] = 1.0  # a column of its own takes each reading out
        design = whiten(np.column_stack((base.columns, left_out)))
        scale = np.linalg.norm(design, axis=0)
        scale = np.where(scale > 0, scale, 1.0)
        solved = np.linalg.lstsq(design / scale, whiten(base.residual), rcond=1e-10)[0] / scale
        shift = dict(zip(base.names, solved[: len(base.names)].tolist(), strict=True))
        for name, moved in moves(channel, shift).items():
            worst[name] = max(worst.get(name, 0.0), moved)
    return worst


def _bearing(moved: dict[str, float], *, everything: bool = False) -> tuple[str, ...]:
    """Return the quantities that move enough to be doubted; all of them if none does, or if they share a misfit."""
    enough = tuple(name for name, move in moved.items() if move > LEAST_MOVE)
    return tuple(moved) if everything or not enough else enough


def _rival(channel: ChannelFit, outcome: rivals.Outcome) -> Evidence:
    moved = moves(channel, outcome.shift)
    code, width_nA = rivals.code_of(outcome.name), _nA * (channel.fit.value(WIDTH) + outcome.shift[WIDTH])
    sentence = say(
        "evidence.rival",
        name=say(code, place=outcome.place),
        channel=channel.readings.channel.number,
        gain=outcome.gain,
        width=width_nA,
    )
    return Evidence(
        code, sentence, outcome.gain,
        max(outcome.probability, _SMALLEST), max(moved.values()), _bearing(moved), _about(channel),
    )  # fmt: skip
