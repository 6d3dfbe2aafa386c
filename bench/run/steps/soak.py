"""The soak step: ramp the chamber, wait out the slot, and judge by every sample of the temperature at its end.

How the units approach their ends says whether the rest of the slot may be left out. Behind a ramp the air of a chamber
comes to rest in minutes. It stands still once its readings of a few looks lie close together; as many looks later what
its own approach did to the unit has died away, and the means count. A lag is learnt from the first soak, which takes
its whole slot: only then is there time to see a slower one behind it.
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence
from contextlib import ExitStack, contextmanager
from typing import TypeAlias

import numpy as np
from numpy.typing import NDArray

from bench.maths.relaxation import Relaxation, Window, relaxation_of, window_of
from bench.model.clock import NS, to_ns
from bench.model.errors import InstrumentError, RunError
from bench.model.events import Error, Late, Settled, Slip, ThermalLag
from bench.model.units import finite
from bench.plan import PlannedSoak, PlannedUnit, SetPoint
from bench.run.bus.reader import hearing
from bench.run.context import RunContext

_LOOKS = 5  # in which the air stands still, and after which the means count
_AT_REST_degC = 0.3  # by so much no reading of them is off the newest: three steps of a controller's display


class Rest:
    """Since when the air stands still, look by look."""

    def __init__(self) -> None:
        self._readings: list[float] = []

    def look(self, air_degC: float) -> int:
        """Take a reading, NaN if there is none; return of how many of the last looks the means count."""
        self._readings.append(air_degC)
        if not all(abs(degC - air_degC) <= _AT_REST_degC for degC in self._readings[-_LOOKS - 1 :]):
            self._readings = [] if math.isnan(air_degC) else [air_degC]
        return max(0, len(self._readings) - 2 * _LOOKS)


class Means:
    """Means of what one unit says of its temperature, one for each look."""

    def __init__(self) -> None:
        self._heard: list[tuple[float, float, float]] = []  # samples, and the sums of their times and temperatures
        self._means: list[tuple[float, float]] = []

    def add(self, t_ns: NDArray[np.int64], degC: NDArray[np.float64]) -> None:
        """Add samples, (n,); those without a temperature count as not there. Any thread."""
        known = np.isfinite(degC)
        self._heard.append((float(known.sum()), float((t_ns[known] / NS).sum()), float(degC[known].sum())))

    def look(self) -> bool:
        """Close the mean of what was said since the look before, NaN if nothing was; return whether anything was."""
        heard, self._heard = self._heard, []
        samples, seconds, degC = (math.fsum(sums) for sums in zip((0.0, 0.0, 0.0), *heard, strict=True))
        self._means.append((seconds / samples, degC / samples) if samples else (math.nan, math.nan))
        return samples > 0.0

    def last(self, looks: int) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
        """Return times, s, and temperatures, degC, of the last looks at which anything was said, (n,) each."""
        means = np.array(self._means[len(self._means) - looks :]).reshape(-1, 2)
        t_s, degC = means[np.isfinite(means[:, 0])].T
        return t_s, degC


class Approach:
    """The units of a soak on their way, from before the chamber is given its set-point; ``means``: of each of them."""

    def __init__(self, context: RunContext, step: PlannedSoak, units: Sequence[PlannedUnit | None]) -> None:
        self._context, self._step = context, step
        ramp_degC = abs(step.temperature_degC - read_air_degC(context, step))
        ramp_s = 60.0 * ramp_degC / step.ramp_degC_min if step.ramp_degC_min else 0.0
        self._ramp_end_s = context.clock.now_ns() / NS + ramp_s
        self.means = {unit: Means() for unit in units}
        self._rest, self._looks = Rest(), 0

    @contextmanager
    def listening(self) -> Iterator[None]:
        """Hear what the units say meanwhile."""
        acquisition = self._context.acquisition
        with ExitStack() as heard:
            for unit, means in self.means.items():
                heard.enter_context(hearing(acquisition.lock, acquisition.readers, means.add, unit))
            yield

    def look(self, at_s: float) -> bool:
        """Look at a planned moment; return whether every unit, by a lag that is known, is near enough to its end."""
        heard = [means.look() for means in self.means.values()]
        if not all(heard):  # a unit is silent, or the soak goes on behind a hold and its moments have passed
            self._rest, self._looks = Rest(), 0
        elif self._context.clock.now_ns() / NS >= self._ramp_end_s:
            self._looks = self._rest.look(read_air_degC(self._context, self._step))
        if at_s < self._step.at_s + (self._step.least_s or 0.0):
            return False
        lags = self._context.decided.lags
        return all(_serial(unit) in lags and self._is_near(self._left(unit)) for unit in self.means)

    def _is_near(self, left: Relaxation | None) -> bool:
        limit_degC = self._step.residual_degC
        return left is not None and limit_degC is not None and left.bound_degC <= limit_degC

    def _left(self, unit: PlannedUnit | None) -> Relaxation | None:
        t_s, degC = self.means[unit].last(self._looks)
        known = self._context.decided.lags.get(_serial(unit))
        return relaxation_of(t_s, degC, self._context.clock.now_ns() / NS, self._step.slot_s, known)

    def note(self, saved_s: float) -> None:
        """Write what the soak says of the lag of each unit; nothing of one that came to no rest, or was silent."""
        for unit in self.means:
            left = self._left(unit)
            if left is not None:
                self._context.event(
                    ThermalLag(
                        uut=_serial(unit), step=self._step.number, lag_s=left.lag.lag_s, share=left.lag.share,
                        residual_degC=left.residual_degC, bound_degC=left.bound_degC, saved_s=saved_s,
                    )
                )  # fmt: skip


def _serial(unit: PlannedUnit | None) -> str | None:
    return None if unit is None else unit.serial


def read_air_degC(context: RunContext, step: PlannedSoak) -> float:
    """Ask the chamber of a soak for its air; NaN if it does not answer: no run ends by that, and nothing is stable."""
    try:
        with context.in_use.take(step.role):
            return float(context.instruments[step.role].measure_air())  # type: ignore[attr-defined]
    except InstrumentError as error:
        context.event(Error.of(error, step.number))
        return math.nan


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
