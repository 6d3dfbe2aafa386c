"""Simulated Agilent E3631A triple supply: auxiliary rails P6V, P25V and N25V with resistive loads.

The selected rail is hidden state; one switch turns all three on and off.

Source: E3631A User's Guide (INSTrument, VOLTage, CURRent, APPLy, MEASure; programming ranges; 77: OUTPut, tracking
sets the -25 V rail as the +25 V one when it begins, then each as the other; 92: regulation of a rail).
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from functools import partial
from typing import Any

from sim_instruments.bus.scpi import Handlers, ScpiDevice, command, words

_READ_S = 0.1
GAIN_SIGMA = 1e-4


@dataclass
class Rail:
    """One output: programming range (volt, ampere), its load (ohm) and its present setting."""

    name: str
    low_V: float
    high_V: float
    high_A: float
    load_ohm: float
    voltage_V: float = 0.0
    current_A: float = 0.0


class AgilentE3631A(ScpiDevice):
    """Three rails; each has a gain error of its own, drawn once."""

    identity = "HEWLETT-PACKARD,E3631A,0,2.1-5.0-1.0"
    settings = """
:INSTrument[:SELect]?                              | rail.name       | -
:INSTrument:NSELect                                | number_selected | 1   | 1 3
:OUTPut[:STATe]                                    | on              | OFF
:OUTPut:TRACk[:STATe]                              | tracks!         | OFF
[:SOURce]:VOLTage[:LEVel][:IMMediate][:AMPLitude]? | rail.voltage_V  | -   |                 | +.8E
[:SOURce]:CURRent[:LEVel][:IMMediate][:AMPLitude]  | rail.current_A  | -   | 0 rail.high_A A | +.8E
:INSTrument:COUPle[:TRIGger]                       |                 | NONE
:TRIGger[:SEQuence]:SOURce                         |                 | BUS | BUS, IMMediate
:TRIGger[:SEQuence]:DELay                          |                 | 0.  | 0 3600 S
:DISPlay[:WINDow][:STATe]                          |                 | ON
:DISPlay[:WINDow]:TEXT[:DATA]                      |                 | ""
:DISPlay[:WINDow]:TEXT:CLEar                       |                 |     |                 | -
:SYSTem:BEEPer[:IMMediate]                         |                 |     |                 | -
:SYSTem:REMote                                     |                 |     |                 | -
"""

    def power_up(self) -> None:
        super().power_up()
        self._gain = self.rng("E3631A gains").normal(1.0, GAIN_SIGMA, 3)
        self._noise = self.rng("E3631A readings")

    def reset(self) -> None:
        self.rails = (
            Rail("P6V", 0.0, 6.18, 5.15, 25.0, current_A=5.0),
            Rail("P25V", 0.0, 25.75, 1.03, 150.0, current_A=1.0),
            Rail("N25V", -25.75, 0.0, 1.03, 150.0, current_A=1.0),
        )

    def outputs(self) -> dict[str, Any]:
        return {"on": self.on, "voltages_V": [rail.voltage_V for rail in self.rails]}

    @property
    def rail(self) -> Rail:
        """The rail that is selected."""
        return self.rails[self.number_selected - 1]

    def output(self, index: int) -> tuple[float, float]:
        """Return voltage (V) and current (A) of rail ``index`` (0 to 2) at its terminals."""
        if not self.on:
            return 0.0, 0.0
        rail = self.rails[index]
        voltage_V = rail.voltage_V * float(self._gain[index])
        current_A = abs(voltage_V) / rail.load_ohm
        if current_A > rail.current_A:
            voltage_V *= rail.current_A / current_A
            current_A = rail.current_A
        return voltage_V, current_A

    def further(self) -> Handlers:
        return {
            ":MEASure[:VOLTage][:DC]?": partial(self._measure, 0, 2e-4),
            ":MEASure:CURRent[:DC]?": partial(self._measure, 1, 1e-4),
            **{
                f":STATus:QUEStionable:INSTrument:ISUMmary{number}:CONDition?": partial(self._regulation, number - 1)
                for number in (1, 2, 3)
            },
        }

    def _regulation(self, index: int, _: str) -> str:
        """Tell 1 for a constant current, 2 for a constant voltage, 0 for an output that is off."""
        return str(self.on * (1 if self.output(index)[1] >= self.rails[index].current_A else 2))

    def _measure(self, what: int, noise: float, text: str) -> str:
        self.reply_after(_READ_S)
        index = self._index(text or self.rail.name)
        return self.reading(f"{self.output(index)[what] + self._noise.normal(0.0, noise):+.8E}")

    def _index(self, text: str) -> int:
        names = [rail.name for rail in self.rails]
        return names.index(self.word(text, *names))

    def _apply(self) -> None:
        self._track(self.rails[1])

    def _track(self, leader: Rail) -> None:
        if self.tracks and leader is not self.rails[0]:
            for rail in self.rails[1:]:
                rail.voltage_V = math.copysign(leader.voltage_V, rail.low_V + rail.high_V)

    @command(":INSTrument[:SELect]")
    def _select(self, text: str) -> None:
        self.number_selected = self._index(text) + 1

    @command(":APPLy")
    def _set_rail(self, text: str) -> None:
        name, *levels = words(text) or [""]
        self._select(name)
        for header, level in zip((":VOLT", ":CURR"), levels, strict=False):
            self.carry_out(f"{header} {level}")

    @command("[:SOURce]:VOLTage[:LEVel][:IMMediate][:AMPLitude]")
    def _set_voltage(self, text: str) -> None:
        rail = self.rail
        rail.voltage_V = self.number(text, rail.low_V, rail.high_V, "V")
        self._track(rail)


SIMULATOR = AgilentE3631A
