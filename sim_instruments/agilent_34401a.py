"""Simulated HP/Agilent 34401A multimeter at the source that the world wires to it, else on rail 1 (+6 V output) of the
auxiliary supply, or where the world says if there is none.

Functions other than direct voltage and resistance see nothing at the terminals.

Source: 34401A User's Guide (CONFigure, FUNCtion, RANGe, RESolution, READ?, INITiate, FETCh?, TRIGger, SAMPle,
NPLCycles, ZERO:AUTO, overload reading 9.9E37; 512 readings are kept by INITiate, else error 531).
"""

from __future__ import annotations

import math
from functools import partial
from typing import ClassVar

from sim_instruments.agilent_e3631a import AgilentE3631A
from sim_instruments.bus.kept import (
    INFINITE,
    HeldSettings,
    Kept,
    KeptSettings,
    held_count,
    held_number,
    held_switch,
    held_word,
)
from sim_instruments.bus.ohms import LINE_HZ, RESOLUTION, Ohmmeter, OhmsSetting
from sim_instruments.bus.scpi import Answers, Handler, Handlers, ScpiDevice, ScpiError, command, words

RANGES_V = (0.1, 1.0, 10.0, 100.0, 1000.0)
OVERLOAD = 9.9e37
GAIN_SIGMA, OFFSET_SIGMA_V = 1e-5, 2e-5
TWO_WIRE_OHM = 0.2
CYCLES = tuple(RESOLUTION)
OPEN_INPUT = ("CONT", "DIOD")  # overload without anything at the terminals
_OTHERS = {  # functions by name: header, least and greatest value
    "VOLT:AC": ("VOLTage:AC", 0.0, 750.0), "VOLT:RAT": ("VOLTage[:DC]:RATio", 0.0, 1000.0),
    "CURR": ("CURRent[:DC]", 0.0, 3.0), "CURR:AC": ("CURRent:AC", 0.0, 3.0), "FREQ": ("FREQuency", 3.0, 3e5),
    "PER": ("PERiod", 3.3e-6, 0.33), "CONT": ("CONTinuity", 0.0, 0.0), "DIOD": ("DIODe", 0.0, 0.0),
}  # fmt: skip
OTHERS = tuple(_OTHERS)
_FUNCTIONS = {"VOLT:DC": "VOLT", "CURR:DC": "CURR", "VOLT:DC:RAT": "VOLT:RAT"}  # other spellings
_MEMORY = 512
_DBM_OHM = 600.0  # reference of a level in dBm
NOT_FOR_READ = (-214, "Trigger deadlock")


def _ranged(header: str, low: float, high: float, unit: str) -> dict[str, Kept]:
    return {
        f"[:SENSe]:{header}:RANGe": Kept(high / 10.0, low, high, unit),
        f"[:SENSe]:{header}:RANGe:AUTO": Kept(True),
        f"[:SENSe]:{header}:RESolution": Kept(high * 1e-6, high * 1e-8, high, unit),
    }


def _cycles_for(share: float) -> float:
    """Return the lowest integration time, power-line cycles, whose resolution is at most a share of the range."""
    return next((cycles for cycles, resolved in RESOLUTION.items() if resolved <= share), CYCLES[-1])


