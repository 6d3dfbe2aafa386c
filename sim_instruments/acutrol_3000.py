"""Simulated ACUTROL3000 controller with its three-axis table: outer axis 1, middle axis 2, inner axis 3.

Headers may be cut to any beginning of their words (``:D:R 1,5`` is ``:DEMAND:RATE 1,5``). A demand is obeyed in its
mode only; a mode that is activated obeys the demand that is loaded. The axes have no stops: positions roll over after
one turn, and a demand is reached the shortest way. A drive without a closed interlock, or in mode Off, is braked to
rest. Two commands within 40 ms are not understood. Motion is exact (worlds.common.motion); only the read-out has noise
and steps. Numbers are figures or binary, as the last user left them.

Source: manual TM-8004-C 2.6 and 4.14.1 (formats), 3.10 (status byte), 4.2.26 (range of positions), 4.3 (demands),
4.6.1 (limits), 4.7 (modes, shortest way), 4.9.1 and 4.11.4 (errors and messages), 5.1.6 (what is out of range wraps);
public programs for this controller and its read-me (reply words, "65" of ``*STB?`` at an interlock fault, 40 ms as
least time over GPIB). Placeholders, not confirmed on hardware: identity, error numbers and texts, the table's own
limits, deceleration without drive, resolution and noise of the read-out.
"""

from __future__ import annotations

import math
import re
from collections import deque
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from typing import Any, ClassVar

import numpy as np

from bench.model.clock import to_ns
from sim_instruments.bus.live import CommandDevice, CommandError
from sim_instruments.faults.fault import Fault, NamedFaults
from sim_instruments.worlds.common.motion import AxisMotion

INTERLOCK_EVENT, ERROR_EVENT, SERVICE = 1, 128, 64
LEAST_NS = to_ns(0.04)
BRAKE_DEG_S2 = 400.0
RANGE_DEG = 360.0
POSITION_NOISE_DEG, RATE_NOISE_DEG_S = 1.0 / 3600.0, 3e-4
ABSOLUTE = (
    (400.0, 400.0, 1e5, 440.0, 5.0),
    (400.0, 400.0, 1e5, 440.0, 5.0),
    (1000.0, 1000.0, 1e5, 1100.0, 5.0),
)  # of each axis: rate, acceleration, jerk, trips of speed and of tracking error
NOT_RECOGNIZED = (101, "COMMAND NOT RECOGNIZED")
BAD_ARGUMENT = (102, "ARGUMENT OUT OF RANGE")
LIMIT_EXCEEDED = (103, "LIMIT EXCEEDED")
INTERLOCK_FAULT = (104, "INTERLOCK FAULT")
_TEXTS = {str(number): text for number, text in (NOT_RECOGNIZED, BAD_ARGUMENT, LIMIT_EXCEEDED, INTERLOCK_FAULT)}
_QUEUE = 20
_AXIS = ("AXIS", 1, len(ABSOLUTE))
_UNIT = re.compile(r"(:?)([A-Z]+(?::[A-Z]+)*)(\??)(?:\s+(.*))?")


@dataclass
class Axis:
    """One axis with its drive, its positions within ``range_deg`` around 0.

    ``offset_deg`` is how far from a position demand it comes to rest (a fault).
    """

    number: int
    motion: AxisMotion
    interlock: str = "Open"
    mode: str = "Off"
    demands: dict[str, float] = field(default_factory=lambda: {"POSITION": 0.0, "RATE": 0.0})
    limits: dict[tuple[str, str], float] = field(default_factory=dict)
    range_deg: float = RANGE_DEG
    stalled: bool = False
    offset_deg: float = 0.0

    @property
    def absolute(self) -> tuple[float, ...]:
        """The limits nobody can exceed, in the order of ``:LIMIT:ABSOLUTE?``."""
        caps = ABSOLUTE[self.number - 1]
        return *caps[:3], -self.range_deg / 2.0, self.range_deg / 2.0, *caps[3:]

    def obey(self, now_ns: int) -> None:
        """Move from ``now_ns`` on as mode, demand, limits and faults say."""
        if self.interlock != "Closed" or self.mode == "Off" or self.stalled:
            self.motion.run_at(0.0, BRAKE_DEG_S2, now_ns)
        elif self.mode == "Rate":
            self.motion.run_at(self.demands["RATE"], self.limits["ACCELERATION", "RATE"], now_ns)
        else:
            here_deg = float(self.motion.angle_deg(now_ns))
            way_deg = self.rolled_over(self.demands["POSITION"] + self.offset_deg - here_deg)
            limits = self.limits["RATE", "POSITION"], self.limits["ACCELERATION", "POSITION"]
            self.motion.go_to(here_deg + way_deg, *limits, now_ns)

    def rolled_over(self, angle_deg: float) -> float:
        """Return an angle as the controller counts it."""
        return math.remainder(angle_deg, self.range_deg)


