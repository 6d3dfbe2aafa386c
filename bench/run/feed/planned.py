"""A plan by planned time: the step at a moment and in words, what is still to come, its temperatures, its end.

Planned time is waited out, so a run is never sooner than its plan plus the slip so far: that is ``likely``, since most
soaks end in their slot, and ``earliest``, but for what is left of soaks behind the least time of those that the lag of
the unit may end. A step that takes longer than planned, and a hold, move both second by second. Where decisions lie
ahead, the plan has their longest way, and the run may be sooner. What makes runs late are soaks.
``latest`` adds

* a share of the soak time that is still to come: the largest share by which a soak of this run was late, at least
  ``SHARE`` / (1 + soaks done);
* for a soak that is late now, what is left of its hold limit;
* ``LOOSE`` of all planned time to come and ``MARGIN_S``, for bus calls no settle time covers and records taken again.
"""

from __future__ import annotations

from bisect import bisect_right
from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass
from typing import Any

from bench.model.quantities import Values
from bench.model.units import format_quantity
from bench.plan import PlannedRecord, PlannedSettle, PlannedSoak, SetPoint, Step, Steps, is_measurement, is_other_length

ORDER = ("prepare", "campaign", "finally")
SHARE = 0.10
LOOSE = 0.005
MARGIN_S = 30.0


class PlannedRun:
    """The steps of a plan by phase; times are planned seconds of a phase.

    Steps that a decision has left out stay among ``steps``, whose indices are their numbers, and count nowhere else.
    """

    def __init__(self, steps: Steps, left_out: Iterable[int] = ()) -> None:
        self.steps = tuple(steps)
        self.length_s = dict.fromkeys(ORDER, 0.0)
        for step in self.steps:
            self.length_s[step.phase] = max(self.length_s[step.phase], step.at_s + step.duration_s)
        self._until_s = self._ends()
        self.total_s = sum(self.length_s.values())
        self._left_out: set[int] = set()
        self.leave_out(left_out)

    def leave_out(self, numbers: Iterable[int]) -> None:
        """Count steps no more, by their numbers."""
        self._left_out.update(numbers)
        self._phases: dict[str, list[Step]] = {phase: [] for phase in ORDER}
        for step in self.steps:
            if step.number not in self._left_out:
                self._phases[step.phase].append(step)
        self._starts = {phase: [step.at_s for step in steps] for phase, steps in self._phases.items()}
        left = [step for steps in self._phases.values() for step in steps]
        self.soaks = tuple(step for step in left if isinstance(step, PlannedSoak))
        self.thermal = tuple(step for step in left if step.set_point is not None)

    def _ends(self) -> list[float]:
        """Until when a step may last by plan: one without a time of its own shares the settle time behind it."""
        ends = [step.at_s + step.duration_s for step in self.steps]
        for index in range(len(self.steps) - 2, -1, -1):
            step, behind = self.steps[index], self.steps[index + 1]
            shares = isinstance(behind, PlannedSettle) or not behind.duration_s
            if not step.duration_s and shares and behind.phase == step.phase and behind.at_s == step.at_s:
                ends[index] = ends[index + 1]
        return ends

    def first(self, phase: str) -> Step | None:
        """Return the first step of a phase; None if it has none."""
        return next(iter(self._phases.get(phase, ())), None)

    def before_s(self, phase: str) -> float:
        """Return planned length of the phases before one, second."""
        return sum(self.length_s[earlier] for earlier in ORDER[: ORDER.index(phase)])

    def step_at(self, phase: str, seconds: float) -> Step | None:
        """Return the step under way at a planned moment; None if the phase has no step."""
        starts = self._starts.get(phase)
        if not starts:
            return None
        return self._phases[phase][max(0, bisect_right(starts, seconds) - 1)]

    def next_telling(self, number: int) -> Step | None:
        """Return the first step behind ``number`` that leaves an event when done; None if its phase has none."""
        for step in self.steps[number + 1 :]:
            if step.proof is not None and step.number not in self._left_out:
                return step
        return None

    def measured_before(self, number: int) -> int:
        """Return records of the campaign that are planned before a step."""
        kept = [step for step in self.steps[:number] if step.number not in self._left_out]
        return sum(
            isinstance(step, PlannedRecord) and is_measurement(step.conditions) and not is_other_length(step, before)
            for before, step in zip([None, *kept], kept, strict=False)
        )

    def position_s(self, step: Step, seconds: float) -> float:
        """Return planned seconds since the start of the run, inside the step under way."""
        inside = min(max(seconds, step.at_s), self._until_s[step.number])
        return self.before_s(step.phase) + inside


