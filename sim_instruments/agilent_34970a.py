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
from typing import Any, ClassVar

from bench.model.clock import NS
from sim_instruments.bus.kept import (
    INFINITE,
    Held,
    HeldSettings,
    Kept,
    KeptSettings,
    held_number,
    held_switch,
    held_word,
    word,
)
from sim_instruments.bus.ohms import LINE_HZ, Ohmmeter, OhmsSetting
from sim_instruments.bus.scpi import (
    MISSING_PARAMETER,
    OUT_OF_RANGE,
    SETTINGS_CONFLICT,
    Answers,
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
_COUPLE = "[:SENSe]:TEMPerature:TRANsducer:TCouple"
_LIST = re.compile(r"\(@([\d,: ]*)\)")
_WHILE_SCANNING = re.compile(r"\*|:?(ABOR|DISP|FORM|SYST|(?!MEAS|READ).*\?)")
_CYCLES = Held("cycles", lambda device, text: device.ohmmeter.cycles_of(text, CYCLES), "+.8E", applied=False)
_BY_CHANNEL: dict[str, tuple[Held, Any, str]] = {  # settings, what one has after *RST, the functions that have it
    ":UNIT:TEMPerature": (held_word("unit", *UNITS), "C", "TEMP"),
    ":CALCulate:SCALe:GAIN": (held_number("gain", -1e15, 1e15, form="+.8E"), 1.0, ""),
    ":CALCulate:SCALe:OFFSet": (held_number("offset", -1e15, 1e15, form="+.8E"), 0.0, ""),
    ":CALCulate:SCALe:STATe": (held_switch("scaled"), False, ""),
    ":ROUTe:CHANnel:DELay": (held_number("delay_s", 0.0, 60.0, form="+.8E"), 0.0, ""),
    ":ROUTe:CHANnel:DELay:AUTO": (held_switch("delays_itself"), True, ""),
    "[:SENSe]:ZERO:AUTO": (held_switch("autozero"), True, ""),
    "[:SENSe]:FRESistance:NPLCycles": (_CYCLES, 1.0, "FRES"),
    "[:SENSe]:RESistance:NPLCycles": (_CYCLES, 1.0, "FRES"),
    "[:SENSe]:TEMPerature:NPLCycles": (_CYCLES, 1.0, "TEMP"),
    "[:SENSe]:VOLTage:DC:NPLCycles": (_CYCLES, 1.0, "VOLT"),
    f"{_COUPLE}:TYPE": (held_word("type", *SEEBECK_UV), "J", ""),
    f"{_COUPLE}:RJUNction": (held_number("fixed_degC", -20.0, 80.0, form="+.8E"), 0.0, ""),
    f"{_COUPLE}:RJUNction:TYPE": (held_word("junction", "FIXed", "INTernal", "EXTernal"), "FIX", ""),
    f"{_COUPLE}:CHECk": (held_switch("checked"), False, ""),
}
_AFTER_RESET = {held.attribute: default for held, default, _ in _BY_CHANNEL.values()}
_AFTER_RESET |= {"function": "VOLT", **vars(OhmsSetting(2, None, 1.0))}
_LEFT_ALONE = ("fixed_degC", "junction", "checked")  # by CONFigure
_PRESET = {name: value for name, value in _AFTER_RESET.items() if name not in _LEFT_ALONE}
_MEASURED = {"TEMP": "TEMPerature", "VOLT": "VOLTage[:DC]", "RES": "RESistance", "FRES": "FRESistance"}


class Agilent34970A(ScpiDevice):
    """Multiplexer with temperature and resistance measurement; each thermocouple has an offset drawn once."""

    identity = "HEWLETT-PACKARD,34970A,0,13-2-2"
    scpi_version = "1994.0"
    answers: ClassVar[Answers] = {
        ":INSTrument:DMM?": lambda self: f"{self.measures:d}",
        ":INSTrument:DMM:INSTalled?": lambda _: "1",
        ":SYSTem:CTYPe?": lambda _: "HEWLETT-PACKARD,34901A,0,2.3",
        ":SYSTem:LFRequency?": lambda _: f"{LINE_HZ:+.0f}",
    }
    held: ClassVar[HeldSettings] = {
        ":TRIGger:SOURce": held_word("source", "IMMediate", "BUS", "EXTernal", "TIMer", "ALARm1"),
        ":TRIGger:COUNt": Held(
            "count", lambda device, text: device.number(text, 1, 50000, INF=INFINITE), "+.8E", applied=False
        ),
        ":TRIGger:TIMer": held_number("interval_s", 0.0, 359999.0, form="+.8E"),
        **{f":FORMat:READing:{name}": held_switch(name) for name in _TOLD},
    }
    kept: ClassVar[KeptSettings] = {
        ":FORMat:READing:TIME:TYPE": word("RELative", "ABSolute"),
        ":DISPlay": Kept(True),
        ":ROUTe:MONitor:STATe": Kept(False),
        ":MEMory:STATe:RECall:AUTO": Kept(True),
        **dict.fromkeys((":DISPlay:TEXT", ":SYSTem:DATE", ":SYSTem:TIME"), Kept("", text=True)),
        **dict.fromkeys((":ROUTe:MONitor", ":OUTPut:ALARm1:SOURce", ":INPut:IMPedance:AUTO"), Kept("")),
        **{f":CALCulate:LIMit:{limit}": Kept("") for limit in ("UPPer", "UPPer:STATe", "LOWer", "LOWer:STATe")},
    }

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
        self.source, self.count, self.interval_s = "IMM", 1.0, 1.0
        vars(self).update(dict.fromkeys(_TOLD, False))

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
            value = float(self.ohmmeter.reading(OhmsSetting(one.wires, one.range_ohm, one.cycles), source))
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
        for header, (held, _, functions) in _BY_CHANNEL.items():
            handlers[header] = partial(self._set_channels, held, functions)
            handlers[f"{header}?"] = partial(self._tell_channels, held)
        for name, header in _MEASURED.items():
            handlers[f":CONFigure:{header}"] = partial(self._configure, name)
            handlers[f":MEASure:{header}?"] = partial(self._measure, name)
        return handlers

    def _set_channels(self, held: Held, functions: str, text: str) -> None:
        first, channels = (*words(text), "", "")[:2]
        value = held.read(self, first)
        for one in self._of(channels):
            if functions and one.function not in functions:
                raise ScpiError(*SETTINGS_CONFLICT)
            setattr(one, held.attribute, value)
            one.delays_itself &= held.attribute != "delay_s"

    def _tell_channels(self, held: Held, text: str) -> str:
        return ",".join(format(getattr(one, held.attribute), held.form or "") for one in self._of(text))

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
            about = f"TC,{one.type},+1.000000E+00" if one.function == "TEMP" else f"{one.range_ohm or 100.0:+.6E}"
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
        self.reply_after(max(0, self._scan_end_ns - self.now_ns) / NS)
        return ",".join(self._stored) if self._stored else None

    @command(":ABORt")
    def _abort(self, _: str) -> None:
        self._replies.clear()
        self._scan_end_ns = 0


SIMULATOR = Agilent34970A
