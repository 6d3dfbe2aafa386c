"""The world of a plain unit at its supply: what the meters of the bench see, each by the role that a station gives it.

``input_meter`` is at its supply, ``output_meter`` at its monitor output, ``rail_meter`` at its regulated rail and
``ohmmeter`` at its thermistor, which is in the chamber.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from typing import Any

from bench.model.clock import Clock
from bench.model.ports import RecordWindow
from sim_instruments.worlds.common.terminals import Source
from sim_instruments.worlds.common.thermal import Thermal
from sim_instruments.worlds.common.world import World, entry
from sim_instruments.worlds.readings.options import PlainOptions

START_V = 6.0  # below, the unit neither starts nor draws current
FULL_SCALE_V = 20.0  # of the supply
LEAD_OHM = 0.4
_MONITOR, _THERMISTOR_OHM = 0.5, 10_000.0
# ln(R/R25) = A + B/T + C/T^2 + D/T^3 of the material with B25/85 = 3977 K: Vishay NTCLE100E3, document 29049.
_A, _B_K, _C_K2, _D_K3 = -14.6337, 4791.842, -115334.0, -3.730535e6


class PlainWorld(World):
    """One simulated bench.

    Args: clock, seed: as of every world.   options: checked ones; the others are as by default.
    """

    ports = ()

    def __init__(self, *, clock: Clock, seed: int, options: Mapping[str, Any]) -> None:
        self.plain = PlainOptions(**options)
        thermal = Thermal(self.plain.time_constants)
        super().__init__(clock=clock, seed=seed, unit=None, thermal=thermal, options=options)
        self.terminals.connect(Source(voltage_V=lambda t_ns: self.supplied_V), "input_meter")
        self.terminals.connect(Source(voltage_V=lambda t_ns: self.monitor_V(self.supplied_V)), "output_meter")
        self.terminals.connect(Source(voltage_V=lambda t_ns: self._rail()), "rail_meter")
        self.terminals.connect(Source(resistance_ohm=self.thermistor_ohm, lead_ohm=LEAD_OHM), "ohmmeter")

    @property
    def load(self) -> tuple[float, float]:
        return START_V, self.plain.idle_A

    def monitor_V(self, supplied_V: float) -> float:
        """Return the monitor output, volt: half of the supply, with errors of offset and gain, and a bow."""
        share = supplied_V / FULL_SCALE_V
        bow_V = 4.0e-6 * self.plain.monitor_bow_ppm * _MONITOR * FULL_SCALE_V * share * (1.0 - share)
        gain = _MONITOR * (1.0 + 1e-6 * self.plain.monitor_gain_ppm)
        return self.plain.monitor_offset_V + gain * supplied_V + bow_V if supplied_V else 0.0

    def thermistor_ohm(self, t_ns: int) -> float:
        """Return the resistance of the thermistor at the temperature of the unit."""
        per_K = 1.0 / (float(self.thermal.unit_degC(t_ns)) + 273.15)
        ratio = math.exp(_A + per_K * (_B_K + per_K * (_C_K2 + per_K * _D_K3)))
        return _THERMISTOR_OHM * (1.0 + 1e-6 * self.plain.thermistor_ppm) * ratio

    def truth(self, windows: Sequence[RecordWindow]) -> list[dict[str, Any]]:
        return [entry("rail", "V", self.plain.rail_V, {}), entry("idle_current", "A", self.plain.idle_A, {})]

    def _rail(self) -> float:
        return self.plain.rail_V if self.supplied_V >= START_V else 0.0


WORLD = PlainWorld
