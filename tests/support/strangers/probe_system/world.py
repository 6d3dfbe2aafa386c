"""Three resistances that follow the chamber's unit: two at the scanner, the reference at the meter."""

from collections.abc import Mapping, Sequence
from typing import Any

from bench.model.ports import RecordWindow
from sim_instruments.worlds.common.terminals import Source
from sim_instruments.worlds.common.thermal import Thermal
from sim_instruments.worlds.common.world import World

OHM_AT_0, OHM_PER_DEGC = 100.0, 0.39
LEAD_OHM = 1.5


class ProbeWorld(World):
    """Probes in the chamber; nothing is supplied and nothing sends frames."""

    ports = ()

    def __init__(self, *, clock: Any, seed: int, options: Mapping[str, Any]) -> None:
        super().__init__(clock=clock, seed=seed, unit=None, thermal=Thermal(), options=options)
        probe = Source(resistance_ohm=self._ohm, lead_ohm=LEAD_OHM)
        self.terminals.connect(probe, "scanner", 101)
        self.terminals.connect(probe, "scanner", 102)
        self.terminals.connect(probe, "meter")

    def truth(self, windows: Sequence[RecordWindow]) -> list[dict[str, Any]]:
        return []

    def _ohm(self, t_ns: int) -> float:
        return OHM_AT_0 + OHM_PER_DEGC * float(self.thermal.unit_degC(t_ns))


WORLD = ProbeWorld
