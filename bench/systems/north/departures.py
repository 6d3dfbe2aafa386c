"""What the data of a north finder say against its model: all sets by both methods as rows of one fit.

Five readings of each set: its azimuth by the lock-ins, by the waveform and as it is stated, the amplitude and the noise
of its waveform. Noise of the waveform is known, what the lock-ins read beside it is what scatters; free are the azimuth
of each place to be found and the placement of the index, and known as far as stated the mark and the level. Beside the
general departures stand a wave of the azimuth once and twice per turn (a magnet, a gain that goes with the angle of the
table), which changes the amplitude a quarter of a turn later, and what adds to the signal at a place to be found, which
turns north as much if it lies across.

Beside the rows: a signal that drowns, and a table that turns otherwise than stated.
Source: docs/decisions/0025 (doubt), 0052 (departures); FOG paper, equation (1).
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
    departures_of,
    evidence_of,
    search,
)
from bench.maths.arrays import Flags
from bench.maths.verdict import coverage_factor
from bench.systems.north.estimators.phasors import wrapped_deg
from bench.systems.north.sets import CALIBRATION, SEARCH, SENSES, TEST, VARYING
from bench.systems.north.solution import LEAST_SQUARES, LIKELIHOOD, LITERAL, QUADRANT, Solution
from bench.systems.north.wording import item_name, method_name, place_name, say

_BY_LOCK_INS = (LEAST_SQUARES, QUADRANT, LITERAL)
_AZIMUTHS = ("azimuth", "azimuth_error", "azimuth_rms_error")
_NO_SIGNAL_deg = 20.0  # of one set: a direction is lost in its noise
_MOST_RATE = 0.05  # of the stated rate; a serial line hands samples over in blocks
_LEAST_deg = 1e-3  # steps of level and lock-ins
_VARIES, _STEADY = 0.2, 0.02  # of amplitude and noise from set to set, where parameters may vary and where not
_ROUNDING = 1e-6  # of the amplitude: noise that is none
_PERCENT = math.degrees(0.01)  # what 1 % of the signal turns north by, if it lies across
_dB = math.log(10.0) / 20.0
LOCK_IN, WAVEFORM, HEADING, AMPLITUDE, NOISE = range(5)  # readings of a set
_CARRIERS: Mapping[str, tuple[str, tuple[int, ...]]] = {
    "azimuth": ("deg", (LOCK_IN, WAVEFORM)),
    "heading": ("deg", (LOCK_IN, WAVEFORM, HEADING)),
    "lock_in": ("deg", (LOCK_IN,)),
    "waveform": ("deg", (WAVEFORM,)),
    "amplitude": ("%", (AMPLITUDE,)),
    "noise": ("dB", (NOISE,)),
}
_SEARCHES = {("azimuth", "heading", "lock_in", "waveform"): 0.8, ("amplitude",): 0.1, ("noise",): 0.1}


def evidence(solution: Solution, entries: Estimates) -> list[Evidence]:
    """Return what every check says of the estimates."""
    rows = Rows(solution, [entry for entry in entries if entry.expanded_uncertainty])
    found: list[Floats] = []
    heard = [*_signal(solution), *_rate(solution)]
    for carriers, share in _SEARCHES.items():
        residuals, departures = rows.residuals(carriers[0], found), rows.departures(carriers)
        if residuals is not None and departures:
            outcome = search(residuals, departures, share)
            found += [finding.departure.effect for finding in outcome.findings]
            heard += evidence_of(outcome, rows.entries, rows.words)
    return heard


def _signal(solution: Solution) -> Iterator[Evidence]:
    for judged, touched in ((LEAST_SQUARES, _BY_LOCK_INS), (LIKELIHOOD, (LIKELIHOOD,))):
        noise_deg = solution.by_method[judged].noise_deg
        if noise_deg > _NO_SIGNAL_deg:
            said = say("evidence.no_signal", method=method_name(judged), noise=noise_deg, limit=_NO_SIGNAL_deg)
            for method in touched:
                about = {"method": method}
                yield Evidence("no_signal", said, noise_deg, 0.0, quantities=_AZIMUTHS, conditions=about, refuses=True)


def _rate(solution: Solution) -> Iterator[Evidence]:
    """Yield a table that turns otherwise than stated: rate and sense decide what the lock-ins' phases mean."""
    for own in solution.sets:
        turned = own.turned_deg_s()
        if not math.isfinite(turned) or abs(turned - own.rate_deg_s) <= _MOST_RATE * abs(own.rate_deg_s):
            continue
        sentence = say("evidence.rate_not_as_stated", turned=turned, name=own.name, stated=own.rate_deg_s)
        for method in _BY_LOCK_INS:
            yield Evidence(
                "rate_not_as_stated", sentence, turned, 0.0, quantities=(*_AZIMUTHS, "index_placement"),
                conditions={"method": method}, refuses=turned * own.rate_deg_s < 0.0,
            )  # fmt: skip
        return