class Acutrol3000(CommandDevice):
    """The controller; ``axes`` are its three axes. A world with ``motion`` is moved, any other has none to see."""

    identity = "ACUTRONIC,ACUTROL3000,SIM3000,1.0"

    def power_up(self) -> None:
        super().power_up()
        motion = getattr(self.world, "motion", None) or [AxisMotion() for _ in ABSOLUTE]
        self.axes = [Axis(number, axis_motion) for number, axis_motion in enumerate(motion, 1)]
        for axis in self.axes:
            for mode in ("POSITION", "RATE"):
                axis.limits["RATE", mode], axis.limits["ACCELERATION", mode] = axis.absolute[:2]
        self._errors: deque[tuple[int, str]] = deque(maxlen=_QUEUE)
        self._events = 0
        self._deaf_until_ns = -1
        self._binary = False
        self._noise = self.rng("table encoders")

    def leave_more(self, draw: np.random.Generator) -> None:
        self._binary = bool(draw.integers(2))
        for axis in self.axes:
            for what, mode in axis.limits:
                axis.limits[what, mode] *= draw.uniform(0.01, 1.0)
            axis.demands = {"POSITION": draw.uniform(-180.0, 180.0), "RATE": draw.uniform(-3.0, 3.0)}
            axis.mode = str(draw.choice(["Off", "Position", "Rate"]))
            axis.interlock = str(draw.choice(["Open", "Open", "Closed", "Fault"]))
            axis.obey(self.now_ns)
        for _ in range(int(draw.integers(_QUEUE + 1))):
            self.error(*NOT_RECOGNIZED)

    def outputs(self) -> dict[str, Any]:
        rates = [round(float(axis.motion.rate_deg_s(self.now_ns)), 3) for axis in self.axes]
        return {"interlocks": [axis.interlock for axis in self.axes], "rates_deg_s": rates}

    def status_byte(self) -> int:
        return super().status_byte() | self._events

    def on_clear(self) -> None:
        self._deaf_until_ns = -1

    # --- faults ------------------------------------------------------------------------------------------------

    def stall(self, *numbers: int) -> None:
        """Fault: these axes come to rest where they are and obey nothing; without a number all axes obey again."""
        for axis in self._chosen(numbers):
            axis.stalled = bool(numbers)
            axis.obey(self.now_ns)

    def offset(self, *given: float) -> None:
        """Fault: the axis of this number stands so many degrees from its position demands; without both none does."""
        for axis in self._chosen(given[:1]):
            axis.offset_deg = given[1] if given else 0.0
            axis.obey(self.now_ns)

    def _chosen(self, numbers: Sequence[float]) -> list[Axis]:
        return [axis for axis in self.axes if not numbers or axis.number in numbers]

    def drop_interlock(self) -> None:
        """Fault: the safety chain opens; closed interlocks are in fault until they are reset."""
        for axis in self.axes:
            if axis.interlock == "Closed":
                axis.interlock = "Fault"
                self._events |= INTERLOCK_EVENT
                axis.obey(self.now_ns)

    named_faults: ClassVar[NamedFaults] = {
        "table_stall": Fault(
            "table", (_AXIS,), "an axis of the turntable stops where it is and obeys nothing", stall, stall),
        "table_offset": Fault(
            "table", (_AXIS, ("DEG", -10.0, 10.0)),
            "an axis of the turntable stands that far from where it is sent", offset, offset),
        "table_interlock": Fault(
            "table", (), "the safety chain of the turntable opens: it is braked to rest", drop_interlock),
    }  # fmt: skip

    # --- messages ----------------------------------------------------------------------------------------------

    def execute(self, message: str) -> None:
        early, self._deaf_until_ns = self.now_ns < self._deaf_until_ns, self.now_ns + LEAST_NS
        if early:
            self.error(*NOT_RECOGNIZED)
            return
        self._parents = ""  # the words that a next command without a colon goes on from
        super().execute(message.upper())

    def carry_out(self, command: str) -> str | None:
        if command in ("*IDN?", "*STB?"):
            return self.told_identity if command == "*IDN?" else self._status()
        match = _UNIT.fullmatch(command)
        if match is None:
            raise CommandError(*NOT_RECOGNIZED)
        colon, header, query, text = match.groups()
        words = (header if colon or not self._parents else f"{self._parents}:{header}").split(":")
        count, method = _command(words, bool(query))
        arguments = [part.strip() for part in text.split(",")] if text else []
        if len(arguments) != count:
            raise CommandError(*BAD_ARGUMENT)
        reply = method(self, *arguments)
        self._parents = ":".join(words[:-1])
        return reply

    def _status(self) -> str:
        told = self._events | (SERVICE if self._events else 0)
        self._events = 0
        return str(told)

    def error(self, number: int, text: str) -> None:
        self._errors.append((number, text))
        self._events |= ERROR_EVENT

    def _axis(self, text: str) -> Axis:
        if text not in ("1", "2", "3"):
            raise CommandError(*BAD_ARGUMENT)
        return self.axes[int(text) - 1]

    # --- commands ----------------------------------------------------------------------------------------------

    def _reset(self) -> None:
        for axis in self.axes:
            if axis.interlock == "Fault":
                axis.interlock = "Open"

    def _close(self, number: str) -> None:
        axis = self._axis(number)
        if axis.interlock == "Fault":
            raise CommandError(*INTERLOCK_FAULT)
        axis.interlock = "Closed"
        axis.obey(self.now_ns)

    def _open(self, number: str) -> None:
        axis = self._axis(number)
        if axis.interlock == "Closed":
            axis.interlock, axis.mode = "Open", "Off"
            axis.obey(self.now_ns)

    def _set_mode(self, number: str, mode: str) -> None:
        axis = self._axis(number)
        axis.mode = mode
        axis.obey(self.now_ns)

    def _demand(self, what: str, number: str, text: str) -> None:
        axis, value = self._axis(number), _number(text)
        if what == "RATE" and abs(value) > axis.limits["RATE", "RATE"]:
            raise CommandError(*LIMIT_EXCEEDED)
        axis.demands[what] = axis.rolled_over(value) if what == "POSITION" else value
        if axis.mode.upper() == what:
            axis.obey(self.now_ns)

    def _choose_mode(self, number: str, word: str) -> None:
        mode = next((mode for mode in ("Off", "Position", "Rate") if word and mode.upper().startswith(word)), None)
        if mode is None:
            raise CommandError(*BAD_ARGUMENT)
        self._set_mode(number, mode)

    def _absolute(self, number: str) -> str:
        return ",".join(self._formed(cap, 4) for cap in self._axis(number).absolute)

    def _step(self, number: str, text: str) -> None:
        axis = self._axis(number)
        self._demand("POSITION", number, repr(axis.demands["POSITION"] + _number(text)))

    def _limit(self, what: str, mode: str, number: str, text: str) -> None:
        axis, value = self._axis(number), _number(text)
        if not 0.0 < value <= axis.absolute[0 if what == "RATE" else 1]:
            raise CommandError(*LIMIT_EXCEEDED)
        axis.limits[what, _mode(mode)] = value

    def _limit_of(self, what: str, mode: str, number: str) -> str:
        return self._formed(self._axis(number).limits[what, _mode(mode)], 4)

    def _read_position(self, number: str) -> str:
        axis = self._axis(number)
        true_deg = float(axis.motion.angle_deg(self.now_ns))
        shown_deg = axis.rolled_over(true_deg + self._noise.normal(0.0, POSITION_NOISE_DEG))
        return self.reading(self._formed(shown_deg, 4))

    def _read_rate(self, number: str) -> str:
        true_deg_s = float(self._axis(number).motion.rate_deg_s(self.now_ns))
        return self.reading(self._formed(true_deg_s + self._noise.normal(0.0, RATE_NOISE_DEG_S), 4))

    def _formed(self, value: float, digits: int) -> str:
        """Return a number in figures; as a block of four bytes, of which a bus of text shows the head alone."""
        return "#14...." if self._binary else f"{value:.{digits}f}"

    def _set_format(self, word: str) -> None:
        if not word or not ("BINARY".startswith(word) or "FLOAT".startswith(word)):
            raise CommandError(*BAD_ARGUMENT)
        self._binary = word[0] == "B"

    def _scaling(self, number: str) -> str:
        return f"{self._axis(number).range_deg:.4f},360.0000,0.0000,deg,NR2,NR2,NR2,NR2,NR2"

    def _next_message(self, queue: str) -> str:
        if queue != "QERROR":
            raise CommandError(*BAD_ARGUMENT)
        return ",".join(map(str, self._errors.popleft())) if self._errors else ""


