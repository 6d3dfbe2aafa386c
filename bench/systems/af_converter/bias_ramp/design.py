"""Bias ramps that may stand in place of a given one: other rates and holds between the same two temperatures.

Windows stay as long as they are, both branches and the range stay. What is faster shows the lag better and the noise
less, so that the shortest ramp follows from the fit of each candidate and from the rivals that it would still tell.
Decision: docs/method-uncertainty.md.

How surely a ramp would show what else could be true is asked of the departures of its search, on a nominal ramp.
"""

from __future__ import annotations

import math
import re
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import lru_cache
from itertools import accumulate, compress, product
from typing import Any

import numpy as np

from bench.analysis import Departure, Document, Estimate, Estimates, Floats, Planned, Trace, powers
from bench.design import Given, Key, Power, SequenceText, blind, reached, weakest
from bench.model.clock import NS
from bench.model.errors import InputError
from bench.model.ports import RecordWindow
from bench.model.units import format_quantity, parse_quantity
from bench.plan import CHAMBER, MEASUREMENT, LAB_AIR_degC, Plan, PlannedCall, PlannedRecord, PlannedSoak
from bench.systems.af_converter.bias_ramp.departures import RELAXATION, SECOND_LAG, SECOND_PLAY, Rows
from bench.systems.af_converter.bias_ramp.fit import ChannelFit, FOLLOWS_degC
from bench.systems.af_converter.bias_ramp.predicted import Fitted, channels_predicted, fitted
from bench.systems.af_converter.constants import read_campaign
from bench.systems.af_converter.wording import kind_name

BRANCHES = ("hold_start", "up", "hold_top", "down", "hold_end")
HOLDS = BRANCHES[::2]
_MINUTE_s = 60.0
_WINDOWS = re.compile(r"\bwindows: *[^,}\s]+")
_RAMP = re.compile(r'\bramp: *("[^"]*"|[^,}]+)')
_FORM = "a soak to one end, then windows of one length without a gap: " + ", ".join(BRANCHES)


@dataclass(frozen=True)
class Template:
    """``rates``: of the ramps up and down, 0.01 degC/min.   ``holds``: windows of each.   ``ends_degC``: cold, hot.

    ``window``: the first of all; ``timed``: whether pulses are timed.   ``soak``: that of the preparation.
    """

    rates: tuple[int, int]
    holds: tuple[int, int, int]
    ends_degC: tuple[float, float]
    window: RecordWindow
    timed: bool
    soak: PlannedSoak

    @property
    def window_s(self) -> float:
        """Length of a window, second."""
        return (self.window.t_end_ns - self.window.t_start_ns) / NS

    def ramps_s(self, rates: tuple[int, int]) -> tuple[float, float]:
        """Return how long the air takes up and down, second."""
        span_degC = self.ends_degC[1] - self.ends_degC[0]
        return 6000.0 * span_degC / rates[0], 6000.0 * span_degC / rates[1]

    def counts(self, rates: tuple[int, int], holds: tuple[int, int, int]) -> dict[str, int]:
        """Return the windows of each branch: a ramp ends inside the last of its own."""
        up, down = (math.ceil(ramp_s / self.window_s - 1e-9) for ramp_s in self.ramps_s(rates))
        return dict(zip(BRANCHES, (holds[0], up, holds[1], down, holds[2]), strict=True))

    def windows(self, counts: Mapping[str, int]) -> list[RecordWindow]:
        """Return the windows of a ramp, by number."""
        first = self.window
        windows: list[RecordWindow] = []
        length_ns = first.t_end_ns - first.t_start_ns
        for branch, count in counts.items():
            for _ in range(count):
                done = len(windows)
                windows.append(
                    replace(
                        first,
                        number=done + 1,
                        first_counter=first.first_counter + done * first.frames,
                        t_start_ns=first.t_start_ns + done * length_ns,
                        t_end_ns=first.t_end_ns + done * length_ns,
                        conditions={**first.conditions, "branch": branch},
                    )
                )
        return windows

    def air(self, rates: tuple[int, int], holds: tuple[int, int, int]) -> tuple[Floats, Floats]:
        """Return times and temperatures of the planned air, the preparation included, once a minute and at corners."""
        cold, hot = self.ends_degC
        up_s, down_s = self.ramps_s(rates)
        counts = list(self.counts(rates, holds).values())
        begins_s = [self.window.t_start_ns / NS + self.window_s * done for done in accumulate(counts, initial=0)]
        soaked_s = self.soak.at_s + 60.0 * abs(cold - LAB_AIR_degC) / self.soak.ramp_degC_min
        corners_s = [
            self.soak.at_s, soaked_s, begins_s[1], begins_s[1] + up_s, begins_s[3], begins_s[3] + down_s, begins_s[5],
        ]  # fmt: skip
        t_s = np.union1d(np.arange(corners_s[0], corners_s[-1], _MINUTE_s), corners_s)
        return t_s, np.interp(t_s, corners_s, [LAB_AIR_degC, cold, cold, hot, hot, cold, cold])


