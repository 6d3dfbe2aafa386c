"""Simulated HP/Agilent 34401A multimeter at the source that the world wires to it, else on rail 1 (+6 V output) of the
auxiliary supply, or where the world says if there is none.

Functions other than direct voltage and resistance see nothing at the terminals.

Source: 34401A User's Guide (CONFigure, FUNCtion, RANGe, RESolution, READ?, INITiate, FETCh?, TRIGger, SAMPle,
NPLCycles, ZERO:AUTO, overload reading 9.9E37; 512 readings are kept by INITiate, else error 531).
"""

from __future__ import annotations

import math
import re
from functools import partial
from typing import ClassVar

from sim_instruments.agilent_e3631a import AgilentE3631A
from sim_instruments.bus.kept import INFINITE
from sim_instruments.bus.ohms import LINE_HZ, RESOLUTION, InputSetting, Ohmmeter
from sim_instruments.bus.scpi import Answers, Handler, Handlers, ScpiDevice, ScpiError, command, words

RANGES_V = (0.1, 1.0, 10.0, 100.0, 1000.0)
OVERLOAD = 9.9e37
GAIN_SIGMA, OFFSET_SIGMA_V = 1e-5, 2e-5
TWO_WIRE_OHM = 0.2
OPEN_INPUT = ("CONT", "DIOD")  # overload without anything at the terminals
_TABLE = """
VOLT:AC  | VOLTage:AC         | 0      | 750
VOLT:RAT | VOLTage[:DC]:RATio | 0      | 1000
CURR     | CURRent[:DC]       | 0      | 3
CURR:AC  | CURRent:AC         | 0      | 3
FREQ     | FREQuency          | 3      | 3E5
PER      | PERiod             | 3.3E-6 | 0.33
CONT     | CONTinuity         | 0      | 0
DIOD     | DIODe              | 0      | 0
"""
_ROWS = [re.split(r"\s*\|\s*", row) for row in _TABLE.strip().splitlines()]
_OTHERS = {  # functions by name: header, least and greatest value
    name: (header, float(low), float(high)) for name, header, low, high in _ROWS
}
_WIRES = {"RES": 2, "FRES": 4}
_RANGED = """
[:SENSe]:#:NPLCycles  | ohms.cycles     | - | by _read_cycles | +.8E
[:SENSe]:#:RANGe      | ohms.range      | - | by _read_ohms   | -
[:SENSe]:#:RANGe?     | ohms.nominal    | - |                 | +.8E
[:SENSe]:#:RANGe:AUTO | ohms.automatic  | - | switch          | d
[:SENSe]:#:RESolution | ohms.resolution | - | 1E-9 1E6 OHM    | +.8E
"""
_FUNCTIONS = {"VOLT:DC": "VOLT", "CURR:DC": "CURR", "VOLT:DC:RAT": "VOLT:RAT"}  # other spellings
_MEMORY = 512
_DBM_OHM = 600.0  # reference of a level in dBm
NOT_FOR_READ = (-214, "Trigger deadlock")


