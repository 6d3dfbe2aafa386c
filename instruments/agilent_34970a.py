"""Agilent 34970A data acquisition unit: thermocouples (laboratory ambient first, then the chamber's).

Source: 34970A User's Guide (CONFigure:TEMPerature, ROUTe:SCAN, READ?, UNIT:TEMPerature). Not confirmed on hardware: the
time a scan takes (10 s is allowed).
"""

from __future__ import annotations

from typing import Any, ClassVar

from bench.model.ports import action
from instruments.readback import either
from instruments.scpi import ScpiInstrument
from instruments.values import read_number

_SCAN_LIMIT_S = 10.0
_THERMOCOUPLES = "BEJKNRST"


def read_scan_list(reply: str) -> str:
    """The list of a ``ROUT:SCAN?`` reply, a block such as ``#210(@101,102)``. Raises: ValueError if there is none."""
    return reply[reply.index("(@") :].replace(" ", "")


class Agilent34970A(ScpiInstrument):
    """Measurement of temperatures; options ``channels`` (101 = slot 1, channel 1 ...) and ``thermocouple`` (type)."""

    identity_pattern = r"(HEWLETT-PACKARD|HP|AGILENT.*|KEYSIGHT.*),34970A"
    safe_state = "scan aborted (ABOR); the logger drives nothing"
    default_options: ClassVar[dict[str, Any]] = {"channels": [101, 102], "thermocouple": "T"}

    @action(bus_s=3.0, returns="degC")
    def scan(self) -> list[float]:
        """Measure every channel of the scan list once, degC, in its order.

        Raises: InstrumentError B-INST-007 if a thermocouple is open, B-INST-004 if readings are missing.
        """
        channels = self._channel_list()
        self.set(f"ROUT:SCAN {channels}", either(lambda: self.ask("ROUT:SCAN?", read_scan_list), channels))
        temperatures_degC = self.ask("READ?", self._read_scan, patience_s=_SCAN_LIMIT_S)
        self.check_errors("READ?")
        return temperatures_degC

    def _read_scan(self, reply: str) -> list[float]:
        readings = [read_number(reading) for reading in reply.split(",")]
        if len(readings) != len(self.options["channels"]):
            raise ValueError(f"{len(self.options['channels'])} readings are due")
        return readings

    def _channel_list(self) -> str:
        return f"(@{','.join(map(str, self.options['channels']))})"

    def _check_options(self) -> None:
        channels, kind = self.options["channels"], self.options["thermocouple"]
        valid = isinstance(channels, list) and all(
            type(channel) is int and 101 <= channel <= 320 for channel in channels
        )
        if not (valid and channels):
            raise self.bad_option(f"channels {channels!r} must be a list of numbers 101 to 320")
        if kind not in tuple(_THERMOCOUPLES):
            raise self.bad_option(f"thermocouple {kind!r} is none of {', '.join(_THERMOCOUPLES)}")

    def _prepare(self) -> None:
        channels = self._channel_list()
        self.set(f"CONF:TEMP TC,{self.options['thermocouple']},{channels}")
        self.set(f"UNIT:TEMP C,{channels}")

    def _go_safe(self) -> None:
        self.bus.write("ABOR", self.timeout_s)
        self.drain_errors()


DRIVER = Agilent34970A