@dataclass(frozen=True)
class Rows:
    """Readings of n sets, (5 n,): all sets by lock-ins, then by waveform, as stated, amplitude (%), noise (dB)."""

    solution: Solution
    entries: Sequence[Estimate]

    @cached_property
    def found(self) -> Flags:
        """Which readings there are, (5, n)."""
        by_method = [self.solution.by_method[method] for method in (LEAST_SQUARES, LIKELIHOOD)]
        azimuths = [np.isfinite(one.azimuth_deg) & (one.noise_deg <= _NO_SIGNAL_deg) for one in by_method]
        raw = np.array([one is not None for one in self.solution.raw], bool)
        return np.array([*azimuths, np.zeros(raw.size, bool), raw, raw])

    @cached_property
    def heading_deg(self) -> Floats:
        """Stated heading of each set, (n,); where none is, the first that was found there."""
        at_deg = self.solution.known_deg.copy()
        for method in (LIKELIHOOD, LEAST_SQUARES):
            azimuth_deg = self.solution.by_method[method].azimuth_deg
            for own in self.groups.values():
                first = np.flatnonzero(own & np.isfinite(azimuth_deg))
                if first.size and not np.isfinite(at_deg[own]).any():
                    at_deg[own] = azimuth_deg[first[0]]
        return np.nan_to_num(at_deg)

    @cached_property
    def groups(self) -> dict[tuple[str, str, float, str], Flags]:
        """Which sets, (n,), are repeats of a heading."""
        names = [own.group for own in self.solution.sets]
        return {name: np.array([other == name for other in names]) for name in dict.fromkeys(names)}

    def at(self, readings: Sequence[int], size: Any = 1.0) -> Floats:
        """Return a column, (5 n,): ``size``, one or (n,), in some readings of each set."""
        column = np.zeros((5, len(self.solution.sets)))
        column[list(readings)] = size
        return column.ravel()

    @cached_property
    def raw(self) -> tuple[Floats, Floats, Floats]:
        """Amplitude and noise of the waveforms, V, and their samples, (n,) each; NaN where there are none."""
        each = [
            (math.nan,) * 3 if one is None else (float(one.amplitude), float(one.noise_V), float(one.samples))
            for one in self.solution.raw
        ]
        amplitude_V, noise_V, samples = np.array(each).reshape(-1, 3).T
        return amplitude_V, np.hypot(noise_V, _ROUNDING * amplitude_V), samples

    @cached_property
    def readings(self) -> Floats:
        """Azimuths beside the heading (deg), 0 of the stated one, amplitude (%) and noise (dB) beside their means."""
        by_method, (amplitude_V, noise_V, _) = self.solution.by_method, self.raw
        azimuths = [wrapped_deg(by_method[one].azimuth_deg - self.heading_deg) for one in (LEAST_SQUARES, LIKELIHOOD)]
        mean_V, whole_V = (
            float(one[self.found[NOISE]].mean()) if self.found[NOISE].any() else 1.0 for one in (amplitude_V, noise_V)
        )
        sizes = [100.0 * (amplitude_V / mean_V - 1.0), np.log(noise_V / whole_V) / _dB]
        return np.asarray(np.where(self.found, [*azimuths, 0.0 * noise_V, *sizes], 0.0).ravel())

    @cached_property
    def std(self) -> Floats:
        """Noise of each reading, (5, n); 0 where there is none."""
        amplitude_V, noise_V, samples = self.raw
        by_method = [self.solution.by_method[method] for method in (LEAST_SQUARES, LIKELIHOOD)]
        azimuths = [np.full(samples.size, math.hypot(one.noise_deg, _LEAST_deg)) for one in by_method]
        sizes = [100.0 * np.sqrt(2.0 / samples) * noise_V / amplitude_V, np.sqrt(0.5 / samples) / _dB]
        return np.where(self.found, [*azimuths, 0.0 * samples, *sizes], 0.0)

    def residuals(self, of: str, explained: Sequence[Floats]) -> Residuals | None:
        """Return the rows of azimuths, amplitudes or noise beside what is explained, (5 n, g); None without any."""
        free, held, scatter = self._azimuths() if of == "azimuth" else self._sizes(of)
        free = [*free, *(column for effect in explained for column in effect.T)]
        weights = self._weights(of)
        if not len(weights) or not self.entries:
            return None

        def whiten(columns: Floats) -> Floats:
            return np.vstack([weights @ columns, np.zeros((len(held), columns.shape[1]))])

        design = whiten(np.reshape([*free, *held], (-1, self.found.size)).T)
        design[len(weights) :, len(free) :] = np.eye(len(held))
        operator = np.array([self._operator(entry) for entry in self.entries])
        by_waveform = self.found[WAVEFORM].any()
        judged = self.solution.by_method[LIKELIHOOD if by_waveform else LEAST_SQUARES]
        return Residuals(
            readings=np.zeros(self.readings.size),  # nothing is in proportion to a reading
            white=whiten(self.readings[:, None])[:, 0],
            design=design,
            scatter=whiten(np.column_stack(scatter)),
            whiten=whiten,
            operator=operator,
            expanded=np.array([float(entry.expanded_uncertainty) for entry in self.entries]),
            noise=coverage_factor() * np.sqrt(operator**2 @ self.std.ravel() ** 2),
            on_curve=np.zeros(len(self.entries), bool),
            noise_dof=judged.dof if of == "azimuth" else math.inf,
        )

    def _weights(self, of: str) -> Floats:
        """Return rows, (m, 5 n): a reading over its noise; by the lock-ins beside the waveform, if there is one."""
        one = np.eye(self.found.size).reshape(*self.found.shape, -1)
        kind = _CARRIERS[of][1][-1]
        rows = one[kind][self.found[kind]] / self.std[kind][self.found[kind]][:, None]
        if of != "azimuth":
            return np.asarray(rows)
        lock_in, waveform = self.found[:2]
        beside = one[LOCK_IN] - waveform[:, None] * one[WAVEFORM]
        noise_deg = np.where(waveform, _LEAST_deg, self.std[LOCK_IN])
        return np.vstack([rows, beside[lock_in] / noise_deg[lock_in][:, None]])

    def _azimuths(self) -> tuple[list[Floats], list[Floats], list[Floats]]:
        """Return what is free, what is known as far as stated, and what scatters, of the azimuths."""
        solution, both = self.solution, (LOCK_IN, WAVEFORM)
        known = np.isfinite(solution.known_deg)
        by_lock_ins = solution.by_method[LEAST_SQUARES]
        free = [self.at(both, own) for own in self.groups.values() if not (own & known).any()]
        free += [self.at([LOCK_IN], solution.sense == sense) for sense in solution.calibrations]
        held = [self.at(both, known * math.hypot(solution.site.azimuth_std_deg, solution.tilted_deg))]
        held += [self.at(both, own * solution.tilted_deg) for own in self.groups.values()]
        apart_deg = [math.sqrt(2.0) * solution.swing_deg, by_lock_ins.common_deg if solution.unsteady else 0.0]
        noise_deg = np.where(self.found[WAVEFORM], np.hypot(*self.std[:2]), 0.0)
        scatter = np.diag(np.hypot(math.hypot(*apart_deg), noise_deg))
        return free, [one for one in held if one.any()], [self.at([LOCK_IN], one) for one in scatter]

    def _sizes(self, of: str) -> tuple[list[Floats], list[Floats], list[Floats]]:
        """Return the same of amplitudes or noise: one of each kind of parameters; an axis that leans changes them."""
        (kind,) = _CARRIERS[of][1]
        parameters = np.array([own.parameters for own in self.solution.sets])
        tangent = abs(math.tan(math.radians(self.solution.site.latitude_deg)))
        lean = np.array([0.1 * tangent * math.hypot(*(own.tilt_mrad or (0.0, 0.0))) for own in self.solution.sets])
        free = [self.at([kind], parameters == one) for one in dict.fromkeys(parameters.tolist())]
        held = [self.at([kind], own * lean) for own in self.groups.values()] if kind == AMPLITUDE else []
        unit = 100.0 if kind == AMPLITUDE else 1.0 / _dB
        scatter = np.diag(unit * np.where(np.isin(parameters, ["", VARYING]), _VARIES, _STEADY))
        return free, [one for one in held if one.any()], [self.at([kind], one) for one in scatter]

    def departures(self, carriers: Sequence[str]) -> list[Departure]:
        """Return what could be true instead, of azimuths, amplitudes or noise."""
        general = departures_of(self._labels(carriers))
        if "noise" in carriers:  # it is measured at each place: what differs is on the side of few
            return [one for each in general for one in _of_few(each, len(self.solution.sets))]
        return [*general, *self._per_turn("azimuth" in carriers), *self._added()]

    def _per_turn(self, lock_ins: bool) -> Iterator[Departure]:
        for times, name in ((1, "once per turn"), (2, "twice per turn")):
            angle = times * np.deg2rad(self.heading_deg)
            sine, cosine = np.sin(angle), np.cos(angle)
            for carrier in ("azimuth", "lock_in") if lock_ins else ("azimuth",):
                unit, of = _CARRIERS[carrier]
                turned = [self.at(of, -sine), self.at(of, cosine)]
                if carrier == "azimuth":
                    turned = [
                        one + self.at([AMPLITUDE], part / _PERCENT)
                        for one, part in zip(turned, (cosine, sine), strict=True)
                    ]
                yield Departure(f"{carrier}: {name}", unit, np.column_stack(turned))

    def _added(self) -> Iterator[Departure]:
        for (item, place, head_deg, _), own in self.groups.items():
            if item == SEARCH:
                effect = self.at([LOCK_IN, WAVEFORM], own * _PERCENT) + self.at([AMPLITUDE], own)
                yield Departure("signal", "%", effect[:, None], {"item": item, "place": place, "head": head_deg})

    def _labels(self, carriers: Sequence[str]) -> Labels:
        sets = self.solution.sets
        kinds = {
            "item": np.array([own.item for own in sets]),
            "place": np.array([own.place for own in sets]),
            "head": np.array([own.head_deg for own in sets]),
            "parameters": np.array([own.parameters for own in sets]),
            "sense": self.solution.sense,
            "known": np.isfinite(self.solution.known_deg),
        }
        several = {name: np.tile(one, 5) for name, one in kinds.items() if name == "item" or np.unique(one).size > 1}
        hours = np.array([(own.begin_s + own.end_s) / 7200.0 for own in sets])
        return Labels(
            kinds=several,
            hours=np.tile(hours, 5),
            visit=np.tile(np.arange(len(sets)), 5),
            carriers={name: (_CARRIERS[name][0], self.at(_CARRIERS[name][1])) for name in carriers},
            scales={"head": (np.tile(kinds["head"] / 360.0, 5), (1,))},
            scopes=[(), ("item",)],
            steps_within=False,
        )

    def words(self, label: str, value: Any) -> str:
        """Return how a person names a label."""
        if value is None:
            return say(f"departs.of.{label.replace(' ', '_')}")
        if label == "visit":
            return self.solution.sets[int(value)].name
        if label in ("known", "sense"):
            return say(f"departs.{label}_{int(value) > 0}")
        if label in ("item", "place"):
            return item_name(value) if label == "item" else place_name(value)
        return say(f"departs.{label}", value=value)

    def _operator(self, entry: Estimate) -> Floats:
        """Return what an estimate gains per unit of each reading, (5 n,)."""
        name, about, value = entry.quantity, entry.conditions, float(entry.value)
        item = np.array([own.item for own in self.solution.sets])
        calibrated = (item == CALIBRATION) & self.found[LOCK_IN]
        if name in ("azimuth", "azimuth_error"):
            own = self.groups[about["item"], about.get("place", ""), about["head_deg"], about.get("parameters", "")]
            return self._of_azimuth(own, str(about["method"]), calibrated) + self._of_interval(own, entry)
        if name == "azimuth_rms_error":
            error_deg = np.nan_to_num(self.solution.error_deg(about["method"]))
            weights = error_deg / max(float(np.sum(error_deg**2)), _LEAST_deg**2) * value
            kind = WAVEFORM if about["method"] == LIKELIHOOD else LOCK_IN
            return self.at([kind], np.where(item == TEST, weights, 0.0))
        if name == "index_placement" or about.get("source", "waveform") != "waveform":
            own = calibrated & np.array([SENSES[int(one)] == about["rotation"] for one in self.solution.sense])
            kind, factor = (LOCK_IN, 1.0) if name == "index_placement" else (AMPLITUDE, value / 100.0)
            return self.at([kind], factor * _mean(own))
        raw = _mean(self.found[NOISE])
        by_amplitude = {"scale": 1.0, "azimuth_bound": -1.0}.get(name, 0.0) * value / 100.0
        by_noise = {"noise": 1.0, "azimuth_bound": 1.0}.get(name, 0.0) * value * _dB
        return self.at([AMPLITUDE], by_amplitude * raw) + self.at([NOISE], by_noise * raw)

    def _of_azimuth(self, own: Flags, method: str, calibrated: Flags) -> Floats:
        """A mean over repeats; by the lock-ins beside the calibration, and beside where the axis really was."""
        if method == LIKELIHOOD:
            return self.at([WAVEFORM], _mean(own & self.found[WAVEFORM]))
        seen = _mean(own & self.found[LOCK_IN])
        for sense in self.solution.calibrations:
            here = self.solution.sense == sense
            seen = seen - float(seen[own & here].sum()) * _mean(calibrated & here)
        return self.at([LOCK_IN], seen) - self.at([HEADING], _mean(own))

    def _of_interval(self, own: Flags, entry: Estimate) -> Floats:
        """Noise does not move an azimuth; it is as much too sure of itself as noise is more at its place."""
        return self.at([NOISE], _mean(own & self.found[NOISE]) * _dB * float(entry.expanded_uncertainty))


def _mean(own: Flags) -> Floats:
    return np.asarray(own / max(int(own.sum()), 1))


def _of_few(departure: Departure, sets: int) -> Iterator[Departure]:
    many = 2 * np.count_nonzero(departure.effect) > sets
    if not many:
        yield replace(departure, whole=None)
    elif "after" in departure.about and departure.whole is not None:
        yield replace(departure, effect=departure.effect - departure.whole[:, None], whole=None)
