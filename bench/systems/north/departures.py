"""What the data of a north finder say against its model: all sets by both methods as rows of one fit.

Readings of each set are its azimuth by the lock-ins, by the waveform and as it is stated, amplitude and noise of its
waveform and, of a log, whose parts are sets, the offset. Noise of the waveform is known, what the lock-ins read beside
it is what scatters; free are the azimuth of each place to be found and the placement of the index, and known as far as
stated the mark and the level. Beside the general departures stand a wave of the azimuth once and twice per turn (a
magnet, a gain that goes with the angle of the table), which changes the amplitude a quarter of a turn later, and what
adds to the signal at a place to be found, which turns north as much if it lies across.

Beside the rows: a signal that drowns, and a table that turns otherwise than stated.
Source: docs/method-uncertainty.md (doubt, departures); FOG paper, equation (1).
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Any

import numpy as np

from bench.analysis import (
    Departure,
    Estimate,
    Estimates,
    Evidence,
    Floats,
    Labels,
    Residuals,
    Searched,
    departures_of,
    search,
)
from bench.maths.arrays import Flags
from bench.maths.verdict import coverage_factor
from bench.systems.north.estimators.phasors import wrapped_deg
from bench.systems.north.sets import CALIBRATION, LOG, SEARCH, SENSES
from bench.systems.north.solution import LEAST_SQUARES, LIKELIHOOD, METHODS, Azimuths, Solution
from bench.systems.north.wording import item_name, method_name, place_name, say

_AZIMUTHS = ("azimuth", "azimuth_error", "azimuth_rms_error")
_NO_SIGNAL_deg = 20.0  # of one set: a direction is lost in its noise
_MOST_RATE = 0.05  # of the stated rate; a serial line hands samples over in blocks
_LEAST_deg = 1e-3  # steps of level and lock-ins
_dB = math.log(10.0) / 20.0
_VARIES_dB = 2.0  # amplitude and noise from set to set
_ROUNDING = 1e-6  # of the amplitude: noise that is none
_WALKS = 100.0  # % of the amplitude, from one part of a log to the next: the offset
LOCK_IN, WAVEFORM, HEADING, AMPLITUDE, NOISE, OFFSET = range(6)  # readings of a set
_BOTH = (LOCK_IN, WAVEFORM)
_SEARCHES: Mapping[int, tuple[str, float, Mapping[str, Sequence[int]]]] = {  # unit, share of false doubt, carriers
    OFFSET: ("%", 0.1, {"offset": [OFFSET]}),
    WAVEFORM: (
        "deg",
        0.7,
        {"azimuth": _BOTH, "heading": (*_BOTH, HEADING), "lock_in": [LOCK_IN], "waveform": [WAVEFORM]},
    ),
    AMPLITUDE: ("dB", 0.1, {"amplitude": [AMPLITUDE]}),
    NOISE: ("dB", 0.1, {"noise": [NOISE]}),
}


def implausible(solution: Solution) -> list[Evidence]:
    """Return signals that tell no azimuth, and rates that are not as stated."""
    return [*_signal(solution), *_rate(solution)]


def searches_of(solution: Solution, entries: Estimates, by_offset: Floats | None = None) -> Iterator[Searched]:
    """Yield the searches of the sets; ``by_offset`` (k, n): what each estimate gains per % of offset in each set."""
    rows = Rows(solution, [entry for entry in entries if entry.expanded_uncertainty], by_offset)
    found: list[Floats] = []
    for kind, (_, share, _) in _SEARCHES.items():
        residuals = rows.residuals(kind, found)
        if residuals is not None:
            outcome = search(residuals, rows.departures(kind), share)
            found += [finding.departure.effect for finding in outcome.findings]
            if kind == WAVEFORM and (len(outcome.findings) > 1 or not outcome.is_noise):  # no azimuth is sure
                outcome = replace(outcome, together=np.abs(residuals.operator) @ rows.at(_BOTH) > 0.0)
            yield Searched(outcome, rows.words)


def _signal(solution: Solution) -> Iterator[Evidence]:
    for method in METHODS:
        judged = LIKELIHOOD if method == LIKELIHOOD else LEAST_SQUARES  # lock-ins share their readings
        noise_deg = solution.by_method[judged].noise_deg
        if noise_deg > _NO_SIGNAL_deg:
            said = say("evidence.no_signal", method=method_name(judged), noise=noise_deg, limit=_NO_SIGNAL_deg)
            about = {"method": method}
            yield Evidence("no_signal", said, noise_deg, 0.0, quantities=_AZIMUTHS, conditions=about, refuses=True)


def _rate(solution: Solution) -> Iterator[Evidence]:
    """Yield a table that turns otherwise than stated: rate and sense decide what the lock-ins' phases mean."""
    for own in solution.sets:
        turned, stated = own.turned_deg_s(), own.rate_deg_s
        if abs(turned - stated) > _MOST_RATE * abs(stated):
            said = say("evidence.rate_not_as_stated", turned=turned, name=own.name, stated=stated)
            for method in (one for one in METHODS if one != LIKELIHOOD):
                yield Evidence(
                    "rate_not_as_stated", said, turned, 0.0, quantities=(*_AZIMUTHS, "index_placement"),
                    conditions={"method": method}, refuses=turned * stated < 0.0,
                )  # fmt: skip
            return


