"""Temperatures through the whole run, once a minute: what the chamber's air and the unit really did."""

from __future__ import annotations

import math

from bench.model.errors import InstrumentError
from bench.model.events import Environment, Error
from bench.plan import CHAMBER
from bench.run.bench.safety import QUICK_S, hurried
from bench.run.context import RunContext, hottest_degC
from bench.run.stop import guarded

PERIOD_S = 60.0


class EnvironmentLog:
    """Writes an "environment" event each minute; of several units one with the hottest, and one of each unit.

    A reading that fails is recorded as missing, never raised.

    The chamber is not asked while a step talks to it: some chambers miss what comes between their commands.
    """

    def __init__(self, context: RunContext) -> None:
        self._context = context
        self._periodic = context.clock.every(PERIOD_S, guarded(self._take, context.stop))

    def stop(self) -> None:
        """No more readings."""
        self._periodic.cancel()

    def _take(self) -> None:
        context, air = self._context, None
        chamber = context.instruments.get(CHAMBER)
        if chamber is not None and CHAMBER not in context.in_use:
            try:
                with hurried(chamber, QUICK_S):  # a mute chamber must not keep the bus from the steps
                    air = float(chamber.measure_air())  # type: ignore[attr-defined]
            except InstrumentError as error:
                context.event(Error(code=error.code, text=str(error), where=error.where))
        temperatures_degC = context.unit_temperatures_degC
        context.event(Environment(air_degC=air, unit_degC=_known(hottest_degC(temperatures_degC))))
        for unit, degC in zip(context.units, temperatures_degC, strict=False):
            context.event(Environment(air_degC=air, unit_degC=_known(degC), uut=unit.serial))


def _known(degC: float) -> float | None:
    return None if math.isnan(degC) else degC
