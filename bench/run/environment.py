"""Temperatures through the whole run, once a minute: what the chamber's air and the unit really did."""

from __future__ import annotations

import math

from bench.model.clock import Clock
from bench.model.errors import InstrumentError
from bench.model.ports import Instrument, SessionSink
from bench.run.acquisition import Acquisition
from bench.run.context import CHAMBER, InUse
from bench.run.safety import QUICK_S, hurried
from bench.run.stop import StopSwitch, guarded

PERIOD_S = 60.0


class EnvironmentLog:
    """Writes an "environment" event each minute; a reading that fails is recorded as missing, never raised.

    The chamber is not asked while a step talks to it: some chambers miss what comes between their commands.
    """

    def __init__(
        self,
        chamber: Instrument | None,
        acquisition: Acquisition,
        clock: Clock,
        sink: SessionSink,
        in_use: InUse,
        stop: StopSwitch,
    ) -> None:
        self._chamber = chamber
        self._acquisition = acquisition
        self._clock = clock
        self._sink = sink
        self._in_use = in_use
        self._periodic = clock.every(PERIOD_S, guarded(self._take, stop))

    def stop(self) -> None:
        """No more readings."""
        self._periodic.cancel()

    def _take(self) -> None:
        air: float | None = None
        if self._chamber is not None and CHAMBER not in self._in_use:
            try:
                with hurried(self._chamber, QUICK_S):  # a mute chamber must not keep the bus from the steps
                    air = float(self._chamber.measure_air())  # type: ignore[attr-defined]
            except InstrumentError as error:
                self._sink.event("error", self._clock.now_ns(), {"code": error.code, "text": str(error)})
        unit = self._acquisition.unit_temperature_degC()
        fields = {"air_degC": air, "unit_degC": None if math.isnan(unit) else unit}
        self._sink.event("environment", self._clock.now_ns(), fields)
