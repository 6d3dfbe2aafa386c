"""The soak step: ramp the chamber, wait out the slot, and judge by every sample of the temperature at its end."""

from __future__ import annotations

import math
from collections.abc import Sequence
from contextlib import ExitStack
from typing import TypeAlias

import numpy as np
from numpy.typing import NDArray

from bench.maths.relaxation import Window, window_of
from bench.model.clock import NS, to_ns
from bench.model.errors import RunError
from bench.model.events import Late, Settled, Slip
from bench.model.units import finite
from bench.plan import PlannedSoak, PlannedUnit, SetPoint
from bench.run.context import RunContext
from bench.run.links.thermometer import hearing
from bench.run.steps.approach import Approach, read_air_degC

POLL_S = 60.0
AIR_POLL_S, LEAST_POLL_S = 5.0, 1.0  # the chamber answers in tens of milliseconds and has other things to do
AIR_READINGS = 60  # in the window
MOST_CHANCE = 0.05  # of leaving the band again within as long as it was watched
_LONGEST_GAP = 0.25  # of the window, without a sample
LOOKS = 100  # in a slot, at units whose lag may end the soak
Times: TypeAlias = NDArray[np.int64]
Temperatures: TypeAlias = NDArray[np.float64]
Judged: TypeAlias = tuple[bool, Window | None]


class Stability:
    """Decides from all samples of the last ``for_s`` seconds whether a temperature has settled in its band."""

    def __init__(self, target_degC: float, within_degC: float, for_s: float) -> None:
        self.target_degC, self.within_degC, self.for_s = target_degC, within_degC, for_s
        self._heard: list[tuple[Times, Temperatures]] = []

    def add(self, t_ns: Times, degC: Temperatures) -> None:
        """Add samples, (n,); those without a temperature count as not there. Any thread."""
        known = np.isfinite(degC)
        if known.any():
            self._heard.append((t_ns[known], degC[known]))

    @property
    def last_degC(self) -> float:
        """The newest sample; NaN if there is none."""
        return float(self._heard[-1][1][-1]) if self._heard else math.nan

    def judged(self, now_ns: int) -> Judged:
        """Return whether it has settled, and what the samples of the window say; None without a sample.

        Settled: the window is covered without a long gap, every sample is within the band, and by all of them it stays
        there as long again, but for a chance of ``MOST_CHANCE``.
        """
        heard = self._heard
        if not heard:
            return False, None
        begin_ns = min(now_ns - to_ns(self.for_s), int(heard[-1][0][-1]))
        while heard[0][0][-1] < begin_ns:
            heard.pop(0)
        t_ns, degC = (np.concatenate(parts) for parts in zip(*heard, strict=True))
        t_ns, degC = t_ns[t_ns >= begin_ns], degC[t_ns >= begin_ns]
        low, high = self.target_degC - self.within_degC, self.target_degC + self.within_degC
        window = window_of((t_ns - now_ns) / NS, degC, low, high)
        covered = self._is_covered(t_ns, now_ns)
        within = bool(((degC >= low) & (degC <= high)).all())
        return covered and within and (window.chance is None or window.chance <= MOST_CHANCE), window

    def _is_covered(self, t_ns: Times, now_ns: int) -> bool:
        longest_ns = to_ns(max(_LONGEST_GAP * self.for_s, 2.0 * LEAST_POLL_S))
        gaps_ns = np.diff(t_ns, append=now_ns)
        return bool(t_ns[0] <= now_ns - to_ns(self.for_s) + longest_ns and (gaps_ns <= longest_ns).all())


def soak(context: RunContext, step: PlannedSoak) -> None:
    """Run one soak slot.

    Stable early: the slot is waited out, unless the lag of its units may end it. Not stable at its end: ``late``
    decides: hold (wait on, at most ``hold_limit_s`` more; the slip is recorded), skip (go on, the records are flagged)
    or abort.
    Raises: RunError B-RUN-031 when the hold limit is over, or at once with abort.
    """
    units: Sequence[PlannedUnit | None] = (context.units or (None,)) if step.sensor == "unit" else (None,)
    approach = None if step.residual_degC is None else Approach(context, step, units)
    drive(context, step.role, step.set_point)
    watches = [Stability(step.temperature_degC, step.within_degC, step.for_s) for _ in units]
    acquisition = context.acquisition
    with ExitStack() as heard:
        for unit, watch in zip(units, watches, strict=True) if step.sensor == "unit" else ():
            heard.enter_context(hearing(acquisition.lock, acquisition.readers, watch.add, unit))
        if approach is None:
            _wait_out(context, step, watches, step.at_s + step.duration_s)
        else:
            _come_near(context, step, watches, approach)
        found = _judged(context, watches)
        if not _is_stable(found):
            found = _late(context, step, watches, found)
    context.settled = _is_stable(found)
    for unit, (stable, window) in zip(units, found, strict=True):
        context.event(_settled(step, stable, window, None if unit is None else unit.serial))


def drive(context: RunContext, role: str, asked: SetPoint) -> None:
    """Give the chamber a set-point and let it run."""
    chamber = context.instruments[role]
    with context.in_use.take(role):
        chamber.set_temperature(asked.temperature_degC, asked.ramp_degC_min)  # type: ignore[attr-defined]
        chamber.run()  # type: ignore[attr-defined]
    context.observers.set_point(asked)


