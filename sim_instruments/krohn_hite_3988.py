"""Simulated Krohn-Hite 3988 filter: channel 1 and 2 in series between the gyroscope and the lock-in amplifiers.

Each channel is a Butterworth filter of 8 poles, or a by-pass. Whatever is read after a command is the display.

Source: 3988 operating manual, section 3 (delimiters, form of the display and of ``V``). Placeholders, not confirmed on
hardware: the letters of the commands but ``V``, the display in by-pass, no limits of voltage, no noise, ac coupling
lets everything through.
"""

from __future__ import annotations

import re
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from scipy.signal import butter, sosfilt

from bench.model.arrays import Floats
from sim_instruments.bus.live import LiveDevice

SAMPLES_HZ = 1000.0
POLES = 8
LOWEST_HZ, HIGHEST_HZ = 0.03, 1e6
_SAMPLE_NS = 1_000_000
_COMMAND = re.compile(r"([A-Z]+)\s*([+-]?[\d.]+(?:E[+-]?\d+)?)?")
_KILO, _MEGA = 1e3, 1e6


@dataclass(frozen=True)
class Channel:
    """Settings of one channel; ``kind`` is HP, LP or BY."""

    kind: str = "BY"
    cutoff_Hz: float = 1000.0
    input_gain_dB: int = 0
    output_gain_dB: int = 0
    coupling: str = "AC"

    @property
    def gain(self) -> float:
        """Gain of both amplifiers, as a factor."""
        return float(10.0 ** ((self.input_gain_dB + self.output_gain_dB) / 20.0))

    def sections(self) -> Floats | None:
        """Return second-order sections at 1000 samples a second; None for a way straight through."""
        if self.kind == "BY" or not self.cutoff_Hz < SAMPLES_HZ / 2:
            return None
        kind = "highpass" if self.kind == "HP" else "lowpass"
        sections: Floats = butter(POLES, self.cutoff_Hz, kind, fs=SAMPLES_HZ, output="sos")
        return sections


class BandPass:
    """The way of one signal through both channels, sample after sample, with what was set in the meantime.

    Args: history: of the filter, (sample from which on, the two channels), the first one from sample 0 on.
    """

    def __init__(self, history: list[tuple[int, tuple[Channel, Channel]]]) -> None:
        self._history = history
        self._at = -1  # place in the history
        self._stages: list[tuple[Floats, Floats]] = []
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
            output[done:end] *= self._gain
            for place, (sections, state) in enumerate(self._stages):
                output[done:end], state = sosfilt(sections, output[done:end], zi=state)
                self._stages[place] = (sections, state)
            done = end
        return output

    def _begin(self, channels: tuple[Channel, Channel]) -> None:
        sections = [channel.sections() for channel in channels]
        self._stages = [(section, np.zeros((len(section), 2))) for section in sections if section is not None]
        self._gain = channels[0].gain * channels[1].gain


class KrohnHite3988(LiveDevice):
    """The filter; ``history`` is what ``BandPass`` wants. A change of the settings begins from rest."""

    identity = "KROHN-HITE V3.5"

    def power_up(self) -> None:
        super().power_up()
        self.channels = [Channel(), Channel()]
        self.history: list[tuple[int, tuple[Channel, Channel]]] = [(0, (Channel(), Channel()))]
        self._shown = 1

    def leave_more(self, draw: np.random.Generator) -> None:
        for place in (0, 1):
            kind, cutoff_Hz = str(draw.choice(["HP", "LP", "BY"])), float(f"{10.0 ** draw.uniform(-1.0, 2.0):.4g}")
            gains = [int(gain) for gain in draw.choice([0, 10, 20], 2)]
            self.channels[place] = Channel(kind, cutoff_Hz, *gains, str(draw.choice(["AC", "DC"])))
        self._shown = int(draw.integers(1, 3))
        self.history.append((self.now_ns // _SAMPLE_NS, (self.channels[0], self.channels[1])))

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
        value = float(text) if text else None
        change: dict[str, Any] = {}
        if word == "CH" and value in (1.0, 2.0):
            self._shown = int(value)
        elif word in ("HP", "LP", "BY"):
            change["kind"] = word
        elif word in ("AC", "DC"):
            change["coupling"] = word
        elif word == "F" and value is not None and LOWEST_HZ <= value <= HIGHEST_HZ:
            change["cutoff_Hz"] = float(f"{value:.4g}")
        elif word in ("IG", "OG") and value is not None:
            change["input_gain_dB" if word == "IG" else "output_gain_dB"] = int(value)
        self.channels[self._shown - 1] = replace(self.channels[self._shown - 1], **change)

    def _display(self) -> str:
        channel = self.channels[self._shown - 1]
        shown = "byP     " if channel.kind == "BY" else _four_digits(channel.cutoff_Hz)
        return (
            f"{channel.input_gain_dB:02d} {shown} {self._shown:02d}.1 {channel.output_gain_dB:02d} {channel.coupling} "
        )


def _four_digits(frequency_Hz: float) -> str:
    """Return four digits with a point and a power of a thousand."""
    unit, power = next((pair for pair in ((_MEGA, 6), (_KILO, 3)) if frequency_Hz >= pair[0]), (1.0, 0))
    digits = f"{frequency_Hz / unit:.4g}".removeprefix("0")
    return f"{digits if '.' in digits else digits + '.'}".ljust(5, "0")[:5] + f"E+{power}"


SIMULATOR = KrohnHite3988