class Agilent34401A(ScpiDevice):
    """Volts and ohms with errors drawn once; a reading takes twice the integration time (autozero).

    Autozero can be switched off for volts and two-wire ohms; selecting four wires switches it on.
    """

    identity = "HEWLETT-PACKARD,34401A,0,11-5-2"
    answers: ClassVar[Answers] = {
        ":TRIGger:COUNt?": lambda self: f"{self.triggers or INFINITE:+.8E}",
        ":DATA:POINts?": lambda self: str(len(self._stored)),
        "[:SENSe]:FUNCtion?": lambda self: f'"{self.function}"',
    }
    settings = "".join(_RANGED.replace("#", header) for header in ("RESistance", "FRESistance"))
    settings += """
[:SENSe]:VOLTage[:DC]:NPLCycles       | volts.cycles     | -      | by _read_cycles   | +.8E
[:SENSe]:VOLTage[:DC]:RANGe           | volts.range      | -      | by _range         | -
[:SENSe]:VOLTage[:DC]:RANGe?          | volts.nominal    | -      |                   | +.8E
[:SENSe]:VOLTage[:DC]:RANGe:AUTO      | volts.automatic  | -      | switch            | d
[:SENSe]:VOLTage[:DC]:RESolution      | volts.resolution | -      | 1E-9 1000 V       | +.8E
[:SENSe]:ZERO:AUTO?                   | autozero         | ON
:ROUTe:TERMinals?                     | terminals        | -
:TRIGger:SOURce                       | source           | IMM    | IMMediate, BUS, EXTernal
:TRIGger:COUNt                        | triggers         | 1      | by _read_triggers | -
:TRIGger:DELay                       | delay_s          | 0.     | by _read_delay    | +.8E
:SAMPle:COUNt                         | samples          | 1      | 1 50000
:CALCulate:FUNCtion                   | mathematics      | NULL   | NULL, DB, DBM, AVERage, LIMit
:CALCulate:STATe                      | calculates       | OFF
:CALCulate:NULL:OFFSet                | null             | 0.     | -1E9 1E9          | +.8E
[:SENSe]:VOLTage:AC:RANGe             |                  | 75.    | 0.1 750 V
[:SENSe]:VOLTage:AC:RANGe:AUTO        |                  | ON
[:SENSe]:VOLTage:AC:RESolution        |                  | 750E-6 | 750E-8 750 V
[:SENSe]:CURRent[:DC]:RANGe           |                  | 0.3    | 0.01 3 A
[:SENSe]:CURRent[:DC]:RANGe:AUTO      |                  | ON
[:SENSe]:CURRent[:DC]:RESolution      |                  | 3E-6   | 3E-8 3 A
[:SENSe]:CURRent[:DC]:NPLCycles       |                  | 10.    | 0.02 100
[:SENSe]:CURRent:AC:RANGe             |                  | 0.3    | 1 3 A
[:SENSe]:CURRent:AC:RANGe:AUTO        |                  | ON
[:SENSe]:CURRent:AC:RESolution        |                  | 3E-6   | 3E-8 3 A
[:SENSe]:FREQuency:VOLTage:RANGe      |                  | 75.    | 0.1 750 V
[:SENSe]:FREQuency:VOLTage:RANGe:AUTO |                  | ON
[:SENSe]:FREQuency:VOLTage:RESolution |                  | 750E-6 | 750E-8 750 V
[:SENSe]:FREQuency:APERture           |                  | 0.1    | 0.01 1 S
[:SENSe]:PERiod:VOLTage:RANGe         |                  | 75.    | 0.1 750 V
[:SENSe]:PERiod:VOLTage:RANGe:AUTO    |                  | ON
[:SENSe]:PERiod:VOLTage:RESolution    |                  | 750E-6 | 750E-8 750 V
[:SENSe]:PERiod:APERture              |                  | 0.1    | 0.01 1 S
[:SENSe]:DETector:BANDwidth           |                  | 20.    | 3 200
:INPut:IMPedance:AUTO                 |                  | OFF
:TRIGger:DELay:AUTO                   | delays_itself    | ON
:DISPlay                              |                  | ON
:DISPlay:TEXT                         |                  | ""
:SYSTem:BEEPer[:IMMediate]            |                  |        |                   | -
:SYSTem:BEEPer:STATe                  |                  | ON
:SYSTem:REMote                        |                  |        |                   | -
"""

    def power_up(self) -> None:
        self.terminals = "FRON"
        super().power_up()
        self._ohmmeter = Ohmmeter(self, "34401A", TWO_WIRE_OHM)
        self._gain = self.rng("34401A gain").normal(1.0, GAIN_SIGMA)
        self._offset_V = self.rng("34401A offset").normal(0.0, OFFSET_SIGMA_V)
        self._noise = self.rng("34401A noise")

    def reset(self) -> None:
        self.function = "VOLT"
        self.volts, self.ohms = InputSetting(0, None, 10.0, first=10.0), InputSetting(2, None, 10.0)
        self._stored: list[str] = []

    def press(self, keys: str) -> None:
        self.terminals = "REAR" if self.terminals == "FRON" else "FRON"

    def further(self) -> Handlers:
        configure: dict[str, Handler] = {
            "VOLTage[:DC]": self._configure,
            "FRESistance": partial(self._configure_ohms, "FRES"),
            "RESistance": partial(self._configure_ohms, "RES"),
            **{header: partial(self._configure_other, name) for name, (header, _, _) in _OTHERS.items()},
        }
        return {
            **{f":CONFigure:{header}": method for header, method in configure.items()},
            **{f":MEASure:{header}?": partial(self._measure_as, method) for header, method in configure.items()},
        }

    @property
    def reading_s(self) -> float:
        """Time of one reading, second."""
        cycles = (self.ohms if self.function in _WIRES else self.volts).cycles
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
        if self.function in _OTHERS:
            return self.reading(self.overload if self.function in OPEN_INPUT else f"{0.0:+.8E}")
        if self.function in _WIRES:
            return self.reading(self._ohmmeter.reading(self.ohms, self.world.terminals.source(self.role)))
        true_V = self._true_V()
        if self.volts.range is not None and abs(true_V) > 1.2 * self.volts.range:
            return f"{OVERLOAD if true_V > 0 else -OVERLOAD:+.8E}"
        return self.reading(f"{true_V * self._gain + self._offset_V + self._noise.normal(0.0, 2e-6):+.8E}")

    def _configure(self, text: str) -> None:
        first = (words(text) or ["DEF"])[0].upper()
        range_V = None if first in ("DEF", "AUTO") else self._range(first)
        self.volts = InputSetting(0, range_V, 10.0, first=10.0)
        self._begin("VOLT")

    def _configure_ohms(self, function: str, text: str) -> None:
        self.ohms = self._ohmmeter.configured(_WIRES[function], words(text), 10.0)
        self._begin(function)

    def _begin(self, function: str) -> None:
        """One reading by an internal trigger, as ``CONFigure`` leaves it."""
        self.function = function
        self.restore("autozero", "source", "triggers", "samples", "delay_s", "calculates")

    def _configure_other(self, function: str, text: str) -> None:
        """Nothing is at the terminals for it: its range and resolution are checked and forgotten."""
        _, low, high = _OTHERS[function]
        parameters = [word for word in words(text) if word.upper() not in ("", "DEF", "AUTO")]
        for parameter, least in zip(parameters, (low, high * 1e-8), strict=False):
            self.number(parameter, least, high)
        if function in OPEN_INPUT and parameters:
            raise ScpiError(-108, "Parameter not allowed")
        self._begin(function)

    def _measure_as(self, configure: Handler, text: str) -> str | None:
        configure(text)
        return self._read("")

    def _range(self, text: str) -> float:
        largest_V = self.number(text, RANGES_V[0], RANGES_V[-1])
        return next(r for r in RANGES_V if largest_V <= r)

    def _read_cycles(self, text: str) -> float:
        return self._ohmmeter.cycles_of(text)

    def _read_ohms(self, text: str) -> float:
        return self._ohmmeter.range_of(text.upper())

    def _read_delay(self, text: str) -> float:
        """Return the delay; one that is given ends the automatic one (User's Guide, TRIGger:DELay)."""
        self.delays_itself = False
        return self.number(text, 0.0, 3600.0, "S", DEF=0.0)

    def _read_triggers(self, text: str) -> int:
        """Return how many triggers are taken; 0 stands for no end, which only the bus ends."""
        return int(self.number(text, 1, 50000, INF=0, INFINITE=0))

    @command("[:SENSe]:ZERO:AUTO")
    def _set_autozero(self, text: str) -> None:
        on = text.strip().upper() != "ONCE" and self.boolean(text)
        if self.function != "FRES":
            self.autozero = on

    @command(":CONFigure?")
    def _get_configuration(self, _: str) -> str:
        if self.function in _WIRES:
            range_ohm = self.ohms.range or 100.0
            return f'"{self.function} {range_ohm:+.6E},{RESOLUTION[self.ohms.cycles] * range_ohm:+.6E}"'
        if self.function in OPEN_INPUT:
            return f'"{self.function}"'
        if self.function in _OTHERS:
            high = _OTHERS[self.function][2]
            return f'"{self.function} {high:+.6E},{high * 1e-6:+.6E}"'
        return f'"VOLT {self.volts.nominal:+.6E},+3.000000E-06"'

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
        if name not in ("VOLT", *_WIRES, *_OTHERS):
            raise ScpiError(-224, "Illegal parameter value")
        self.function = name
        if name in _WIRES:
            self.ohms = self._ohmmeter.configured(_WIRES[name], (), 10.0)

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
