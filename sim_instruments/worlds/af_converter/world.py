"""The world of the AF-converter bench: a unit of ten channels, in the chamber, at the calibrator's matrix."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from typing import Any, ClassVar, Protocol

from bench.model.clock import Clock
from bench.model.ports import RecordWindow
from sim_instruments.worlds.af_converter.constants import CURRENT_A, START_V
from sim_instruments.worlds.af_converter.ngu import Ngu
from sim_instruments.worlds.af_converter.options import apart
from sim_instruments.worlds.af_converter.slots import AfSlots
from sim_instruments.worlds.af_converter.truth import UnitTruth, estimates
from sim_instruments.worlds.common.thermal import TemperatureFunction, Thermal
from sim_instruments.worlds.common.world import Unit, World


class AfUnit(Unit, Protocol):
    """The unit under test, with the truth about it."""

    truth: UnitTruth


UnitFactory = Callable[[Clock, int, TemperatureFunction, Mapping[str, str]], AfUnit]


class AfWorld(World):
    """One simulated bench of AF converters.

    Args: clock, seed: as of every world.   options: checked ones; switches that are not given are on.
        unit_factory: makes the unit from (clock, seed, its temperature, options of its own).
    """

    ports: ClassVar[tuple[str, ...]] = ("port_a", "port_b")
    load = START_V, CURRENT_A

    def __init__(self, *, clock: Clock, seed: int, options: Mapping[str, Any], unit_factory: UnitFactory = Ngu) -> None:
        own, texts = apart(options)
        thermal = Thermal(float(own.get("time_constants", 1.0)))
        self.converters = unit_factory(clock, seed, thermal.unit, texts)
        super().__init__(clock=clock, seed=seed, unit=self.converters, thermal=thermal, options=own)

    @classmethod
    def in_slots(cls, slots: Mapping[str, Any], **made: Any) -> World:
        return AfSlots(slots, **made)

    def truth(self, windows: Sequence[RecordWindow]) -> list[dict[str, Any]]:
        return estimates(self.converters.truth, self.thermal, windows)


WORLD = AfWorld
