"""Leica Nivel210/220 two-axis inclination sensor on its serial line, sensor 1 asked by computer 1.

A telegram is SYN STX text ETX CR LF, its text begins with who speaks and to whom: ``N1C1 G A`` asks for a measurement,
``C1N1 X:+0.206 Y:-0.040 T:+23.8`` is the answer, in mrad and degC. A telegram that is not understood is not answered.

Source: public programs for this sensor (form of the telegram, ``G A`` and its answer, ``RB I`` as a question of what
it is). Not confirmed on hardware: the answer to ``RB I``, by which it is known here only as a sensor of this family;
that an answer ends in CR LF and has no checksum behind ETX (one public program cuts off two bytes there); speed and
parity of the line; the sense of rotation of X and Y, which depends on how the sensor is mounted.
"""

from __future__ import annotations

import re

from bench.model.ports import Identity, action
from instruments.base import BaseInstrument

_NUMBER = r"\s*([+-]?\d+\.\d+)"
_READING = re.compile(rf"C1N1\s+X:{_NUMBER}\s+Y:{_NUMBER}\s+T:{_NUMBER}\s*")
_TELEGRAM = re.compile("\x16\x02(C1N1 [^\x03]*)\x03.*", re.DOTALL)


def telegram(text: str) -> str:
    """Return a question as it is sent, but for its line feed."""
    return f"\x16\x02N1C1 {text}\x03\r"


def read_telegram(reply: str) -> str:
    """Return the text of an answer. Raises: ValueError."""
    match = _TELEGRAM.fullmatch(reply)
    if match is None:
        raise ValueError("SYN STX C1N1 ... ETX is due")
    return match[1]


def read_tilt(reply: str) -> tuple[float, float, float]:
    """Return X (mrad), Y (mrad) and temperature (degC) of an answer. Raises: ValueError."""
    match = _READING.fullmatch(read_telegram(reply))
    if match is None:
        raise ValueError("C1N1 X:... Y:... T:... is due")
    return float(match[1]), float(match[2]), float(match[3])


class LeicaNivel220(BaseInstrument):
    """Measurement of the tilt of the axis of rotation."""

    identity_pattern = r"LEICA,NIVEL220"
    identity_question = telegram("RB I")
    safe_state = "nothing to do: it only measures"

    @action(bus_s=1.0, returns="mrad")
    def measure(self) -> dict[str, float]:
        """Measure the tilt about the sensor's two axes, mrad, and the temperature inside it, degC."""
        x_mrad, y_mrad, temperature_degC = self.ask(telegram("G A"), read_tilt)
        return {"x_mrad": x_mrad, "y_mrad": y_mrad, "temperature_degC": temperature_degC}

    def raw(self, command: str, *, answers: bool = False) -> str | None:
        """Control by hand; what the sensor is asked, ``N1C1 G A``, is put into its frame."""
        asked = command.removeprefix("N1C1 ")
        return super().raw(command if asked == command else telegram(asked), answers=answers)

    def drain_errors(self) -> list[str]:
        """Get nothing: it keeps no errors."""
        return []

    def _identity_of(self, reply: str) -> Identity:
        try:
            told = read_telegram(reply)
        except ValueError:
            return Identity("", reply, "", "")
        return Identity("LEICA", "NIVEL220", told.removeprefix("C1N1").strip().removeprefix("I:"), "")

    def _go_safe(self) -> None:
        self._ask_identity()  # there is nothing to switch: only whether it is there


DRIVER = LeicaNivel220
