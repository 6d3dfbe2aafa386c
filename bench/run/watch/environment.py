"""Temperatures through the whole run, once a minute: what the chamber's air and the unit really did."""

from __future__ import annotations

from bench.model.errors import InstrumentError
from bench.model.events import Environment, Error
from bench.model.units import finite
from bench.plan import CHAMBER
from bench.run.bus.safety import QUICK_S, hurried
from bench.run.context import RunContext, hottest_degC

PERIOD_S = 60.0


def note_temperatures(context: RunContext) -> None:
    """Write an "environment" event; of several units one with the hottest, and one of each unit.

    A reading that fails is recorded as missing, never raised.

    The chamber is not asked while a step talks to it: some chambers miss what comes between their commands.
    """
    air, chamber = None, context.instruments.get(CHAMBER)
    if chamber is not None and CHAMBER not in context.in_use:
        try:
            with hurried(chamber, QUICK_S):  # a mute chamber must not keep the bus from the steps
                air = float(chamber.measure_air())  # type: ignore[attr-defined]
        except InstrumentError as error:
            context.event(Error.of(error))
    temperatures_degC = context.unit_temperatures_degC
    context.event(Environment(air_degC=air, unit_degC=finite(hottest_degC(temperatures_degC))))
    for unit, degC in zip(context.units, temperatures_degC, strict=False):
        context.event(Environment(air_degC=air, unit_degC=finite(degC), uut=unit.serial))
