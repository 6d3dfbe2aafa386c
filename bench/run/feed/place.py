"""The step under way, its place on the timeline, and what it waits for: since when, until when, the last that was read.

A living run tells the step; in a recording it is found by planned time.

A plan by planned time: the step at a moment and in words, what is still to come, its temperatures, its end.

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

import math
from bisect import bisect_right
from collections import deque
from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass
from typing import Any

from bench.model.events import (
    DECISION,
    Answer,
    Decision,
    Event,
    Late,
    Overrun,
    Phase,
    Prompt,
    Reading,
    Record,
    Reentry,
    Release,
    Resume,
    Skip,
    Slip,
    ThermalLag,
)
from bench.model.quantities import Values
from bench.model.units import format_quantity
from bench.plan import (
    PlannedPrompt,
    PlannedRecord,
    PlannedSettle,
    PlannedSoak,
    SetPoint,
    Step,
    Steps,
    is_measurement,
    is_other_length,
    left_out_by,
)
from bench.run.position import point_start

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


SLOPE_S = 600.0
LONG_CALL_S = 2.0  # an instrument that takes longer to do what it was told is waited for
_KEPT = 400


class Place:
    """The place of a run in its plan.

    ``since_utc_s``: when the step under way began. ``first_degC``: of the chamber before the plan changes it. Second 0
    of the phase under way is at ``_origin`` (UTC second), slip included.

    A recording is followed by planned time, but never past a step that leaves an event and has left none yet.
    """

    def __init__(self, plan: PlannedRun) -> None:
        self._plan = plan
        self.step: Step | None = None
        self.since_utc_s: float | None = None
        self.first_degC: float | None = None
        self._origin: float | None = None
        self._live = False
        self._next: Step | None = plan.next_telling(-1)
        self._resumed_at = 0
        self._late: PlannedSoak | None = None
        self._shares: dict[int, float] = {}  # by number of a soak that is done
        self._starts: dict[int, float] = {}  # of soaks and set-points that have begun

    # --- a living run ------------------------------------------------------------------------------------------

    def begin(self, number: int, t: float) -> None:
        """A step begins."""
        self._live = True
        self._leave(self._plan.steps[number], t)

    def on_timeline(self, origin: float) -> None:
        """The timeline of the phase under way."""
        self._live, self._origin = True, origin

    # --- a recording -------------------------------------------------------------------------------------------

    def follow(self, t: float) -> None:
        """A recording: go on to the step that is planned for now."""
        if not self._live and self.step is not None and self._origin is not None:
            self.at_planned(self.step.phase, t - self._origin)

    def at_planned(self, phase: str, seconds: float) -> None:
        """The step under way is the one planned for this moment of a phase, as far as events bear it out."""
        step = self._plan.step_at(phase, seconds)
        limit = self._late or self._next
        if step is not None and limit is not None and limit.phase == phase and step.number > limit.number:
            step = limit
        if step is not None and step is not self.step:
            self._leave(step, (self._origin or 0.0) + step.at_s)

    def on_event(self, event: Event, t: float) -> None:
        """Take what an event of a session says about its place."""
        match event:
            case Phase():
                self._on_phase(event, t)
            case Resume():
                start = event.start or 0
                self._resumed_at = start if 0 <= start < len(self._plan.steps) else 0
                self._late = None
            case Late(policy="hold"):
                late = self._numbered(event.step)
                self._late = late if isinstance(late, PlannedSoak) else self._late
            case Slip():
                self._on_slip(event)
            case Overrun():
                self._shift(event.seconds)
            case ThermalLag() if self.step is not None and event.step == self.step.number:  # none that is done again
                self._shift(-event.saved_s)
            case Release() if not self._live:
                self._on_release(event, t)
            case Reentry() if not self._resumed_at:
                self._shift(event.seconds)
            case Skip() if not self._live and 0 < event.stop < len(self._plan.steps):
                self._on_skip(event, self._plan.steps[event.stop], t)
            case Decision():
                self._plan.leave_out(n for stretch in left_out_by(self._plan.steps, [event]) for n in stretch)
                if not self._live:
                    self._bear_out(event, t)
            case Record() | Reading() | Prompt() | Answer() if not self._live:
                self._bear_out(event, t)

    def _on_phase(self, event: Phase, t: float) -> None:
        first = self._plan.first(event.name)
        if first is None:
            return
        if self._resumed_at and self._plan.steps[self._resumed_at].phase == first.phase:
            first = self._plan.steps[self._resumed_at]
        self._resumed_at = 0
        if self._live:
            self._origin = t - first.at_s
        else:
            self._back_to(first, t)

    def _on_skip(self, event: Skip, following: Step, t: float) -> None:
        self._done_to(event.stop - 1)
        if event.by == DECISION and self.step is not None and self.step.phase == following.phase:
            self._origin = t - following.at_s  # its planned time is left out too
        self._leave(following, t)

    def _on_slip(self, event: Slip) -> None:
        if event.reason == "soak" and self._late is not None:
            self._shares[self._late.number] = event.seconds / self._late.duration_s
            self._late = None
        self._shift(event.seconds)

    def _on_release(self, event: Release, t: float) -> None:
        step = self._numbered(event.step) or self.step
        if step is None:
            return
        first = self._plan.steps[point_start(self._plan.steps, step.number)]
        if first.number < step.number:
            self._back_to(first, t)
        else:
            self._shift(event.seconds)

    def _bear_out(self, event: Record | Reading | Prompt | Answer | Decision, t: float) -> None:
        """An event that names its step proves that it is done, a record also when."""
        step = self._numbered(event.step)
        if step is None or step.proof is not type(event):
            return
        self._done_to(step.number)
        if isinstance(event, Record):
            self._origin = t - (step.at_s + step.duration_s)
        following = self._plan.steps[min(step.number + 1, len(self._plan.steps) - 1)]
        if following.phase == step.phase:
            self._leave(following, t)

    def _back_to(self, first: Step, t: float) -> None:
        self._origin = t - first.at_s
        self._done_to(first.number - 1)
        self._leave(first, t)

    def _done_to(self, number: int) -> None:
        """Steps up to one are known to be done."""
        self._next = self._plan.next_telling(number)

    def _numbered(self, number: int) -> Step | None:
        return self._plan.steps[number] if 0 <= number < len(self._plan.steps) else None

    # --- both --------------------------------------------------------------------------------------------------

    def first_air(self, air_degC: float) -> None:
        """Temperature of the chamber before the plan changes it."""
        if self.first_degC is None and not self._starts:
            self.first_degC = air_degC

    def _leave(self, step: Step, t: float) -> None:
        if isinstance(self.step, PlannedSoak) and step.number > self.step.number:
            self._shares.setdefault(self.step.number, 0.0)
        self.step, self.since_utc_s = step, t
        for thermal in self._plan.thermal:  # a recording may step over some
            if thermal.phase == step.phase and thermal.number <= step.number and thermal.number not in self._starts:
                self._starts[thermal.number] = t if thermal is step else min(t, (self._origin or t) + thermal.at_s)

    def _shift(self, seconds: float) -> None:
        if not self._live and self._origin is not None and not math.isnan(seconds):
            self._origin += seconds

    def end_of(self, step: Step) -> float | None:
        """Return when a step of the phase under way ends by plan and slip, or would have ended."""
        if self._origin is None or self.step is None or step.phase != self.step.phase:
            return None
        return self._origin + (step.at_s + step.duration_s)

    def start_of(self, step: Step) -> float:
        """Return when a step began, or will begin by plan and slip."""
        if step.number in self._starts:
            return self._starts[step.number]
        assert self.step is not None
        here = (self._origin or 0.0) - self._plan.before_s(self.step.phase)
        return here + self._plan.before_s(step.phase) + step.at_s

    @property
    def late_shares(self) -> tuple[float, ...]:
        """Of every soak that is done: how late it was over its planned length."""
        return tuple(self._shares.values())

    def position_s(self, t: float) -> float | None:
        """Return planned seconds since the start of the run, inside the step under way; None before the first."""
        if self.step is None:
            return None
        return self._plan.position_s(self.step, t - (self._origin if self._origin is not None else t))

    def late_until(self, step: Step) -> float | None:
        """Return when the patience with a soak that is late ends; None if it is not late."""
        late = self._late
        if late is None or late is not step:
            return None
        since = self._starts.get(step.number, self.since_utc_s or 0.0)
        return since + late.duration_s + late.hold_limit_s

    def grace_s(self, t: float) -> float:
        """Return how much longer a soak that is late may last, second."""
        limit = None if self._late is None else self.late_until(self._late)
        return 0.0 if limit is None else max(0.0, limit - t)


class Temperature:
    """Newest temperature of the unit, and its slope over the last ten minutes."""

    def __init__(self) -> None:
        self._readings: deque[tuple[float, float]] = deque(maxlen=_KEPT)

    def add(self, t_utc_s: float, unit_degC: float) -> None:
        """A reading; one that comes within 2 s of the one before takes its place."""
        if len(self._readings) > 1 and t_utc_s - self._readings[-2][0] < 2.0:
            self._readings.pop()
        self._readings.append((t_utc_s, unit_degC))
        while t_utc_s - self._readings[0][0] > SLOPE_S:
            self._readings.popleft()

    @property
    def sentence(self) -> str | None:
        """Such as "48.21 degC, +0.401 degC/min"; None before the first reading."""
        if not self._readings:
            return None
        (t0, first), (t1, last) = self._readings[0], self._readings[-1]
        slope = f", {(last - first) / (t1 - t0) * 60.0:+.3f} degC/min" if t1 - t0 >= 30.0 else ""
        return f"{last:.2f} degC{slope}"


def wait_of(t: float, step: Step, place: Place, unit: Temperature) -> dict[str, Any] | None:
    """Return what a step waits for; None for one that takes no time worth telling."""
    since, until = place.since_utc_s, place.end_of(step)
    if isinstance(step, PlannedSoak):
        limit = place.late_until(step)
        late = "" if limit is None else ", later than planned"
        until = until if limit is None else limit
        return wait_document(f"soak {step.temperature_degC:g} degC{late}", since, until, unit.sentence)
    if isinstance(step, PlannedSettle):
        return wait_document(f"settle {step.duration_s:g} s", since, until)
    if isinstance(step, PlannedRecord):
        return wait_document(f"record of {step.seconds:g} s", since, until, unit.sentence)
    if isinstance(step, PlannedPrompt) or since is None or t - since < LONG_CALL_S:
        return None
    return wait_document(f"{step.role}.{step.name or step.kind}", since)


def wait_document(
    reason: str, since: float | None, until: float | None = None, last: str | None = None
) -> dict[str, Any]:
    """Return the entry ``wait`` of the state document: why, since when, until when, the last that was read."""
    return {"reason": reason, "since_utc_s": since, "until_utc_s": until, "last": last}
