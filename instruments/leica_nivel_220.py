"""Leica Nivel210/220 two-axis inclination sensor on its serial line, sensor 1 asked by computer 1.

A telegram is SYN STX text ETX, its text begins with to whom and from whom: ``N1C1 G A`` asks for a measurement,
``C1N1 X:+0.206 Y:-0.040 T:+23.8`` is the answer, in mrad and degC. Behind ETX come two bytes of a checksum, which may
be any bytes and stand before the next answer where they were not read; the sensor does not check those it gets. A
telegram that is not understood, and one that sets something, is not answered.

An answer takes up to 2 s, and nothing may be sent before it has come. Outside of its range of +-3 mrad the sensor says
so to ``G P`` alone, so that is asked before each measurement.

Source: NIVEL200 Technical Reference Manual 1.0 (8 to 10 telegram and checksum; 20 serial number; 24 to 29 compensation,
trigger mode, averages; 37 and 38 measurement and range; 51 times) and User Manual (57 range, 59 warm-up of 20 min).
Not confirmed on hardware: speed and parity of the line; the sense of rotation of X and Y, which depends on how the
sensor is mounted.
"""

from __future__ import annotations

import re
from collections.abc import Callable
from typing import TypeVar

from bench.model.ports import Identity, action
from instruments.base import BaseInstrument

T = TypeVar("T")

_NUMBER = r"\s*([+-]?\d+\.\d+)"
_READING = re.compile(rf"C1N1\s+X:{_NUMBER}\s+Y:{_NUMBER}\s+T:{_NUMBER}\s*")
_TELEGRAM = re.compile(".{0,2}\x16\x02(C1N1 [^\x03]*)", re.DOTALL)
_SERIAL_AND_FIRMWARE = re.compile(r"C1N1 (\S+) (\S+)")
_PATIENCE_S = 3.0


def telegram(text: str) -> str:
    """Return a text as it is sent, but for its line feed."""
    return f"\x16\x02{text}\x03\r"


def read_telegram(reply: str) -> str:
    """Return the text of an answer, read up to ETX. Raises: ValueError."""
    match = _TELEGRAM.fullmatch(reply)
    if match is None:
        raise ValueError("SYN STX C1N1 ... ETX is due")
    return match[1].rstrip()


def read_tilt(text: str) -> tuple[float, float, float]:
    """Return X (mrad), Y (mrad) and temperature (degC) of the text of an answer. Raises: ValueError."""
    match = _READING.fullmatch(text)
    if match is None:
        raise ValueError("C1N1 X:... Y:... T:... is due")
    return float(match[1]), float(match[2]), float(match[3])


class LeicaNivel220(BaseInstrument):
    """Measurement of the tilt of the axis of rotation."""

    identity_pattern = r"LEICA,NIVEL220"
    identity_question = telegram("N1C1 RB D")
    safe_state = "nothing to do: it only measures"
    reply_end = "\x03"

    @action(bus_s=4.0, returns="mrad")
    def measure(self) -> dict[str, float]:
        """Measure the tilt about the sensor's two axes, mrad, and the temperature inside it, degC.

        Raises: InstrumentError B-INST-019 outside of its range.
        """
        self.bring("measure")
        x_mrad, y_mrad, temperature_degC = self.ask("N1C1 G A", read_tilt)
        return {"x_mrad": x_mrad, "y_mrad": y_mrad, "temperature_degC": temperature_degC}

    def ask(self, query: str, parse: Callable[[str], T], patience_s: float = _PATIENCE_S) -> T:
        """Ask in a telegram; ``parse`` gets the text of the answer. Raises: as of any driver."""
        return super().ask(telegram(query), lambda reply: parse(read_telegram(reply)), patience_s)

    def raw(self, command: str, *, answers: bool = False) -> str | None:
        """Control by hand; what the sensor is told, ``N1C1 G A``, is put into its frame."""
        sent = telegram(command) if command.startswith("N1C1 ") else command
        if not answers:
            return super().raw(sent)
        self._ready()
        return self.bus.query(sent, str, self.timeout_s, repeatable=False, patience_s=_PATIENCE_S)

    def drain_errors(self) -> list[str]:
        """Get nothing: it keeps no errors."""
        return []

    def _send(self, command: str) -> None:
        super()._send(telegram(command))

    def _identity_of(self, reply: str) -> Identity:
        match = _SERIAL_AND_FIRMWARE.fullmatch(reply.partition("\x02")[2].rstrip())
        return Identity("", reply, "", "") if match is None else Identity("LEICA", "NIVEL220", match[1], match[2])

    def _go_safe(self) -> None:
        self._ask_identity()  # there is nothing to switch: only whether it is there


DRIVER = LeicaNivel220
