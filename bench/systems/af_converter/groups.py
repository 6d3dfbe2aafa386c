"""Sort the records of a scale-factor campaign into channels, temperatures and repeats.

The temperature of the unit during a record is measured, or interpolated over a short gap; never the set-point.
"""

from __future__ import annotations

import json
import math
from collections import Counter
from collections.abc import Hashable, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace
from typing import TYPE_CHECKING, Any

import numpy as np

from bench.analysis import Document, count_problem
from bench.model.errors import FitError
from bench.model.stopping import STAGE, STAGE_INDEX
from bench.record import UNIT_TEMPERATURE, is_off_target
from bench.systems.af_converter.estimators.readings import Readings
from bench.systems.af_converter.point import joined
from bench.systems.af_converter.wording import say

if TYPE_CHECKING:
    from bench.record import RecordRow

_PURPOSE = "measurement"
_NOT_SETTLED = "not settled"
Place = tuple[int, float, int]  # channel, nominal temperature, repeat
LONGEST_REACH_s = 600.0
_WANDER_degC = 0.05  # standard: how far a unit that takes tens of minutes to follow its chamber leaves a straight line


@dataclass(frozen=True)
class Group:
    """Usable records of one channel at one nominal temperature; ``repeat`` 0 is the first visit."""

    channel: int
    temperature_degC: float
    repeat: int
    closed: Readings  # route closed: zero and level rows
    numbers: tuple[int, ...]  # record numbers of the closed rows; of a point of several records the first one
    opened: Readings  # input open
    left_out: Mapping[str, int] = field(default_factory=dict)  # reason -> records that do not enter the fit
    open_planned: int = 0  # records with the input open, usable or not
    odd: tuple[Readings, ...] = ()  # closed rows that were left out because they are unlike all others

    @property
    def place(self) -> Place:
        """Channel, nominal temperature and repeat."""
        return self.channel, self.temperature_degC, self.repeat

    @property
    def dropped(self) -> int:
        """Records that do not enter the fit."""
        return sum(self.left_out.values())

    def without(self, row: int, reason: str) -> Group:
        """Return the group without one of its closed rows, which is counted as left out."""
        kept = np.arange(len(self.numbers)) != row
        odd = (*self.odd, self.closed.take(~kept))
        numbers = tuple(number for number, stays in zip(self.numbers, kept, strict=True) if stays)
        left_out = Counter(self.left_out) + Counter([f"{reason} (record {self.numbers[row]})"])
        return replace(self, closed=self.closed.take(kept), numbers=numbers, left_out=left_out, odd=odd)

    @property
    def unit_temperature_degC(self) -> float:
        """Return the temperature of the unit, mean over all usable records of the group; NaN if no record is usable."""
        measured = np.concatenate([self.closed.unit_temperature_degC, self.opened.unit_temperature_degC])
        return float(measured.mean()) if measured.size else float("nan")


def place_name(place: Place) -> str:
    """Return name of a group in messages and notes."""
    channel, temperature_degC, repeat = place
    if repeat:
        return say("place.repeat", channel=channel, degC=temperature_degC, repeat=repeat)
    return say("place", channel=channel, degC=temperature_degC)


def place_of(conditions: Document) -> Place:
    """Group that a record with these conditions belongs to."""
    return int(conditions["channel"]), float(conditions["temperature_degC"]), int(conditions.get("repeat", 0))


def campaign_rows(rows: Iterable[RecordRow]) -> list[RecordRow]:
    """Records that belong to the campaign, by number: what was taken for another purpose (wiring check) is left out.

    Raises: FitError B-FIT-007 if there is no such record.
    """
    chosen = sorted((row for row in rows if _belongs(row.window.conditions)), key=lambda row: row.window.number)
    if not chosen:
        raise FitError(
            "B-FIT-007",
            "the session holds no record of a channel at a temperature",
            next_step="check with 'bench recover' what the session holds",
        )
    return chosen


