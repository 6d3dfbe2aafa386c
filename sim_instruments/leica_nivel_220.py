"""Simulated Leica Nivel210/220 two-axis inclination sensor, number 1, at the table's axis of rotation.

It tells what its world says of the tilt (``level_mrad``), the mean of the last measurements (one a second), in steps of
0.001 mrad; on a bench without a tilt, zero.

Source: NIVEL200 Technical Reference Manual 1.0 (9 checksum; 20, 24 to 29, 35 to 40, 51) and User Manual (57 range).
Placeholders, not confirmed on hardware: what is raw without compensation, what is told before the first trigger.
"""

from __future__ import annotations

import re
from typing import Any

import numpy as np

from bench.model.clock import NS
from sim_instruments.bus.live import LiveDevice

_TELEGRAM = re.compile("\x16\x02N1C1 ([^\x03]*)\x03$")
_ANSWER_S, _MEASUREMENT_S = 0.1, 2.0
_INSIDE_DEGC, _RANGE_MRAD = 23.0, 3.0
_RAW_GAIN, _RAW_OFFSET_MRAD = 1.02, 0.1
_SETTINGS = {"S C": ("RS C", "ON|OFF"), "S M": ("RS M", "CONT|PRE"), "W N": ("R N", r"00[1-9]|0\d\d|1[01]\d|12[0-8]")}


class LeicaNivel220(LiveDevice):
    """Inclination sensor; a telegram it does not understand is not answered."""

    identity = "SIM220 1.0"

    def power_up(self) -> None:
        super().power_up()
        self.add_eom("ASRL INSTR", "\n", "")
        self.held = {"RS C": "ON", "RS M": "CONT", "R N": "008"}  # by question
        self._triggered_mrad = (0.0, 0.0)

    def leave(self, setting: str) -> None:
        super().leave(f"\x16\x02{setting}\x03")

    def execute(self, message: str) -> None:
        match = _TELEGRAM.search(message)
        if match is None:
            return
        order, _, value = match[1].rpartition(" ")
        question, legal = _SETTINGS.get(order, ("", ""))
        if question and re.fullmatch(legal, value):
            self.held[question] = value
        if match[1] in ("S M PRE", "TT"):
            self._triggered_mrad = self._tilt_mrad()
        answer, after_s = self._answer(match[1]), _MEASUREMENT_S if match[1] == "G A" else _ANSWER_S
        if answer:
            self.reply(answer, after_s=after_s)

    def _answer(self, question: str) -> str:
        """Return the telegram that answers, "" where there is none."""
        if question == "RB D":
            return self.faults.identity or _framed(self.identity)
        told_mrad = self._triggered_mrad if self.held["RS M"] == "PRE" else self._tilt_mrad()
        if question == "G P":
            return _framed("OK" if max(map(abs, told_mrad)) <= _RANGE_MRAD else "F")
        if question == "G A":
            return _framed(self.reading(f"X:{told_mrad[0]:+.3f} Y:{told_mrad[1]:+.3f} T:{_INSIDE_DEGC:+.1f}"))
        return _framed(self.held[question]) if question in self.held else ""

    def _tilt_mrad(self) -> tuple[float, float]:
        level: Any = getattr(self.world, "level_mrad", None)
        if level is None:
            return 0.0, 0.0
        means = np.mean([level(self.now_ns - past * NS) for past in range(int(self.held["R N"]))], axis=0)
        x_mrad, y_mrad = means if self.held["RS C"] == "ON" else means * _RAW_GAIN + _RAW_OFFSET_MRAD
        return float(x_mrad), float(y_mrad)


def _framed(text: str) -> str:
    total = sum(f"C1N1 {text}".encode("latin-1"))
    return f"\x16\x02C1N1 {text}\x03{chr(total >> 8 & 255)}{chr(total & 255)}"


SIMULATOR = LeicaNivel220
