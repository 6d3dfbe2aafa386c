"""When the chamber was given which temperature, from the plan and the events of a session.

A session has no event for each step; a set-point lies between what is recorded in front of it and behind it, as far
from the former as the plan says.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

from bench.model.clock import NS, to_ns
from bench.plan import Step

_AT_THE_END = ("record", "slip")  # written when their step is over
_AT_THE_BEGIN = ("reading", "prompt", "release", "verify", "answer")

Event = tuple[int, str, int, Mapping[str, Any]]  # part, kind, monotonic time in ns, fields


@dataclass(frozen=True)
class SetPoint:
    """Air temperature that is asked from a time on; monotonic time of its part of the session."""

    part: int
    t_ns: int
    value_degC: float


def recorded_setpoints(steps: Sequence[Step], events: Iterable[Event]) -> Iterator[SetPoint]:
    """Set-points in order of time. ``steps``: the compiled plan as it is in the session."""
    asked = {index: step.set_point.temperature_degC for index, step in enumerate(steps) if step.set_point is not None}
    done, known_ns, known_s = 0, 0, 0.0  # steps before ``done`` are over; a time, and what the plan says of it
    started = 0
    for part, kind, t_ns, fields in events:
        if kind == "resume":
            done = started = int(fields.get("start", done))
            continue
        if kind == "phase":
            first = next((i for i, step in enumerate(steps) if step.phase == fields["name"]), 0)
            position = max(first, started)
        elif kind in (*_AT_THE_END, *_AT_THE_BEGIN) and 0 <= int(fields.get("step", -1)) < len(steps):
            position = int(fields["step"])
        elif kind == "end" and "steps" in fields:
            position = min(int(fields["steps"]), len(steps))
        else:
            continue
        for index in range(done, position):
            if index in asked:
                after_s = max(0.0, steps[index].at_s - known_s)
                yield SetPoint(part, min(t_ns, known_ns + to_ns(after_s)), asked[index])
        if position < len(steps):
            step, over = steps[position], kind in _AT_THE_END
            known_s = step.at_s + (step.duration_s if over else 0.0)
            known_ns = int(fields.get("t_end_ns", t_ns))
            if over and position in asked and position >= done:
                yield SetPoint(part, known_ns - round(NS * step.duration_s), asked[position])
            done = position + over
