"""Krohn-Hite 3988 filter, 0.03 Hz to 1 MHz: its two 8-pole channels in series as a band-pass.

Channel 1 is the high-pass at half the centre frequency, channel 2 the low-pass at twice of it, both Butterworth: by
symmetry the phase at the centre is zero, and the band is two octaves wide. Commands have no reply; whatever is read
after one is the display: input gain, cutoff, channel, output gain, coupling. The 3940 of the same maker begins at
3 Hz, too high for a table that turns once a second.

The display tells neither high-pass nor low-pass and neither Butterworth nor Bessel: both are set each time.

Source: 3988 operating manual of 4/03, 3.3.2 (free format of commands with delimiters, lines of at most 32 characters),
3.5.1 (display, "*" at its end in the all-channel mode), 3.5.3 (answer to ``V``). Not confirmed on hardware: the letters
of all other commands (CH channel, F cutoff, LP, HP, BU Butterworth, BY by-pass, IG, OG gains, DC), and that a channel
in by-pass shows letters for its cutoff. The answer to ``V`` names the maker only: any filter of the maker is taken for
a 3988.
"""

from __future__ import annotations

import re
from dataclasses import dataclass

from bench.model.ports import Identity, Parameter, action
from instruments.base import BaseInstrument
from instruments.commands import ReadBack
from instruments.values import exponent_form

_DISPLAY = re.compile(r"(\d\d) +([\w.]+?)(E\+[036])? +(\d\d)\.\d (\d\d) (AC|DC)\*?")
_HIGH_PASS, _LOW_PASS = 1, 2  # channels
_HALF_BAND = 2.0  # an octave to each side of the centre
_DIGITS, _STEP_HZ = 1e-3, 1e-4  # of the display: relative, and below 1 Hz


@dataclass(frozen=True)
class Display:
    """Settings of one channel: gains in dB, ``cutoff_Hz`` None in by-pass."""

    channel: int
    cutoff_Hz: float | None
    input_gain_dB: int
    output_gain_dB: int
    coupling: str


def read_display(reply: str) -> Display:
    """Return the display as it is told, ``00 .5000E+0 01.1 00 DC``. Raises: ValueError."""
    match = _DISPLAY.fullmatch(reply)
    if match is None:
        raise ValueError("gain, cutoff, channel, gain and coupling are due")
    gain, shown, power, channel, output_gain, coupling = match.groups()
    cutoff_Hz = float(shown + power) if power else None
    return Display(int(channel), cutoff_Hz, int(gain), int(output_gain), coupling)


class KrohnHite3988(BaseInstrument):
    """Control of the filter before the lock-in amplifiers."""

    identity_pattern = r"KROHN-HITE,3988"
    identity_question = "V"
    safe_state = "nothing to do: it drives nothing but the lock-in amplifiers"

    wanted: tuple[float | None, float | None] | None = None  # cutoffs of the channels, None for by-pass

    @action(Parameter("centre", "Hz", 0.06, 150e3), bus_s=1.0)
    def configure(self, centre: float) -> None:
        """Set a band-pass of two octaves about ``centre`` (hertz), gain 1, dc coupled, and read both channels back.

        Raises: InstrumentError B-INST-008, B-INST-011, B-INST-019 (what is set for one channel is set for both).
        """
        self.bring("configure")
        self._set_both(centre / _HALF_BAND, centre * _HALF_BAND)

    @action(bus_s=1.0)
    def bypass(self) -> None:
        """Set both channels through, gain 1, dc coupled, and read it back. Raises: InstrumentError B-INST-011."""
        self._set_both(None, None)

    def drain_errors(self) -> list[str]:
        """Get nothing: it keeps no errors."""
        return []

    def _set_both(self, high_pass_Hz: float | None, low_pass_Hz: float | None) -> None:
        self._ready()
        self.wanted = None
        for channel, kind, cutoff_Hz in ((_HIGH_PASS, "HP", high_pass_Hz), (_LOW_PASS, "LP", low_pass_Hz)):
            how = "BY" if cutoff_Hz is None else f"{kind};BU;F {exponent_form(float(f'{cutoff_Hz:.4g}'))}"
            self._channel(channel, f"CH {channel};IG 0;OG 0;DC", None, gains_only=True)
            self._channel(channel, f"CH {channel};{how}", cutoff_Hz)
        self._confirm((high_pass_Hz, low_pass_Hz))
        self.wanted = (high_pass_Hz, low_pass_Hz)

    def _channel(self, channel: int, command: str, cutoff_Hz: float | None, *, gains_only: bool = False) -> None:
        def done(display: Display) -> bool:
            return _is_plain(display) and (gains_only or _is_at(display, cutoff_Hz))

        self.set(command, ReadBack(lambda: self._display(channel), done, lambda _: True))

    def _display(self, channel: int) -> Display:
        return self.ask(f"CH {channel}", read_display)

    def _recheck(self) -> None:
        if self.wanted is not None:
            self._confirm(self.wanted)

    def _confirm(self, cutoffs_Hz: tuple[float | None, float | None]) -> None:
        for channel, cutoff_Hz in zip((_HIGH_PASS, _LOW_PASS), cutoffs_Hz, strict=True):
            display = self._display(channel)
            if display.channel != channel or not _is_plain(display) or not _is_at(display, cutoff_Hz):
                due = "by-pass" if cutoff_Hz is None else f"{cutoff_Hz:g} Hz"
                message = f"channel {channel} reads back {display}, but {due} with gain 1, dc coupled, was set"
                raise self.error("B-INST-011", message, "look at its front panel")

    def _identity_of(self, reply: str) -> Identity:
        manufacturer, _, firmware = reply.partition(" ")
        if manufacturer != "KROHN-HITE":
            return Identity("", reply, "", "")
        return Identity(manufacturer, "3988", "", firmware)

    def _forget(self) -> None:
        self.wanted = None

    def _go_safe(self) -> None:
        self._ask_identity()  # there is nothing to switch: only whether it is there


def _is_plain(display: Display) -> bool:
    return (display.input_gain_dB, display.output_gain_dB, display.coupling) == (0, 0, "DC")


def _is_at(display: Display, cutoff_Hz: float | None) -> bool:
    if cutoff_Hz is None or display.cutoff_Hz is None:
        return display.cutoff_Hz is cutoff_Hz
    return abs(display.cutoff_Hz - cutoff_Hz) <= max(_DIGITS * cutoff_Hz, _STEP_HZ)


DRIVER = KrohnHite3988
