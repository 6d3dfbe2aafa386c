"""Simulated SR830 lock-in amplifier, wired to the gyroscope of its world and to one of the table's index pulses.

Options: ``reference`` index_a or index_b, ``input`` fog or filter, ``divider`` ratio of the divider before input A,
``demodulation`` sine as the SR830, or square as a switching lock-in amplifier. On a bench without a signal there is no
reference either. Its processing is in sim_instruments.synchronous_detection.

Source: SR830 manual, remote programming, as quoted in public programs (5-2: each answer of a chain has a terminator of
its own, no space is needed behind a command; 5-15: SNAP?); the settings of ``*RST`` (time constant 100 ms,
12 dB/oct, 1 V, internal reference). Placeholders, not confirmed on hardware: the input takes 1.41 V peak at high
reserve, 30 times the sensitivity at normal and the sensitivity itself at low noise, but never more than that;
there is no internal oscillator.
"""

from __future__ import annotations

import re
from collections.abc import Callable

import numpy as np

from bench.model.arrays import Floats, Integers
from sim_instruments.bus.live import LiveDevice
from sim_instruments.krohn_hite_3988 import BandPass, KrohnHite3988
from sim_instruments.synchronous_detection import SAMPLE_NS, LockIn

_HIGHEST_INPUT_V = 1.0
_RESERVES = {0: np.inf, 1: 30.0, 2: 1.0}
_SENSITIVITY_V = [digit * 10.0**power for power in range(-9, 1) for digit in (1, 2, 5)][1:28]
_TIME_CONSTANT_S = [digit * 10.0**power for power in range(-5, 5) for digit in (1, 3)]
_MOST = {
    "FMOD": 1, "RSLP": 2, "HARM": 19999, "ISRC": 3, "IGND": 1, "ICPL": 1, "ILIN": 3, "RMOD": 2, "SENS": 26, "OFLT": 19,
    "OFSL": 3, "SYNC": 1, "OUTX": 1,
}  # fmt: skip
_AFTER_RESET = {"FMOD": 1, "HARM": 1, "RMOD": 1, "SENS": 26, "OFLT": 8, "OFSL": 1}
_UNIT = re.compile(r"(\*?[A-Z]+)\s*(\??)\s*(.*)")
_OTHER = {
    "SRAT": 14, "SEND": 1, "FPOP": 3, "TSTR": 1, "FAST": 2, "OVRM": 1, "KCLK": 1, "ALRM": 1, "LOCL": 2,
    "*ESE": 255, "*SRE": 255, "*PSC": 1, "LIAE": 255, "ERRE": 255,
}  # fmt: skip
_DONE = ("APHS", "AGAN", "ARSV", "AOFF", "STRT", "STRD", "PAUS", "REST", "TRIG", "SSET", "RSET")
_AUX, _LOWEST_SINE_V, _HIGHEST_SINE_V, _HIGHEST_AUX_V = 4, 0.004, 5.0, 10.5
_HIGHEST_HZ = 102e3
_SNAPPED = range(2, 7)  # quantities of one SNAP?
_EXECUTION_ERROR, _COMMAND_ERROR, _POWER_ON = 1 << 4, 1 << 5, 1 << 7
_LEAST_PHASE_DEG, _MOST_PHASE_DEG = -360.0, 729.99
_MOST_OFFSET = 105.0


