"""What the windows of a bias ramp say against its joint fit: the windows of a channel are the rows of one search.

Free are the curve, the width and, in first order, lag and half-width as far as the bounds of their search let them. The
noise is declared; nothing scatters beside it. General departures are of the bias, its slope and its loop; a second lag,
a second play, a loop that is late or lost, and a bend are those of a ramp.
Source: docs/method-af-converter.md (joint fit), method-uncertainty.md (departures); Krejci and Kuhnen,
IEE Proc. Control Theory 148 (2001) 185 (several play operators); two masses in a row answer like
(t1 F1 - t2 F2) / (t1 - t2), a sum of two first-order lags.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Any

import numpy as np

from bench.analysis import (
    Departure,
    Estimate,
    Estimates,
    Labels,
    Residuals,
    Searched,
    departures_of,
    search,
    with_priors,
)
from bench.maths.arrays import Floats
from bench.maths.verdict import coverage_factor
from bench.systems.af_converter.bias_ramp.estimates import QUANTITIES, parameter_weights, reading_weights
from bench.systems.af_converter.bias_ramp.fit import ChannelFit
from bench.systems.af_converter.estimators.gates import Drive
from bench.systems.af_converter.estimators.hysteresis.fit import HALF_WIDTH, LAG
from bench.systems.af_converter.estimators.hysteresis.model import Gates, HysteresisModel, ModelShape, mean_of_walk
from bench.systems.af_converter.estimators.hysteresis.search import Problem, first_order
from bench.systems.af_converter.wording import say

_nA = 1e-9
SECOND_LAG, SECOND_PLAY, RELAXATION, BEND = "second_lag", "second_play", "relaxation", "bend"
_LAGS_s, _APART = np.geomspace(30.0, 21_600.0, 13), np.log(1.3)
_PLAYS = np.geomspace(0.008, 0.25, 9)  # half-widths, in parts of the span of the temperature
_RELAXES_s = (400.0, 1000.0, 2500.0, 6000.0, 15_000.0, 40_000.0)
_STEPS = 200  # places of a step of the bias, at most
_PARTS = 20  # stretches of time in which slope or loop may be another
_BANDS = 6  # of temperature


def searches_of(fits: Sequence[ChannelFit], drive: Drive, entries: Estimates) -> Iterator[Searched]:
    """Yield the search of every channel; all of them share the chance of a false doubt."""
    for channel in fits:
        rows = Rows(channel, drive)
        found = search(rows.residuals(entries), rows.loop.departures(), share=1.0 / len(fits))
        yield Searched(found, rows.loop.words)


@dataclass(frozen=True)
class Loop:
    """Readings of a unit with lag and play, (m,), about a fitted place: lag in s and half-width in degC.

    ``carrier``: what is read, ``unit`` its unit and ``size`` that in the readings.   ``item``: whose it is.
    ``branch`` (m,): names.
    """

    model: HysteresisModel
    gates: Gates
    place: tuple[float, float]
    branch: Any
    carrier: str
    unit: str
    size: float
    item: str

    @cached_property
    def rest_degC(self) -> Floats:
        """Lagged temperature from that of reference on."""
        return self.model.unit_degC(self.place[0]) - self.model.shape.reference_degC

    @cached_property
    def column(self) -> Floats:
        """The loop of a width of 1."""
        return self.model.shape_column(*self.place)

    def departures(self) -> list[Departure]:
        """Return all that could be true instead."""
        size, per_degC = self.size, f"{self.unit}/degC"
        whole = {self.carrier: (self.unit, np.full(self.column.size, size))}
        fine = self._labels(min(self.column.size, _STEPS), whole)
        further = {"slope": (per_degC, size * self.rest_degC), "loop": (self.unit, size * self.column)}
        coarse = self._labels(_PARTS, {**whole, **further})
        own = (
            Departure(self.carrier, shape, unit, size * effect[:, None], {"value": float(value)})
            for shape, unit, effect, value in self._own(per_degC)
        )
        return [*departures_of(fine), *departures_of(coarse), *own]

    def _labels(self, parts: int, carriers: Any) -> Labels:
        """Return labels of the readings, which are taken together in so many stretches of time."""
        middle_s, rest = self.gates.middle_s, self.rest_degC
        rate = np.gradient(rest, middle_s)
        first = np.linspace(0, middle_s.size, parts, endpoint=False).astype(np.int64)
        warmest_degC = max(float(np.abs(rest).max()), 1.0)
        band_degC = max(np.round(np.ptp(rest) / _BANDS), 1.0)
        return Labels(
            kinds={
                "branch": self.branch,
                "temperature": self.model.shape.reference_degC + band_degC * np.round(rest / band_degC),
            },
            hours=middle_s / 3600.0,
            visit=first[np.searchsorted(first, np.arange(middle_s.size), side="right") - 1],
            scales={
                "temperature": (rest / warmest_degC, range(1, 7)),
                "rate": (rate / max(float(np.abs(rate).max()), 1e-12), (2,)),
            },
            carriers=carriers,
            corners=[("branch",)],
            steps_within=False,
        )

    def _own(self, per_degC: str) -> Iterator[tuple[str, str, Floats, float]]:
        """Yield what only a loop over temperature has: shape, unit, effect (m,) and what it is named by."""
        (lag_s, half_degC), model, rest = self.place, self.model, self.rest_degC
        for second_s in _LAGS_s[np.abs(np.log(_LAGS_s / max(lag_s, 1.0))) > _APART]:
            yield SECOND_LAG, per_degC, model.unit_degC(float(second_s)) - model.unit_degC(lag_s), second_s / 60.0
        low, high = model.span_degC(lag_s)
        for second_degC in _PLAYS * (high - low):
            yield SECOND_PLAY, self.unit, model.shape_column(lag_s, float(second_degC)) - self.column, second_degC
        for tau_s in _RELAXES_s:
            late = model.shape_column(lag_s, half_degC, tau_s)
            for effect in (late - self.column, late, self.column * np.exp(-self._since_turn_s() / tau_s)):
                yield RELAXATION, self.unit, effect, tau_s / 60.0
        reference_degC = model.shape.reference_degC
        for at_degC in np.arange(np.ceil(rest.min() / 5.0) * 5.0 + 5.0, rest.max() - 4.0, 5.0):
            yield BEND, per_degC, np.maximum(rest - at_degC, 0.0), reference_degC + at_degC

    def _since_turn_s(self) -> Floats:
        """Return time since the branch began, (m,)."""
        start_s, branch = self.gates.start_s, self.branch
        begins = np.flatnonzero(np.append(True, branch[1:] != branch[:-1]))
        return np.asarray(start_s - start_s[begins[np.searchsorted(begins, np.arange(branch.size), side="right") - 1]])

    def words(self, label: str, value: Any) -> str:
        """Return how a person names a label."""
        if label == "visit":
            return say("departs.window", value=(self.gates.start_s[value] - self.gates.start_s[0]) / 3600.0)
        if value is None:
            return say(f"departs.of.{label}", item=self.item)
        return say(f"departs.{label}", value=value)


@dataclass(frozen=True)
class Rows:
    """The windows of a channel, (m,), with the joint fit in first order."""

    channel: ChannelFit
    drive: Drive

    @cached_property
    def loop(self) -> Loop:
        """The model of the fit over the windows."""
        fit, readings = self.channel.fit, self.channel.readings
        shape = ModelShape(reference_degC=fit.reference_degC, order=fit.order)
        model = HysteresisModel(readings.gates, self.drive, shape)
        place, item = (fit.value(LAG), fit.value(HALF_WIDTH)), say("departs.channel", value=readings.channel.number)
        return Loop(model, readings.gates, place, self.channel.branch, "bias", "nA", _nA, item)

    def residuals(self, entries: Estimates) -> Residuals:
        """Return the rows for a search, those of the bounds of lag and half-width last."""
        readings, whiten, std = self.channel.readings, self.channel.readings.noise.whiten, self.channel.bounds.std
        columns, residual = first_order(Problem(self.loop.model, readings.bias_A, whiten), *self.loop.place)
        number = readings.channel.number
        stated = [
            entry
            for entry in entries
            if entry.quantity in QUANTITIES and entry.conditions["channel"] == number and entry.expanded_uncertainty
        ]
        operator, noise = self._operators(with_priors(whiten(columns), std), stated)
        rows = Residuals.of(
            readings=readings.bias_A, error=residual, free=columns, std=std, whiten=whiten, operator=operator,
            stated=stated,
        )  # fmt: skip
        return replace(rows, noise=np.minimum(coverage_factor() * noise, rows.expanded))

    def _operators(self, design: Floats, stated: Sequence[Estimate]) -> tuple[Floats, Floats]:
        """Return what each estimate gains per ampere of a reading, (k, m), and the standard deviation of it, (k,)."""
        readings, scale = self.channel.readings, np.linalg.norm(design, axis=0)
        of_fit = np.linalg.pinv(design / scale)[:, :-2] / scale[:, None]
        level = mean_of_walk(readings.gates.start_s, readings.gates.end_s, readings.channel.noise.walk_A_rth)
        walk = readings.noise.whiten(level.covariance)
        of_fit[0] += walk - walk @ design[:-2] @ of_fit
        weights = np.array([parameter_weights(self.channel, entry) for entry in stated])
        direct = np.array([reading_weights(self.channel, entry) for entry in stated])
        return weights @ readings.noise.turn(of_fit.T).T + direct, np.linalg.norm(weights @ of_fit, axis=1)