def template_of(plan: Plan) -> Template:
    """Read the parts of a ramp from its plan. Raises: InputError B-DES-005 for one of another form."""
    steps = plan.phase("campaign")
    records = [step for step in steps if isinstance(step, PlannedRecord)]
    points = [step.set_point for step in steps if isinstance(step, PlannedCall) and step.set_point is not None]
    soaks = [step for step in plan.phase("prepare") if isinstance(step, PlannedSoak)]
    branches = [str(step.conditions.get("branch")) for step in records]
    if list(dict.fromkeys(branches)) != list(BRANCHES) or branches != sorted(branches, key=BRANCHES.index):
        raise _other_form(plan, "branches missing or in another order")
    measuring = all(step.purpose == MEASUREMENT for step in records)
    if len(points) != 2 or len(soaks) != 1 or len({step.seconds for step in records}) != 1 or not measuring:
        raise _other_form(plan, "another number of ramps or soaks, or windows of several lengths")
    cold, hot = soaks[0].temperature_degC, points[0].temperature_degC
    first, begin_s = records[0], plan.prepare_s
    rate_Hz = float(plan.campaign["rate_Hz"])
    template = Template(
        rates=(round(100.0 * points[0].ramp_degC_min), round(100.0 * points[1].ramp_degC_min)),
        holds=(branches.count(HOLDS[0]), branches.count(HOLDS[1]), branches.count(HOLDS[2])),
        ends_degC=(cold, hot),
        window=RecordWindow(
            number=1, link=plan.measurement_link, first_counter=round(begin_s * rate_Hz),
            frames=round(first.seconds * rate_Hz), t_start_ns=round(begin_s * NS),
            t_end_ns=round((begin_s + first.seconds) * NS), conditions=first.conditions,
        ),
        timed=first.pulse_timing,
        soak=soaks[0],
    )  # fmt: skip
    counts = template.counts(template.rates, template.holds)
    if hot <= cold or points[1].temperature_degC != cold or counts != {name: branches.count(name) for name in BRANCHES}:
        raise _other_form(plan, "ramps are not up and down again, as long as their branches")
    return template


def write_steps(text: SequenceText, template: Template, rates: tuple[int, int], holds: tuple[int, int, int]) -> None:
    """Write the steps with other windows and ramps. Raises: InputError B-DES-005 for another form."""
    lines = list(_step_lines(text, template, rates, holds))
    if "ramp" in text.tree.get("parameters", {}) and text.count("{ramp}") == len(rates):
        text.remove(("parameters", "ramp"))
    text.replace_below(("steps",), lines)


def _step_lines(
    text: SequenceText, template: Template, rates: Sequence[int], holds: tuple[int, int, int]
) -> Iterator[str]:
    counts = template.counts((rates[0], rates[1]), holds)
    before = template.counts(template.rates, template.holds)
    branches, ramps = list(BRANCHES), [f"ramp: {rate / 100.0:g} degC/min" for rate in rates]
    for number in range(len(text.tree["steps"])):
        block = "\n".join(text.block(("steps", number)))
        if _WINDOWS.search(block) and branches:
            branch = branches.pop(0)
            yield f"  # {branch}: {counts[branch]} windows, {before[branch]} before"
            block = _WINDOWS.sub(f"windows: {counts[branch]}", block)
        elif _RAMP.search(block) and ramps:
            block = _RAMP.sub(ramps.pop(0), block)
        yield from block.splitlines()
    if branches or ramps:
        message = f"the ramp cannot be written in the place of this one, which is not of the form: {_FORM}"
        raise InputError(
            "B-DES-005", message, where=text.where(("steps",)), next_step="begin with the shipped bias_ramp_25h"
        )


