"""Simulated Agilent 34970A data logger with thermocouples: 101 laboratory, 102 chamber air, 103 the unit's case.

Any other channel hangs in the laboratory's air, but for those that the world wires to a source. A channel that was not
configured measures its voltage (of a thermocouple 0.04 mV per degC against the terminal block). Each slot holds a
34901A: with four wires channel n (source leads) is paired with n+10 (sense leads), so that n is 1 to 10. A thermocouple
whose reference junction is FIXed reads what it would if the terminal block had that temperature, whatever it has.

Source: 34970A User's Guide (CONFigure:TEMPerature, CONFigure:FRESistance, FRESistance:NPLC, ROUTe:SCAN,
ROUTe:CHANnel:DELay, TRIGger, FORMat:READing, READ?, UNIT:TEMPerature, channel lists; tutorial, four-wire multiplexers);
reference of the 34980A, which has the same commands (TEMPerature:TRANsducer:TCouple:RJUNction: its TYPE and value end
with ``*RST`` alone, EXTernal reads 9.9E+37 until a reference was measured). Placeholders: number of the error of a
channel that cannot have four wires; that ``CONFigure`` leaves the junction as it is, as on the 34980A.
"""

from __future__ import annotations

import re
from functools import partial
from typing import Any, ClassVar

import numpy as np

from sim_instruments.bus.kept import Held, HeldSettings, held_count, held_number, held_word
from sim_instruments.bus.ohms import Ohmmeter, OhmsSetting
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

OFFSET_SIGMA_DEGC, NOISE_SIGMA_DEGC = 0.2, 0.02
CHANNEL_S = 0.25
SWITCH_S = 0.02  # opening and closing of a channel's relays
TWO_WIRE_OHM = 4.0
CYCLES = (0.02, 0.2, 1.0, 2.0, 10.0, 20.0, 100.0, 200.0)
CHANNELS, PAIRS = 20, 10  # of a 34901A
BLOCK_DEGC = 23.0
FIXED_DEGC = (-20.0, 80.0)  # that a reference junction may be fixed at
NO_FOUR_WIRES = (308, "Channel not able to perform requested operation")
_TOLD = ("UNIT", "TIME", "CHANnel", "ALARm")  # what may stand beside a reading
_JUNCTION = "[:SENSe]:TEMPerature:TRANsducer:TCouple:RJUNction"
_BY_CHANNEL = {  # settings of single channels, and what one has that was never set
    ":ROUTe:CHANnel:DELay": (held_number("delays_s", 0.0, 60.0, form="+.8E"), 0.0),
    f"{_JUNCTION}:TYPE": (held_word("junctions", "INTernal", "EXTernal", "FIXed"), "INT"),
    _JUNCTION: (held_number("fixed_degC", *FIXED_DEGC, form="+.8E"), 0.0),
}
_LIST = re.compile(r"\(@([\d,: ]*)\)")


