"""Simulated SR830 lock-in amplifier, wired to the gyroscope of its world and to one of the table's index pulses.

Options: ``reference`` index_a or index_b, ``input`` fog or filter, ``divider`` ratio of the divider before input A,
``demodulation`` sine as the SR830, or square as a switching lock-in amplifier. On a bench without a signal there is no
reference either. Its processing is in sim_instruments.synchronous_detection.

Source: SR830 manual (3-13: offsets act on what is told of X, Y and R, expands do not, and neither acts on the R that
follows from X and Y; 5-2: each answer of a chain has a terminator of its own, no space is needed behind a command; 5-8,
5-9; 5-10: answers go to one interface only; 5-15: SNAP?) and public programs; the settings of ``*RST`` (time constant
100 ms, 12 dB/oct, 1 V, internal reference). Placeholders, not confirmed on hardware: the input takes 1.41 V peak at
high reserve, 30 times the sensitivity at normal and the sensitivity itself at low noise, but never more than that; ac
coupling is one pole at 0.16 Hz, a line filter a notch of quality 4 at 50 or 100 Hz; a grounded shield changes nothing;
there is no internal oscillator.
"""

from __future__ import annotations

import re
from collections.abc import Callable, Iterable
from typing import NamedTuple

import numpy as np
from scipy.signal import butter, iirnotch, tf2sos

from bench.model.arrays import Floats, Integers
from sim_instruments.bus.live import LiveDevice
from sim_instruments.krohn_hite_3988 import SAMPLES_HZ, BandPass, KrohnHite3988, Stage
from sim_instruments.synchronous_detection import SAMPLE_NS, LockIn

_HIGHEST_INPUT_V = 1.0
_RESERVES = (np.inf, 30.0, 1.0)
_SENSITIVITY_V = [digit * 10.0**power for power in range(-9, 1) for digit in (1, 2, 5)][1:28]
_TIME_CONSTANT_S = [digit * 10.0**power for power in range(-5, 5) for digit in (1, 3)]
_AC_HZ, _NOTCHES_HZ, _NOTCH_QUALITY = 0.16, (50.0, 100.0), 4.0
_UNIT = re.compile(r"(\*?[A-Z]+)\s*(\??)\s*(.*)")


class Field(NamedTuple):
    """One parameter of a setting: its limits, what it is after ``*RST``, how it is told."""

    low: float
    high: float
    reset: float = 0
    form: str = "d"

    def read(self, text: str) -> float:
        """Return its value. Raises: ValueError."""
        value = float(text)
        value = int(value) if self.form == "d" else value  # "0.000000" is a place, too
        if not self.low <= value <= self.high:
            raise ValueError(text)
        return value


_MOST = {  # settings from 0 to so much, 0 after *RST
    "RSLP": 2, "ISRC": 3, "IGND": 1, "ICPL": 1, "ILIN": 3, "SYNC": 1, "SRAT": 14, "SEND": 1, "TSTR": 1, "FAST": 2,
    "OVRM": 1, "KCLK": 1, "ALRM": 1, "LOCL": 2, "*ESE": 255, "*SRE": 255, "*PSC": 1, "LIAE": 255, "ERRE": 255,
}  # fmt: skip
_FIELDS: dict[str, tuple[Field, ...]] = {head: (Field(0, most),) for head, most in _MOST.items()} | {
    "FMOD": (Field(0, 1, 1),), "HARM": (Field(1, 19999, 1),), "RMOD": (Field(0, 2, 1),), "SENS": (Field(0, 26, 26),),
    "OFLT": (Field(0, 19, 8),), "OFSL": (Field(0, 3, 1),), "OUTX": (Field(0, 1, 1),),
    "PHAS": (Field(-360.0, 729.99, 0.0, ".2f"),), "FREQ": (Field(1e-3, 102e3, 1000.0, ".6g"),),
    "SLVL": (Field(0.004, 5.0, 1.0, ".3f"),), "AUXV": (Field(-10.5, 10.5, 0.0, ".3f"),), "FPOP": (Field(0, 1),),
    "OEXP": (Field(-105.0, 105.0, 0.0, ".2f"), Field(0, 2)), "DDEF": (Field(0, 4), Field(0, 2)),
}  # fmt: skip
_PLACES = {"OEXP": 3, "AUXV": 4, "DDEF": 2, "FPOP": 2, "OUTP": 4, "OUTR": 2, "OAUX": 4}  # the first parameter is one
_NOT_RESET = ("OUTX", "LOCL", "OVRM", "*ESE", "*SRE", "*PSC", "LIAE", "ERRE")
_DONE = ("APHS", "AGAN", "ARSV", "AOFF", "STRT", "STRD", "PAUS", "REST", "TRIG", "SSET", "RSET")
_SNAPPED = range(2, 7)  # quantities of one SNAP?
_EXECUTION_ERROR, _COMMAND_ERROR, _POWER_ON = 1 << 4, 1 << 5, 1 << 7


