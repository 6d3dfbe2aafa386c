"""How the units of a soak approach their ends, so that the rest of its slot may be left out.

Behind a ramp the air of a chamber comes to rest in minutes. It stands still once its readings of a few looks lie close
together; as many looks later what its own approach did to the unit has died away, and the means count.

A lag is learnt from the first soak, which takes its whole slot: only then is there time to see a slower one behind it.
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence
from contextlib import ExitStack, contextmanager

import numpy as np
from numpy.typing import NDArray

from bench.maths.relaxation import Relaxation, relaxation_of
from bench.model.clock import NS
from bench.model.errors import InstrumentError
from bench.model.events import Error, ThermalLag
from bench.plan import PlannedSoak, PlannedUnit
from bench.run.context import RunContext
from bench.run.links.thermometer import hearing

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
