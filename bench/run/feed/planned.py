"""A plan by planned time: its phases one after the other, the step at a moment, what is still to come."""

from __future__ import annotations

from bisect import bisect_right
from collections.abc import Mapping, Sequence
from typing import Any

from bench.plan import MEASUREMENT, PlannedRecord, PlannedSettle, PlannedSoak, Step

ORDER = ("prepare", "campaign", "finally")
TELLING = ("prompt", "record", "unit", "verify")  # kinds of step that always leave an event in the session


def is_measurement(conditions: Mapping[str, Any]) -> bool:
    """Return whether a record counts as one of the campaign's (those of the wiring check do not)."""
    return bool(conditions.get("purpose", MEASUREMENT) == MEASUREMENT)


class PlannedRun:
    """The steps of a plan by phase; times are planned seconds of a phase."""

    def __init__(self, steps: Sequence[Step]) -> None:
        self.steps = tuple(steps)
        self._first = dict.fromkeys(ORDER, 0)
        self._starts: dict[str, list[float]] = {phase: [] for phase in ORDER}
        self.length_s = dict.fromkeys(ORDER, 0.0)
        for index, step in enumerate(self.steps):
            if not self._starts[step.phase]:
                self._first[step.phase] = index
            self._starts[step.phase].append(step.at_s)
            self.length_s[step.phase] = max(self.length_s[step.phase], step.at_s + step.duration_s)
        self._until_s = self._ends()
        self.total_s = sum(self.length_s.values())
        self.soaks = tuple(step for step in self.steps if isinstance(step, PlannedSoak))
        self.thermal = tuple(step for step in self.steps if step.set_point is not None)

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
        return self.steps[self._first[phase]] if self._starts.get(phase) else None

    def before_s(self, phase: str) -> float:
        """Planned length of the phases before one, second."""
        return sum(self.length_s[one] for one in ORDER[: ORDER.index(phase)])

    def step_at(self, phase: str, seconds: float) -> Step | None:
        """Return the step under way at a planned moment; None if the phase has no step."""
        starts = self._starts.get(phase)
        if not starts:
            return None
        return self.steps[self._first[phase] + max(0, bisect_right(starts, seconds) - 1)]

    def next_telling(self, number: int) -> Step | None:
        """The first step behind ``number`` that leaves an event when it is done; None if there is none in its phase."""
        for step in self.steps[number + 1 :]:
            if step.kind in TELLING:
                return step
        return None

    def measured_before(self, number: int) -> int:
        """Records of the campaign that are planned before a step."""
        return sum(isinstance(step, PlannedRecord) and is_measurement(step.conditions) for step in self.steps[:number])

    def position_s(self, step: Step, seconds: float) -> float:
        """Planned seconds since the start of the run, inside the step under way."""
        inside = min(max(seconds, step.at_s), self._until_s[step.number])
        return self.before_s(step.phase) + inside
