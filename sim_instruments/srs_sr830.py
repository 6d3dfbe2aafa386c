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


def _field(low: str, high: str, reset: str, form: str = "d") -> Field:
    return Field(float(low), float(high), int(reset) if form == "d" else float(reset), form)


# Setting | of each of its parameters: two limits, what it is after *RST, how it is told if it is not whole | how many
# places there are of it, one of which the first parameter names
_TABLE = """
*ESE | 0 255 0
*PSC | 0 1 0
*SRE | 0 255 0
ALRM | 0 1 0
AUXV | -10.5 10.5 0. .3f        | 4
DDEF | 0 4 0, 0 2 0             | 2
ERRE | 0 255 0
FAST | 0 2 0
FMOD | 0 1 1
FPOP | 0 1 0                    | 2
FREQ | 0.001 102E3 1000. .6g
HARM | 1 19999 1
ICPL | 0 1 0
IGND | 0 1 0
ILIN | 0 3 0
ISRC | 0 3 0
KCLK | 0 1 0
LIAE | 0 255 0
LOCL | 0 2 0
OEXP | -105. 105. 0. .2f, 0 2 0 | 3
OFLT | 0 19 8
OFSL | 0 3 1
OUTX | 0 1 1
OVRM | 0 1 0
PHAS | -360. 729.99 0. .2f
RMOD | 0 2 1
RSLP | 0 2 0
SEND | 0 1 0
SENS | 0 26 26
SLVL | 0.004 5. 1. .3f
SRAT | 0 14 0
SYNC | 0 1 0
TSTR | 0 1 0
"""
_ROWS = [[column.strip() for column in f"{row}|".split("|")] for row in _TABLE.strip().splitlines()]
_FIELDS = {head: [_field(*text.split()) for text in fields.split(",")] for head, fields, *_ in _ROWS}
_PLACES = {"OUTP": 4, "OUTR": 2, "OAUX": 4} | {head: int(places) for head, _, places, *_ in _ROWS if places}
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
            "*ESR": lambda: self.read_out("_events"),
            "ERRS": lambda: "0",
            "LIAS": self._read_status,
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

    def _read_status(self) -> str:
        status, self.processor.status = self.processor.status, 0
        return str(status)

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


def _place(head: str, arguments: list[str]) -> int:
    """Return the place that the first parameter names, and take it away; 0 for what has none. Raises: ValueError."""
    return int(Field(1, _PLACES[head]).read(arguments.pop(0))) if head in _PLACES else 0


SIMULATOR = SrsSr830
