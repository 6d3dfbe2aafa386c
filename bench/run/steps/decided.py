"""What a run has read and decided so far, by the events of its session: a run that is gone on with knows the same."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

from bench.maths.relaxation import Lag
from bench.model.events import Decision, Event, Prompt, Reading, ThermalLag, UnitLeftOut
from bench.model.quantities import Values
from bench.plan import PlannedCall, PlannedDecision, Step, is_answered, left_out_by


@dataclass(frozen=True)
class Read:
    """A reading: its value, None if there should have been one, and the step that took it."""

    value: float | None
    step: int


KNOWN = 0.2  # of a lag, one standard uncertainty: with less nothing is ended by it


class Decided:
    """The newest reading of each action, the outcome of each decision, and the steps that are left out by them.

    ``lags``: of the units, by serial number, None where a bench has only one; as soon as they are ``KNOWN``.

    Args: steps: those of the plan, so that a number is an index.
    """

    def __init__(self, steps: Sequence[Step]) -> None:
        self._steps = steps
        self._follows = any(isinstance(step, PlannedDecision) for step in steps)
        self._newest: dict[tuple[str, str, str], tuple[Values, Read]] = {}  # oldest first
        self.outcomes: dict[int, str] = {}
        self.left_out: set[int] = set()
        self.units_out: set[str] = set()  # serial numbers of units that are left out
        self.lags: dict[str | None, Lag] = {}

    def take(self, event: Event) -> None:
        """Take what an event says of it; of readings a plan without decisions needs to know nothing."""
        if isinstance(event, UnitLeftOut):
            self.units_out.add(str(event.uut))
            self.left_out.update(*left_out_by(self._steps, [event]))
        elif isinstance(event, ThermalLag) and event.share <= KNOWN:
            self.lags[event.uut] = Lag(event.lag_s, event.share)
        if not self._follows:
            return
        if isinstance(event, Reading):
            self._read(event.role, event.name, self._arguments(event), event.value, event.step)
        elif isinstance(event, Prompt) and event.quantity:
            self._read("", event.quantity, {}, event.value, event.step)
        elif isinstance(event, Decision):
            self.outcomes[event.step] = event.outcome
            self.left_out.update(*left_out_by(self._steps, [event]))

    def newest(self, decision: PlannedDecision) -> Read | None:
        """Return the newest reading that a decision asks for, None if it was never taken."""
        for (role, name, _), (arguments, read) in reversed(self._newest.items()):
            if (role, name) == (decision.role, decision.name) and is_answered(decision, arguments):
                return read
        return None

    def _read(self, role: str, name: str, arguments: Values, value: Any, step: int) -> None:
        key = role, name, repr(sorted(arguments.items()))
        self._newest.pop(key, None)
        number = isinstance(value, int | float) and not isinstance(value, bool) and math.isfinite(value)
        self._newest[key] = arguments, Read(float(value) if number else None, step)

    def _arguments(self, event: Reading) -> Values:
        if event.arguments is not None:
            return event.arguments
        step = self._steps[event.step] if 0 <= event.step < len(self._steps) else None
        return step.arguments if isinstance(step, PlannedCall) else {}
