"""Simulated HP 6632B system supply (20 V, 5 A), power of the unit under test.

The unit takes a constant current (linear regulators), as its world says; below its starting voltage, or when the
current limit is lower than that, it is off.

Source: HP 6631B-6634B operating and programming guides (ranges, VOLT:PROT, CURR:PROT:STAT, OUTP:PROT:CLE, VOLT:TRIG,
INIT:NAME, ABOR; OUTP:PROT:DEL, the over-current trip waits so long after a change of the output). Placeholder: the
over-voltage trip acts at once.
"""

from __future__ import annotations

from typing import Any, ClassVar

import numpy as np

from sim_instruments.bus.kept import (
    HeldSettings,
    Kept,
    KeptSettings,
    held_number,
    held_switch,
    word,
)
from sim_instruments.bus.scpi import Answers, ScpiDevice, command
from sim_instruments.faults.fault import Fault, NamedFaults

HIGHEST_V, HIGHEST_A, HIGHEST_TRIP_V = 20.475, 5.1188, 22.0
RESTART_S = 0.3  # the unit's supply is away
_READ_S = 0.05
_QUESTIONABLE = {"OV": 1, "OC": 2}


class Hp6632B(ScpiDevice):
    """DC supply with over-voltage and over-current trips that stay latched until cleared."""

    identity = "HEWLETT-PACKARD,6632B,SIM6632,A.03.01"
    answers: ClassVar[Answers] = {
        "[:SOURce]:VOLTage[:LEVel]:TRIGgered[:AMPLitude]?": lambda self: f"{self._triggered_V():.5E}",
        "[:SOURce]:CURRent[:LEVel]:TRIGgered[:AMPLitude]?": lambda self: f"{self._triggered_A():.5E}",
        ":STATus:QUEStionable:CONDition?": lambda self: str(_QUESTIONABLE.get(self.tripped, 0)),
    }

    held: ClassVar[HeldSettings] = {
        "[:SOURce]:VOLTage[:LEVel]": held_number("voltage_V", 0.0, HIGHEST_V, "V", ".5E", applied=True),
        "[:SOURce]:CURRent[:LEVel]": held_number("current_A", 0.0, HIGHEST_A, "A", ".5E", applied=True),
        "[:SOURce]:VOLTage:PROTection[:LEVel]": held_number("trip_V", 0.0, HIGHEST_TRIP_V, "V", ".5E", applied=True),
        "[:SOURce]:CURRent:PROTection:STATe": held_switch("over_current_trip", applied=True),
        "[:SOURce]:VOLTage[:LEVel]:TRIGgered[:AMPLitude]": held_number("next_V", 0.0, HIGHEST_V, "V"),
        "[:SOURce]:CURRent[:LEVel]:TRIGgered[:AMPLitude]": held_number("next_A", 0.0, HIGHEST_A, "A"),
        ":OUTPut[:STATe]": held_switch("on", applied=True),
        ":OUTPut:PROTection:DELay": held_number("delay_s", 0.0, 2147483.647, "s", ".5E"),
    }

    kept: ClassVar[KeptSettings] = {
        ":SENSe:CURRent[:DC]:RANGe[:UPPer]": Kept(HIGHEST_A, 0.0, HIGHEST_A, "A"),
        "[:SOURce]:VOLTage:ALC:BANDwidth": Kept(15000.0, 15000.0, 60000.0),
        "[:SOURce]:DIGital:DATA": Kept(0, 0.0, 7.0),
        "[:SOURce]:DIGital:FUNCtion": word("RIDFi", "DIGio"),
        ":DISPlay:MODE": word("NORMal", "TEXT"),
        ":DISPlay:TEXT[:DATA]": Kept("", text=True),
        ":INITiate:CONTinuous:SEQuence1": Kept(False),
        ":OUTPut:DFI[:STATe]": Kept(False),
        ":OUTPut:DFI:SOURce": word("OFF", "QUEStionable", "OPERation", "ESB", "RQS"),
        ":OUTPut:RI:MODE": word("OFF", "LATChing", "LIVE"),
        ":SENSe:SWEep:TINTerval": Kept(15.6e-6, 15.6e-6, 31200.0, "S"),
        ":SENSe:SWEep:POINts": Kept(2048, 1.0, 4096.0),
        ":SENSe:WINDow[:TYPE]": word("HANNing", "RECTangular"),
    }

    def power_up(self) -> None:
        self.supplied_V, self._changes = 0.0, 0
        super().power_up()
        self._noise = self.world.rng("6632B readings")

    def reset(self) -> None:
        self.voltage_V, self.current_A, self.trip_V = 0.0, 0.512, HIGHEST_TRIP_V
        self.over_current_trip, self.on, self.tripped, self.delay_s = False, False, "", 0.08
        self.next_V: float | None = None
        self.next_A: float | None = None
        self.armed = False
        self._apply()

    def leave_more(self, draw: np.random.Generator) -> None:
        self.voltage_V, self.trip_V = draw.uniform(0.0, HIGHEST_V), draw.uniform(1.0, HIGHEST_TRIP_V)
        self.current_A, self.delay_s = draw.uniform(0.0, HIGHEST_A), draw.uniform(0.0, 30.0)
        self.over_current_trip, self.on = bool(draw.integers(2)), bool(draw.integers(2))
        self.tripped = str(draw.choice(["", "OV", "OC"], p=[0.8, 0.1, 0.1]))
        self.armed, self.next_V = bool(draw.integers(2)), draw.uniform(0.0, HIGHEST_V)
        self._apply()

    def outputs(self) -> dict[str, Any]:
        return {"on": self.on, "voltage_V": self.voltage_V, "tripped": self.tripped}

    def _load(self) -> tuple[float, float]:
        """Return voltage (V) and current (A) at the terminals."""
        if not self.on or self.tripped:
            return 0.0, 0.0
        start_V, load_A = self.world.load
        if self.voltage_V < start_V:
            return self.voltage_V, 0.0
        if self.current_A >= load_A:
            return self.voltage_V, load_A
        return start_V / 2, self.current_A  # the limit holds the voltage below the start of the unit

    def _is_overloaded(self) -> bool:
        start_V, load_A = self.world.load
        limited = self.voltage_V >= start_V and self.current_A < load_A
        return self.on and not self.tripped and self.over_current_trip and limited

    def _trip_late(self, number: int) -> None:
        """Act ``delay_s`` behind the change that brought the supply to its limit, unless it changed again."""
        if number == self._changes and self._is_overloaded():
            self.tripped = "OC"
            self._apply()

    def _apply(self) -> None:
        start_V = self.world.load[0]
        self._changes += 1
        if self.on and not self.tripped and self.voltage_V > self.trip_V:
            self.tripped = "OV"
        if self._is_overloaded():
            changes = self._changes
            self.world.after(self.delay_s, lambda: self._trip_late(changes))
        voltage_V = self._load()[0]
        supplied_V = voltage_V if voltage_V >= start_V else 0.0
        if supplied_V != self.supplied_V:
            self.supplied_V = supplied_V
            self.world.supply(supplied_V, self.role)

    def restart_unit(self) -> None:
        """Fault: the unit loses its supply for ``RESTART_S``, if it has one."""
        if self.is_first and self.supplied_V > 0.0:
            self.world.fed_by(self.role).set_power(False, self.now_ns, 0.0)
            self.world.after(RESTART_S, self._back)

    def _back(self) -> None:
        if self.supplied_V > 0.0:
            self.world.fed_by(self.role).set_power(True, self.now_ns, self.supplied_V)

    named_faults: ClassVar[NamedFaults] = {
        "unit_restart": Fault(
            "supply", (), f"the unit loses its supply for {RESTART_S:g} s; its counter starts anew", restart_unit),
    }  # fmt: skip

    def _triggered_V(self) -> float:
        """Voltage that a trigger sets, volt: without one the immediate level, as the guide has it."""
        return self.voltage_V if self.next_V is None else self.next_V

    def _triggered_A(self) -> float:
        return self.current_A if self.next_A is None else self.next_A

    @command(":INITiate[:IMMediate]:NAME")
    def _arm(self, text: str) -> None:
        self.armed = self.word(text, "TRANsient", "ACQuire") == "TRAN" or self.armed

    @command(":ABORt")
    def _abort(self, _: str) -> None:
        self.armed = False

    @command(":TRIGger[:TRANsient][:IMMediate]")
    def _trigger_now(self, _: str) -> None:
        self.trigger()

    def trigger(self) -> None:
        if self.armed:
            self.armed, self.voltage_V, self.current_A = False, self._triggered_V(), self._triggered_A()
            self._apply()

    @command(":OUTPut:PROTection:CLEar")
    def _clear_protection(self, _: str) -> None:
        self.tripped = ""
        self._apply()

    @command(":MEASure[:SCALar]:VOLTage?")
    def _measure_voltage(self, _: str) -> str:
        self.reply_after(_READ_S)
        return self.reading(f"{self._load()[0] + self._noise.normal(0.0, 1e-3):.5E}")

    @command(":MEASure[:SCALar]:CURRent?")
    def _measure_current(self, _: str) -> str:
        self.reply_after(_READ_S)
        return self.reading(f"{self._load()[1] + self._noise.normal(0.0, 2e-4):.5E}")


SIMULATOR = Hp6632B
