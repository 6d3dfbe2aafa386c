"""Stanford Research Systems SR830 DSP lock-in amplifier: X and Y of a signal against an external TTL reference.

Input A, dc coupled (a reference of 1 Hz is far below what ac coupling lets through), line filters out, high reserve,
first harmonic, no offsets. It detects with a sine, so harmonics of the signal do not reach X and Y. The phase is that
of the reference: X is the part of the signal that is in phase with a sine which begins at the rising edge plus the
phase. Overload and loss of lock are values of a reading, not errors: they stand for everything since the reading, the
set of the phase or the set-up before, because reading the status clears it.

OUTX, which turns the answers to this interface, comes before any question and again with each question who is there.
What else a last user may have left is in the state table; the phase is whatever it was until it is set.

Source: SR830 manual, chapter 5 (remote programming; 5-8 OEXP, 5-15 SNAP?, 5-23 bits of LIAS?). Not confirmed on
hardware: that a lock that is still lost sets its bit again within 0.5 s of a reading, that the phase reads back with
0.01 deg.
"""

from __future__ import annotations

from collections.abc import Mapping
from types import MappingProxyType
from typing import Any, ClassVar

from bench.model.errors import InstrumentError
from bench.model.ports import Parameter, action
from instruments.base import BaseInstrument
from instruments.bus import DOUBTFUL
from instruments.commands import Setting
from instruments.values import plain_form, read_integer, read_number

TIME_CONSTANTS_S = tuple(float(f"{digit}e{power}") for power in range(-5, 5) for digit in (1, 3))
SENSITIVITIES_V = tuple(float(f"{digit}e{power}") for power in range(-9, 1) for digit in (1, 2, 5))[1:28]
SLOPES_DB = (6, 12, 18, 24)
WIRING: Mapping[str, tuple[str, ...]] = MappingProxyType(
    {"reference": ("index_a", "index_b"), "input": ("fog", "filter"), "demodulation": ("sine", "square")}
)
_OVERLOADS, _UNLOCKED = 0b111, 1 << 3  # input or reserve, filter, output; reference
_PHASE_STEP_DEG = 0.0101  # the instrument rounds to 0.01 deg
_LOOK_S = 0.5
_TURN_DEG = 360.0
_ALIKE = 1e-9  # of two numbers that went through different roundings
_EVENTS = ((0, "input queue overflow"), (2, "output queue overflow"), (4, "execution error"), (5, "command error"))
_FAILURES = (
    (1, "battery backup"), (2, "RAM"), (4, "ROM"), (5, "fast data transfer"), (6, "DSP"), (7, "math"),
)  # fmt: skip


def read_snapshot(reply: str) -> tuple[float, float, float]:
    """Return X (V), Y (V) and reference frequency (Hz) of a ``SNAP? 1,2,9`` reply. Raises: ValueError."""
    values = [read_number(field.strip()) for field in reply.split(",")]
    if len(values) != 3:
        raise ValueError("X, Y and a frequency are due")
    return values[0], values[1], values[2]


