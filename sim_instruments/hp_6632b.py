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

from sim_instruments.bus.scpi import Answers, ScpiDevice, command
from sim_instruments.faults.fault import Fault, NamedFaults

HIGHEST_V = 20.475
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

    settings = """
[:SOURce]:VOLTage[:LEVel][:IMMediate][:AMPLitude] | voltage_V!         | 0.      | 0 20.475 V      | .5E
[:SOURce]:CURRent[:LEVel][:IMMediate][:AMPLitude] | current_A!         | 0.512   | 0 5.1188 A      | .5E
[:SOURce]:VOLTage:PROTection[:LEVel]              | trip_V!            | 22.     | 0 22 V          | .5E
[:SOURce]:CURRent:PROTection:STATe                | over_current_trip! | OFF
[:SOURce]:VOLTage[:LEVel]:TRIGgered[:AMPLitude]   | next_V             | -       | 0 20.475 V      | -
[:SOURce]:CURRent[:LEVel]:TRIGgered[:AMPLitude]   | next_A             | -       | 0 5.1188 A      | -
:OUTPut[:STATe]                                   | on!                | OFF
:OUTPut:PROTection:DELay                          | delay_s            | 0.08    | 0 2147483.647 s | .5E
:OUTPut:RI:MODE                                   | inhibit_mode       | OFF     | OFF, LATChing, LIVE
:INITiate:CONTinuous:SEQuence1                    | continuous         | OFF
:SENSe:CURRent[:DC]:RANGe[:UPPer]                 | range_A            | 5.1188  | 0 5.1188 A      | .5E
:SENSe:SWEep:TINTerval                            | interval_s         | 15.6E-6 | 15.6E-6 31200 s | .5E
:SENSe:SWEep:POINts                               | points             | 2048    | 1 4096
[:SOURce]:VOLTage:ALC:BANDwidth                   |                    | 15000.  | 15000 60000
[:SOURce]:DIGital:DATA                            |                    | 0       | 0 7
[:SOURce]:DIGital:FUNCtion                        |                    | RIDF    | RIDFi, DIGio
:DISPlay:MODE                                     |                    | NORM    | NORMal, TEXT
:DISPlay:TEXT[:DATA]                              |                    | ""
:OUTPut:DFI[:STATe]                               |                    | OFF
:OUTPut:DFI:SOURce                                |                    | OFF | OFF, QUEStionable, OPERation, ESB, RQS
:OUTPut:PON:STATe                                 |                    | RST     | RST, RCL0
:SENSe:WINDow[:TYPE]                              |                    | HANN    | HANNing, RECTangular
:SYSTem:LANGuage                                  |                    | SCPI    | SCPI, COMPatibility
"""

    def power_up(self) -> None:
        self.supplied_V, self._changes = 0.0, 0
        super().power_up()
        self._noise = self.world.rng("6632B readings")

    def reset(self) -> None:
        self.next_V: float | None = None
        self.next_A: float | None = None
        self.armed, self.inhibited, self.tripped = False, False, ""
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
