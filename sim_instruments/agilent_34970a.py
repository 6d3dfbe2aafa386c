"""Simulated Agilent 34970A data logger with thermocouples: 101 laboratory, 102 chamber air, 103 the unit's case.

Any other channel hangs in the laboratory's air. A channel that was not configured as a thermocouple measures its
voltage (0.04 mV per degC against the terminal block).

Source: 34970A User's Guide (CONFigure:TEMPerature, ROUTe:SCAN, READ?, UNIT:TEMPerature, channel lists).
"""

from __future__ import annotations

import re
from typing import Any

from sim_instruments.bus.scpi import MISSING_PARAMETER, OUT_OF_RANGE, ScpiDevice, ScpiError, command, words

OFFSET_SIGMA_DEGC, NOISE_SIGMA_DEGC = 0.2, 0.02
CHANNEL_S = 0.25
_LIST = re.compile(r"\(@([\d,: ]*)\)")


class Agilent34970A(ScpiDevice):
    """Multiplexer with temperature measurement; each thermocouple has an offset drawn once."""

    identity = "HEWLETT-PACKARD,34970A,0,13-2-2"

    def __init__(self, *arguments: Any) -> None:
        super().__init__(*arguments)
        self._noise = self.world.rng("34970A noise")

    def reset(self) -> None:
        self.scan_list: list[int] = []
        self.thermocouples: set[int] = set()

    def _listed_channels(self, text: str) -> list[int]:
        match = _LIST.fullmatch(text.strip())
        if match is None:
            raise ScpiError(*MISSING_PARAMETER)
        channels: list[int] = []
        for item in filter(None, match.group(1).replace(" ", "").split(",")):
            first, _, last = item.partition(":")
            channels += range(int(first), int(last or first) + 1)
        if not all(channel // 100 in (1, 2, 3) and 1 <= channel % 100 <= 20 for channel in channels):
            raise ScpiError(*OUT_OF_RANGE)
        return channels

    def _degC(self, channel: int) -> float:
        thermal, t_ns = self.world.thermal, self.now_ns
        true = {102: thermal.air_degC, 103: thermal.unit_degC}.get(channel, thermal.lab_degC)(t_ns)
        offset = self.world.rng("thermocouple offset", channel).normal(0.0, OFFSET_SIGMA_DEGC)
        return float(true + offset + self._noise.normal(0.0, NOISE_SIGMA_DEGC))

    def _reading(self, channel: int) -> str:
        degC = self._degC(channel)
        return self.reading(f"{degC if channel in self.thermocouples else (degC - 23.0) * 4e-5:+.8E}")

    @command(":CONFigure:TEMPerature")
    def _configure(self, text: str) -> None:
        parameters = words(text)
        if len(parameters) < 3:
            raise ScpiError(*MISSING_PARAMETER)
        self.word(parameters[0], "TCouple", "TC")
        self.word(parameters[1], "B", "E", "J", "K", "N", "R", "S", "T")
        channels = self._listed_channels(parameters[-1])
        self.thermocouples |= set(channels)
        self.scan_list = channels

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
            raise ScpiError(-221, "Settings conflict")
        self.reply_after(CHANNEL_S * len(self.scan_list))
        return ",".join(self._reading(channel) for channel in self.scan_list)

    @command(":ABORt")
    def _abort(self, _: str) -> None:
        self._replies.clear()


SIMULATOR = Agilent34970A
