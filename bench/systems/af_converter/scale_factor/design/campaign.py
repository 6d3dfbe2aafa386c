"""Scale-factor campaigns that may stand in place of a given one: some of its levels and temperatures, in any order.

Nothing is tried that the given campaign does not do already: levels and temperatures are its own, ramp, settle time and
the band of a soak stay. A record may become longer, as far as no channel takes more heat in a visit.
"""

from __future__ import annotations

import math
from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass, replace
from functools import cached_property, lru_cache
from itertools import combinations, product
from typing import Any

import numpy as np

from bench.analysis import Departure, Estimates, Material, Planned, powers
from bench.design import Given, Key, Power, blind, reached, slot_s, weakest
from bench.model.clock import NS
from bench.model.errors import InputError
from bench.model.ports import RecordWindow
from bench.model.units import format_quantity
from bench.systems.af_converter.constants import read_campaign, read_standards
from bench.systems.af_converter.estimators.scale_factor import METHODS
from bench.systems.af_converter.nominal import stimulated_row
from bench.systems.af_converter.scale_factor.analysis import predicted
from bench.systems.af_converter.scale_factor.departures import SHARE, residuals_of
from bench.systems.af_converter.scale_factor.design.template import (
    COEFFICIENTS,
    Point,
    Template,
    Tour,
    is_monotone,
    missing_repeats,
    template_of,
    tours,
    write_length,
    write_levels,
    write_stops,
)
from bench.systems.af_converter.scale_factor.estimates import Determined, determine
from bench.systems.af_converter.wording import kind_name

_PARAMETERS = 2  # of a polarity: scale-factor error and offset
_SPARE_LEVELS, _SPARE_TEMPERATURES = 2, 1
_SHORTEST_s, _STEP_s = 20.0, 1.0  # of records
_STEP = "gain: step ("  # what repeats are for
_SMALL = {"channel", "polarity", "temperature", "visit"}  # of what a candidate may leave out
Levels = tuple[float, ...]


@dataclass(frozen=True)
class Candidate:
    """``levels_A``: of each group of channels.   ``again``: channels of the repeats before the last, and of the last.

    ``by_lag``: soaks last as long as the lag asks, not the given slot.
    """

    levels_A: tuple[Levels, ...]
    stops: Tour
    again: tuple[tuple[int, ...], tuple[int, ...]]
    by_lag: bool

    def channels_at(self, number: int) -> tuple[int, ...]:
        """Return the channels of a stop that is a repeat, () for all channels."""
        if not self.stops[number].repeat:
            return ()
        return self.again[number == len(self.stops) - 1]


def design(given: Given) -> Campaigns:
    """Return the campaigns that may stand in place of a given one. Raises: InputError B-DES-004, B-DES-005."""
    return Campaigns(given, template_of(given.plan))