def _other_form(plan: Plan, why: str) -> InputError:
    message = f"a shorter ramp is made of {_FORM}; {plan.name} is not ({why})"
    return InputError("B-DES-005", message, where=plan.name, next_step="begin with the shipped bias_ramp_25h")


QUANTITIES = ("bias", "bias_tc1", "hysteresis_width", "play_half_width", "thermal_lag")
_RHYTHM, _ANY_RESULT = "rhythm", "a result"
_RIVALS = {
    "step": "a step",
    "drift": "a linear drift",
    SECOND_LAG: "a second thermal lag",
    SECOND_PLAY: "several play operators",
    RELAXATION: "a loop that relaxes",
    _RHYTHM: "1.5 times a daily rhythm begun at hour {0[hour]}",
}
_DAY_h, _HOURS = 24.0, 12  # half a day later the same rhythm begins with the other sign
_BELIEVED = 1.5  # expanded uncertainties off, from which on a sound result counts as wrong
_LAGS = 4.0  # of a hold: 2 % of what trails is left
_AHEAD_min = 10.0  # of the converters, which the unit's sensor may be for the fit to believe it
_COARSE, _FINE = 2, 1  # steps of a rate, hundredths of a degC/min
_HOLD_STEP = 6  # windows
_NOISE = ("white_noise", "random_walk")


@dataclass(frozen=True)
class Candidate:
    """``rates``: of the ramps up and down, 0.01 degC/min.   ``holds``: windows at the start, the top and the end."""

    rates: tuple[int, int]
    holds: tuple[int, int, int]


def design(given: Given) -> Ramps:
    """Return the ramps that may stand in place of a given one. Raises: InputError B-DES-001, B-DES-004, B-DES-005."""
    return Ramps(given, template_of(given.plan))


