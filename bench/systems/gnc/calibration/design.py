"""Calibrations that may stand in place of a given one: other lengths of its records, and fewer whole turns.

Poses, their order, rates and the times in which the table comes to rest stay. Both sets stay whole, since the fit takes
the first record of each pose and turn, and the second one only to check it: a third would be of no use.
"""

from __future__ import annotations

import math
from collections import Counter
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import lru_cache
from itertools import product
from typing import Any

import numpy as np

from bench.analysis import CONTINUES, Document, Estimates, Planned, Reading, powers
from bench.design import Given, Key, Power, SequenceText, blind, reached
from bench.maths.verdict import coverage_factor
from bench.model.clock import NS
from bench.model.errors import InputError
from bench.model.ports import RecordWindow
from bench.plan import MEASUREMENT, Plan, PlannedCall, PlannedRecord, Step, bus_s
from bench.systems.gnc.calibration.analysis import estimates_of, fit_triad
from bench.systems.gnc.calibration.departures import SHARE, triads
from bench.systems.gnc.calibration.report import Calibration, sets_of
from bench.systems.gnc.declaration import ACCELEROMETER, CALIBRATED, TURNS, UPS, Sensor
from bench.systems.gnc.estimators.clocks import UnitClock
from bench.systems.gnc.estimators.earth_rate import MARGIN_S
from bench.systems.gnc.estimators.sensor_noise import SensorNoise
from bench.systems.gnc.limits import limits_of
from bench.systems.gnc.predicted import ITEMS, fitted, noise_of, nominal_material
from bench.systems.gnc.rows import SampledRow, sampled_rows

POSITION, CHECK, TURN = "position", "check_position", "turn_record"  # parameters that the records take their length of
_SETS = 2
_FOUND = ("scale_error", "cross_coupling", "bias")  # of both triads: what a calibration is made for
_RIVALS = {
    ("accel", "offset: drift"): "accelerometer biases that drift steadily",
    ("accel", "offset: own ^2"): "square of the acceleration",
    ("gyro", "offset: drift"): "gyro biases that drift steadily",
    ("gyro", "gain: own absolute"): "scale factors of gyros that change with the rate",
}
_SHORTEST_s, _STEP_s = 20.0, 1.0  # of positions: 20 means of a second tell their noise
_CHECKS_s = 20.0, 30.0, 40.0, 50.0  # beside that of today
_TURN_STEP_s = 0.5
_SPARE_s = 7.0  # of a record beside its turn: the commands of the table, 4 s, and the rest that tells the noise
_LONGEST_TURN_s = 8.0  # that a turn may keep the table's driver
_USE_OF_LIMIT = 0.1  # by the uncertainty of what the second set is held against
_NEARLY = 0.999  # of an uncertainty that is computed without a fit
_REPEATED = tuple(
    f"{triad}_{name}" for triad in ("accel", "gyro") for name in ("coupling_compensated", "scale_repeatability")
)


@dataclass(frozen=True)
class Candidate:
    """``check_s``: length of the second positions.   ``turn_s``: of a record behind the second before its turn.
    ``turns``: whole turns each way. The length that the search finds is that of the first positions.
    """

    check_s: float
    turn_s: float
    turns: int


def design(given: Given) -> Calibrations:
    """Return the calibrations that may stand in place of a given one.

    Raises: InputError B-DES-001 for a lag, which nothing here waits for, B-DES-004, B-DES-005.
    """
    if given.lag_s is not None:
        message = f"nothing in {given.plan.name} waits for a lag"
        raise InputError("B-DES-001", message, where="--lag", next_step="leave it out")
    return Calibrations(given)


