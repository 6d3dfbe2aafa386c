"""Simulated HP 6632B system supply (20 V, 5 A), power of the unit under test.

The unit takes a constant current (linear regulators), as its world says; below its starting voltage, or when the
current limit is lower than that, it is off.

Source: HP 6631B-6634B operating and programming guides (ranges, VOLT:PROT, CURR:PROT:STAT, OUTP:PROT:CLE, VOLT:TRIG,
INIT:NAME, INIT:CONT, ABOR; OUTP:PROT:DEL, the over-current trip waits so long after a change of the output; 36: bits
of the status, remote inhibit); InstrumentKit, hp6632b (current up to 20 mA selects the low range). Placeholders: the
over-voltage trip acts at once, the low range answers with an overload, nothing else takes time in a reading.
"""

from __future__ import annotations

from typing import Any, ClassVar

from sim_instruments.bus.kept import (
    HeldSettings,
    Kept,
    KeptSettings,
    held_count,
    held_number,
    held_switch,
    held_word,
    word,
)
from sim_instruments.bus.scpi import Answers, ScpiDevice, command
from sim_instruments.faults.fault import Fault, NamedFaults

HIGHEST_V, HIGHEST_A, HIGHEST_TRIP_V = 20.475, 5.1188, 22.0
RESTART_S = 0.3  # the unit's supply is away
_LOW_A = 0.02  # the low range of current
_QUESTIONABLE = {"OV": 1, "OC": 2, "RI": 512}
_CV, _CC = 256, 1024  # operation status