class Ramps:
    """The problem as the search sees it (``bench.design.Problem``)."""

    wanted = tuple((quantity, "") for quantity in QUANTITIES)

    def __init__(self, given: Given, template: Template) -> None:
        """Take a ramp apart. Raises: InputError B-DES-004 if its unit is not declared, B-DES-001 for less lag."""
        self._given, self._template = given, template
        self._campaign = _one_of_each_kind(given.plan.campaign)
        self._count = len(given.plan.campaign["channels"])
        constants = read_campaign(self._campaign)
        if constants.thermal_lag_s is None or any(channel.typical is None for channel in constants.channels):
            message = f"{given.plan.name} declares no typical unit, of which the uncertainties of a ramp are"
            step = "write 'thermal_lag' and 'typical' of each kind under 'uut', as bias_ramp_25h does"
            raise InputError("B-DES-004", message, where=given.plan.name, next_step=step)
        self._lag_s = constants.thermal_lag_s if given.lag_s is None else given.lag_s
        if self._lag_s < constants.thermal_lag_s:
            declared = f"the declared lag of the unit alone, {constants.thermal_lag_s / 60.0:g} min"
            message = f"{self._lag_s / 60.0:.3g} min is less than {declared}"
            step = f"state that of unit and air together, or change 'thermal_lag' in {given.plan.name}"
            raise InputError("B-DES-001", message, where="--lag", next_step=step)
        self._fastest = min(_fastest_of_chamber(given.plan), math.floor(100.0 * FOLLOWS_degC / _AHEAD_min))
        self.today = Candidate(template.rates, template.holds), template.window_s
        self._fitted = lru_cache(maxsize=8)(self._fit)
        self.estimates = lru_cache(maxsize=4096)(self._estimates)
        self.powers = lru_cache(maxsize=4096)(self._powers)

    @property
    def _least_holds(self) -> tuple[int, int, int]:
        """Windows of each hold at least: four lags, or what the given ramp has if that is less."""
        due = math.ceil(_LAGS * self._lag_s / self._template.window_s - 1e-9)
        start, top, end = (min(due, given) for given in self._template.holds)
        return start, top, end

    @property
    def starts(self) -> Iterator[Candidate]:
        """Yield ramps of all rates with the least holds and with those given, the shortest first."""
        slowest = min(self._template.rates)
        rates = sorted({*range(slowest, self._fastest + 1, _COARSE), slowest})
        holds = dict.fromkeys((self._least_holds, self._template.holds))
        found = [Candidate(pair, each) for pair in product(rates, rates) for each in holds]
        allowed = [each for each in found if not self._broken_form(each)]
        yield from sorted(allowed, key=lambda each: (self._windows_of(each), each.rates, each.holds))

    def moves(self, candidate: Candidate) -> Iterator[Candidate]:
        """Yield the ramp with another rate, with other holds, or with holds that may pay for a rate."""
        for up, down in ((0, 0), (-_FINE, 0), (_FINE, 0), (0, -_FINE), (0, _FINE)):
            rates = candidate.rates[0] + up, candidate.rates[1] + down
            found = [Candidate(rates, holds) for holds in _holds_beside(candidate.holds)]
            yield from (each for each in found if not self._broken_form(each))

    def lengths_s(self, candidate: Candidate) -> Sequence[float]:
        """Return the given length of a window."""
        return [self._template.window_s]

    def _windows_of(self, candidate: Candidate) -> int:
        return sum(self._template.counts(candidate.rates, candidate.holds).values())

    def duration_s(self, candidate: Candidate, length_s: float) -> float:
        """Return how long the ramp takes."""
        return self._windows_of(candidate) * length_s

    def _fit(self, candidate: Candidate) -> Fitted:
        template = self._template
        windows = template.windows(template.counts(candidate.rates, candidate.holds))
        t_s, air_degC = template.air(candidate.rates, candidate.holds)
        trace = Trace(t_s, air_degC, np.full(t_s.shape, np.nan))
        timed = {window.number for window in windows} if template.timed else ()
        ramp = fitted(Planned(windows, self._campaign, self._given.plan.station.standards(), timed, trace))
        assert ramp is not None  # what a unit has to declare is asked for at the start
        return ramp

    def _estimates(self, candidate: Candidate, length_s: float) -> Estimates:
        return channels_predicted(self._fitted(candidate))

    def at_least(self, candidate: Candidate, length_s: float) -> dict[Key, float]:
        """Return nothing: there is no bound that costs less than the fit."""
        return {}

    def broken(self, candidate: Candidate, length_s: float) -> list[str]:
        """Return the rules that a ramp breaks."""
        sentences = self._broken_form(candidate)
        return sentences or blind(self, candidate, length_s)

    def _broken_form(self, candidate: Candidate) -> list[str]:
        sentences = [
            f"the hold {name} of {hold} windows is shorter than {_LAGS:g} lags and than the given one: {least} windows"
            for name, hold, least in zip(HOLDS, candidate.holds, self._least_holds, strict=True)
            if hold < least
        ]
        if max(candidate.rates) > self._fastest:
            sentences.append(
                f"a ramp of {max(candidate.rates) / 100.0:g} degC/min is faster than {self._fastest / 100.0:g}, the "
                f"fastest of the chamber or that at which a sensor {_AHEAD_min:g} min ahead is still believed"
            )
        if self._left_degC(candidate) > self._left_degC(self.today[0]) + 1e-9:
            sentences.append(
                f"the unit stays {self._left_degC(candidate):.2f} degC short of an end of its range, by the given plan "
                f"{self._left_degC(self.today[0]):.2f}"
            )
        return sentences

    def _left_degC(self, candidate: Candidate) -> float:
        """Return how far the unit is at most from an end of its range when it is left."""
        holds_s = [hold * self._template.window_s for hold in candidate.holds[1:]]
        return max(
            rate / 6000.0 * self._lag_s * math.exp(-hold_s / self._lag_s)
            for rate, hold_s in zip(candidate.rates, holds_s, strict=True)
        )

    def _powers(self, candidate: Candidate, length_s: float) -> list[Power]:
        """Return how surely what departs would be seen if it moved a result by its U, a rhythm of a day by 1.5 U."""
        ramp, entries, share = self._fitted(candidate), self.estimates(candidate, length_s), 1.0 / self._count
        seen: list[tuple[str, str, float]] = []
        for kind, channel in ramp.fits.items():
            rows = Rows(channel, ramp.drive)
            residuals, rhythms = rows.residuals(entries), _rhythms(channel)
            departures = [*rows.loop.departures(), *rhythms]
            of_rhythms = powers(replace(residuals, expanded=_BELIEVED * residuals.expanded), departures, share)
            of_all = np.vstack([powers(residuals, departures, share)[: -len(rhythms)], of_rhythms[-len(rhythms) :]])
            wanted = [_is_wanted(entry, channel) for entry in residuals.stated]
            seen += [
                (
                    f"{_RIVALS[one.shape].format(one.about)} ({kind})",
                    _ANY_RESULT if one.shape == _RHYTHM else entry.quantity,
                    float(power),
                )
                for one, of_it in zip(departures, of_all, strict=True)
                if one.carrier == "bias" and one.shape in _RIVALS
                for power, entry in compress(zip(of_it, residuals.stated, strict=True), wanted)
            ]
        return weakest(seen)

    def told(self, candidate: Candidate, length_s: float) -> dict[str, str]:
        """Return rates, windows and holds in words, and U of the noise, for which no target stands by itself."""
        up, down = (f"{rate / 100.0:g}" for rate in candidate.rates)
        holds = ", ".join(f"{hold * length_s / 60.0:.0f}" for hold in candidate.holds)
        units = {entry.quantity: entry.unit for entry in self.estimates(candidate, length_s)}
        noise = {
            f"U {key.quantity}, {kind_name(key.kind)}": format_quantity(float(f"{U:.2g}"), units[key.quantity])
            for key, U in reached(self.estimates(candidate, length_s)).items()
            if key.quantity in _NOISE and not key.part
        }
        return {
            "ramps": f"{up} degC/min up, {down} degC/min down",
            "holds": f"{holds} min at start, top and end",
            "windows": f"{self._windows_of(candidate)} of {length_s:g} s",
            **noise,
        }

    def changes(self, candidate: Candidate, length_s: float) -> Iterator[tuple[str, Candidate, float]]:
        """Yield the way from the given ramp: holds, then ramps both ways."""
        here = replace(self.today[0], holds=candidate.holds)
        yield "holds", here, length_s
        yield "ramps", candidate, length_s

    def written(self, candidate: Candidate, length_s: float, name: str, heading: Sequence[str]) -> str:
        """Return the ramp as a sequence of this name. Raises: InputError B-DES-005."""
        duration_s, windows = self.duration_s(candidate, length_s), self._windows_of(candidate)
        title = f"AF-converter bias and hysteresis over temperature as planned, {windows} windows"
        heads = {"duration": f"{duration_s:.10g} s", "records": str(windows)}
        title = f"{title} of {length_s:g} s, {duration_s / 3600.0:.1f} hours"
        text = self._given.renamed(name, title=title, **heads)
        write_steps(text, self._template, candidate.rates, candidate.holds)
        return text.text(heading)


