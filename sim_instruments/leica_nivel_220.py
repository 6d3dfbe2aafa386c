"""Simulated Leica Nivel210/220 two-axis inclination sensor, number 1, at the table's axis of rotation.

It tells what its world says of the tilt (``level_mrad``), in steps of 0.001 mrad; on a bench without a tilt, zero.

Source: telegrams as public programs send and cut them. Placeholders, not confirmed on hardware: the answer to ``RB I``,
CR LF behind ETX and no checksum, no end of the range, time of a measurement.
"""

from __future__ import annotations

import re
from typing import Any

from sim_instruments.bus.live import LiveDevice

_TELEGRAM = re.compile("\x16\x02N1C1 ([^\x03]*)\x03")
_MEASUREMENT_S = 0.3
_INSIDE_DEGC = 23.0


class LeicaNivel220(LiveDevice):
    """Inclination sensor; a telegram it does not understand is not answered."""

    identity = "I:SIM220"

    def execute(self, message: str) -> None:
        match = _TELEGRAM.fullmatch(message)
        if match is None:
            return
        if match[1] == "RB I":
            self.reply(self.faults.identity or _framed(self.identity))
        elif match[1] == "G A":
            x_mrad, y_mrad = self._tilt_mrad()
            told = self.reading(f"X:{x_mrad:+.3f} Y:{y_mrad:+.3f} T:{_INSIDE_DEGC:+.1f}")
            self.reply(_framed(told), after_s=_MEASUREMENT_S)

    def _tilt_mrad(self) -> tuple[float, float]:
        level: Any = getattr(self.world, "level_mrad", None)
        return (0.0, 0.0) if level is None else level(self.now_ns)


def _framed(text: str) -> str:
    return f"\x16\x02C1N1 {text}\x03\r"


SIMULATOR = LeicaNivel220