class Calibrations:
    """The problem as the search sees it (``bench.design.Problem``)."""

    wanted = tuple((f"{triad}_{name}", "") for triad in ("accel", "gyro") for name in _FOUND)

    def __init__(self, given: Given) -> None:
        """Take a calibration apart. Raises: InputError B-DES-004 if it has less than the rules ask for, B-DES-005."""
        self._given, self._plan = given, given.plan
        _require_sets(self._plan)
        self._steps = list(_named(self._plan))
        self._turn = _turn_of(self._plan)
        self._call_s = max(bus_s(step, self._plan.station) for step in _turns(self._plan))
        position_s, check_s, turn_s = (self._length_s(name) for name in (POSITION, CHECK, TURN))
        self._turn_deg = abs(self._turn["angle"])
        self.today = Candidate(check_s, turn_s, round(self._turn_deg / 360.0)), position_s
        if not math.isclose(self.duration_s(*self.today), self._plan.duration_s) or self._turn_deg % 360.0:
            raise _other_form(self._plan, "its turns are not whole, or its records not one behind the other")
        self._accelerometer, self._gyro = map(self._noise, CALIBRATED)
        self.nominal = lru_cache(maxsize=2)(self._nominal)
        self.by_positions = lru_cache(maxsize=4096)(self._by_positions)
        self.estimates = lru_cache(maxsize=4096)(self._estimates)
        self.powers = lru_cache(maxsize=4096)(self._powers)

    def _length_s(self, name: str) -> float:
        lengths = {step.duration_s for step, parameter in self._steps if parameter == name}
        if len(lengths) != 1:
            raise _other_form(self._plan, f"records of {len(lengths)} lengths in the place of {name}")
        return lengths.pop()

    def _noise(self, sensor: Sensor) -> SensorNoise:
        undeclared: list[str] = []
        noise = noise_of(self._plan.campaign, sensor, undeclared)
        if noise is None:
            raise _other_form(self._plan, undeclared[0])
        return noise

    @property
    def starts(self) -> Iterator[Candidate]:
        """Yield the most turns in long records, which leave every other change room, and the given calibration."""
        today = self.today[0]
        yield replace(
            today, turn_s=2.0 * today.turn_s, turns=max(self._counts(2.0 * today.turn_s), default=today.turns)
        )
        yield today

    def moves(self, candidate: Candidate) -> Iterator[Candidate]:
        """Yield all others: each record is a part of the time that the unit's clock is told by, and turns by all."""
        today = self.today[0]
        turns_s = {*np.arange(_SPARE_s, 2.0 * today.turn_s, _TURN_STEP_s).tolist(), today.turn_s}
        for check_s, turn_s in product(sorted({*_CHECKS_s, today.check_s}), sorted(turns_s)):
            yield from (replace(candidate, check_s=check_s, turn_s=turn_s, turns=n) for n in self._counts(turn_s))

    def _counts(self, turn_s: float) -> list[int]:
        """Return how many turns a record of a length may hold, the most first: of equal hours they say most."""
        return [turns for turns in range(self.today[0].turns, 0, -1) if not self._broken_turns(turns, turn_s)]

    def lengths_s(self, candidate: Candidate) -> Sequence[float]:
        """Return whole seconds up to twice the given length."""
        given_s = self.today[1]
        return sorted({given_s, *np.arange(_SHORTEST_s, 2.0 * given_s + _STEP_s, _STEP_s).tolist()})

    def duration_s(self, candidate: Candidate, length_s: float) -> float:
        """Return how long a calibration takes."""
        lengths_s = _lengths_s(candidate, length_s)
        return math.fsum(lengths_s.get(name, step.duration_s) for step, name in self._steps)

    def _nominal(self, candidate: Candidate, length_s: float) -> tuple[list[SampledRow], Calibration]:
        """Return the records of a nominal unit and what is fitted to them."""
        planned = self._planned(candidate, length_s)
        rows, _ = sampled_rows(nominal_material(planned, ("gyro", "accel")), ITEMS)
        return rows, fitted(rows, planned.campaign)

    def _estimates(self, candidate: Candidate, length_s: float) -> Estimates:
        return estimates_of(self.nominal(candidate, length_s)[1], limits_of(self._plan.campaign))

    def _powers(self, candidate: Candidate, length_s: float) -> list[Power]:
        """Return how surely each rival would be seen that moves a result by 1 U; the noise holds what is declared."""
        parts, found = self.nominal(candidate, length_s)[1], []
        for triad in triads(parts, limits_of(self._plan.campaign)):
            departures = [one for one in triad.departures() if len(one.effect.T) == 1]
            rows = triad.residuals(self.estimates(candidate, length_s))
            for one, seen in zip(departures, powers(rows, departures, SHARE), strict=True):
                name = _RIVALS.get((triad.prefix, one.family), "") if not one.about else ""
                for quantity in _FOUND[: 2 if one.shape == "drift" else 3] if name else ():  # a bias is of its time
                    wanted = f"{triad.prefix}_{quantity}"
                    of_it = [p for p, entry in zip(seen, rows.stated, strict=True) if entry.quantity == wanted]
                    found.append(Power(name, wanted, float(min(of_it))))
        return found

    def at_least(self, candidate: Candidate, length_s: float) -> dict[Key, float]:
        """Return what accelerometers reach by the first positions alone, and what white noise leaves of the gyros.

        Of them bias and scale factors are those of four records and of two turns.
        """
        bounds = {key: _NEARLY * U for key, U in self.by_positions(length_s).items() if key[:2] in self.wanted}
        noise, begin_s = coverage_factor() * math.sqrt(self._gyro.density), 1.0  # before the command to turn
        moving_s, turn_deg = self._turn_s(candidate.turns) + 2.0 * MARGIN_S, 360.0 * candidate.turns
        bias = 3600.0 * noise / math.sqrt(4.0 * (begin_s + candidate.turn_s))
        scale_ppm = 1e6 * noise * math.sqrt(2.0 * moving_s) / (2.0 * turn_deg)
        of_gyros = (("gyro_bias", bias), ("gyro_scale_error", scale_ppm))
        return bounds | {Key(name, "", "gyro"): _NEARLY * U for name, U in of_gyros}

    def _by_positions(self, length_s: float) -> dict[Key, float]:
        """Return what the first positions alone say."""
        planned = self._planned(self.today[0], length_s)
        first: dict[str, RecordWindow] = {}
        for window in planned.windows:
            if window.conditions["item"] == "position":
                first.setdefault(str(window.conditions["up"]), window)
        rows, _ = sampled_rows(nominal_material(replace(planned, windows=list(first.values())), ("accel",)), ITEMS)
        parts = Calibration(sets_of(rows), UnitClock(), {row.number: 0 for row in rows})
        fit_triad(parts, ACCELEROMETER, planned.campaign, self._accelerometer)
        return reached(estimates_of(parts, limits_of(planned.campaign)))

    def broken(self, candidate: Candidate, length_s: float) -> list[str]:
        """Return the rules that a calibration breaks; all positions, turns and their repeats are in each of them."""
        sentences = self._broken_turns(candidate.turns, candidate.turn_s)
        for name, seconds in (("position", length_s), ("repeated position", candidate.check_s)):
            if seconds < _SHORTEST_s:
                sentences.append(f"a {name} of {seconds:g} s, which is shorter than {_SHORTEST_s:g} s")
        return sentences or [*self._unjudged(candidate, length_s), *blind(self, candidate, length_s)]

    def _broken_turns(self, turns: int, turn_s: float) -> list[str]:
        """Return what is wrong with turns. The more there are, the less of their angle is the error of one that ends
        off it, which moves the scale factor by more than its U before the sets differ.
        """
        moving_s, most, sentences = self._turn_s(turns), self.today[0].turns, []
        if turns > most:
            sentences.append(f"{turns} turns hide by how much one of them ends off its angle better than {most} do")
        if moving_s > _LONGEST_TURN_s:
            sentences.append(f"{turns} turns take {moving_s:.3g} s, longer than {_LONGEST_TURN_s:g} s")
        if turn_s < self._call_s:
            sentences.append(f"the call of a turn may take {self._call_s:g} s, longer than its record of {turn_s:g} s")
        if turn_s < moving_s + _SPARE_s:
            sentences.append(
                f"a turn of {moving_s:.3g} s leaves a record of {turn_s:g} s less than {_SPARE_s:g} s of rest"
            )
        return sentences

    def _turn_s(self, turns: int) -> float:
        """Return how long so many turns take from rest to rest."""
        angle, rate, acceleration = 360.0 * turns, self._turn["rate"], self._turn["acceleration"]
        peak = min(rate, math.sqrt(angle * acceleration))
        return angle / peak + peak / acceleration

    def _unjudged(self, candidate: Candidate, length_s: float) -> list[str]:
        """Return what the second set would know too badly for its limit."""
        return [
            f"{entry.quantity} is known to {entry.expanded_uncertainty:.2g}, more than a tenth of its limit"
            for entry in self.estimates(candidate, length_s)
            if entry.quantity in _REPEATED
            and entry.limit is not None
            and entry.expanded_uncertainty > _USE_OF_LIMIT * entry.limit
        ]

    def told(self, candidate: Candidate, length_s: float) -> dict[str, str]:
        """Return positions and turns in words."""
        return {
            "positions": f"6 of {length_s:g} s, again {candidate.check_s:g} s each",
            "turns": f"{candidate.turns} each way about each axis, twice, in records of 1 + {candidate.turn_s:g} s",
        }

    def changes(self, candidate: Candidate, length_s: float) -> Iterator[tuple[str, Candidate, float]]:
        """Yield the way from the given calibration: turns, second positions, first positions."""
        here, given_s = self.today
        here = replace(here, turn_s=candidate.turn_s, turns=candidate.turns)
        yield "turns", here, given_s
        yield "second positions", candidate, given_s
        yield "first positions", candidate, length_s

    def written(self, candidate: Candidate, length_s: float, name: str, heading: Sequence[str]) -> str:
        """Return the calibration as a sequence of this name. Raises: InputError B-DES-005."""
        title = f"GNC module, six positions and {candidate.turns} turns each way, as planned"
        text = self._given.renamed(name, title=title, duration=f"{self.duration_s(candidate, length_s):.10g} s")
        given = _lengths_s(*self.today)
        for parameter, seconds in _lengths_s(candidate, length_s).items():
            if parameter not in text.tree.get("parameters", {}):
                raise _other_form(self._plan, f"no parameter {parameter}")
            if seconds != given[parameter]:
                text.set_value(("parameters", parameter), f"{seconds:g} s", f"{given[parameter]:g} s before")
        if candidate.turns != self.today[0].turns:
            self._write_turns(text, candidate.turns)
        return text.text(heading)

    def _write_turns(self, text: SequenceText, turns: int) -> None:
        place, before = ("procedures", "rotations", "do"), f"{self._turn_deg:g} deg"
        try:
            lines = text.block(place)[1:]
        except KeyError as error:
            raise _other_form(self._plan, "no procedure rotations") from error
        if not any(before in line for line in lines):
            raise _other_form(self._plan, f"no {before} in the procedure rotations")
        text.replace_below(place, [line.replace(before, f"{360 * turns} deg") for line in lines])

    def _planned(self, candidate: Candidate, length_s: float) -> Planned:
        """Return the records at their times, and the turns between them."""
        lengths_s, factor = _lengths_s(candidate, length_s), candidate.turns / self.today[0].turns
        windows: list[RecordWindow] = []
        readings, now_s = [], self._plan.prepare_s
        for step, name in self._steps:
            seconds = lengths_s.get(name, step.duration_s)
            if isinstance(step, PlannedRecord):
                ends_ns = round(now_s * NS), round((now_s + seconds) * NS)
                conditions = self._turned(step.conditions, factor)
                link = self._plan.measurement_link
                windows.append(RecordWindow(len(windows) + 1, link, 0, 0, *ends_ns, conditions))
            elif isinstance(step, PlannedCall):
                arguments = self._turned(step.arguments, factor)
                readings.append(Reading(now_s, step.number, step.role, step.name, None, {}, arguments))
            now_s += seconds
        return Planned(windows, self._plan.campaign, {}, readings=readings)

    def _turned(self, values: Document, factor: float) -> dict[str, Any]:
        """Return conditions or arguments with another angle wherever that of a whole turn stands."""
        return {
            key: factor * value if isinstance(value, float) and abs(value) == self._turn_deg else value
            for key, value in values.items()
        }