class SrsSr830(BaseInstrument):
    """Measurement with the lock-in amplifier.

    Options: ``reference``, ``input`` say what it is wired to and are read by the simulated bench only, as is
    ``demodulation``; ``divider`` is the ratio of a resistive divider before input A: voltages and sensitivities are
    those before the divider.
    """

    identity_pattern = r"STANFORD[ _]RESEARCH[ _]SYSTEMS,SR830"
    safe_state = "nothing to do: it only measures, and its sine output is not wired"
    default_options: ClassVar[dict[str, Any]] = {
        "reference": "index_a", "input": "fog", "demodulation": "sine", "divider": 1.0,
    }  # fmt: skip
    option_limits = (
        *(Parameter(name, choices=words) for name, words in WIRING.items()),
        Parameter("divider", low=1.0, high=1000.0),
    )

    def __init__(self, *arguments: Any, **named: Any) -> None:
        super().__init__(*arguments, **named)
        self.identity_question = f"OUTX {int('(ASRL' not in self.bus.where.upper())};*IDN?"

    @action(
        Parameter("time_constant", "s", 1e-5, 3e4, values=TIME_CONSTANTS_S),
        Parameter("slope", choices=SLOPES_DB),
        Parameter("sensitivity", "V", 2e-9, 1e3),
        Parameter("synchronous", choices=("on", "off")),
        bus_s=3.0,
    )
    def configure(self, time_constant: float, slope: int, sensitivity: float, synchronous: str) -> None:
        """Set the amplifier up: time constant (s), slope (dB/oct), full scale (V), synchronous filter; read all back.

        Raises: InstrumentError B-INST-008 (also what is not in its lists, with the nearest), B-INST-005, B-INST-011.
        """
        ranges_V = tuple(sensitivity_V * self.divider for sensitivity_V in SENSITIVITIES_V)
        chosen = {
            "SENS": self._place("sensitivity", sensitivity, ranges_V, "V"),
            "OFSL": SLOPES_DB.index(slope),
            "OFLT": self._place("time_constant", time_constant, TIME_CONSTANTS_S, "s"),  # sensitivity may change it
            "SYNC": int(synchronous == "on"),
        }
        self._ready()
        self.kept = phase = tuple(setting for setting in self.kept if setting.query == "PHAS?")
        self.bring("configure")
        for name, value in chosen.items():
            self.set(f"{name} {value}", self.number(f"{name}?", value, 0.0))
        self.keep(*(Setting(f"{name}?", float(value), 0.0, "") for name, value in chosen.items()))
        of_table = [Setting(row.ask, float(row.right), 0.0, "") for row in self.states.values() if row.right.isdigit()]
        self.kept += (*of_table, *phase)  # have read back
        self._status()

    @action(Parameter("phase", "deg", -360.0, 729.99), bus_s=0.5)
    def set_phase(self, phase: float) -> None:
        """Set the phase of the reference, degree, and read it back within 0.01 deg, turns aside.

        What was altered by hand since ``configure`` is set again, or refused, before the time in which it settles.

        Raises: InstrumentError B-INST-008, B-INST-005, B-INST-011.
        """
        self._ready()
        self.kept = tuple(setting for setting in self.kept if setting.query != "PHAS?")
        self.bring("set_phase")
        self.confirm_kept()
        setting = self.put(Setting("PHAS?", phase, _PHASE_STEP_DEG, "deg", _TURN_DEG), plain_form)
        self.confirm(*setting)
        self.kept += (setting,)
        self._status()

    @action(bus_s=0.3, returns="V")
    def measure(self) -> dict[str, float | bool]:
        """Measure X and Y (V, at one instant, before the divider) and the reference's frequency (Hz), with flags.

        ``overload`` (input, filter or output) and ``unlocked`` stand for all the time since the last reading, set of
        the phase or set-up.
        """
        x_V, y_V, frequency_Hz = self.ask("SNAP? 1,2,9", read_snapshot)
        status = self._status()
        return {
            "x_V": x_V * self.divider,
            "y_V": y_V * self.divider,
            "frequency_Hz": frequency_Hz,
            "overload": bool(status & _OVERLOADS),
            "unlocked": bool(status & _UNLOCKED),
        }

    @action(bus_s=1.0)
    def locked(self) -> bool:
        """Get whether the reference is locked at present, and has been for half a second; clears the status."""
        self.ask("LIAS?", read_integer)
        self.clock.sleep(_LOOK_S)
        return not self.ask("LIAS?", read_integer) & _UNLOCKED

    @property
    def divider(self) -> float:
        """Ratio of the divider before input A."""
        return float(self.options["divider"])

    def drain_errors(self) -> list[str]:
        """Get what the event and error registers tell, which that clears."""
        events = self.bus.query("*ESR?", read_integer, self.timeout_s, repeatable=False)
        failures = self.bus.query("ERRS?", read_integer, self.timeout_s, repeatable=False)
        problems = [text for bit, text in _EVENTS if events >> bit & 1]
        return problems + [f"{text} failure" for bit, text in _FAILURES if failures >> bit & 1]

    def _status(self) -> int:
        """Return the status, which that clears: a reply that is lost is lost, and counts as an overload."""
        try:
            return self.bus.query("LIAS?", read_integer, self.timeout_s, repeatable=False)
        except InstrumentError as doubt:
            if doubt.code not in DOUBTFUL or self.bus.hurried:
                raise
        self.bus.note("rx", "<the status is lost: it counts as an overload>")
        return self.ask("LIAS?", read_integer) | _OVERLOADS

    def _place(self, name: str, value: float, known: tuple[float, ...], unit: str) -> int:
        nearest = min(range(len(known)), key=lambda place: max(known[place] / value, value / known[place]))
        if abs(known[nearest] - value) > _ALIKE * value:
            message = f"configure: {name} {value!r} {unit} is none of its settings; the nearest is {known[nearest]:g}"
            raise self.refusal(f"{message} {unit}")
        return nearest

    def _go_safe(self) -> None:
        self.drain_errors()


DRIVER = SrsSr830