class Hp6632B(ScpiDevice):
    """DC supply with over-voltage and over-current trips that stay latched until cleared."""

    identity = "HEWLETT-PACKARD,6632B,SIM6632,A.03.01"
    answers: ClassVar[Answers] = {
        "[:SOURce]:VOLTage[:LEVel]:TRIGgered[:AMPLitude]?": lambda self: f"{self._levels()[0]:.5E}",
        "[:SOURce]:CURRent[:LEVel]:TRIGgered[:AMPLitude]?": lambda self: f"{self._levels()[1]:.5E}",
        ":STATus:QUEStionable:CONDition?": lambda self: str(_QUESTIONABLE.get(self.tripped, 0)),
        ":STATus:OPERation:CONDition?": lambda self: str(_CC if self._is_limited else _CV),
    }

    held: ClassVar[HeldSettings] = {
        "[:SOURce]:VOLTage[:LEVel][:IMMediate][:AMPLitude]": held_number(
            "voltage_V", 0.0, HIGHEST_V, "V", ".5E", applied=True
        ),
        "[:SOURce]:CURRent[:LEVel][:IMMediate][:AMPLitude]": held_number(
            "current_A", 0.0, HIGHEST_A, "A", ".5E", applied=True
        ),
        "[:SOURce]:VOLTage:PROTection[:LEVel]": held_number("trip_V", 0.0, HIGHEST_TRIP_V, "V", ".5E", applied=True),
        "[:SOURce]:CURRent:PROTection:STATe": held_switch("over_current_trip", applied=True),
        "[:SOURce]:VOLTage[:LEVel]:TRIGgered[:AMPLitude]": held_number("next_V", 0.0, HIGHEST_V, "V"),
        "[:SOURce]:CURRent[:LEVel]:TRIGgered[:AMPLitude]": held_number("next_A", 0.0, HIGHEST_A, "A"),
        ":OUTPut[:STATe]": held_switch("on", applied=True),
        ":OUTPut:PROTection:DELay": held_number("delay_s", 0.0, 2147483.647, "s", ".5E"),
        ":OUTPut:RI:MODE": held_word("inhibit_mode", "OFF", "LATChing", "LIVE"),
        ":INITiate:CONTinuous:SEQuence1": held_switch("continuous"),
        ":SENSe:CURRent[:DC]:RANGe[:UPPer]": held_number("range_A", 0.0, HIGHEST_A, "A", ".5E"),
        ":SENSe:SWEep:TINTerval": held_number("interval_s", 15.6e-6, 31200.0, "s", ".5E"),
        ":SENSe:SWEep:POINts": held_count("points", 1, 4096, ""),
    }

    kept: ClassVar[KeptSettings] = {
        "[:SOURce]:VOLTage:ALC:BANDwidth": Kept(15000.0, 15000.0, 60000.0),
        "[:SOURce]:DIGital:DATA": Kept(0, 0.0, 7.0),
        "[:SOURce]:DIGital:FUNCtion": word("RIDFi", "DIGio"),
        ":DISPlay:MODE": word("NORMal", "TEXT"),
        ":DISPlay:TEXT[:DATA]": Kept("", text=True),
        ":OUTPut:DFI:SOURce": word("OFF", "QUEStionable", "OPERation", "ESB", "RQS"),
        ":OUTPut:PON:STATe": word("RST", "RCL0"),
        ":SENSe:WINDow[:TYPE]": word("HANNing", "RECTangular"),
        ":SYSTem:LANGuage": word("SCPI", "COMPatibility"),
        ":OUTPut:DFI[:STATe]": Kept(False),
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
        self.armed, self.continuous, self.inhibited, self.inhibit_mode = False, False, False, "OFF"
        self.range_A, self.points, self.interval_s = HIGHEST_A, 2048, 15.6e-6
        self._apply()

    def press(self, keys: str) -> None:
        """Pull the line INH, or let it go."""
        self.inhibited = not self.inhibited
        if self.inhibit_mode != "OFF":
            self.tripped = "RI" if self.inhibited or self.inhibit_mode == "LATC" else ""
        self._apply()

    def outputs(self) -> dict[str, Any]:
        return {"on": self.on, "voltage_V": self.voltage_V, "tripped": self.tripped}

    def _load(self) -> tuple[float, float]:
        """Return voltage (V) and current (A) at the terminals."""
        if not self.on or self.tripped:
            return 0.0, 0.0
        start_V, load_A = self.world.load
        if self._is_limited:
            return start_V / 2, self.current_A  # the limit holds the voltage below the start of the unit
        return self.voltage_V, load_A if self.voltage_V >= start_V else 0.0

    @property
    def _is_limited(self) -> bool:
        start_V, load_A = self.world.load
        return self.on and not self.tripped and self.voltage_V >= start_V and self.current_A < load_A

    def _trip_late(self, number: int) -> None:
        """Act ``delay_s`` behind the change that brought the supply to its limit, unless it changed again."""
        if number == self._changes and self.over_current_trip and self._is_limited:
            self.tripped = "OC"
            self._apply()

    def _apply(self) -> None:
        start_V = self.world.load[0]
        self._changes += 1
        if self.on and not self.tripped and self.voltage_V > self.trip_V:
            self.tripped = "OV"
        if self.over_current_trip and self._is_limited:
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

    def _levels(self) -> tuple[float, float]:
        """Return what a trigger sets, volt and ampere: without a level of its own the immediate one (guide)."""
        return (
            self.voltage_V if self.next_V is None else self.next_V,
            self.current_A if self.next_A is None else self.next_A,
        )

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
        if self.armed or self.continuous:
            self.armed, (self.voltage_V, self.current_A) = False, self._levels()
            self._apply()

    @command(":OUTPut:PROTection:CLEar")
    def _clear_protection(self, _: str) -> None:
        self.tripped = ""
        self._apply()

    @command(":MEASure[:SCALar]:VOLTage?")
    def _measure_voltage(self, _: str) -> str:
        return self._taken(self._load()[0] + self._noise.normal(0.0, 1e-3))

    @command(":MEASure[:SCALar]:CURRent?")
    def _measure_current(self, _: str) -> str:
        current_A = self._load()[1]
        beyond = self.range_A <= _LOW_A < current_A
        return self._taken(float(self.overload) if beyond else current_A + self._noise.normal(0.0, 2e-4))

    def _taken(self, value: float) -> str:
        self.reply_after(self.points * self.interval_s)
        return self.reading(f"{value:.5E}")


SIMULATOR = Hp6632B
