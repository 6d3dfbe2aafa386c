"""Sort the records of a scale-factor campaign into channels, temperatures and repeats.

The temperature of the unit during a record is measured, or interpolated over a short gap; never the set-point.

A measuring point of a scale-factor campaign, as far as a stop rule asks: how well its mean current is known.

Random is what differs from one measurement of the same point to the next: the fractions of a pulse at the ends of each
piece, of the counts and of the AF clock, and the white noise of the converter. Source:
docs/method-af-converter.md, method-uncertainty.md.

Points that are measured in several records: how well their mean is known, and the records as one reading.

Source: docs/method-af-converter.md (quantisation, white noise), method-uncertainty.md (stop rules).
"""

from __future__ import annotations

import json
import math
from collections import Counter
from collections.abc import Hashable, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from bench.analysis import Document, count_problem
from bench.maths.arrays import Flags
from bench.model.errors import FitError
from bench.model.stopping import FIRST, STAGE, STAGE_INDEX
from bench.record import UNIT_TEMPERATURE, is_off_target
from bench.systems.af_converter.constants import read_campaign
from bench.systems.af_converter.estimators.readings import Converter, Readings
from bench.systems.af_converter.wording import say

if TYPE_CHECKING:
    from bench.record import RecordRow

UNIT = "A"


def may_end(conditions: Document) -> bool:
    """Return whether the point may end early: a level of a first visit. Zeros and repeats hold up all other points."""
    closed = conditions.get("route", "closed") != "open" and bool(conditions.get("polarity"))
    return closed and level(conditions) > 0.0 and not conditions.get("repeat", 0)


def level(conditions: Document) -> float:
    """Return the magnitude of the calibrator's current, ampere."""
    return abs(float(conditions.get("current_A") or 0.0))


def random(campaign: Document, conditions: Document, seconds: float, cuts: int) -> tuple[float, float]:
    """Return standard uncertainties of the mean current, ampere: by quantisation alone, and with the declared noise.

    Raises: FitError B-FIT-008 for a channel or noise that is not declared.
    """
    converter = read_campaign(campaign).converter(int(conditions.get("channel", 0)))
    return random_A(converter, level(conditions), seconds, cuts)


def mean(row: RecordRow, campaign: Document) -> float:
    """Return the mean current of a record by nominal scale factors, signed, ampere; NaN for one that does not count.

    Source: AF-converter paper equations (1), (2): K0 C with C = r N / t is K0 f_AF0 N / n_AF, the gate cancels.
    """
    if count_problem(row):
        return math.nan
    number = int(row.window.conditions["channel"])
    converter = read_campaign(campaign).converter(number)
    pulses = int(row.sums["npp"][number - 1]) - int(row.sums["ppp"][number - 1])
    return converter.k0_C * converter.af_clock_Hz * pulses / float(row.sums["af_clock"])


def random_A(converter: Converter, level_A: float, seconds: float, cuts: int) -> tuple[float, float]:
    """Return standard uncertainties of a mean current, ampere: by quantisation alone, and with white noise.

    Args:    level_A: magnitude of the current.   seconds: that is measured in all, positive.
             cuts: pieces it is measured in; each begins and ends anywhere between two pulses.
    Source:  docs/method-af-converter.md: two uniform residues of one pulse for each piece, of the counts and of the
             AF clock; white / sqrt(2 seconds).
    """
    of_pulse_A = converter.k0_C / seconds
    of_clock_A = level_A / (converter.af_clock_Hz * seconds)
    quantised_A = math.hypot(of_pulse_A, of_clock_A) * math.sqrt(cuts / 6.0)
    return quantised_A, math.hypot(quantised_A, converter.white_A_rtHz / math.sqrt(2.0 * seconds))


def joined(
    rows: Readings, places: Sequence[Hashable], stages: Sequence[int], follows: Sequence[bool]
) -> tuple[Readings, Flags]:
    """Return readings of which each is a whole point, and which rows (m,) are the first of theirs.

    Counts and gates add up; records without a gap between them cut no pulse there. ``scatter`` of a point is the
    variance of its mean from the scatter of its first stage alone: that of one record over the records of that length
    in the whole point. It holds the fractions of a pulse at the ends of each record, so that of a point which is quiet
    beside a pulse is too large, never too small.

    Args:    places: of each row, equal for records of one point, which stand behind each other; None for a row that is
             a point by itself, (m,).   stages: 1 for records of the first stage, (m,).   follows: records that begin
             with the very frame behind the row before, (m,).
    Source:  Stein 1945, see bench.maths.stein.
    """
    begins = np.array([place is None or not at or place != places[at - 1] for at, place in enumerate(places)], bool)
    if begins.all():
        return rows, begins
    cuts = ~(begins | np.asarray(follows, bool))
    first = np.flatnonzero(begins)
    gate_s = np.add.reduceat(rows.gate_s, first)
    columns = {name: getattr(rows, name)[first] for name in rows.__dataclass_fields__}
    for name in ("n_count", "p_count", "af_count"):
        columns[name] = np.add.reduceat(getattr(rows, name), first)
    columns["halves"] = np.where(np.append(begins[1:], True)[first], columns["halves"], np.nan)
    columns["gaps"] = np.add.reduceat(rows.gaps + cuts, first)
    for name in ("time_s", "unit_temperature_degC"):
        columns[name] = np.add.reduceat(getattr(rows, name) * rows.gate_s, first) / gate_s
    columns["temperature_std_degC"] = np.maximum.reduceat(rows.temperature_std_degC, first)
    stop = np.append(first[1:], rows.gate_s.size)
    of_stage = np.asarray(stages) == FIRST
    for at, (begin, end) in enumerate(zip(first, stop, strict=True)):
        chosen = np.flatnonzero(of_stage[begin:end]) + begin
        columns["scatter"][at], columns["scatter_dof"][at] = _scatter(rows, chosen, gate_s[at])
    return Readings(**{**columns, "gate_s": gate_s}), begins


def _scatter(rows: Readings, chosen: NDArray[np.int_], gate_s: float) -> tuple[float, float]:
    """Return the variance of the mean of pulses per pulse of the AF clock over ``gate_s``, and degrees of freedom."""
    if chosen.size < 2:
        return 0.0, 0.0
    per_pulse = (rows.n_count[chosen] - rows.p_count[chosen]) / rows.af_count[chosen]
    return float(np.var(per_pulse, ddof=1) * rows.gate_s[chosen].mean() / gate_s), chosen.size - 1.0


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