@dataclass(frozen=True)
class Rows:
    """Readings of n sets, (6 n,): all by lock-ins, by waveform, as stated, amplitude (dB), noise (dB), offset (%)."""

    solution: Solution
    entries: Sequence[Estimate]
    by_offset: Floats | None = None

    @property
    def azimuths(self) -> list[Azimuths]:
        """Azimuths by the lock-ins and by the waveform."""
        return [self.solution.by_method[method] for method in (LEAST_SQUARES, LIKELIHOOD)]

    @cached_property
    def noise(self) -> Floats:
        """Noise of the waveforms over their amplitude, (n,)."""
        return np.hypot(self.solution.of_waveforms("noise_V") / self.solution.of_waveforms("amplitude"), _ROUNDING)

    @cached_property
    def readings(self) -> Floats:
        """Azimuths beside the heading (deg), none as stated, amplitude, noise (dB), offset (%), (6, n); NaN: none."""
        amplitude_V, none = self.solution.of_waveforms("amplitude"), np.full(len(self.solution.sets), math.nan)
        azimuths = [
            wrapped_deg(one.azimuth_deg - self.heading_deg) if one.noise_deg <= _NO_SIGNAL_deg else none
            for one in self.azimuths
        ]
        offset = none if self.by_offset is None else 100.0 * self.solution.of_waveforms("offset_V") / amplitude_V.mean()
        return np.array([*azimuths, none, *(np.log([amplitude_V, self.noise * amplitude_V]) / _dB), offset])

    @cached_property
    def found(self) -> Flags:
        """Which readings there are, (6, n)."""
        return np.isfinite(self.readings)

    @cached_property
    def std(self) -> Floats:
        """Noise of each reading, (6, n); 0 where there is none."""
        mean = 1.0 / np.sqrt(self.solution.of_waveforms("samples"))
        azimuths = [math.hypot(one.noise_deg, _LEAST_deg) + 0.0 * one.azimuth_deg for one in self.azimuths]
        of_waveform = [0.0 * mean, math.sqrt(2.0) / _dB * mean * self.noise, math.sqrt(0.5) / _dB * mean]
        return np.where(self.found, [*azimuths, *of_waveform, 100.0 * mean * self.noise], 0.0)

    @cached_property
    def heading_deg(self) -> Floats:
        """Stated heading of each set, (n,); where none is, the first that was found there."""
        at_deg = np.array([self.solution.known_deg, *(one.azimuth_deg for one in reversed(self.azimuths))])
        heading_deg = np.zeros(at_deg.shape[1])
        for own in self.groups.values():
            heading_deg[own] = next((one for one in at_deg[:, own].ravel() if math.isfinite(one)), 0.0)
        return heading_deg

    @cached_property
    def groups(self) -> dict[tuple[str, str, float, str], Flags]:
        """Which sets, (n,), are repeats of a heading."""
        names = [own.group for own in self.solution.sets]
        return {name: np.array([other == name for other in names]) for name in dict.fromkeys(names)}

    def at(self, readings: Sequence[int], size: Any = 1.0) -> Floats:
        """Return a column, (6 n,): ``size``, one or (n,), in some readings of each set."""
        column = np.zeros((6, len(self.solution.sets)))
        column[list(readings)] = size
        return column.ravel()

    def residuals(self, kind: int, explained: Sequence[Floats]) -> Residuals | None:
        """Return the rows of a kind beside what is explained, (6 n, g) each; None without any."""
        free, held, scatter = self._azimuths() if kind == WAVEFORM else self._sizes(kind)
        free += [column for effect in explained for column in effect.T]
        held = [one for one in held if one.any()]
        weights = self._weights(kind)
        if not len(weights) or not self.entries:
            return None
        operator = np.array([self._operator(entry) for entry in self.entries])
        if self.by_offset is not None:
            operator[:, -self.by_offset.shape[1] :] = self.by_offset
        return Residuals.of(
            readings=np.zeros(self.found.size),  # nothing is in proportion to a reading
            error=np.nan_to_num(self.readings).ravel(),
            free=np.reshape([*free, *held], (-1, self.found.size)).T,
            std=np.ones(len(held)),
            scatter=np.transpose(scatter),
            whiten=lambda columns: weights @ columns,
            operator=operator,
            stated=self.entries,
            noise=coverage_factor() * np.sqrt(operator**2 @ self.std.ravel() ** 2),
            noise_dof=self.azimuths[1].dof if kind == WAVEFORM else math.inf,
        )

    def _weights(self, kind: int) -> Floats:
        """Return rows, (m, 6 n): readings over their noise; those of the lock-ins, beside the waveform, over steps."""
        one, seen = np.eye(self.found.size).reshape(*self.found.shape, -1), self.found[kind]
        rows: Floats = one[kind][seen] / self.std[kind][seen][:, None]
        if kind == WAVEFORM:
            beside = one[LOCK_IN] - seen[:, None] * one[WAVEFORM]
            rows = np.vstack([rows, beside[self.found[LOCK_IN]] / _LEAST_deg])
        return rows

    def _azimuths(self) -> tuple[list[Floats], list[Floats], list[Floats]]:
        """Return what is free, what is known as far as stated, and by what the lock-ins scatter beside their noise."""
        solution, known = self.solution, np.isfinite(self.solution.known_deg)
        free = [self.at(_BOTH, own) for own in self.groups.values() if not (own & known).any()]
        free += [self.at([LOCK_IN], solution.sense == sense) for sense in solution.calibrations]
        held = [self.at(_BOTH, known * math.hypot(solution.site.azimuth_std_deg, solution.tilted_deg))]
        held += [self.at(_BOTH, own * solution.tilted_deg) for own in self.groups.values()]
        square_deg2 = 2.0 * solution.swing_deg**2 + (self.azimuths[0].common_deg * solution.unsteady) ** 2
        square_deg2 += np.sum(self.std[:2] ** 2, axis=0)
        return free, held, [self.at([LOCK_IN], one) for one in np.diag(np.sqrt(square_deg2))]

    def _sizes(self, kind: int) -> tuple[list[Floats], list[Floats], list[Floats]]:
        """Return the same of what waveforms have one of for each kind of parameters; an offset may walk."""
        parameters = np.array([own.parameters for own in self.solution.sets])
        free = [self.at([kind], parameters == one) for one in dict.fromkeys(parameters.tolist())]
        scatter = _WALKS * np.tri(parameters.size).T if kind == OFFSET else _VARIES_dB * np.eye(parameters.size)
        return free, [], [self.at([kind], one) for one in scatter]

    def departures(self, kind: int) -> list[Departure]:
        """Return what could be true instead, of readings of a kind."""
        sets, names = self.solution.sets, ("item", "place", "parameters", "sense", "head_deg")
        kinds = {name: np.tile([getattr(own, name) for own in sets], 6) for name in names}
        kinds["known"] = np.tile(np.isfinite(self.solution.known_deg), 6)
        labels = Labels(
            kinds={name: one for name, one in kinds.items() if name == "item" or np.unique(one).size > 1},
            hours=np.tile([(own.begin_s + own.end_s) / 7200.0 for own in sets], 6),
            visit=np.tile(np.arange(len(sets)), 6),
            carriers={name: (_SEARCHES[kind][0], self.at(of)) for name, of in _SEARCHES[kind][2].items()},
            scales={"head_deg": (kinds["head_deg"] / 360.0, (1,))},
            scopes=[(), ("item",)],
            steps_within=False,
        )
        if kind != NOISE:
            return [*departures_of(labels), *self._own()]
        found = []
        for one in departures_of(labels):  # noise is measured at each place: what differs is on the side of few
            if one.whole is not None and np.count_nonzero(one.effect) > len(sets) / 2:
                one = replace(one, effect=one.effect - one.whole[:, None])
            found.append(replace(one, whole=None))
        return found

    def _own(self) -> Iterator[Departure]:
        for times, name in ((1, "once_per_turn"), (2, "twice_per_turn")):
            angle = times * np.deg2rad(self.heading_deg)
            sine, cosine = np.sin(angle), np.cos(angle)
            turned = [
                self.at(_BOTH, across) + self.at([AMPLITUDE], math.radians(1.0) / _dB * along)
                for across, along in ((-sine, cosine), (cosine, sine))
            ]
            yield Departure("azimuth", name, "deg", np.column_stack(turned))
        for (item, place, *_), own in self.groups.items():
            if item == SEARCH:
                effect = self.at(_BOTH, own * math.degrees(_dB)) + self.at([AMPLITUDE], own)
                yield Departure("", "signal", "dB", effect[:, None], {"item": item, "place": place})

    def words(self, label: str, value: Any) -> str:
        """Return how a person names a label."""
        if value is None:
            return say(f"departs.of.{label}")
        if label == "visit":
            return self.solution.sets[int(value)].name
        if label in ("known", "sense"):
            return say(f"departs.{label}_{int(value) > 0}")
        if label in ("item", "place"):
            return {"item": item_name, "place": place_name}[label](value)
        return say(f"departs.{label}", value=value)

    def _operator(self, entry: Estimate) -> Floats:
        """Return what an estimate gains per unit of each reading, (6 n,)."""
        name, about, value = entry.quantity, entry.conditions, float(entry.value)
        kind = WAVEFORM if about.get("method") == LIKELIHOOD else LOCK_IN
        calibrated = self.solution.of(CALIBRATION) & self.found[LOCK_IN]
        if name in ("azimuth", "azimuth_error"):
            place = about.get("item", LOG), about.get("place", ""), about.get("head_deg", 0.0)
            own = self.groups[*place, about.get("parameters", "")]
            seen = _mean(own & self.found[kind])
            for sense in self.solution.calibrations if kind == LOCK_IN else ():
                here = self.solution.sense == sense
                seen = seen - float(seen[own & here].sum()) * _mean(calibrated & here)
            really = -_mean(own) * (kind == LOCK_IN)
            wider = _mean(own) * _dB * float(entry.expanded_uncertainty)  # noise moves nothing but what is said of it
            return self.at([kind, HEADING, NOISE], [seen, really, wider])
        if name == "azimuth_rms_error":
            error_deg = self.solution.error_deg(about["method"])
            return self.at([kind], np.nan_to_num(error_deg) / np.isfinite(error_deg).sum() / value)
        if "rotation" in about:
            own = calibrated & np.array([SENSES[int(one)] == about["rotation"] for one in self.solution.sense])
            kind, factor = (LOCK_IN, 1.0) if name == "index_placement" else (AMPLITUDE, value * _dB)
            return self.at([kind], factor * _mean(own))
        sizes = {"scale": (1.0, 0.0), "amplitude": (1.0, 0.0), "noise": (0.0, 1.0), "azimuth_bound": (-1.0, 1.0)}
        of_both = np.outer(sizes.get(name, (0.0, 0.0)), value * _dB * _mean(self.found[NOISE]))
        return self.at([AMPLITUDE, NOISE], of_both)


def _mean(own: Flags) -> Floats:
    return own / max(int(own.sum()), 1)