def _lengths_s(candidate: Candidate, length_s: float) -> dict[str, float]:
    return {POSITION: length_s, CHECK: candidate.check_s, TURN: candidate.turn_s}


def _records(plan: Plan) -> Iterator[PlannedRecord]:
    steps = (step for step in plan.phase("campaign") if isinstance(step, PlannedRecord))
    return (step for step in steps if step.purpose == MEASUREMENT)


def _shown(step: PlannedRecord) -> tuple[Any, ...]:
    """Return the pose or the turn that a record shows."""
    conditions = step.conditions
    if conditions.get("item") == "position":
        return (str(conditions.get("up")),)
    return str(conditions.get("axis")), int(math.copysign(1, float(conditions.get("turn_deg", math.nan))))


def _require_sets(plan: Plan) -> None:
    """Refuse a calibration without each pose and each turn twice. Raises: InputError B-DES-004."""
    counts = Counter(_shown(step) for step in _records(plan) if CONTINUES not in step.conditions)
    due: list[tuple[Any, ...]] = [*((up,) for up in UPS), *TURNS]
    missing = [f"{' '.join(map(str, shown))} {counts[shown]} times" for shown in due if counts[shown] != _SETS]
    if missing or len(counts) != len(due):
        message = (
            f"the rules ask for all six positions and for turns about each axis both ways, each twice; {plan.name} has"
        )
        told = ", ".join(missing) or "others beside them"
        raise InputError("B-DES-004", f"{message} {told}", where=plan.name, next_step="add what is missing to it")


