"""Simulated Agilent 34970A data logger with thermocouples: 101 laboratory, 102 chamber air, 103 the unit's case.

Any other channel hangs in the laboratory's air, but for those that the world wires to a source. Each slot holds a
34901A: with four wires channel n (source leads) is paired with n+10 (sense leads), so that n is 1 to 10. All thermo-
couples are of the type that the station names; one taken for another type, or for its voltage, reads what its voltage
against the terminal block is then. Where a source hangs there is none: the block's temperature is read, or overload if
open thermocouples are looked for and it is above 5 kohm.

``CONFigure`` resets everything of its channels but the reference junction and the look for open thermocouples, the
trigger and the form of readings. While a scan runs nothing is set. The internal multimeter off, nothing is measured.

Source: 34970A/34972A Command Reference (ABORt, CALCulate, CONFigure, FETCh?, FORMat, INITiate, INSTrument:DMM, READ?,
ROUTe, SENSe, TRIGger, UNIT; factory reset state: junction FIXed at 0 degC, type J; error messages); ITS-90 tables of
thermocouples, mean from 20 to 80 degC. Placeholders: numbers of the errors of a channel of another function and of a
monitor that is off; autozero changes the time of a reading alone; alarms and the input resistance change nothing.
"""

from __future__ import annotations

import re
from collections import defaultdict
from functools import partial
from types import SimpleNamespace
from typing import Any

from bench.model.clock import NS
from sim_instruments.bus.kept import INFINITE, Setting, settings_of
from sim_instruments.bus.ohms import LINE_HZ, InputSetting, Ohmmeter
from sim_instruments.bus.scpi import (
    MISSING_PARAMETER,
    OUT_OF_RANGE,
    SETTINGS_CONFLICT,
    Handler,
    Handlers,
    ScpiDevice,
    ScpiError,
    command,
    words,
)
from sim_instruments.worlds.common.terminals import Source

OFFSET_SIGMA_DEGC, NOISE_SIGMA_DEGC = 0.2, 0.02
SWITCH_S = {"RES": 0.02, "FRES": 0.02, "TEMP": 0.21, "VOLT": 0.21}  # all but the integration
TWO_WIRE_OHM = 4.0
CYCLES = (0.02, 0.2, 1.0, 2.0, 10.0, 20.0, 100.0, 200.0)
CHANNELS, PAIRS = 20, 10  # of a 34901A
BLOCK_DEGC = 23.0
OPEN_OHM = 5e3
OVERLOAD = 9.9e37
SEEBECK_UV = {"B": 0.3, "E": 63.4, "J": 52.9, "K": 41.2, "N": 27.9, "R": 6.5, "S": 6.5, "T": 43.0}  # of one degC
UNITS = {"C": (1.0, 0.0), "F": (1.8, 32.0), "K": (1.0, 273.15)}
NO_FOUR_WIRES = (308, "Channel not able to perform requested operation")
_TOLD = ("UNIT", "TIME", "CHANnel", "ALARm")  # what may stand beside a reading
_LIST = re.compile(r"\(@([\d,: ]*)\)")
_WHILE_SCANNING = re.compile(r"\*|:?(ABOR|DISP|FORM|SYST|(?!MEAS|READ).*\?)")
# settings of a channel, as in ``sim_instruments.bus.kept``; behind the columns of all the functions that have it
_BY_CHANNEL = settings_of("""
:UNIT:TEMPerature                                      | unit          | C   | C, F, K         |      | TEMP
:CALCulate:SCALe:GAIN                                  | gain          | 1.  | -1E15 1E15      | +.8E
:CALCulate:SCALe:OFFSet                                | offset        | 0.  | -1E15 1E15      | +.8E
:CALCulate:SCALe:STATe                                 | scaled        | OFF
:ROUTe:CHANnel:DELay                                   | delay_s       | 0.  | 0 60            | +.8E
:ROUTe:CHANnel:DELay:AUTO                              | delays_itself | ON
[:SENSe]:ZERO:AUTO                                     | autozero      | ON
[:SENSe]:FRESistance:NPLCycles                         | cycles        | 1.  | by _read_cycles | +.8E | FRES
[:SENSe]:RESistance:NPLCycles                          | cycles        | 1.  | by _read_cycles | +.8E | FRES
[:SENSe]:TEMPerature:NPLCycles                         | cycles        | 1.  | by _read_cycles | +.8E | TEMP
[:SENSe]:VOLTage:DC:NPLCycles                          | cycles        | 1.  | by _read_cycles | +.8E | VOLT
[:SENSe]:VOLTage:DC:RANGe:AUTO                         | ranges_itself | ON  |                 |      | VOLT
[:SENSe]:TEMPerature:TRANsducer:TCouple:TYPE           | type          | J   | B, E, J, K, N, R, S, T
[:SENSe]:TEMPerature:TRANsducer:TCouple:RJUNction      | fixed_degC    | 0.  | -20 80          | +.8E
[:SENSe]:TEMPerature:TRANsducer:TCouple:RJUNction:TYPE | junction      | FIX | FIXed, INTernal, EXTernal
[:SENSe]:TEMPerature:TRANsducer:TCouple:CHECk          | checked       | OFF
""")
_AFTER_RESET = {setting.attribute: setting.default for setting in _BY_CHANNEL}
_AFTER_RESET |= {"function": "VOLT", **vars(InputSetting(2, None, 1.0))}
_LEFT_ALONE = ("fixed_degC", "junction", "checked")  # by CONFigure
_PRESET = {name: value for name, value in _AFTER_RESET.items() if name not in _LEFT_ALONE}
_MEASURED = {"TEMP": "TEMPerature", "VOLT": "VOLTage[:DC]", "RES": "RESistance", "FRES": "FRESistance"}