class Agilent34970A(ScpiDevice):
    """Multiplexer with temperature and resistance measurement; each thermocouple has an offset drawn once."""

    identity = "HEWLETT-PACKARD,34970A,0,13-2-2"
    held: ClassVar[HeldSettings] = {
        ":TRIGger:SOURce": held_word("source", "IMMediate", "BUS", "EXTernal", "TIMer", "ALARm1", form=None),
        ":TRIGger:COUNt": held_count("count", 1, 50000),
    }

    def power_up(self) -> None:
        super().power_up()
        self._ohmmeter = Ohmmeter(self, "34970A", TWO_WIRE_OHM)
        self._noise = self.world.rng("34970A noise")

    def reset(self) -> None:
        self.scan_list: list[int] = []
        self.thermocouples: set[int] = set()
        self.junctions: dict[int, str] = {}  # INT where nothing else was set
        self.fixed_degC: dict[int, float] = {}
        self.ohms: dict[int, OhmsSetting] = {}
        self.delays_s: dict[int, float] = {}
        self.source, self.count = "IMM", 1
        self.told = dict.fromkeys(_TOLD, False)

    def leave_more(self, draw: np.random.Generator) -> None:
        self.source, self.count = str(draw.choice(["IMM", "BUS", "EXT", "TIM"])), int(draw.integers(1, 6))
        self.told = {name: bool(draw.integers(2)) for name in _TOLD}
        self.scan_list = [int(channel) for channel in draw.choice(np.arange(101, 121), 3, replace=False)]
        self.delays_s = dict.fromkeys(self.scan_list, draw.uniform(0.0, 2.0))
        channels = range(101, 104)
        self.junctions = {channel: str(draw.choice(["INT", "EXT", "FIX"])) for channel in channels}
        self.fixed_degC = {channel: draw.uniform(*FIXED_DEGC) for channel in channels}

    def _listed_channels(self, text: str) -> list[int]:
        match = _LIST.fullmatch(text.strip())
        if match is None:
            raise ScpiError(*MISSING_PARAMETER)
        channels: list[int] = []
        for item in filter(None, match.group(1).replace(" ", "").split(",")):
            first, _, last = item.partition(":")
            channels += range(int(first), int(last or first) + 1)
        if not all(channel // 100 in (1, 2, 3) and 1 <= channel % 100 <= CHANNELS for channel in channels):
            raise ScpiError(*OUT_OF_RANGE)
        return channels

    def _degC(self, channel: int) -> float:
        thermal, t_ns = self.world.thermal, self.now_ns
        true = {102: thermal.air_degC, 103: thermal.unit_degC}.get(channel, thermal.lab_degC)(t_ns)
        offset = self.world.rng("thermocouple offset", channel).normal(0.0, OFFSET_SIGMA_DEGC)
        return float(true + offset + self._noise.normal(0.0, NOISE_SIGMA_DEGC))

    def _reading(self, channel: int) -> str:
        source = self.world.terminals.source(self.role, channel)
        if channel in self.ohms:
            return self.reading(self._ohmmeter.reading(self.ohms[channel], source))
        if source is not None and channel not in self.thermocouples:
            return self.reading(f"{source.voltage_V(self.now_ns):+.8E}")
        degC = self._degC(channel)
        if channel not in self.thermocouples:
            return self.reading(f"{(degC - BLOCK_DEGC) * 4e-5:+.8E}")
        junction = self.junctions.get(channel, "INT")
        if junction == "FIX":
            degC += self.fixed_degC.get(channel, 0.0) - BLOCK_DEGC
        return self.reading(self.overload if junction == "EXT" else f"{degC:+.8E}")

    @command(":CONFigure:TEMPerature")
    def _configure(self, text: str) -> None:
        parameters = words(text)
        if len(parameters) < 3:
            raise ScpiError(*MISSING_PARAMETER)
        self.word(parameters[0], "TCouple", "TC")
        self.word(parameters[1], "B", "E", "J", "K", "N", "R", "S", "T")
        channels = self._listed_channels(parameters[-1])
        self._is_now(channels)
        self.thermocouples |= set(channels)

    def _is_now(self, channels: list[int]) -> None:
        """``CONFigure`` resets the channels and makes them the scan list."""
        self.thermocouples -= set(channels)
        for channel in channels:
            self.ohms.pop(channel, None)
            self.delays_s.pop(channel, None)
        self.scan_list = channels

    def _configure_ohms(self, wires: int, text: str) -> None:
        parameters = words(text)
        channels = self._listed_channels(parameters[-1] if parameters else "")
        if wires == 4 and any(channel % 100 > PAIRS for channel in channels):
            raise ScpiError(*NO_FOUR_WIRES)
        settings = {channel: self._ohmmeter.configured(wires, parameters[:-1], 1.0) for channel in channels}
        self._is_now(channels)
        self.ohms |= settings

    @command("[:SENSe]:FRESistance:NPLCycles")
    def _set_ohms_cycles(self, text: str) -> None:
        first, channels = (*words(text), "", "")[:2]
        cycles = self._ohmmeter.cycles_of(first, CYCLES)
        for channel in self._listed_channels(channels):
            if channel not in self.ohms:
                raise ScpiError(*SETTINGS_CONFLICT)
            self.ohms[channel].cycles = cycles

    @command("[:SENSe]:FRESistance:NPLCycles?")
    def _get_ohms_cycles(self, text: str) -> str:
        known = [self.ohms.get(channel) for channel in self._listed_channels(text)]
        return ",".join(f"{1.0 if setting is None else setting.cycles:+.8E}" for setting in known)

    @command(":CONFigure?")
    def _get_configuration(self, text: str) -> str:
        told = []
        for channel in self._listed_channels(text):
            setting = self.ohms.get(channel)
            name = "TEMP TC,T,+1.000000E+00" if channel in self.thermocouples else "VOLT +1.000000E+01"
            told.append(f'"{name if setting is None else f"{setting.name} {setting.range_ohm or 100.0:+.6E}"}"')
        return ",".join(told)

    def further(self) -> Handlers:
        handlers: dict[str, Handler] = {
            ":CONFigure:FRESistance": partial(self._configure_ohms, 4),
            ":CONFigure:RESistance": partial(self._configure_ohms, 2),
        }
        for name in _TOLD:
            handlers[f":FORMat:READing:{name}"] = partial(self._show, name)
        for header, (setting, default) in _BY_CHANNEL.items():
            handlers[header] = partial(self._set_channels, setting)
            handlers[f"{header}?"] = partial(self._tell_channels, setting, default)
        return handlers

    def _set_channels(self, setting: Held, text: str) -> None:
        first, channels = (*words(text), "", "")[:2]
        value = setting.read(self, first)
        getattr(self, setting.attribute).update(dict.fromkeys(self._listed_channels(channels), value))

    def _tell_channels(self, setting: Held, default: Any, text: str) -> str:
        values = getattr(self, setting.attribute)
        return ",".join(format(values.get(channel, default), setting.form) for channel in self._listed_channels(text))

    @command(":UNIT:TEMPerature")
    def _set_unit(self, text: str) -> None:
        parameters = words(text)
        if not parameters:
            raise ScpiError(*MISSING_PARAMETER)
        self.word(parameters[0], "C")
        if len(parameters) > 1:
            self._listed_channels(parameters[1])

    @command(":ROUTe:SCAN")
    def _set_scan(self, text: str) -> None:
        self.scan_list = self._listed_channels(text)

    @command(":ROUTe:SCAN?")
    def _get_scan(self, _: str) -> str:
        text = f"(@{','.join(map(str, self.scan_list))})"
        return f"#2{len(text):02d}{text}"

    @command(":READ?")
    def _read(self, _: str) -> str | None:
        if not self.scan_list:
            raise ScpiError(*SETTINGS_CONFLICT)
        if self.source in ("BUS", "EXT"):
            return None  # it waits for a trigger
        self.reply_after(self.count * sum(self._takes_s(channel) for channel in self.scan_list))
        return ",".join(self._formed(channel) for _ in range(self.count) for channel in self.scan_list)

    def _formed(self, channel: int) -> str:
        unit = " C" if channel in self.thermocouples else " VDC"
        more = {"TIME": ",000000012.345", "CHANnel": f",{channel}", "ALARm": ",0"}
        shown = self._reading(channel) + unit * self.told["UNIT"]
        return shown + "".join(text for name, text in more.items() if self.told[name])

    def _show(self, name: str, text: str) -> None:
        self.told[name] = self.boolean(text)

    def _takes_s(self, channel: int) -> float:
        setting = self.ohms.get(channel)
        measured_s = CHANNEL_S if setting is None else SWITCH_S + setting.reading_s
        return measured_s + self.delays_s.get(channel, 0.0)

    @command(":ABORt")
    def _abort(self, _: str) -> None:
        self._replies.clear()


SIMULATOR = Agilent34970A
