"""Looks at the temperatures a hard limit is set on, often enough that a crossing cannot be missed for long."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping
from typing import Protocol

from bench.model.clock import Clock, Periodic, to_ns
from bench.model.errors import InstrumentError
from bench.model.events import Event
from bench.model.ports import Instrument
from bench.plan import CHAMBER
from bench.run.bus.safety import hurried
from bench.run.context import InUse
from bench.run.stop import CHAMBER_AIR, UNIT, Health, StopSwitch, guarded

WALL_S = 1.0
FASTEST_DEGC_MIN = 5.0  # no chamber of the bench heats its air faster
LONGEST_S = 300.0
BLIND_S = 10.0  # a chamber that did not answer is asked again after this time
CALL_S = 0.5  # a question that is not answered at once is asked again later: it must not keep the bus


class Guarded(Protocol):
    """As much of a run (bench.run.context.RunContext) as whatever guards it needs."""

    instruments: dict[str, Instrument]
    clock: Clock
    stop: StopSwitch
    health: Health
    in_use: InUse

    @property
    def unit_temperature_degC(self) -> float:
        """Of the unit under test, NaN if it is not known."""

    def event(self, event: Event) -> None:
        """Record something that happened."""


class TemperatureWatch:
    """Notes the chamber's air and the unit's temperature in ``context.health``, then calls ``on_reading``.

    Under the wall clock each second. Under the virtual clock, where 38 hours pass in seconds, no sooner than the
    hottest one could reach its limit at ``FASTEST_DEGC_MIN``. The chamber is not asked while a step talks to it.
    """

    def __init__(self, context: Guarded, limits: Mapping[str, float], on_reading: Callable[[], None]) -> None:
        self._context = context
        self._limits = limits
        self._on_reading = on_reading
        self._read = guarded(self.read, context.stop)
        self._periodic: Periodic | None = None
        self._wait_s = WALL_S
        self._blind_until_ns = 0

    def __enter__(self) -> TemperatureWatch:
        if self._limits:
            self._again(WALL_S)
        return self

    def __exit__(self, *_: object) -> None:
        if self._periodic is not None:
            self._periodic.cancel()

    def read(self) -> None:
        """Read once; a chamber that did not answer a moment ago is left alone, its bus may be another one's too."""
        context = self._context
        if context.clock.now_ns() >= self._blind_until_ns:
            self._wait_s = self._read_air()
        unit_degC = context.unit_temperature_degC
        if not math.isnan(unit_degC):
            context.health.note(UNIT, unit_degC)
        self._on_reading()

    def _read_air(self) -> float:
        """Note the air if the chamber can be asked; returns when to look again under the virtual clock, second."""
        context = self._context
        chamber = context.instruments.get(CHAMBER)
        if chamber is not None and CHAMBER_AIR in self._limits:
            if CHAMBER in context.in_use:
                return WALL_S
            try:
                with hurried(chamber, CALL_S):
                    context.health.note(CHAMBER_AIR, float(chamber.measure_air()))  # type: ignore[attr-defined]
            except InstrumentError:  # an old value is not a value; the environment log says what was wrong
                self._blind_until_ns = context.clock.now_ns() + to_ns(BLIND_S)
                return BLIND_S
        return patience_s(context.health.values(), self._limits)

    def _again(self, period_s: float) -> None:
        clock = self._context.clock
        self._periodic = clock.every(period_s, self._virtual_turn if clock.virtual else self._read)

    def _virtual_turn(self) -> None:
        assert self._periodic is not None
        self._periodic.cancel()
        self._read()
        self._again(self._wait_s)


def patience_s(values: Mapping[str, float], limits: Mapping[str, float]) -> float:
    """Return seconds in which nothing can reach its limit, between 1 s and ``LONGEST_S``."""
    room_degC = min((limits[name] - value for name, value in values.items() if name in limits), default=0.0)
    return min(LONGEST_S, max(WALL_S, room_degC / FASTEST_DEGC_MIN * 60.0))