def _rhythms(channel: ChannelFit) -> list[Departure]:
    """Return rhythms of a day, by the hour of it at which the windows begin."""
    gates = channel.readings.gates
    of_day = 2.0 * np.pi / _DAY_h * ((gates.middle_s - gates.start_s[0]) / 3600.0 + np.arange(_HOURS)[:, None])
    effects = np.stack([np.sin(of_day), np.cos(of_day)], axis=-1)
    return [Departure("bias", _RHYTHM, "A", effect, {"hour": hour}) for hour, effect in enumerate(effects)]


def _is_wanted(entry: Estimate, channel: ChannelFit) -> bool:
    reference_degC = channel.fit.reference_degC
    return entry.quantity in QUANTITIES and entry.conditions.get("temperature_degC", reference_degC) == reference_degC


def _holds_beside(holds: tuple[int, int, int]) -> Iterator[tuple[int, int, int]]:
    """Yield the holds themselves, then with any of them shorter or longer."""
    for steps in product((0, -_HOLD_STEP, _HOLD_STEP), repeat=len(HOLDS)):
        start, top, end = (hold + step for hold, step in zip(holds, steps, strict=True))
        yield start, top, end


def _one_of_each_kind(campaign: Document) -> dict[str, Any]:
    """Return the constants with the first channel of each kind: all of a kind are declared alike."""
    first = {channel["kind"]: channel for channel in reversed(campaign["channels"])}
    channels = [channel for channel in campaign["channels"] if channel is first[channel["kind"]]]
    return {**campaign, "channels": channels}


def _fastest_of_chamber(plan: Plan) -> int:
    """Return the fastest ramp that the station allows its chamber, 0.01 degC/min."""
    limits = plan.station.instruments[CHAMBER].limits
    return math.floor(100.0 * parse_quantity(limits["ramp"][1], "degC/min")) if "ramp" in limits else 1_000_000