_COMMANDS: dict[tuple[str, bool], tuple[int, Callable[..., str | None]]] = {
    ("INTERLOCK:RESET", False): (0, Acutrol3000._reset),
    ("INTERLOCK:CLOSE", False): (1, Acutrol3000._close),
    ("INTERLOCK:OPEN", False): (1, Acutrol3000._open),
    ("INTERLOCK", True): (1, lambda table, number: table._axis(number).interlock),
    ("MODE:OFF", False): (1, lambda table, number: table._set_mode(number, "Off")),
    ("MODE:POSITION", False): (1, lambda table, number: table._set_mode(number, "Position")),
    ("MODE:RATE", False): (1, lambda table, number: table._set_mode(number, "Rate")),
    ("MODE", True): (1, lambda table, number: table._axis(number).mode[0]),
    ("DEMAND:POSITION", False): (2, lambda table, *given: table._demand("POSITION", *given)),
    ("DEMAND:RATE", False): (2, lambda table, *given: table._demand("RATE", *given)),
    ("DEMAND:POSITION", True): (1, lambda table, number: table._formed(table._axis(number).demands["POSITION"], 6)),
    ("DEMAND:RATE", True): (1, lambda table, number: table._formed(table._axis(number).demands["RATE"], 6)),
    ("LIMIT:RATE", False): (3, lambda table, *given: table._limit("RATE", *given)),
    ("LIMIT:ACCELERATION", False): (3, lambda table, *given: table._limit("ACCELERATION", *given)),
    ("LIMIT:RATE", True): (2, lambda table, mode, number: table._limit_of("RATE", mode, number)),
    ("LIMIT:ACCELERATION", True): (2, lambda table, mode, number: table._limit_of("ACCELERATION", mode, number)),
    ("LIMIT:ABSOLUTE", True): (1, Acutrol3000._absolute),
    ("READ:POSITION", True): (1, Acutrol3000._read_position),
    ("READ:RATE", True): (1, Acutrol3000._read_rate),
    ("DEMAND:DELTAPOSITION", False): (2, Acutrol3000._step),
    ("QUERY:ERROR", True): (1, lambda table, code: _TEXTS.get(code, "UNKNOWN ERROR")),
    ("STATUS:MSG", True): (1, Acutrol3000._next_message),
    ("STATUS:MSGCLR", False): (1, lambda table, queue: table._errors.clear()),
    ("UTILITY:FORMAT", False): (1, Acutrol3000._set_format),
    ("UTILITY:FORMAT", True): (0, lambda table: "BINARY" if table._binary else "FLOAT"),
    ("CONFIGURE:SCALING", True): (1, Acutrol3000._scaling),
    ("MODE", False): (2, lambda table, number, word: table._choose_mode(number, word)),
}  # fmt: skip


def _command(words: list[str], query: bool) -> tuple[int, Callable[..., str | None]]:
    """Return number of arguments and function of a header whose words are beginnings of those of a command."""
    for (header, asks), command in _COMMANDS.items():
        whole = header.split(":")
        if asks == query and len(whole) == len(words) and all(map(str.startswith, whole, words)):
            return command
    raise CommandError(*NOT_RECOGNIZED)


def _mode(text: str) -> str:
    mode = next((mode for mode in ("POSITION", "RATE") if text and mode.startswith(text)), None)
    if mode is None:
        raise CommandError(*BAD_ARGUMENT)
    return mode


def _number(text: str) -> float:
    try:
        value = float(text)
    except ValueError:
        value = math.nan
    if not math.isfinite(value):
        raise CommandError(*BAD_ARGUMENT)
    return value


SIMULATOR = Acutrol3000