class SrsSr830(LiveDevice):
    """The lock-in amplifier."""

    identity = "Stanford_Research_Systems,SR830,s/n48830,ver1.07"

    def power_up(self) -> None:
        super().power_up()
        self._divider = float(self.options.get("divider", 1.0))
        self._offsets = {1: (0.0, 0), 2: (0.0, 0), 3: (0.0, 0)}
        self._set = dict.fromkeys(_MOST, 0) | _AFTER_RESET
        self._other = dict.fromkeys(_OTHER, 0)
        self._numbers = {"SLVL": 1.0, "FREQ": 1000.0}
        self._aux_V = dict.fromkeys(range(1, _AUX + 1), 0.0)
        self._displays = {1: (0, 0), 2: (0, 0)}  # X and Y
        self._phase_deg = 0.0
        self._events = _POWER_ON
        self._filter: BandPass | None = None
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
                if answer is not None:
                    self.reply(answer)  # each with a terminator of its own

    # --- signals -----------------------------------------------------------------------------------------------

    def _signal(self, first: int, last: int) -> Floats:
        waveform: Callable[[int, int], Floats] | None = getattr(self.world, "waveform", None)
        if waveform is None or self._set["ISRC"] != 0:
            return np.zeros(last - first)
        volts = np.asarray(waveform(first, last), dtype=np.float64)
        if self.options.get("input", "fog") == "filter":
            if self._filter is None:
                self._filter = BandPass(self._wired_filter().history)
            volts = self._filter.filtered(first, volts)
        return volts / self._divider

    def _wired_filter(self) -> KrohnHite3988:
        wired: KrohnHite3988 = self.world.instrument(KrohnHite3988)
        return wired

    def _pulses(self, t0_ns: int, t1_ns: int) -> Integers:
        pulses: Callable[[str, int, int], Integers] | None = getattr(self.world, "pulses", None)
        external = self._set["FMOD"] == 0 and self._set["RSLP"] == 1
        if pulses is None or not external:
            return np.zeros(0, np.int64)
        return pulses(str(self.options.get("reference", "index_a")).removeprefix("index_"), t0_ns, t1_ns)

    def _apply(self) -> None:
        sensitivity_V = _SENSITIVITY_V[self._set["SENS"]]
        self.processor.change(
            time_constant_s=_TIME_CONSTANT_S[self._set["OFLT"]],
            poles=self._set["OFSL"] + 1,
            synchronous=self._set["SYNC"] == 1,
            phase_deg=self._phase_deg,
            sensitivity_V=sensitivity_V,
            input_limit_V=2**0.5 * min(_HIGHEST_INPUT_V, _RESERVES[self._set["RMOD"]] * sensitivity_V),
            square=self.options.get("demodulation", "sine") == "square",
        )

    # --- commands ----------------------------------------------------------------------------------------------

    def _order(self, head: str, arguments: list[str]) -> None:
        if head == "PHAS":
            self._phase_deg = _phase(arguments)
        elif head == "OEXP":
            self._offset(arguments)
        elif head == "*RST":
            self._set |= dict.fromkeys(_MOST, 0) | _AFTER_RESET | {"OUTX": self._set["OUTX"]}
            self._phase_deg = 0.0
        elif head == "*CLS":
            self._events = self.processor.status = 0
        elif head in _DONE:
            return
        elif head in self._other:
            self._other[head] = _choice(arguments, _OTHER[head], 0)
        elif head in ("SLVL", "FREQ"):
            self._number(head, float(arguments[0]))
        elif head == "AUXV":
            self._aux_V[_choice(arguments, _AUX, 1)] = _inside(float(arguments[1]), -_HIGHEST_AUX_V, _HIGHEST_AUX_V)
        elif head == "DDEF":
            shown = _choice(arguments[1:], 4, 0), _choice(arguments[2:], 2, 0)
            self._displays[_choice(arguments, 2, 1)] = shown
        else:
            self._set[head] = _choice(arguments, _MOST[head], 1 if head == "HARM" else 0)
        self._apply()

    def _number(self, head: str, value: float) -> None:
        if head == "FREQ" and self._set["FMOD"] == 0:
            raise ValueError(value)  # an external reference has its own
        low, high = (_LOWEST_SINE_V, _HIGHEST_SINE_V) if head == "SLVL" else (1e-3, _HIGHEST_HZ)
        self._numbers[head] = _inside(value, low, high)

    def leave_more(self, draw: np.random.Generator) -> None:
        self._set |= {name: int(draw.integers(1 if name == "HARM" else 0, most + 1)) for name, most in _MOST.items()}
        self._set["OUTX"] = 1
        self._phase_deg = draw.uniform(-180.0, 180.0)
        self._offsets = {place: (draw.uniform(-_MOST_OFFSET, _MOST_OFFSET), 2) for place in (1, 2, 3)}
        self._events |= _EXECUTION_ERROR | _COMMAND_ERROR
        self._apply()

    def _offset(self, arguments: list[str]) -> None:
        quantity, offset, expand = (int(arguments[0]), float(arguments[1]), int(arguments[2]))
        if quantity not in self._offsets or abs(offset) > _MOST_OFFSET or expand not in (0, 1, 2):
            raise ValueError(arguments)
        self._offsets[quantity] = (offset, expand)

    def _ask(self, head: str, arguments: list[str]) -> str:
        asked: dict[str, Callable[[], str]] = {
            "*IDN": lambda: self.told_identity,
            "*ESR": self._take_events,
            "ERRS": lambda: "0",
            "LIAS": self._take_status,
            "PHAS": lambda: f"{self._phase_deg:.2f}",
            "*STB": lambda: str(self.status_byte()),
            "*TST": lambda: "0",
            "FREQ": lambda: f"{self._numbers['FREQ'] if self._set['FMOD'] else self.processor.frequency_Hz:.6g}",
            "SLVL": lambda: f"{self._numbers['SLVL']:.3f}",
            "SPTS": lambda: "0",
            "OUTP": lambda: self._told(_choice(arguments, 4, 1)),
            "OUTR": lambda: self._told(9 + _choice(arguments, 2, 1)),
            "OAUX": lambda: self._told(4 + _choice(arguments, _AUX, 1)),
            "AUXV": lambda: f"{self._aux_V[_choice(arguments, _AUX, 1)]:.3f}",
            "DDEF": lambda: "{},{}".format(*self._displays[_choice(arguments, 2, 1)]),
            "SNAP": lambda: self._snapped([int(argument) for argument in arguments]),
            "OEXP": lambda: "{:.2f},{}".format(*self._offsets[int(arguments[0])]),
        }
        return asked[head]() if head in asked else str((self._other | self._set)[head])

    def _snapped(self, quantities: list[int]) -> str:
        if len(quantities) not in _SNAPPED:
            raise ValueError(quantities)
        return ",".join(self._told(quantity) for quantity in quantities)

    def _told(self, quantity: int) -> str:
        x_V, y_V = (
            volts - self._offsets[place][0] / 100.0 * self.processor.settings.sensitivity_V
            for place, volts in enumerate(self.processor.outputs_V, 1)
        )
        values = {1: x_V, 2: y_V, 3: float(np.hypot(x_V, y_V)), 4: float(np.degrees(np.arctan2(y_V, x_V)))}
        values |= dict.fromkeys(range(5, 9), 0.0)  # nothing is connected to the auxiliary inputs
        values |= {9: self.processor.frequency_Hz, 10: self._displayed(1, values), 11: self._displayed(2, values)}
        if quantity not in values:
            raise ValueError(quantity)
        value = values[quantity]
        return self.reading(f"{value:.6g}")

    def _displayed(self, channel: int, values: dict[int, float]) -> float:
        """Return what a display shows (DDEF): X or Y, R or theta; noise and auxiliary inputs read 0."""
        shown = self._displays[channel][0]
        return values[channel if shown == 0 else channel + 2] if shown < 2 else 0.0

    def _take_events(self) -> str:
        events, self._events = self._events, 0
        return str(events)

    def _take_status(self) -> str:
        status, self.processor.status = self.processor.status, 0
        return str(status)


def _choice(arguments: list[str], most: int, least: int) -> int:
    value = int(float(arguments[0]))  # "0.000000" is a place too
    if not least <= value <= most:
        raise ValueError(arguments)
    return value


def _inside(value: float, low: float, high: float) -> float:
    if not low <= value <= high:
        raise ValueError(value)
    return value


def _phase(arguments: list[str]) -> float:
    value = float(arguments[0])
    if not _LEAST_PHASE_DEG <= value <= _MOST_PHASE_DEG:
        raise ValueError(arguments)
    return (round(value, 2) + 180.0) % 360.0 - 180.0


SIMULATOR = SrsSr830
