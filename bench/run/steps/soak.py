"""The soak step: ramp the chamber, wait out the slot, and judge by the unit's own temperature."""

from __future__ import annotations

import math
from dataclasses import dataclass, field

from bench.model.clock import NS, to_ns
from bench.model.errors import InstrumentError, RunError
from bench.model.events import Error, Late, Slip
from bench.plan import PlannedSoak
from bench.run.context import RunContext

POLL_S = 60.0
LEAST_POLL_S = 1.0
READINGS = 4  # at least, over the time for which the temperature must be stable


@dataclass
class Stability:
    """Decides from (time, temperature) whether a temperature has stayed within its band long enough."""

    target_degC: float
    within_degC: float
    for_s: float
    readings: list[tuple[int, float]] = field(default_factory=list)

    def add(self, t_ns: int, temperature_degC: float) -> None:
        """Add a reading and forget those older than needed."""
        self.readings.append((t_ns, temperature_degC))
        while len(self.readings) > 1 and self.readings[1][0] <= t_ns - to_ns(self.for_s):
            self.readings.pop(0)

    @property
    def poll_s(self) -> float:
        """Time between two readings of the temperature, second."""
        return min(POLL_S, max(LEAST_POLL_S, self.for_s / READINGS))

    @property
    def stable(self) -> bool:
        """All readings of the last ``for_s`` seconds are within the band (a NaN is not)."""
        if not self.readings or self.readings[-1][0] - self.readings[0][0] < to_ns(self.for_s):
            return False
        return all(abs(value - self.target_degC) <= self.within_degC for _, value in self.readings)

    @property
    def slope_degC_min(self) -> float:
        """Slope over the readings kept, degC/min; NaN with fewer than two moments."""
        if not self.readings or self.readings[0][0] == self.readings[-1][0]:
            return math.nan
        (t0, first), (t1, last) = self.readings[0], self.readings[-1]
        return (last - first) / ((t1 - t0) / NS / 60.0)


def soak(context: RunContext, step: PlannedSoak) -> None:
    """Run one soak slot.

    Stable early: the slot is waited out. Not stable at its end: ``late`` decides: hold (wait on, at most
    ``hold_limit_s`` more; the slip is recorded), skip (go on, the records are flagged) or abort.
    Raises: RunError B-RUN-031 when the hold limit is over, or at once with abort.
    """
    chamber = context.instruments[step.role]
    with context.in_use.take(step.role):
        chamber.set_temperature(step.temperature_degC, step.ramp_degC_min)  # type: ignore[attr-defined]
        chamber.run()  # type: ignore[attr-defined]
    watch = Stability(step.temperature_degC, step.within_degC, step.for_s)
    end_s = step.at_s + step.duration_s
    moment_s = step.at_s
    while not watch.readings or moment_s < end_s:
        moment_s = min(end_s, moment_s + watch.poll_s)
        context.timeline.wait_until(moment_s)
        watch.add(context.clock.now_ns(), _sensor(context, step))
    if not watch.stable:
        _late(context, step, watch)
    context.settled = watch.stable


def _sensor(context: RunContext, step: PlannedSoak) -> float:
    if step.sensor == "unit":
        return context.unit_temperature_degC
    try:
        with context.in_use.take(step.role):
            return float(context.instruments[step.role].measure_air())  # type: ignore[attr-defined]
    except InstrumentError as error:  # no reading is not a stable temperature, and no reason to end a run
        context.event(Error(code=error.code, text=str(error), where=error.where, step=step.number))
        return math.nan


def _late(context: RunContext, step: PlannedSoak, watch: Stability) -> None:
    last = watch.readings[-1][1]
    context.event(
        Late(
            step=step.number,
            policy=step.late,
            last_degC=last,
            slope_degC_min=watch.slope_degC_min,
            role=step.role,
            target_degC=watch.target_degC,
        )
    )
    if step.late == "skip":
        return
    waited_s = 0.0
    while step.late == "hold" and waited_s < step.hold_limit_s and not watch.stable:
        context.timeline.add_slip(to_ns(watch.poll_s))
        context.timeline.wait_until(step.at_s + step.duration_s)
        waited_s += watch.poll_s
        watch.add(context.clock.now_ns(), _sensor(context, step))
    if watch.stable:
        context.event(Slip(step=step.number, seconds=waited_s, reason="soak"))
        return
    last, slope = watch.readings[-1][1], watch.slope_degC_min
    raise RunError(
        "B-RUN-031",
        f"{watch.target_degC:g} degC not reached within {watch.within_degC:g} degC in "
        f"{step.duration_s + waited_s:.0f} s (last {last:.2f} degC, {slope:+.3f} degC/min)",
        where=step.role,
        next_step="the outputs are off; check the chamber, then start again",
    )