def _judged(context: RunContext, watches: Sequence[Stability]) -> list[Judged]:
    now_ns = context.clock.now_ns()
    return [watch.judged(now_ns) for watch in watches]


def _is_stable(found: Sequence[Judged]) -> bool:
    """Return whether every unit has settled."""
    return all(stable for stable, _ in found)


def _slowest(watches: Sequence[Stability], found: Sequence[Judged]) -> tuple[Stability, Window | None]:
    """Return the first that has not settled, and what its samples say."""
    return next((watch, window) for watch, (stable, window) in zip(watches, found, strict=True) if not stable)


def _wait_out(context: RunContext, step: PlannedSoak, watches: Sequence[Stability], end_s: float) -> None:
    """Wait until the end of the slot; look as often as the window needs once it has begun."""
    moment_s, window_s = step.at_s, end_s - step.for_s
    looked = False
    while not looked or moment_s < end_s:
        poll_s = POLL_S if moment_s + POLL_S < window_s else _poll_s(step)
        moment_s = min(end_s, moment_s + poll_s)
        context.timeline.wait_until(moment_s)
        _look(context, step, watches)
        looked = True


def _come_near(context: RunContext, step: PlannedSoak, watches: Sequence[Stability], approach: Approach) -> None:
    """Wait until the units are near their ends and stable, at most until the end of the slot; say how near they are."""
    moment_s, end_s = step.at_s, step.at_s + step.duration_s
    is_over = False
    with approach.listening():
        while not is_over and moment_s < end_s:
            moment_s = min(end_s, moment_s + min(POLL_S, max(LEAST_POLL_S, step.duration_s / LOOKS)))
            context.timeline.wait_until(moment_s)
            _look(context, step, watches)
            is_over = approach.look(moment_s) and _is_stable(_judged(context, watches))
    approach.note(end_s - moment_s)
    context.timeline.leave_out(end_s - moment_s)


def _poll_s(step: PlannedSoak) -> float:
    """Return the time between two looks: of the unit every sample is heard all the same."""
    if step.sensor == "unit":
        return min(POLL_S, max(LEAST_POLL_S, step.for_s / 4.0))
    return min(AIR_POLL_S, max(LEAST_POLL_S, step.for_s / AIR_READINGS))


def _look(context: RunContext, step: PlannedSoak, watches: Sequence[Stability]) -> None:
    """Take in what the units have said until now, or ask the chamber."""
    if step.sensor == "unit":
        _ = context.unit_temperatures_degC
        return
    degC = read_air_degC(context, step)
    for watch in watches:
        watch.add(np.array([context.clock.now_ns()]), np.array([degC]))


def _late(context: RunContext, step: PlannedSoak, watches: Sequence[Stability], found: list[Judged]) -> list[Judged]:
    """Say so, and wait on if the step says so; return what was found then. Raises: RunError B-RUN-031."""
    watch, window = _slowest(watches, found)
    context.event(
        Late(
            step=step.number,
            policy=step.late,
            last_degC=watch.last_degC,
            slope_degC_min=math.nan if window is None else window.slope_degC_min,
            role=step.role,
            target_degC=watch.target_degC,
        )
    )
    waited_s, poll_s = 0.0, _poll_s(step)
    while step.late == "hold" and waited_s < step.hold_limit_s and not _is_stable(found):
        context.timeline.add_slip(to_ns(poll_s))
        context.timeline.wait_until(step.at_s + step.duration_s)
        waited_s += poll_s
        _look(context, step, watches)
        found = _judged(context, watches)
    if _is_stable(found):
        context.event(Slip(step=step.number, seconds=waited_s, reason="soak"))
    elif step.late != "skip":
        watch, window = _slowest(watches, found)
        raise RunError(
            "B-RUN-031",
            f"{watch.target_degC:g} degC not reached within {watch.within_degC:g} degC in "
            f"{step.duration_s + waited_s:.0f} s ({_found(watch, window)})",
            where=step.role,
            next_step="check the chamber, then start again",
        )
    return found


def _found(watch: Stability, window: Window | None) -> str:
    """Return what the temperature did, in words."""
    if window is None:
        return "no temperature came"
    said = f"last {watch.last_degC:.2f} degC, {window.slope_degC_min:+.3f} degC/min"
    if window.chance is None or window.chance >= 1.0:
        return said
    return (
        f"{said}; chance that it leaves its band again {100.0 * window.chance:.0f} %, not {100.0 * MOST_CHANCE:.0f} %"
    )


def _settled(step: PlannedSoak, stable: bool, window: Window | None, uut: str | None) -> Settled:
    return Settled(
        uut=uut,
        step=step.number,
        role=step.role,
        target_degC=step.temperature_degC,
        within_degC=step.within_degC,
        for_s=step.for_s,
        stable=stable,
        samples=0 if window is None else window.samples,
        mean_degC=None if window is None else window.mean_degC,
        slope_degC_min=None if window is None else finite(window.slope_degC_min),
        spread_degC=None if window is None else window.spread_degC,
        chance=None if window is None else window.chance,
    )