def conditions_in_words(conditions: Values) -> str:
    """Return temperature, channel, level and branch of a step or record, such as "50 degC channel 3 -10 mA"."""
    parts = []
    if "temperature_degC" in conditions:
        parts.append(f"{conditions['temperature_degC']:g} degC")
    if "channel" in conditions:
        parts.append(f"channel {conditions['channel']}")
    if conditions.get("route") == "open":
        parts.append("open")
    elif "current_A" in conditions:
        sign = "-" if conditions.get("polarity", 1) < 0 else "+"
        parts.append(sign + format_quantity(float(conditions["current_A"]), "A"))
    if "branch" in conditions:
        parts.append(str(conditions["branch"]))
    return " ".join(parts)


def in_words(step: Step) -> str:
    """Return one line about a step: what is done and under which conditions."""
    conditions = conditions_in_words(step.conditions)
    if isinstance(step, PlannedSoak) and "temperature_degC" not in step.conditions:
        conditions = f"{step.temperature_degC:g} degC {conditions}"
    what = f"{step.role}.{step.name}" if step.on_the_bus else step.kind
    return f"{what} {conditions}".strip()


def corners(
    thermal: Steps, start_of: Callable[[Step], float], end_utc_s: float, first_degC: float | None
) -> dict[str, list[Any]]:
    """Return corners of the set-point over time, and the bands in which soaks want the temperature.

    Args: thermal: soaks and set-points of the chamber in order.   start_of: when a step began or will, UTC second.
          end_utc_s: end of the run.   first_degC: of the chamber before the first one; None: its own target.
    Returns: ``t_utc_s`` (rising or equal) and ``temperature_degC``, of equal length; ``bands``: [begin and end, UTC
             second, least and greatest temperature], from the end of the ramp of a soak to the next set-point.
    """
    times: list[float] = []
    bands: list[list[float]] = []
    values: list[float] = []
    now_degC = first_degC
    starts = [start_of(step) for step in thermal]
    for index, step in enumerate(thermal):
        asked = step.set_point
        if asked is None:
            continue
        before_degC = asked.temperature_degC if now_degC is None else now_degC
        start = max(starts[index], times[-1] if times else starts[index])
        stop = max(start, starts[index + 1] if index + 1 < len(starts) else end_utc_s)
        there, now_degC = _ramp(start, stop, before_degC, asked)
        times += [start, there, stop]
        values += [before_degC, now_degC, now_degC]
        if isinstance(step, PlannedSoak) and there < stop:
            bands.append(
                [there, stop, step.temperature_degC - step.within_degC, step.temperature_degC + step.within_degC]
            )
    return {"t_utc_s": times, "temperature_degC": values, "bands": bands}


def _ramp(start: float, stop: float, before_degC: float, asked: SetPoint) -> tuple[float, float]:
    """Return when the set-point is at its target, or how far it comes until the next one."""
    target_degC, rate_degC_s = asked.temperature_degC, asked.ramp_degC_min / 60.0
    if rate_degC_s <= 0.0:
        return start, target_degC
    there = start + abs(target_degC - before_degC) / rate_degC_s
    if there <= stop:
        return there, target_degC
    share = (stop - start) / (there - start)
    return stop, before_degC + share * (target_degC - before_degC)


@dataclass(frozen=True)
class Remaining:
    """Time that is left: ``likely_s`` seconds, of which ``soak_s`` in soaks; ``grace_s``: a late soak may last.

    ``early_s``: soaks may be over so much before their slots, all together.
    """

    likely_s: float
    soak_s: float
    grace_s: float = 0.0
    early_s: float = 0.0


def end_of_run(t_utc_s: float, left: Remaining, late_shares: Sequence[float]) -> dict[str, float]:
    """Return range of the end, seconds since 1970 UTC. ``late_shares``: lateness over planned length of soaks done."""
    share = max([SHARE / (1 + len(late_shares)), *late_shares])
    likely = t_utc_s + left.likely_s
    spread_s = left.soak_s * share + left.grace_s + LOOSE * left.likely_s + MARGIN_S
    return {"earliest_utc_s": likely - left.early_s, "likely_utc_s": likely, "latest_utc_s": likely + spread_s}


def soak_to_come_s(soaks: Steps, step: Step, inside_s: float) -> float:
    """Return planned soak time behind a moment of the plan, second; a soak under way counts from there on."""
    whole = sum(soak.duration_s for soak in soaks if soak.number > step.number)
    return whole + (max(0.0, step.at_s + step.duration_s - inside_s) if isinstance(step, PlannedSoak) else 0.0)


def early_s(soaks: Steps, step: Step, inside_s: float) -> float:
    """Return how much planned soak time behind a moment of the plan the lag of the unit may leave out, second."""
    early = 0.0
    for soak in soaks:
        if isinstance(soak, PlannedSoak) and soak.least_s is not None and soak.number >= step.number:
            passed_s = max(0.0, inside_s - soak.at_s) if soak is step else 0.0
            early += max(0.0, soak.duration_s - max(soak.least_s, passed_s))
    return early
