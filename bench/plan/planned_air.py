"""The planned temperature of a chamber's air, and when each step of a plan begins."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np

from bench.model.arrays import Floats
from bench.plan.plan import SetPoint, Step, Steps
from bench.plan.step_kinds import CHAMBER, PlannedCall, PlannedSoak

LAB_AIR_degC = 23.0  # where a chamber starts when the plan does not say (reference conditions 23 degC)


@dataclass(frozen=True)
class _Move:
    """From ``t_s`` on the set-point goes from ``from_degC`` to ``to_degC``, and is there at ``there_s``."""

    t_s: float
    from_degC: float
    to_degC: float
    there_s: float

    def at(self, t_s: float) -> float:
        """Return set-point at a time, degC."""
        if t_s >= self.there_s:
            return self.to_degC
        return self.from_degC + (self.to_degC - self.from_degC) * (t_s - self.t_s) / (self.there_s - self.t_s)


class _Chamber:
    """Follows the commands: a set-point counts from ``run`` on, a new one replaces it wherever the ramp is."""

    def __init__(self) -> None:
        self._last_degC = LAB_AIR_degC
        self._asked: SetPoint | None = None
        self._move: _Move | None = None
        self.t_s: list[float] = []
        self.degC: list[float] = []

    def soak(self, t_s: float, asked: SetPoint) -> None:
        """Take a set-point and run."""
        self._asked = asked
        self.run(t_s)

    def set_temperature(self, t_s: float, asked: SetPoint) -> None:
        """Take a new set-point, at once if the chamber runs."""
        self._asked = asked
        if self._move is not None:
            self.run(t_s)

    def run(self, t_s: float) -> None:
        """Begin to move, or go on."""
        if self._asked is not None:
            to_degC, ramp_degC_min = self._asked.temperature_degC, self._asked.ramp_degC_min
            self.until(t_s)
            ramp_s = 60.0 * abs(to_degC - self._last_degC) / ramp_degC_min if ramp_degC_min else 0.0
            self._move = _Move(t_s, self._last_degC, to_degC, t_s + ramp_s)
            self._corner(t_s, self._last_degC)

    def hold(self, t_s: float) -> None:
        """The ramp stands still."""
        if self._move is not None:
            self.until(t_s)
            self._move = _Move(t_s, self._last_degC, self._last_degC, t_s)

    def stop(self, t_s: float) -> None:
        """Nothing is planned any more: the line ends here."""
        self.until(t_s)
        if self._move is not None:
            self._corner(t_s, float("nan"))
        self._move = None

    def until(self, t_s: float) -> None:
        """Draw what has been begun up to this time."""
        if self._move is not None:
            if self._move.t_s < self._move.there_s < t_s:
                self._corner(self._move.there_s, self._move.to_degC)
            self._last_degC = self._move.at(t_s)
            self._corner(t_s, self._last_degC)

    def _corner(self, t_s: float, degC: float) -> None:
        if not self.t_s or (self.t_s[-1], self.degC[-1]) != (t_s, degC):
            self.t_s.append(t_s)
            self.degC.append(degC)


def planned_temperature(steps: Steps, prepare_s: float) -> tuple[Floats, Floats]:
    """Return corners of the planned air temperature through all phases: it ramps from where it is, then holds.

    Before the chamber is first used it has the temperature of the room.

    Args:    steps, prepare_s: of the plan, and how long its preparation lasts.
    Returns: (t_s, degC), each (k,), seconds from the start of the campaign, NaN where the chamber is stopped; empty
             if the plan does not use a chamber.
    """
    chamber = _Chamber()
    end_s = 0.0
    for step, t_s in timed_steps(steps, prepare_s):
        end_s = max(end_s, t_s + step.duration_s)
        if isinstance(step, PlannedSoak):
            chamber.soak(t_s, step.set_point)
        elif isinstance(step, PlannedCall) and step.role == CHAMBER:
            _command(chamber, step, t_s)
    chamber.until(end_s)
    return np.array(chamber.t_s), np.array(chamber.degC)


def _command(chamber: _Chamber, call: PlannedCall, t_s: float) -> None:
    if call.set_point is not None:
        chamber.set_temperature(t_s, call.set_point)
    elif call.name == "run":
        chamber.run(t_s)
    elif call.name == "hold":
        chamber.hold(t_s)
    elif call.name == "stop":
        chamber.stop(t_s)


def timed_steps(steps: Steps, prepare_s: float) -> Iterator[tuple[Step, float]]:
    """Yield each step with its start in seconds from the campaign's start: preparation before 0, the rest behind."""
    end_s = max((step.at_s + step.duration_s for step in steps if step.phase == "campaign"), default=0.0)
    origin_s = {"prepare": -prepare_s, "finally": end_s}
    for step in steps:
        yield step, step.at_s + origin_s.get(step.phase, 0.0)