class Agilent34401A(ScpiDevice):
    """Volts and ohms with errors drawn once; a reading takes twice the integration time (autozero).

    Autozero can be switched off for volts and two-wire ohms; selecting four wires switches it on.
    """

    identity = "HEWLETT-PACKARD,34401A,0,11-5-2"
    answers: ClassVar[Answers] = {
        "[:SENSe]:FRESistance:NPLCycles?": lambda self: f"{self.ohms_cycles:+.8E}",
        "[:SENSe]:ZERO:AUTO?": lambda self: str(int(self.autozero)),
        "[:SENSe]:VOLTage[:DC]:NPLCycles?": lambda self: f"{self.power_line_cycles:+.8E}",
        "[:SENSe]:VOLTage[:DC]:RANGe?": lambda self: f"{self.range_V or 10.0:+.8E}",
        "[:SENSe]:VOLTage[:DC]:RANGe:AUTO?": lambda self: str(int(self.range_V is None)),
        "[:SENSe]:VOLTage[:DC]:RESolution?": lambda self: (
            f"{RESOLUTION[self.power_line_cycles] * (self.range_V or 10.0):+.8E}"
        ),
        **{
            f"[:SENSe]:{header}:{node}?": tell
            for header in ("RESistance", "FRESistance")
            for node, tell in (
                ("RANGe", lambda self: f"{self.ohms_range_ohm:+.8E}"),
                ("RANGe:AUTO", lambda self: str(int(self.ohms is None or self.ohms.range_ohm is None))),
                ("RESolution", lambda self: f"{RESOLUTION[self.ohms_cycles] * self.ohms_range_ohm:+.8E}"),
            )
        },
        "[:SENSe]:RESistance:NPLCycles?": lambda self: f"{self.ohms_cycles:+.8E}",
        ":TRIGger:COUNt?": lambda self: f"{self.triggers or INFINITE:+.8E}",
        ":DATA:POINts?": lambda self: str(len(self._stored)),
        ":ROUTe:TERMinals?": lambda self: self.terminals,
    }

    held: ClassVar[HeldSettings] = {
        ":TRIGger:SOURce": held_word("source", "IMMediate", "BUS", "EXTernal"),
        ":SAMPle:COUNt": held_count("samples", 1, 50000, ""),
        ":CALCulate:FUNCtion": held_word("mathematics", "NULL", "DB", "DBM", "AVERage", "LIMit"),
        ":CALCulate:STATe": held_switch("calculates"),
        ":CALCulate:NULL:OFFSet": held_number("null", -1e9, 1e9, form="+.8E"),
        ":TRIGger:DELay": held_number("delay_s", 0.0, 3600.0, "S", "+.8E"),
    }

    kept: ClassVar[KeptSettings] = {
        **_ranged("VOLTage:AC", 0.1, 750.0, "V"),
        **_ranged("CURRent[:DC]", 0.01, 3.0, "A"),
        **_ranged("CURRent:AC", 1.0, 3.0, "A"),
        **_ranged("FREQuency:VOLTage", 0.1, 750.0, "V"),
        **_ranged("PERiod:VOLTage", 0.1, 750.0, "V"),
        "[:SENSe]:CURRent[:DC]:NPLCycles": Kept(10.0, 0.02, 100.0),
        "[:SENSe]:FREQuency:APERture": Kept(0.1, 0.01, 1.0, "S"),
        "[:SENSe]:PERiod:APERture": Kept(0.1, 0.01, 1.0, "S"),
        "[:SENSe]:DETector:BANDwidth": Kept(20.0, 3.0, 200.0),
        ":INPut:IMPedance:AUTO": Kept(False),
        ":TRIGger:DELay:AUTO": Kept(True),
        ":DISPlay": Kept(True),
        ":DISPlay:TEXT": Kept("", text=True),
        ":SYSTem:BEEPer:STATe": Kept(True),
    }

    def power_up(self) -> None:
        self.terminals = "FRON"
        super().power_up()
        self._ohmmeter = Ohmmeter(self, "34401A", TWO_WIRE_OHM)
        self._gain = self.rng("34401A gain").normal(1.0, GAIN_SIGMA)
        self._offset_V = self.rng("34401A offset").normal(0.0, OFFSET_SIGMA_V)
        self._noise = self.rng("34401A noise")

    def reset(self) -> None:
        self.range_V: float | None = None  # autorange
        self.power_line_cycles = 10.0
        self.ohms: OhmsSetting | None = None  # volts
        self.autozero, self.other, self.mathematics, self.null = True, "", "NULL", 0.0
        self._stored: list[str] = []
        self._at_once()

    def _at_once(self) -> None:
        """One reading by an internal trigger, as ``CONFigure`` leaves it."""
        self.source, self.triggers, self.samples, self.delay_s, self.calculates = "IMM", 1, 1, 0.0, False

    def press(self, keys: str) -> None:
        self.terminals = "REAR" if self.terminals == "FRON" else "FRON"

    def further(self) -> Handlers:
        configure: dict[str, Handler] = {
            "VOLTage[:DC]": self._configure,
            "FRESistance": partial(self._configure_ohms, 4),
            "RESistance": partial(self._configure_ohms, 2),
            **{header: partial(self._configure_other, name) for name, (header, _, _) in _OTHERS.items()},
        }
        return {
            **{f":CONFigure:{header}": method for header, method in configure.items()},
            **{f":MEASure:{header}?": partial(self._measure_as, method) for header, method in configure.items()},
        }

    @property
    def ohms_range_ohm(self) -> float:
        """Range of resistance, ohm; the one an automatic range begins with."""
        return 1e3 if self.ohms is None else self.ohms.range_ohm or 1e3

    @property
    def ohms_cycles(self) -> float:
        """Power-line cycles of a resistance."""
        return 10.0 if self.ohms is None else self.ohms.cycles

    @property
    def reading_s(self) -> float:
        """Time of one reading, second."""
        cycles = self.power_line_cycles if self.ohms is None else self.ohms.cycles
        return cycles / LINE_HZ * (2 if self.autozero else 1)

    def _true_V(self) -> float:
        source, supply = self.world.terminals.source(self.role), self.partner(AgilentE3631A)
        if source is not None:
            return source.voltage_V(self.now_ns)
        return float(supply.output(0)[0] if supply is not None else self.world.rail_V)

    def _measure(self) -> str:
        self.reply_after((self.delay_s + self.reading_s) * self.samples * self.triggers)
        return self._calculated(self._seen())

    def _calculated(self, seen: str) -> str:
        """Return a reading as mathematics alter it. Source: 34401A User's Guide, CALCulate."""
        if not self.calculates or self.mathematics in ("AVER", "LIM"):
            return seen
        value = float(seen)
        if self.mathematics == "NULL":
            return f"{value - self.null:+.8E}"
        level = 20.0 * math.log10(max(abs(value), 1e-9))
        return f"{level if self.mathematics == 'DB' else level - 10.0 * math.log10(_DBM_OHM * 1e-3):+.8E}"

    def _seen(self) -> str:
        if self.other:
            return self.reading(self.overload if self.other in OPEN_INPUT else f"{0.0:+.8E}")
        if self.ohms is not None:
            return self.reading(self._ohmmeter.reading(self.ohms, self.world.terminals.source(self.role)))
        true_V = self._true_V()
        if self.range_V is not None and abs(true_V) > 1.2 * self.range_V:
            return f"{OVERLOAD if true_V > 0 else -OVERLOAD:+.8E}"
        return self.reading(f"{true_V * self._gain + self._offset_V + self._noise.normal(0.0, 2e-6):+.8E}")

    def _configure(self, text: str) -> None:
        first = (words(text) or ["DEF"])[0].upper()
        self.range_V = None if first in ("DEF", "AUTO") else self._range(first)
        self.power_line_cycles = 10.0
        self._begin(None)

    def _configure_ohms(self, wires: int, text: str) -> None:
        self._begin(self._ohmmeter.configured(wires, words(text), 10.0))

    def _begin(self, ohms: OhmsSetting | None, other: str = "") -> None:
        self.ohms, self.autozero, self.other = ohms, True, other
        self._at_once()

    def _configure_other(self, function: str, text: str) -> None:
        """Nothing is at the terminals for it: its range and resolution are checked and forgotten."""
        _, low, high = _OTHERS[function]
        parameters = [word for word in words(text) if word.upper() not in ("", "DEF", "AUTO")]
        for parameter, least in zip(parameters, (low, high * 1e-8), strict=False):
            self.number(parameter, least, high)
        if function in OPEN_INPUT and parameters:
            raise ScpiError(-108, "Parameter not allowed")
        self._begin(None, function)

    def _measure_as(self, configure: Handler, text: str) -> str | None:
        configure(text)
        return self._read("")

    def _range(self, text: str) -> float:
        largest_V = self.number(text, RANGES_V[0], RANGES_V[-1])
        return next(r for r in RANGES_V if largest_V <= r)

    @command("[:SENSe]:VOLTage[:DC]:NPLCycles")
    def _set_cycles(self, text: str) -> None:
        self.power_line_cycles = self._ohmmeter.cycles_of(text)

    @command("[:SENSe]:RESistance:NPLCycles")
    @command("[:SENSe]:FRESistance:NPLCycles")
    def _set_ohms_cycles(self, text: str) -> None:
        cycles = self._ohmmeter.cycles_of(text)
        if self.ohms is not None:
            self.ohms.cycles = cycles

    @command("[:SENSe]:ZERO:AUTO")
    def _set_autozero(self, text: str) -> None:
        on = text.strip().upper() != "ONCE" and self.boolean(text)
        if self.ohms is None or self.ohms.wires == 2:
            self.autozero = on

    @command(":CONFigure?")
    def _get_configuration(self, _: str) -> str:
        if self.ohms is not None:
            range_ohm = self.ohms.range_ohm or 100.0
            return f'"{self.ohms.name} {range_ohm:+.6E},{RESOLUTION[self.ohms.cycles] * range_ohm:+.6E}"'
        if self.other:
            high = _OTHERS[self.other][2]
            return f'"{self.other}"' if self.other in OPEN_INPUT else f'"{self.other} {high:+.6E},{high * 1e-6:+.6E}"'
        return f'"VOLT {self.range_V or 10.0:+.6E},+3.000000E-06"'

    def _take(self) -> None:
        self._stored = [self._measure() for _ in range(self.samples * self.triggers)]

    @command(":READ?")
    def _read(self, _: str) -> str | None:
        if self.source == "BUS":
            raise ScpiError(*NOT_FOR_READ)
        if self.source == "EXT" or not self.triggers:
            return None  # it waits, or does not end
        self._take()
        return ",".join(self._stored)

    @command("[:SENSe]:FUNCtion")
    def _set_function(self, text: str) -> None:
        name = text.strip("\"' ").upper()
        name = _FUNCTIONS.get(name, name)
        if name not in ("VOLT", "RES", "FRES", *OTHERS):
            raise ScpiError(-224, "Illegal parameter value")
        wires = {"RES": 2, "FRES": 4}.get(name)
        self.ohms = None if wires is None else self._ohmmeter.configured(wires, (), 10.0)
        self.other = name if name in OTHERS else ""

    @command("[:SENSe]:FUNCtion?")
    def _get_function(self, _: str) -> str:
        return f'"{self.other or ("VOLT" if self.ohms is None else self.ohms.name)}"'

    @command("[:SENSe]:VOLTage[:DC]:RANGe")
    def _set_range(self, text: str) -> None:
        self.range_V = self._range(text)

    @command("[:SENSe]:VOLTage[:DC]:RANGe:AUTO")
    def _set_autorange(self, text: str) -> None:
        self.range_V = None if self.boolean(text) else self.range_V or 10.0

    @command("[:SENSe]:VOLTage[:DC]:RESolution")
    def _set_resolution(self, text: str) -> None:
        share = self.number(text, 1e-9, 1000.0, "V") / (self.range_V or 10.0)
        self.power_line_cycles = _cycles_for(share)

    @command("[:SENSe]:RESistance:RANGe")
    @command("[:SENSe]:FRESistance:RANGe")
    def _set_ohms_range(self, text: str) -> None:
        if self.ohms is not None:
            self.ohms.range_ohm = self._ohmmeter.range_of(text.upper())

    @command("[:SENSe]:RESistance:RESolution")
    @command("[:SENSe]:FRESistance:RESolution")
    def _set_ohms_resolution(self, text: str) -> None:
        share = self.number(text, 1e-9, 1e6, "OHM") / self.ohms_range_ohm
        if self.ohms is not None:
            self.ohms.cycles = _cycles_for(share)

    @command("[:SENSe]:RESistance:RANGe:AUTO")
    @command("[:SENSe]:FRESistance:RANGe:AUTO")
    def _set_ohms_autorange(self, text: str) -> None:
        if self.ohms is not None:
            self.ohms.range_ohm = None if self.boolean(text) else self.ohms.range_ohm or 1e3

    @command(":TRIGger:COUNt")
    def _set_triggers(self, text: str) -> None:
        """Set how many triggers are taken; 0 stands for no end, which only the bus ends."""
        self.triggers = int(self.number(text, 1, 50000, INF=0, INFINITE=0))

    @command(":SYSTem:BEEPer[:IMMediate]")
    @command(":SYSTem:REMote")
    def _remote(self, _: str) -> None:
        """Nobody hears the beeper; on GPIB it is remote anyway."""

    @command(":INITiate")
    def _start(self, _: str) -> None:
        if not self.triggers or self.samples * self.triggers > _MEMORY:
            raise ScpiError(531, "Insufficient memory")
        self._take()
        self.busy(self.reading_s * len(self._stored))

    @command(":FETCh?")
    def _fetch(self, _: str) -> str:
        if not self._stored:
            raise ScpiError(-230, "Data stale")
        self._complete("")
        return ",".join(self._stored)


SIMULATOR = Agilent34401A