def _named(plan: Plan) -> Iterator[tuple[Step, str]]:
    """Yield each step of a campaign with the parameter that its length is of, "" for one that stays as it is."""
    seen: set[tuple[Any, ...]] = set()
    for step in plan.phase("campaign"):
        name = ""
        if isinstance(step, PlannedRecord) and step.conditions.get("item") == "position":
            name = CHECK if _shown(step) in seen else POSITION
            seen.add(_shown(step))
        elif isinstance(step, PlannedRecord) and CONTINUES in step.conditions:
            name = TURN
        yield step, name


def _turn_of(plan: Plan) -> Mapping[str, float]:
    """Return angle, rate and acceleration of the turns. Raises: InputError B-DES-005 if they differ."""
    names = ("angle", "rate", "acceleration")
    kinds = {tuple(abs(float(step.arguments[name])) for name in names) for step in _turns(plan)}
    if len(kinds) != 1:
        raise _other_form(plan, f"{len(kinds)} kinds of turns")
    return dict(zip(names, kinds.pop(), strict=True))


def _turns(plan: Plan) -> Iterator[PlannedCall]:
    steps = (step for step in plan.phase("campaign") if isinstance(step, PlannedCall))
    return (step for step in steps if step.name == "turn")


def _other_form(plan: Plan, why: str) -> InputError:
    message = f"a shorter plan is made of six positions and whole turns, each twice, which {plan.name} is not ({why})"
    return InputError("B-DES-005", message, where=plan.name, next_step="begin with the shipped gnc_imu_calibration")