class Campaigns:
    """The problem as the search sees it (``bench.design.Problem``)."""

    wanted = (
        ("dsf_n", "random"), ("dsf_p", "random"), ("dsf_asymmetry", ""),
        ("dsf_n_tc1", ""), ("dsf_p_tc1", ""), ("dsf_n_tc2", ""), ("dsf_p_tc2", ""),
    )  # fmt: skip

    def __init__(self, given: Given, template: Template) -> None:
        """Take a campaign apart. Raises: InputError B-DES-004 if it leaves the rules no room."""
        self._given, self._template = given, template
        self._campaign = read_campaign(given.plan.campaign)
        self._register = given.plan.station.standards()
        self._standards = read_standards(self._register)
        given_levels_A = tuple(template.levels_A)
        self.today = Candidate(given_levels_A, template.stops, template.again, by_lag=False), template.dwell_s
        self._require_room()
        self.estimates = lru_cache(maxsize=4096)(self._estimates)
        self.powers = lru_cache(maxsize=4096)(self._powers)
        self.extent = lru_cache(maxsize=65536)(self._extent)

    def _require_room(self) -> None:
        temperatures = {stop.temperature_degC for stop in self._template.stops}
        least = COEFFICIENTS + _SPARE_TEMPERATURES
        few = [levels for levels in self._template.levels_A if len(levels) + 1 < _PARAMETERS + _SPARE_LEVELS]
        if len(temperatures) < least or few:
            message = (
                f"the rules ask for {least} temperatures and for {_PARAMETERS + _SPARE_LEVELS - 1} levels beside zero; "
                f"{self._given.plan.name} has {len(temperatures)} and {min(map(len, self._template.levels_A))}"
            )
            raise InputError("B-DES-004", message, where=self._given.plan.name, next_step="add what is missing to it")

    @cached_property
    def tours(self) -> Sequence[Tour]:
        """Tours of the given temperatures, the shortest first."""
        found = tours(list({stop.temperature_degC for stop in self._template.stops}))
        allowed = [tour for tour in found if self._may(tour)]
        return sorted(allowed, key=lambda tour: (sum(self._slots_s(tour, self._by_lag)), tour))

    @property
    def _by_lag(self) -> bool:
        return self._given.lag_s is not None

    @property
    def starts(self) -> Iterator[Candidate]:
        """Yield every tour, the shortest first, with the levels that determine scale factors and asymmetry best."""
        levels_A = self._best_levels()
        yield from (Candidate(levels_A, tour, (self._firsts, self._firsts), self._by_lag) for tour in self.tours)

    @property
    def _firsts(self) -> tuple[int, ...]:
        """Return the channels that are repeated today, and the first of each other group."""
        again = self._template.again[1]
        others = [group[0] for group in self._template.groups if not set(group) & set(again)]
        return tuple(sorted({*again, *others}))

    def _best_levels(self) -> tuple[Levels, ...]:
        """Return the levels with the least random part of a visit against the given one, records as long as may be."""
        here = replace(self.today[0], stops=self.tours[0], again=(self._firsts,) * 2, by_lag=self._by_lag)
        given = reached(self.estimates(*self.today))
        for group, (channel, *_) in enumerate(self._template.groups):
            kind = self._campaign.channel(channel).kind
            keys = Key("dsf_n", "random", kind), Key("dsf_asymmetry", "", kind)
            firsts = [channels[0] for channels in self._template.groups[: group + 1]]

            def worth(candidate: Candidate, keys: Sequence[Key] = keys, firsts: Sequence[int] = firsts) -> Any:
                length_s = min(self._longest_s(candidate, first) for first in firsts)
                known = reached(self.estimates(candidate, length_s))
                return len(blind(self, candidate, length_s)), max(known[key] / given[key] for key in keys)

            others = (self._with(here, group, levels) for levels in _with_the_largest(self._template.levels_A[group]))
            here = min(others, key=worth)
        return here.levels_A

    @staticmethod
    def _with(candidate: Candidate, group: int, levels_A: Levels) -> Candidate:
        of_groups = [*candidate.levels_A]
        of_groups[group] = levels_A
        return replace(candidate, levels_A=tuple(of_groups))

    def lengths_s(self, candidate: Candidate) -> Sequence[float]:
        """Return whole steps, as long as no channel takes more heat in a visit than the given campaign brings it."""
        longest_s = min(self._longest_s(candidate, group[0]) for group in self._template.groups)
        return np.arange(_SHORTEST_s, longest_s + 1e-6, _STEP_s).tolist()

    def _longest_s(self, candidate: Candidate, channel: int) -> float:
        given, given_s = self.today
        return given_s * self._heat(given, channel) / self._heat(candidate, channel)

    def moves(self, candidate: Candidate) -> Iterator[Candidate]:
        """Yield the candidate with other levels of one group, or with another tour."""
        for group, levels_A in enumerate(self._template.levels_A):
            yield from (self._with(candidate, group, kept) for kept in _with_the_largest(levels_A))
        yield from (replace(candidate, again=again) for again in self._choices_again())
        yield from (replace(candidate, stops=tour) for tour in self.tours)

    def _choices_again(self) -> Iterator[tuple[tuple[int, ...], tuple[int, ...]]]:
        """Yield the channels of the repeats, the quietest first: two repeats of it tell a step from a drift.

        The last repeat has those of today, which use the ranges that they use.
        """
        known = reached(self.estimates(*self.today))
        kinds = {channel: self._campaign.channel(channel).kind for channel in self._firsts}
        quietest = sorted(self._firsts, key=lambda channel: known[Key("dsf_n", "random", kinds[channel])])
        middles = [*((channel,) for channel in quietest), self._firsts]
        yield from product(dict.fromkeys(middles), dict.fromkeys([self._template.again[1], self._firsts]))

    def duration_s(self, candidate: Candidate, length_s: float) -> float:
        """Return how long a campaign takes."""
        between_s, records = self.extent(candidate)
        return between_s + records * length_s

    def _extent(self, candidate: Candidate) -> tuple[float, int]:
        """Return the time of a campaign outside of its records, and how many these are."""
        slots_s = self._slots_s(candidate.stops, candidate.by_lag)
        stays = [candidate.channels_at(number) or self._template.points for number in range(len(candidate.stops))]
        leads_s = [self._leads_s(candidate, channel) for channels in stays for channel in channels]
        return math.fsum([*slots_s, *map(math.fsum, leads_s)]), sum(map(len, leads_s))

    def _estimates(self, candidate: Candidate, length_s: float) -> Estimates:
        return predicted(self._planned(candidate, length_s)).estimates

    def _determined(self, candidate: Candidate, length_s: float) -> Determined:
        planned = self._planned(candidate, length_s)
        rows = [stimulated_row(window, self._campaign) for window in planned.windows]
        return determine(Material(rows, planned.campaign, planned.standards), METHODS[0])

    def _planned(self, candidate: Candidate, length_s: float) -> Planned:
        alike = {group[0] for group in self._template.groups}.union(*candidate.again)
        return Planned(list(self._windows(candidate, length_s, alike)), self._given.plan.campaign, self._register)

    def at_least(self, candidate: Candidate, length_s: float) -> dict[Key, float]:
        """Return nothing: a bound would save a quarter of the search."""
        return {}

    def broken(self, candidate: Candidate, length_s: float) -> list[str]:
        """Return the rules that a campaign breaks."""
        return [*self._broken_order(candidate.stops), *blind(self, candidate, length_s, _STEP)]

    def _powers(self, candidate: Candidate, length_s: float) -> list[Power]:
        """Return how surely what departs would be seen if it moved a result by its U, or by that of today if larger."""
        known = self._determined(candidate, length_s)
        rows, departures = residuals_of(known.fitted, known.estimates, known.constants, known.standards)
        today = reached(self.estimates(*self.today))
        kinds = [str(entry.conditions["kind"]) for entry in rows.stated]
        asked = [today.get(Key(entry.quantity, "", kind), 0.0) for entry, kind in zip(rows.stated, kinds, strict=True)]
        rows = replace(rows, expanded=np.maximum(rows.expanded, asked))
        wanted = {quantity for quantity, _ in self.wanted}
        return weakest(
            (f"{one.family} ({kind})", entry.quantity, float(power))
            for one, of_it in zip(departures, powers(rows, departures, SHARE), strict=True)
            if _is_kept(one)
            for power, entry, kind in zip(of_it, rows.stated, kinds, strict=True)
            if entry.quantity in wanted and "repeat" not in entry.conditions
        )

    def told(self, candidate: Candidate, length_s: float) -> dict[str, str]:
        """Return levels, temperatures, repeats, length of records and soaks in words."""
        told = {}
        for group, levels_A in zip(self._template.groups, candidate.levels_A, strict=True):
            kind = kind_name(self._campaign.channel(group[0]).kind)
            told[f"levels, {kind}"] = ", ".join(format_quantity(level_A, "A") for level_A in levels_A)
        visits = (
            f"{stop.temperature_degC:g}{_repeat_told(candidate.channels_at(number))}"
            for number, stop in enumerate(candidate.stops)
        )
        told["temperatures, degC"] = ", ".join(visits)
        told["records"] = f"{length_s:g} s"
        slots_min = [slot / 60.0 for slot in self._slots_s(candidate.stops, candidate.by_lag) if slot]
        told["soaks"] = ", ".join(f"{slot:g}" for slot in slots_min) + f" min{self._why_so_long(candidate)}"
        return told

    def changes(self, candidate: Candidate, length_s: float) -> Iterator[tuple[str, Candidate, float]]:
        """Yield the way from the given campaign: soaks, temperatures and repeats, levels of each kind, records."""
        here, given_s = self.today
        if candidate.by_lag:
            here = replace(here, by_lag=True)
            yield "soaks by the lag", here, given_s
        here = replace(here, stops=candidate.stops, again=candidate.again)
        yield "temperatures and repeats", here, given_s
        for group, channels in enumerate(self._template.groups):
            here = self._with(here, group, candidate.levels_A[group])
            yield f"levels, {kind_name(self._campaign.channel(channels[0]).kind)}", here, given_s
        yield "records", candidate, length_s

    def written(self, candidate: Candidate, length_s: float, name: str, heading: Sequence[str]) -> str:
        """Return the campaign as a sequence of this name. Raises: InputError B-DES-005."""
        duration_s = self.duration_s(candidate, length_s)
        title = f"AF-converter scale factor as planned, {duration_s / 3600.0:.1f} hours"
        records = str(self.extent(candidate)[1])
        text = self._given.renamed(name, title=title, duration=f"{duration_s:.10g} s", records=records)
        write_levels(text, self._template, candidate.levels_A)
        write_length(text, length_s, self._template.dwell_s)
        channels = [candidate.channels_at(number) for number in range(len(candidate.stops))]
        slots_s = self._slots_s(candidate.stops, candidate.by_lag)
        write_stops(text, candidate.stops, channels, slots_s, self._why_so_long(candidate) or " of the given length")
        return text.text(heading)

    def _why_so_long(self, candidate: Candidate) -> str:
        """Return what the lengths of the soaks rest on, "" where they are those given."""
        if not candidate.by_lag or self._given.lag_s is None:
            return ""
        lag_min, start_degC = self._given.lag_s / 60.0, self._template.start_degC
        return f" for a lag of {lag_min:.3g} min and no more, the chamber at {start_degC:g} degC before the first"

    def _may(self, tour: Tour) -> bool:
        return not self._broken_order(tour) and math.isfinite(sum(self._slots_s(tour, self._by_lag)))

    def _broken_order(self, tour: Tour) -> list[str]:
        sentences = [f"no {what} visit of one temperature" for what in missing_repeats(tour)]
        if self._standards.drift is None and is_monotone(tour):
            sentences.append("temperatures in one direction while nobody declares the drift of the calibrator")
        return sentences

    def _heat(self, candidate: Candidate, channel: int) -> float:
        return math.fsum(point.level_A**2 for point in self._visit(candidate, channel))

    def _visit(self, candidate: Candidate, channel: int) -> list[Point]:
        kept = {0.0, *candidate.levels_A[self._template.group_of(channel)]}
        return [point for point in self._template.points[channel] if point.level_A in kept]

    def _leads_s(self, candidate: Candidate, channel: int) -> list[float]:
        return [point.lead_s for point in self._visit(candidate, channel)]

    def _visit_s(self, candidate: Candidate, length_s: float, channel: int) -> float:
        leads_s = self._leads_s(candidate, channel)
        return math.fsum(leads_s) + len(leads_s) * length_s

    def _slots_s(self, stops: Tour, by_lag: bool) -> list[float]:
        """Return the time before each stop; infinite for a step of temperature of an unknown length."""
        template, soak, lag_s = self._template, self._template.soak, self._given.lag_s
        if stops == template.stops and not by_lag:
            return list(template.slots_s)
        if by_lag and lag_s is not None:
            slots_s = (
                slot_s(step, soak.ramp_degC_min, soak.within_degC, soak.for_s, lag_s) if step or not number else 0.0
                for number, step in enumerate(template.steps_degC(stops))
            )
            return [max(slot, soak.least_s or 0.0) if slot else 0.0 for slot in slots_s]
        longest, slot = max(template.steps_degC(template.stops)), max(template.slots_s)
        return [slot if step <= longest else math.inf for step in template.steps_degC(stops)]

    def _windows(self, candidate: Candidate, length_s: float, wanted: Iterable[int]) -> Iterator[RecordWindow]:
        """Yield the records of some channels at their times."""
        now_s, number, chosen = self._template.begin_s, 0, set(wanted)
        slots_s = self._slots_s(candidate.stops, candidate.by_lag)
        for place, (stop, slot) in enumerate(zip(candidate.stops, slots_s, strict=True)):
            now_s += slot
            for channel in candidate.channels_at(place) or self._template.points:
                if channel not in chosen:
                    now_s += self._visit_s(candidate, length_s, channel)
                    continue
                for point in self._visit(candidate, channel):
                    begin_ns, number = round((now_s + point.lead_s) * NS), number + 1
                    conditions = {**point.conditions, "temperature_degC": stop.temperature_degC, "repeat": stop.repeat}
                    end_ns = begin_ns + round(length_s * NS)
                    link = self._given.plan.measurement_link
                    yield RecordWindow(number, link, 0, 0, begin_ns, end_ns, conditions)
                    now_s += point.lead_s + length_s


def _is_kept(departure: Departure) -> bool:
    """Return whether a plan must still show a departure that today shows: a part of the current, of a kind or of all.

    A drift is none of them: it is measured by the repeats, and stands in each uncertainty.
    """
    return departure.carrier == "gain" and departure.shape != "drift" and not _SMALL & departure.about.keys()


def _repeat_told(channels: Sequence[int]) -> str:
    return f" (repeat of channel {', '.join(map(str, channels))})" if channels else ""


def _with_the_largest(levels_A: Levels) -> Iterator[Levels]:
    """Yield the choices of levels with the largest, which alone shows a soft end, and enough to spare."""
    *others, largest = levels_A
    for count in range(_PARAMETERS + _SPARE_LEVELS - 2, len(others) + 1):
        yield from ((*kept, largest) for kept in combinations(others, count))