def _belongs(conditions: Document) -> bool:
    return conditions.get("purpose", _PURPOSE) == _PURPOSE and {"channel", "temperature_degC"} <= conditions.keys()


def row_problem(row: RecordRow, temperature: UnitTemperature | None) -> str:
    """Return why a record may not enter a group at one temperature, "" if it may."""
    problem = count_problem(row)
    if problem or temperature is None:
        return problem or say("reason.no_temperature")
    return _NOT_SETTLED if is_off_target(row.window.conditions, temperature.value_degC) else ""


def record_problems(rows: Sequence[RecordRow], measuring: Iterable[RecordRow]) -> Iterator[str]:
    """Yield of each record why a campaign of points at one temperature leaves it out, "" if it does not."""
    known = unit_temperatures(measuring)
    yield from (row_problem(row, known.get(row.window.number)) for row in rows)


def group_rows(rows: Sequence[RecordRow], master_Hz: float) -> list[Group]:
    """Groups in the order of their first record; records that are flagged or without a temperature are counted only."""
    temperatures = unit_temperatures(rows)
    sorted_rows: dict[Place, list[RecordRow]] = {}
    for row in rows:
        sorted_rows.setdefault(place_of(row.window.conditions), []).append(row)
    return [_group(place, members, temperatures, master_Hz) for place, members in sorted_rows.items()]


def _group(
    place: Place, members: list[RecordRow], temperatures: Mapping[int, UnitTemperature], master_Hz: float
) -> Group:
    problems = [row_problem(row, temperatures.get(row.window.number)) for row in members]
    good = [row for row, problem in zip(members, problems, strict=True) if not problem]
    closed = [row for row in good if not _is_open(row)]
    channel, temperature_degC, repeat = place
    readings, begins = joined(_readings(closed, channel, temperatures, master_Hz), *_stages(closed))
    return Group(
        channel=channel,
        temperature_degC=temperature_degC,
        repeat=repeat,
        closed=readings,
        numbers=tuple(row.window.number for row, begin in zip(closed, begins, strict=True) if begin),
        opened=_readings([row for row in good if _is_open(row)], channel, temperatures, master_Hz),
        left_out=Counter(problem for problem in problems if problem),
        open_planned=sum(_is_open(row) for row in members),
    )


def _stages(rows: Sequence[RecordRow]) -> tuple[list[Hashable], list[int], list[bool]]:
    """Return of each record its point, its stage, and whether it has no gap to the one before.

    None and 0 of one that is a point by itself.
    """
    conditions = [row.window.conditions for row in rows]
    if not any(STAGE in of_row for of_row in conditions):
        return [None] * len(rows), [0] * len(rows), [False] * len(rows)
    points = [
        json.dumps({name: value for name, value in of_row.items() if name not in (STAGE, STAGE_INDEX)}, sort_keys=True)
        if STAGE in of_row
        else None
        for of_row in conditions
    ]
    stops = [0, *(row.window.first_counter + row.window.frames for row in rows)]
    follows = [row.window.first_counter == stop for row, stop in zip(rows, stops[:-1], strict=True)]
    return list(points), [int(of_row.get(STAGE, 0)) for of_row in conditions], follows


def _is_open(row: RecordRow) -> bool:
    return bool(row.window.conditions.get("route", "closed") == "open")


