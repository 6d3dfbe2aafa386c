"""Simulated Krohn-Hite 3988 filter: channel 1 and 2 in series between the gyroscope and the lock-in amplifiers.

Each channel is a Butterworth or Bessel filter of 8 poles, or a by-pass. Whatever is read after a command is the
display. In the all-channel mode (a key) a command acts on both.

Source: 3988 operating manual of 4/03, title page (poles, gains), 3.3.2 (delimiters), 3.5.1 (display), 3.5.3 (``V``).
Placeholders, not confirmed on hardware: the letters of the commands but ``V``, the display in by-pass, no limits of
voltage, no noise, ac coupling as one pole at 0.16 Hz.
"""

from __future__ import annotations

import re
from dataclasses import dataclass, replace
from functools import partial
from typing import Any

import numpy as np
from scipy.signal import bessel, butter, sosfilt

from bench.model.arrays import Floats
from sim_instruments.bus.live import LiveDevice

SAMPLES_HZ = 1000.0
POLES = 8
AC_HZ = 0.16
LOWEST_HZ, HIGHEST_HZ = 0.03, 1e6
_SAMPLE_NS = 1_000_000
_COMMAND = re.compile(r"([A-Z]+)\s*([+-]?[\d.]+(?:E[+-]?\d+)?)?")
_KILO, _MEGA = 1e3, 1e6
_WORDS = {"kind": ("HP", "LP", "BY"), "response": ("BU", "BE"), "coupling": ("AC", "DC")}
_GAINS = {"IG": ("input_gain_dB", 50), "OG": ("output_gain_dB", 20)}


@dataclass(frozen=True)
class Channel:
    """Settings of one channel; ``kind`` is HP, LP or BY, ``response`` BU (Butterworth) or BE (Bessel)."""

    kind: str = "BY"
    cutoff_Hz: float = 1000.0
    input_gain_dB: int = 0
    output_gain_dB: int = 0
    coupling: str = "DC"
    response: str = "BU"

    @property
    def gain(self) -> float:
        """Gain of both amplifiers, as a factor."""
        return float(10.0 ** ((self.input_gain_dB + self.output_gain_dB) / 20.0))

    def sections(self) -> list[Floats]:
        """Return second-order sections at 1000 samples a second; none for a way straight through."""
        sections = [] if self.coupling == "DC" else [butter(1, AC_HZ, "highpass", fs=SAMPLES_HZ, output="sos")]
        if self.kind != "BY" and self.cutoff_Hz < SAMPLES_HZ / 2:
            kind, poles = "highpass" if self.kind == "HP" else "lowpass", (POLES, self.cutoff_Hz)
            response = {"BU": butter, "BE": partial(bessel, norm="mag")}[self.response]
            sections.append(response(*poles, kind, fs=SAMPLES_HZ, output="sos"))
        return sections


class Stage:
    """Filters of second order in series, from rest on, to be called piece by piece; without any, nothing changes."""

    def __init__(self, sections: list[Floats]) -> None:
        self._sections = np.vstack(sections) if sections else np.zeros((0, 6))
        self._state = np.zeros((len(self._sections), 2))

    def filtered(self, volts: Floats) -> Floats:
        """Return the next samples behind them, volt (n,)."""
        if len(self._sections):
            volts, self._state = sosfilt(self._sections, volts, zi=self._state)
        return volts


class BandPass:
    """The way of one signal through both channels, sample after sample, with what was set in the meantime.

    Args: history: of the filter, (sample from which on, the two channels), the first one from sample 0 on.
    """

    def __init__(self, history: list[tuple[int, tuple[Channel, Channel]]]) -> None:
        self._history = history
        self._at = -1  # place in the history
        self._stage = Stage([])
        self._gain = 1.0

    def filtered(self, first: int, volts: Floats) -> Floats:
        """Return the samples from ``first`` on behind the filter, volt (n,); to be called piece by piece."""
        output = np.array(volts)
        done = 0
        while done < len(output):
            while self._at + 1 < len(self._history) and self._history[self._at + 1][0] <= first + done:
                self._at += 1
                self._begin(self._history[self._at][1])
            change = self._history[self._at + 1][0] - first if self._at + 1 < len(self._history) else len(output)
            end = min(change, len(output))
            output[done:end] = self._stage.filtered(output[done:end] * self._gain)
            done = end
        return output

    def _begin(self, channels: tuple[Channel, Channel]) -> None:
        self._stage = Stage([section for channel in channels for section in channel.sections()])
        self._gain = channels[0].gain * channels[1].gain


class KrohnHite3988(LiveDevice):
    """The filter; ``history`` is what ``BandPass`` wants. A change of the settings begins from rest."""

    identity = "KROHN-HITE V3.5"

    def power_up(self) -> None:
        super().power_up()
        self.channels = [Channel(), Channel()]
        self.history: list[tuple[int, tuple[Channel, Channel]]] = [(0, (Channel(), Channel()))]
        self._shown, self.together = 1, False

    def press(self, keys: str) -> None:
        self.together = not self.together

    def outputs(self) -> dict[str, Any]:
        return {"channels": [f"{channel.kind} {channel.cutoff_Hz:g} Hz" for channel in self.channels]}

    def execute(self, message: str) -> None:
        if message.strip().upper() == "V":
            self.reply(self.told_identity)
            return
        for unit in re.split(r"[;:/\\]", message.upper()):
            if match := _COMMAND.fullmatch(unit.strip()):
                self._carry_out(match[1], match[2])
        settings = (self.channels[0], self.channels[1])
        if settings != self.history[-1][1]:
            self.history.append((self.now_ns // _SAMPLE_NS, settings))
        self.reply(self._display())

    def _carry_out(self, word: str, text: str | None) -> None:
        value = float(text) if text else 0.0
        change: dict[str, Any] = {name: word for name, words in _WORDS.items() if word in words}
        if word == "CH" and value in (1.0, 2.0):
            self._shown = int(value)
        elif word == "F" and LOWEST_HZ <= value <= HIGHEST_HZ:
            change["cutoff_Hz"] = float(f"{value:.4g}")
        elif word in _GAINS and 0 <= value <= _GAINS[word][1]:
            change[_GAINS[word][0]] = int(value)
        for place in (0, 1) if self.together else (self._shown - 1,):
            self.channels[place] = replace(self.channels[place], **change)

    def _display(self) -> str:
        channel = self.channels[self._shown - 1]
        shown = "byP     " if channel.kind == "BY" else _four_digits(channel.cutoff_Hz)
        gain, mode = f"{channel.output_gain_dB:02d}", "*" if self.together else " "
        return f"{channel.input_gain_dB:02d} {shown} {self._shown:02d}.1 {gain} {channel.coupling}{mode}"


def _four_digits(frequency_Hz: float) -> str:
    """Return four digits with a point and a power of a thousand."""
    unit, power = next((pair for pair in ((_MEGA, 6), (_KILO, 3)) if frequency_Hz >= pair[0]), (1.0, 0))
    digits = f"{frequency_Hz / unit:.4g}".removeprefix("0")
    return f"{digits if '.' in digits else digits + '.'}".ljust(5, "0")[:5] + f"E+{power}"


SIMULATOR = KrohnHite3988
