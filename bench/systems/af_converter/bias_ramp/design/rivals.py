"""How surely a ramp would show what else could be true, at the size that puts its results off.

A rival is a column beside the fit of a nominal ramp in first order; the fit says how far it moves a result and what it
leaves for the checks to see. Both scale with the size.
Source: docs/decisions/0049-the-shortest-plan.md; likelihood ratio of further columns; noncentral chi-square: Scheffé,
The Analysis of Variance (1959), 2.8.
"""

from __future__ import annotations

import math
from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np
from scipy import special

from bench.analysis import FALSE_DOUBT, Estimates, Floats
from bench.design import Power
from bench.systems.af_converter.bias_ramp.evidence import listed_rivals
from bench.systems.af_converter.bias_ramp.fit import ChannelFit
from bench.systems.af_converter.bias_ramp.predicted import Fitted
from bench.systems.af_converter.estimators.hysteresis.fit import HALF_WIDTH, LAG
from bench.systems.af_converter.estimators.hysteresis.model import WIDTH
from bench.systems.af_converter.estimators.hysteresis.rivals import PLAYS, Rival

PARAMETERS = {  # of the fit, and how many of its unit are one of the estimate's
    "bias": ("b0", 1.0),
    "bias_tc1": ("b1", 1.0),
    "hysteresis_width": (WIDTH, 1.0),
    "play_half_width": (HALF_WIDTH, 1.0),
    "thermal_lag": (LAG, 60.0),
}
_NOT_MISSED = 1e3  # noncentrality: seen by any check
_SMALLEST = 1e-300
_RANK = 1e-9
_DAY_h, _HOURS = 24.0, 12  # half a day later the same rhythm begins with the other sign
_BELIEVED = 1.5  # expanded uncertainties off, from which on a sound result counts as wrong


@dataclass(frozen=True)
class _Effect:
    """``left``: whitened, what the fit leaves of each column, (m, k).   ``moves``: of each parameter, (p, k)."""

    left: Floats
    moves: Floats


class Rivals:
    """The fit of one channel in first order, and what could stand beside it. ``checks``: of the campaign, which share
    the chance of a false doubt; ``entries``: of the ramp, which hold U.
    """

    def __init__(self, channel: ChannelFit, ramp: Fitted, entries: Estimates, checks: int) -> None:
        """Whiten the columns of the fit and those of its rivals."""
        self._channel, self._checks = channel, checks
        self._base, self._listed = listed_rivals(channel, ramp.drive)
        white = channel.readings.noise.whiten(self._base.columns)
        self._scale = np.linalg.norm(white, axis=0)
        self._basis, self._triangle = np.linalg.qr(white / self._scale)
        self._effects = [self._effect(np.column_stack(rival.candidates)) for rival in self._listed]
        self._U = {name: unit * _at_reference(entries, name, channel) for name, (_, unit) in PARAMETERS.items()}

    def _effect(self, columns: Floats) -> _Effect:
        effect = self._channel.readings.noise.whiten(columns)
        inside = self._basis.T @ effect
        moves = np.linalg.solve(self._triangle, inside) / self._scale[:, None]
        return _Effect(effect - self._basis @ inside, moves)

    def powers(self) -> Iterator[Power]:
        """Yield how surely each listed rival would be seen at its worst place, were it large enough to cost 1 U."""
        for rival, effect in zip(self._listed, self._effects, strict=True):
            moves = effect.moves.copy()
            if rival.name == PLAYS:
                moves[self._base.names.index(WIDTH)] -= 1.0  # the width of a unit is that of all its play operators
            seen = np.sum(effect.left**2, axis=0)
            for quantity in PARAMETERS:
                size = 1.0 / np.maximum(self._in_U(moves, quantity), _SMALLEST)
                power = self._seen(rival, float(np.min(seen * size**2)))
                yield Power(f"{rival.name} ({self._channel.readings.channel.kind})", quantity, power)

    def rhythm_powers(self) -> Floats:
        """Return how surely a daily rhythm would be seen, (12,), by the hour of the day at which the windows begin.

        It is no rival of the list, so that the misfit and the rivals see it by what they share with it. It is so large
        that the quantity which it moves most is 1.5 U off.
        """
        gates = self._channel.readings.gates
        hours = (gates.middle_s - gates.start_s[0]) / 3600.0
        begins = np.arange(_HOURS)
        effect = self._effect(np.sin(2.0 * np.pi / _DAY_h * (hours[:, None] + begins)))
        size = _BELIEVED / np.max([self._in_U(effect.moves, quantity) for quantity in PARAMETERS], axis=0)
        return self._seen_by_any(effect.left * size)

    def _in_U(self, moves: Floats, quantity: str) -> Floats:
        parameter, _ = PARAMETERS[quantity]
        return np.asarray(np.abs(moves[self._base.names.index(parameter)]) / self._U[quantity])

    def _seen_by_any(self, left: Floats) -> Floats:
        """Return the power of the check that sees best what the fit leaves, whitened (m, k), of each of its columns."""
        dof = left.shape[0] - self._base.columns.shape[1]
        powers = [[_power(dof, FALSE_DOUBT / self._checks, square) for square in np.sum(left**2, axis=0)]]
        for rival, effect in zip(self._listed, self._effects, strict=True):
            powers.append([self._seen(rival, shared) for shared in _shared(left, effect.left, rival)])
        return np.asarray(np.max(powers, axis=0))

    def _seen(self, rival: Rival, noncentrality: float) -> float:
        added, candidates = rival.candidates[0].shape[1], len(rival.candidates)
        return _power(added, FALSE_DOUBT / (self._checks * candidates), noncentrality)


def _shared(left: Floats, columns: Floats, rival: Rival) -> Floats:
    """Return how much of each residual (m, k) the candidate of a rival takes that takes most, as a square (k,)."""
    if rival.candidates[0].shape[1] == 1:
        length = np.linalg.norm(columns, axis=0)
        shares = (columns / np.where(length > 0.0, length, 1.0)).T @ left
        return np.asarray(np.max(shares**2, axis=0))
    vectors, singular, _ = np.linalg.svd(np.split(columns, len(rival.candidates), axis=1), full_matrices=False)
    kept = vectors * (singular > _RANK * singular[:, :1])[:, None, :]
    return np.asarray(np.max(np.sum((kept.transpose(0, 2, 1) @ left) ** 2, axis=1), axis=0))


def _power(added: int, chance: float, noncentrality: float) -> float:
    limit = special.chdtri(added, chance)
    return float(1.0 - special.chndtr(limit, added, min(noncentrality, _NOT_MISSED)))


def _at_reference(entries: Estimates, quantity: str, channel: ChannelFit) -> float:
    """Return U of a quantity of a channel at the reference temperature, infinite if the ramp does not tell it."""
    number, at_degC = channel.readings.channel.number, channel.fit.reference_degC
    conditions = [(entry, entry["conditions"]) for entry in entries if entry["quantity"] == quantity]
    found = [
        entry["expanded_uncertainty"]
        for entry, of_entry in conditions
        if of_entry["channel"] == number and of_entry.get("temperature_degC", at_degC) == at_degC
    ]
    return max(found, default=math.inf)
