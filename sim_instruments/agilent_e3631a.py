"""Simulated Agilent E3631A triple supply: auxiliary rails P6V, P25V and N25V with resistive loads.

The selected rail is hidden state; one switch turns all three on and off.

Source: E3631A User's Guide (INSTrument, VOLTage, CURRent, APPLy, MEASure, OUTPut; programming ranges).
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Any, ClassVar

import numpy as np

from sim_instruments.bus.kept import HeldSettings, held_switch
from sim_instruments.bus.scpi import MISSING_PARAMETER, Answers, ScpiDevice, ScpiError, command, words

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
    answers: ClassVar[Answers] = {
        ":INSTrument:NSELect?": lambda self: f"{self.selected + 1}",
        ":INSTrument[:SELect]?": lambda self: self.rails[self.selected].name,
        "[:SOURce]:VOLTage?": lambda self: f"{self.rails[self.selected].voltage_V:+.8E}",
        "[:SOURce]:CURRent?": lambda self: f"{self.rails[self.selected].current_A:+.8E}",
    }
    held: ClassVar[HeldSettings] = {
        ":OUTPut[:STATe]": held_switch("on"),
        ":OUTPut:TRACk[:STATe]": held_switch("tracks"),
    }

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
        self.selected, self.on, self.tracks = 0, False, False

    def leave_more(self, draw: np.random.Generator) -> None:
        for rail in self.rails:
            rail.voltage_V, rail.current_A = (
                draw.uniform(rail.low_V, rail.high_V),
                draw.uniform(0.01, 1.0),
            )
        self.selected, self.on, self.tracks = int(draw.integers(3)), bool(draw.integers(2)), bool(draw.integers(2))

    def outputs(self) -> dict[str, Any]:
        return {"on": self.on, "voltages_V": [rail.voltage_V for rail in self.rails]}

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

    def _index(self, text: str) -> int:
        if not text:
            return self.selected
        return ("P6V", "P25V", "N25V").index(self.word(text, "P6V", "P25V", "N25V"))

    def _limited(self, rail: Rail, voltage: str, current: str) -> None:
        voltage_V = self.number(voltage, rail.low_V, rail.high_V) if voltage else rail.voltage_V
        current_A = self.number(current, 0.0, rail.high_A) if current else rail.current_A
        rail.voltage_V, rail.current_A = voltage_V, current_A
        if self.tracks and rail is not self.rails[0]:
            for other in self.rails[1:]:
                other.voltage_V = math.copysign(voltage_V, other.low_V + other.high_V)

    @command(":INSTrument:NSELect")
    def _select_number(self, text: str) -> None:
        self.selected = int(self.number(text, 1, 3)) - 1

    @command(":INSTrument[:SELect]")
    def _select(self, text: str) -> None:
        if not text:
            raise ScpiError(*MISSING_PARAMETER)
        self.selected = self._index(text)

    @command(":APPLy")
    def _set_rail(self, text: str) -> None:
        name, voltage, current = [*words(text), "", "", ""][:3]
        index = self._index(name)
        self._limited(self.rails[index], voltage, current)
        self.selected = index

    @command("[:SOURce]:VOLTage")
    def _set_voltage(self, text: str) -> None:
        if not text:
            raise ScpiError(*MISSING_PARAMETER)
        self._limited(self.rails[self.selected], text, "")

    @command("[:SOURce]:CURRent")
    def _set_current(self, text: str) -> None:
        if not text:
            raise ScpiError(*MISSING_PARAMETER)
        self._limited(self.rails[self.selected], "", text)

    @command(":SYSTem:REMote")
    def _remote(self, _: str) -> None:
        """On GPIB it is remote anyway; on RS-232 it is taken before everything else."""

    @command(":MEASure[:VOLTage]?")
    def _measure_voltage(self, text: str) -> str:
        self.reply_after(_READ_S)
        return self.reading(f"{self.output(self._index(text))[0] + self._noise.normal(0.0, 2e-4):+.8E}")

    @command(":MEASure:CURRent?")
    def _measure_current(self, text: str) -> str:
        self.reply_after(_READ_S)
        return self.reading(f"{self.output(self._index(text))[1] + self._noise.normal(0.0, 1e-4):+.8E}")


SIMULATOR = AgilentE3631A