class SrsSr830(LiveDevice):
    """The lock-in amplifier."""

    identity = "Stanford_Research_Systems,SR830,s/n48830,ver1.07"

    def power_up(self) -> None:
        super().power_up()
        self._divider = float(self.options.get("divider", 1.0))
        self._held: dict[tuple[str, int], tuple[float, ...]] = {}  # by head and place, 0 without one
        self._reset(_FIELDS)
        self._events = _POWER_ON
        self._filter: BandPass | None = None
        self._conditioned: tuple[tuple[int, int], Stage] | None = None
        self.processor = LockIn(self._signal, self._pulses, self.now_ns // SAMPLE_NS)
        self._apply()

    def execute(self, message: str) -> None:
        self.processor.run_to(self.now_ns // SAMPLE_NS)
        for unit in message.upper().split(";"):
            match = _UNIT.fullmatch(unit.strip())
            if match is None:
                self._events |= _COMMAND_ERROR if unit.strip() else 0
                continue
            head, query, text = match.groups()
            arguments = [part.strip() for part in text.split(",") if part.strip()]
            try:
                answer = self._ask(head, arguments) if query else self._order(head, arguments)
            except KeyError:
                self._events |= _COMMAND_ERROR
            except (ValueError, IndexError):
                self._events |= _EXECUTION_ERROR
            else:
                serial_line = (self.resource_name or "").startswith("ASRL")
                if answer is not None and self._whole("OUTX") != serial_line:
                    self.reply(answer)  # each with a terminator of its own

    # --- signals -----------------------------------------------------------------------------------------------

    def _signal(self, first: int, last: int) -> Floats:
        waveform: Callable[[int, int], Floats] | None = getattr(self.world, "waveform", None)
        if waveform is None or self._whole("ISRC"):
            return np.zeros(last - first)
        volts = np.asarray(waveform(first, last), dtype=np.float64)
        if self.options.get("input", "fog") == "filter":
            if self._filter is None:
                self._filter = BandPass(self._wired_filter().history)
            volts = self._filter.filtered(first, volts)
        return self._stage().filtered(volts / self._divider)

    def _stage(self) -> Stage:
        """Return input coupling and line filters; a change of them begins from rest."""
        coupling, notches = self._whole("ICPL"), self._whole("ILIN")
        if self._conditioned is None or self._conditioned[0] != (coupling, notches):
            sections = [] if coupling else [butter(1, _AC_HZ, "highpass", fs=SAMPLES_HZ, output="sos")]
            for place, notch_Hz in enumerate(_NOTCHES_HZ):
                if notches >> place & 1:
                    sections.append(tf2sos(*iirnotch(notch_Hz, _NOTCH_QUALITY, SAMPLES_HZ)))
            self._conditioned = (coupling, notches), Stage(sections)
        return self._conditioned[1]

    def _wired_filter(self) -> KrohnHite3988:
        wired: KrohnHite3988 = self.world.instrument(KrohnHite3988)
        return wired

    def _pulses(self, t0_ns: int, t1_ns: int) -> Integers:
        pulses: Callable[[str, int, int], Integers] | None = getattr(self.world, "pulses", None)
        if pulses is None or self._whole("FMOD") or self._whole("RSLP") != 1:
            return np.zeros(0, np.int64)
        return pulses(str(self.options.get("reference", "index_a")).removeprefix("index_"), t0_ns, t1_ns)

    def _apply(self) -> None:
        sensitivity_V = _SENSITIVITY_V[self._whole("SENS")]
        self.processor.change(
            time_constant_s=_TIME_CONSTANT_S[self._whole("OFLT")],
            poles=self._whole("OFSL") + 1,
            synchronous=self._whole("SYNC") == 1,
            phase_deg=self._held["PHAS", 0][0],
            harmonic=self._whole("HARM"),
            sensitivity_V=sensitivity_V,
            input_limit_V=2**0.5 * min(_HIGHEST_INPUT_V, _RESERVES[self._whole("RMOD")] * sensitivity_V),
            square=self.options.get("demodulation", "sine") == "square",
        )

    # --- commands ----------------------------------------------------------------------------------------------

    def _whole(self, head: str) -> int:
        return int(self._held[head, 0][0])

    def _reset(self, heads: Iterable[str]) -> None:
        for head in heads:
            for place in range(1, _PLACES[head] + 1) if head in _PLACES else (0,):
                self._held[head, place] = tuple(field.reset for field in _FIELDS[head])

    def _order(self, head: str, arguments: list[str]) -> None:
        if head == "*RST":
            self._reset(head for head in _FIELDS if head not in _NOT_RESET)
        elif head == "*CLS":
            self._events = self.processor.status = 0
        elif head not in _DONE:
            fields, place = _FIELDS[head], _place(head, arguments)
            if head == "FREQ" and not self._whole("FMOD"):
                raise ValueError(arguments)  # an external reference has its own
            values = [field.read(text) for field, text in zip(fields, arguments, strict=True)]
            if head == "PHAS":
                values = [(round(values[0], 2) + 180.0) % 360.0 - 180.0]
            self._held[head, place] = tuple(values)
        self._apply()

    def _ask(self, head: str, arguments: list[str]) -> str:
        asked: dict[str, Callable[[], str]] = {
            "*IDN": lambda: self.told_identity,
            "*ESR": self._take_events,
            "ERRS": lambda: "0",
            "LIAS": self._take_status,
            "*STB": lambda: str(self.status_byte()),
            "*TST": lambda: "0",
            "SPTS": lambda: "0",
            "OUTP": lambda: self._told(_place(head, arguments)),
            "OUTR": lambda: self._told(9 + _place(head, arguments)),
            "OAUX": lambda: self._told(4 + _place(head, arguments)),
            "SNAP": lambda: self._snapped([int(argument) for argument in arguments]),
        }
        if head in asked:
            return asked[head]()
        if head == "FREQ" and not self._whole("FMOD"):
            return f"{self.processor.frequency_Hz:.6g}"
        values = self._held[head, _place(head, arguments)]
        return ",".join(format(value, field.form) for field, value in zip(_FIELDS[head], values, strict=True))

    def _snapped(self, quantities: list[int]) -> str:
        if len(quantities) not in _SNAPPED:
            raise ValueError(quantities)
        return ",".join(self._told(quantity) for quantity in quantities)

    def _told(self, quantity: int) -> str:
        x_V, y_V = self.processor.outputs_V
        values = {1: x_V, 2: y_V, 3: float(np.hypot(x_V, y_V)), 4: float(np.degrees(np.arctan2(y_V, x_V)))}
        for place in (1, 2, 3):
            values[place] -= self._held["OEXP", place][0] / 100.0 * self.processor.settings.sensitivity_V
        values |= dict.fromkeys(range(5, 9), 0.0)  # nothing is connected to the auxiliary inputs
        values |= {9: self.processor.frequency_Hz, 10: self._displayed(1, values), 11: self._displayed(2, values)}
        if quantity not in values:
            raise ValueError(quantity)
        return self.reading(f"{values[quantity]:.6g}")

    def _displayed(self, channel: int, values: dict[int, float]) -> float:
        """Return what a display shows (DDEF): X or Y, R or theta; noise and auxiliary inputs read 0."""
        shown = self._held["DDEF", channel][0]
        return values[channel if shown == 0 else channel + 2] if shown < 2 else 0.0

    def _take_events(self) -> str:
        events, self._events = self._events, 0
        return str(events)

    def _take_status(self) -> str:
        status, self.processor.status = self.processor.status, 0
        return str(status)


def _place(head: str, arguments: list[str]) -> int:
    """Return the place that the first parameter names, and take it away; 0 for what has none. Raises: ValueError."""
    return int(Field(1, _PLACES[head]).read(arguments.pop(0))) if head in _PLACES else 0


SIMULATOR = SrsSr830