def _readings(
    rows: list[RecordRow], channel: int, temperatures: Mapping[int, UnitTemperature], master_Hz: float
) -> Readings:
    def column(values: Iterable[Any]) -> Any:
        return np.array(list(values), dtype=np.float64)

    conditions = [row.window.conditions for row in rows]
    warmth = [temperatures[row.window.number] for row in rows]
    return Readings(
        polarity=column(given.get("polarity", 0) for given in conditions),
        level_A=column(abs(given.get("current_A", 0.0)) for given in conditions),
        range_A=column(given.get("range_A", 0.0) or 0.0 for given in conditions),
        n_count=column(row.sums["npp"][channel - 1] for row in rows),
        p_count=column(row.sums["ppp"][channel - 1] for row in rows),
        af_count=column(row.sums["af_clock"] for row in rows),
        gate_s=column(row.sums["master_count"] for row in rows) / master_Hz,
        gaps=column(row.lost for row in rows),
        time_s=column(0.5e-9 * (row.window.t_start_ns + row.window.t_end_ns) for row in rows),
        unit_temperature_degC=column(given.value_degC for given in warmth),
        temperature_std_degC=column(given.std_degC for given in warmth),
        temperature_gap=column(given.gap for given in warmth),
        scatter=np.zeros(len(rows)),
        scatter_dof=np.zeros(len(rows)),
        halves=column(_halves(row, channel) for row in rows),
    )


def _halves(row: RecordRow, channel: int) -> float:
    """Return by how much more net pulses per pulse of the AF clock a record has in its first half; NaN: not known."""
    first = row.first_half
    second = {name: row.sums[name] - early for name, early in first.items()}
    if not all(half.get("af_clock", 0) for half in (first, second)):
        return math.nan
    rates = [(half["npp"][channel - 1] - half["ppp"][channel - 1]) / half["af_clock"] for half in (first, second)]
    return float(rates[0] - rates[1])


@dataclass(frozen=True)
class UnitTemperature:
    """Mean temperature of the unit during a record.

    ``std_degC``: standard uncertainty of an interpolation, 0 where the temperature was measured; ``gap``: records with
    the same number share one error of interpolation, 0 where measured.
    """

    value_degC: float
    std_degC: float = 0.0
    gap: int = 0


def unit_temperatures(rows: Iterable[RecordRow]) -> dict[int, UnitTemperature]:
    """Return temperatures by record number; a record whose temperature is not known is not in the answer.

    A record without housekeeping takes the straight line in time between the nearest records of its link that have
    some, one before and one after, both at the same nominal temperature and, middle to middle, not more than
    ``LONGEST_REACH_s`` away. The uncertainty is that of a rectangular distribution between the two (standard deviation
    of their difference over sqrt(12)) and of ``_WANDER_degC``, and common to all records of the gap.
    """
    temperatures: dict[int, UnitTemperature] = {}
    by_link: dict[str, list[RecordRow]] = {}
    for row in sorted(rows, key=lambda row: row.window.number):
        by_link.setdefault(row.window.link, []).append(row)
    for members in by_link.values():
        known = {index: value for index, row in enumerate(members) if (value := _measured(row)) is not None}
        for index, row in enumerate(members):
            temperature = UnitTemperature(known[index]) if index in known else _between(members, known, index)
            if temperature is not None:
                temperatures[row.window.number] = temperature
    return temperatures


def _measured(row: RecordRow) -> float | None:
    value = float(row.context.get(UNIT_TEMPERATURE, float("nan")))
    return value if np.isfinite(value) else None


def _between(members: list[RecordRow], known: Mapping[int, float], index: int) -> UnitTemperature | None:
    before = max((other for other in known if other < index), default=None)
    after = min((other for other in known if other > index), default=None)
    if before is None or after is None:
        return None
    nominal = [members[position].window.conditions.get("temperature_degC") for position in (before, index, after)]
    back_s, ahead_s = (
        _middle_s(members[index]) - _middle_s(members[before]),
        _middle_s(members[after]) - _middle_s(members[index]),
    )
    if len(set(nominal)) > 1 or not (0 < back_s <= LONGEST_REACH_s and 0 < ahead_s <= LONGEST_REACH_s):
        return None
    step_degC = known[after] - known[before]
    return UnitTemperature(
        value_degC=known[before] + step_degC * back_s / (back_s + ahead_s),
        std_degC=float(np.hypot(step_degC / np.sqrt(12.0), _WANDER_degC)),
        gap=before + 1,
    )


def _middle_s(row: RecordRow) -> float:
    return 0.5e-9 * (row.window.t_start_ns + row.window.t_end_ns)