class Agilent34970A(ScpiDevice):
    """Multiplexer with temperature and resistance measurement; each thermocouple has an offset drawn once."""

    identity = "HEWLETT-PACKARD,34970A,0,13-2-2"
    scpi_version = "1994.0"
    settings = """
:INSTrument:DMM?             | measures   | -   |             | d
:INSTrument:DMM:INSTalled?   |            | 1
:SYSTem:CTYPe?               |            | HEWLETT-PACKARD,34901A,0,2.3
:SYSTem:LFRequency?          |            | 50  |             | +d
:TRIGger:SOURce              | source     | IMM | IMMediate, BUS, EXTernal, TIMer, ALARm1
:TRIGger:COUNt               | count      | 1.  | 1 50000 INF | +.8E
:TRIGger:TIMer               | interval_s | 1.  | 0 359999    | +.8E
:FORMat:READing:UNIT         | UNIT       | OFF
:FORMat:READing:TIME         | TIME       | OFF
:FORMat:READing:CHANnel      | CHANnel    | OFF
:FORMat:READing:ALARm        | ALARm      | OFF
:FORMat:READing:TIME:TYPE    |            | REL | RELative, ABSolute
:DISPlay                     |            | ON
:DISPlay:TEXT                |            | ""
:ROUTe:MONitor               |            |
:ROUTe:MONitor:STATe         |            | OFF
:MEMory:STATe:RECall:AUTO    |            | ON
:SYSTem:DATE                 |            | ""
:SYSTem:TIME                 |            | ""
:OUTPut:ALARm1:SOURce        |            |
:INPut:IMPedance:AUTO        |            |
:CALCulate:LIMit:UPPer       |            |
:CALCulate:LIMit:UPPer:STATe |            |
:CALCulate:LIMit:LOWer       |            |
:CALCulate:LIMit:LOWer:STATe |            |
"""

    def power_up(self) -> None:
        self.measures = True
        super().power_up()
        self.ohmmeter = Ohmmeter(self, "34970A", TWO_WIRE_OHM)
        self._noise = self.world.rng("34970A noise")

    def reset(self) -> None:
        self.channels: dict[int, Any] = defaultdict(lambda: SimpleNamespace(**_AFTER_RESET))
        self.scan_list: list[int] = []
        self._stored: list[str] = []
        self._scan_end_ns = 0
        self._at_once()

    def _at_once(self) -> None:
        """One sweep by an internal trigger, told as plain readings: after ``*RST`` and as ``CONFigure`` leaves it."""
        self.restore("source", "count", "interval_s", *_TOLD)

    def carry_out(self, command: str) -> str | None:
        if command and self.now_ns < self._scan_end_ns and not _WHILE_SCANNING.match(command.upper()):
            raise ScpiError(261, "Not able to execute while scan initiated")
        return super().carry_out(command)

    def on_clear(self) -> None:
        self._scan_end_ns = 0

    def _listed_channels(self, text: str) -> list[int]:
        """Return the channels of a list as they are scanned, in ascending order."""
        match = _LIST.fullmatch(text.strip())
        if match is None:
            raise ScpiError(*MISSING_PARAMETER)
        channels: set[int] = set()
        for item in filter(None, match.group(1).replace(" ", "").split(",")):
            first, _, last = item.partition(":")
            channels |= {*range(int(first), int(last or first) + 1)}
        if not all(channel // 100 in (1, 2, 3) and 1 <= channel % 100 <= CHANNELS for channel in channels):
            raise ScpiError(*OUT_OF_RANGE)
        return sorted(channels)

    def _of(self, text: str) -> list[Any]:
        """Return the settings of the channels of a list, those of the scan list if it is left out."""
        return [self.channels[channel] for channel in (self._listed_channels(text) if text else self.scan_list)]

    def _across_uV(self, channel: int) -> float:
        thermal = self.world.thermal
        true = {102: thermal.air_degC, 103: thermal.unit_degC}.get(channel, thermal.lab_degC)(self.now_ns)
        return SEEBECK_UV.get(str(self.options.get("thermocouple")), SEEBECK_UV["T"]) * float(true - BLOCK_DEGC)

    def _temperature(self, channel: int, one: Any, source: Source | None) -> float:
        if one.junction == "EXT" or (source and one.checked and source.ohm(2, self.now_ns) > OPEN_OHM):
            return OVERLOAD
        degC = BLOCK_DEGC if one.junction == "INT" else one.fixed_degC
        degC += 0.0 if source else self._across_uV(channel) / SEEBECK_UV[one.type]
        degC += self.world.rng("thermocouple offset", channel).normal(0.0, OFFSET_SIGMA_DEGC)
        factor, zero = UNITS[one.unit]
        return float(factor * (degC + self._noise.normal(0.0, NOISE_SIGMA_DEGC)) + zero)

    def _reading(self, channel: int) -> str:
        one, source = self.channels[channel], self.world.terminals.source(self.role, channel)
        if one.function == "TEMP":
            value = self._temperature(channel, one, source)
        elif one.function == "VOLT":
            value = source.voltage_V(self.now_ns) if source else 1e-6 * self._across_uV(channel)
        else:
            value = float(self.ohmmeter.reading(one, source))
        if one.scaled and value != OVERLOAD:
            value = one.gain * value + one.offset
        return self.reading(f"{value:+.8E}")

    def _formed(self, channel: int) -> str:
        one = self.channels[channel]
        unit = {"TEMP": f" {one.unit}", "VOLT": " VDC"}.get(one.function, " OHM")
        more = {"UNIT": unit, "TIME": ",000000012.345", "CHANnel": f",{channel}", "ALARm": ",0"}
        return self._reading(channel) + "".join(text for name, text in more.items() if getattr(self, name))

    def further(self) -> Handlers:
        handlers: dict[str, Handler] = {}
        for setting in _BY_CHANNEL:
            handlers[setting.header] = partial(self._set_channels, setting)
            handlers[f"{setting.header}?"] = partial(self._tell_channels, setting)
        for name, header in _MEASURED.items():
            handlers[f":CONFigure:{header}"] = partial(self._configure, name)
            handlers[f":MEASure:{header}?"] = partial(self._measure, name)
        return handlers

    def _read_cycles(self, text: str) -> float:
        return self.ohmmeter.cycles_of(text, CYCLES)

    def _set_channels(self, setting: Setting, text: str) -> None:
        first, channels = (*words(text), "", "")[:2]
        value = setting.read(self, first)
        for one in self._of(channels):
            if setting.more and one.function not in setting.more:
                raise ScpiError(*SETTINGS_CONFLICT)
            setting.hold(one, value)
            one.delays_itself &= setting.attribute != "delay_s"

    def _tell_channels(self, setting: Setting, text: str) -> str:
        return ",".join(map(setting.tell, self._of(text)))

    def _configure(self, function: str, text: str) -> None:
        """Reset the channels and make them the scan list."""
        self._need_multimeter()
        *parameters, listed = words(text) or [""]
        channels = self._listed_channels(listed)
        new = _PRESET | {"function": function}
        if function == "TEMP":
            probe, kind = (*parameters, "", "")[:2]
            self.word(probe, "TCouple", "TC")
            new["type"] = self.word(kind, *SEEBECK_UV)
        elif function != "VOLT":
            if function == "FRES" and any(channel % 100 > PAIRS for channel in channels):
                raise ScpiError(*NO_FOUR_WIRES)
            new |= vars(self.ohmmeter.configured(4 if function == "FRES" else 2, parameters, 1.0))
        for channel in channels:
            vars(self.channels[channel]).update(new)
        self.scan_list = channels
        self._at_once()

    def _measure(self, function: str, text: str) -> str | None:
        self._configure(function, text)
        return self._read("")

    @command(":CONFigure?")
    def _get_configuration(self, text: str) -> str:
        told = []
        for one in self._of(text):
            about = f"TC,{one.type},+1.000000E+00" if one.function == "TEMP" else f"{one.range or 100.0:+.6E}"
            told.append(f'"{one.function} {about}"')
        return ",".join(told)

    @command(":ROUTe:SCAN")
    def _set_scan(self, text: str) -> None:
        self.scan_list = self._listed_channels(text)

    @command(":ROUTe:SCAN?")
    def _get_scan(self, _: str) -> str:
        text = f"(@{','.join(map(str, self.scan_list))})"
        return f"#{len(str(len(text)))}{len(text)}{text}"

    def _need_multimeter(self) -> None:
        if not self.measures:
            raise ScpiError(225, "Settings conflict: DMM disabled or missing")

    @command(":INSTrument:DMM")
    def _set_multimeter(self, text: str) -> None:
        """Switch the internal multimeter on or off; a change resets the unit."""
        if self.boolean(text) != self.measures:
            self._reset("")
            self.measures = not self.measures

    def _sweeps_s(self) -> float:
        """Return how long the sweeps take, second: infinite where they wait or do not end."""
        self._need_multimeter()
        if not self.scan_list:
            raise ScpiError(113, "Channel list: empty scan list")
        if self.source not in ("IMM", "TIM") or self.count == INFINITE:
            return INFINITE
        sweep_s = sum(self._takes_s(one) for one in self._of(""))
        return sweep_s + (self.count - 1) * max(sweep_s, self.interval_s * (self.source == "TIM"))

    def _takes_s(self, one: Any) -> float:
        integrated_s = (1 + one.autozero) * one.cycles / LINE_HZ
        return float(SWITCH_S[one.function] + integrated_s + one.delay_s * (not one.delays_itself))

    def _swept(self) -> list[str]:
        return [self._formed(channel) for _ in range(int(self.count)) for channel in self.scan_list]

    @command(":READ?")
    def _read(self, _: str) -> str | None:
        if self.source == "BUS":
            raise ScpiError(-214, "Trigger deadlock")
        if (takes_s := self._sweeps_s()) == INFINITE:
            return None
        self.reply_after(takes_s)
        return ",".join(self._swept())

    @command(":INITiate")
    def _start(self, _: str) -> None:
        takes_s = self._sweeps_s()
        self._stored = [] if takes_s == INFINITE else self._swept()
        self._scan_end_ns = self.now_ns + round(takes_s * NS)

    @command(":FETCh?")
    def _fetch(self, _: str) -> str | None:
        self.reply_at(self._scan_end_ns)
        return ",".join(self._stored) if self._stored else None

    @command(":ABORt")
    def _abort(self, _: str) -> None:
        self._replies.clear()
        self._scan_end_ns = 0


SIMULATOR = Agilent34970A
