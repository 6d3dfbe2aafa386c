"""Simulated ACUTROL3000 controller with its three-axis table: outer axis 1, middle axis 2, inner axis 3.

Headers may be cut to any beginning of their words (``:D:R 1,5`` is ``:DEMAND:RATE 1,5``). A demand is obeyed in its
mode only; a mode that is activated obeys the demand that is loaded, with what is summed to it. The axes have no stops:
positions roll over after one turn, and a demand is reached the shortest way. A drive without a closed interlock, or in
a mode without a motion (Off, Abort; Synthesis and Track have no source here), comes to rest. Two commands within 40 ms
are not understood. Motion is exact (worlds.common.motion); only the read-out has noise and steps. Numbers are figures
or binary, and degrees or another unit, as the last user left them.

Source: manual TM-8004-C 2.6 and 4.14.1 (formats), 3.10 (status byte), 4.2.6 (sums), 4.2.26 (range of positions, scale),
4.3 (demands), 4.6 (limits; of Off and Abort the acceleration brakes), 4.7 (modes, shortest way), 4.9.1 and 4.11.4
(errors and messages), 5.1.6 (what is out of range wraps);
public programs for this controller and its read-me (reply words, "65" of ``*STB?`` at an interlock fault, 40 ms as
least time over GPIB). Placeholders, not confirmed on hardware: identity, error numbers and texts, the table's own
limits, deceleration without drive, resolution and noise of the read-out.
"""

from __future__ import annotations

import inspect
import math
import re
from collections import deque
from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass, field
from functools import partial
from typing import Any, ClassVar

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
_MODES = ("Off", "Position", "Rate", "Abort", "Arate", "Synthesis", "Track")
_STATES = ("POSITION", "RATE", "ACCELERATION", "JERK")
_UNIT = re.compile(r"(:?)([A-Z]+(?::[A-Z]+)*)(\??)(?:\s+(.*))?")


@dataclass
class Axis:
    """One axis with its drive, its positions within ``range_deg`` around 0.

    ``sums``: by state whether something is summed to its demand, which variable, its gain and the offset; no variable
    has a signal.   ``scale``: numbers of the controller for one degree, in ``unit``.   ``offset_deg`` is how far from
    a position demand it comes to rest (a fault).
    """

    number: int
    motion: AxisMotion
    interlock: str = "Open"
    mode: str = "Off"
    demands: dict[str, float] = field(default_factory=lambda: {"POSITION": 0.0, "RATE": 0.0})
    limits: dict[tuple[str, str], float] = field(default_factory=dict)
    sums: dict[str, list[str]] = field(default_factory=lambda: {state: ["D", "0", "0", "0"] for state in _STATES})
    range_deg: float = RANGE_DEG
    scale: float = 1.0
    unit: str = "deg"
    stalled: bool = False
    offset_deg: float = 0.0

    @property
    def absolute(self) -> tuple[float, ...]:
        """The limits nobody can exceed, in the order of ``:LIMIT:ABSOLUTE?``."""
        caps = ABSOLUTE[self.number - 1]
        return *caps[:3], -self.range_deg / 2.0, self.range_deg / 2.0, *caps[3:]

    def demand(self, state: str) -> float:
        """Return a demand as it is obeyed."""
        enabled, _, _, offset = self.sums[state]
        return self.demands[state] + (float(offset) if enabled == "E" else 0.0)

    def obey(self, now_ns: int) -> None:
        """Move from ``now_ns`` on as mode, demand, limits and faults say."""
        if self.interlock == "Open" or self.stalled:
            self.motion.run_at(0.0, BRAKE_DEG_S2, now_ns)
        elif self.interlock == "Fault":
            self.motion.run_at(0.0, self.limits["ACCELERATION", "ABORT"], now_ns)
        elif self.mode in ("Rate", "Arate"):
            self.motion.run_at(self.demand("RATE"), self.limits["ACCELERATION", "RATE"], now_ns)
        elif self.mode == "Position":
            here_deg = float(self.motion.angle_deg(now_ns))
            way_deg = self.rolled_over(self.demand("POSITION") + self.offset_deg - here_deg)
            limits = self.limits["RATE", "POSITION"], self.limits["ACCELERATION", "POSITION"]
            self.motion.go_to(here_deg + way_deg, *limits, now_ns)
        else:
            self.motion.run_at(0.0, self.limits["ACCELERATION", "OFF"], now_ns)

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
            for mode in map(str.upper, _MODES):
                axis.limits["RATE", mode], axis.limits["ACCELERATION", mode] = axis.absolute[:2]
            for mode in ("OFF", "ABORT"):
                axis.limits["ACCELERATION", mode] = BRAKE_DEG_S2
        self._errors: deque[tuple[int, str]] = deque(maxlen=_QUEUE)
        self._events = 0
        self._deaf_until_ns = -1
        self._binary = False
        self._noise = self.rng("table encoders")

    def leave(self, setting: str) -> None:
        self._deaf_until_ns = -1  # somebody took the time
        super().leave(setting)

    def press(self, keys: str) -> None:
        """The emergency stop: all interlocks are in fault."""
        for axis in self.axes:
            axis.interlock = "Fault"
            axis.obey(self.now_ns)

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
        method = _command(words, bool(query))
        arguments = [part.strip() for part in text.split(",")] if text else []
        try:
            bound = inspect.signature(method).bind(self, *arguments)
        except TypeError:  # another number of arguments
            raise CommandError(*BAD_ARGUMENT) from None
        given = bound.arguments
        if "axis" in given:
            given["axis"] = self._axis(given["axis"])
        if "value" in given:  # in the unit of that axis
            given["value"] = _number(given["value"]) / given["axis"].scale
        reply = method(*bound.args, **bound.kwargs)
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

    def _close(self, axis: Axis) -> None:
        if axis.interlock == "Fault":
            raise CommandError(*INTERLOCK_FAULT)
        axis.interlock = "Closed"
        axis.obey(self.now_ns)

    def _open(self, axis: Axis) -> None:
        if axis.interlock == "Closed":
            axis.interlock, axis.mode = "Open", "Off"
            axis.obey(self.now_ns)

    def _set_mode(self, axis: Axis, interval: str = "", *, mode: str) -> None:
        axis.mode = _chosen(mode, _MODES)
        axis.obey(self.now_ns)

    def _demand(self, axis: Axis, value: float, *, what: str) -> None:
        if what == "RATE" and abs(value) > axis.limits["RATE", "RATE"]:
            raise CommandError(*LIMIT_EXCEEDED)
        axis.demands[what] = axis.rolled_over(value) if what == "POSITION" else value
        if axis.mode.upper().endswith(what):
            axis.obey(self.now_ns)

    def _demand_of(self, axis: Axis, *, what: str) -> str:
        return self._formed(axis, axis.demands[what], 6)

    def _sum(self, axis: Axis, state: str, enable: str, *configuration: str) -> None:
        state = _chosen(state, _STATES)
        axis.sums[state] = [_chosen(enable, ("ENABLE", "DISABLE"))[0], *(configuration or axis.sums[state][1:])]
        axis.obey(self.now_ns)

    def _sum_of(self, axis: Axis, state: str) -> str:
        return ",".join(axis.sums[_chosen(state, _STATES)])

    def _absolute(self, axis: Axis) -> str:
        return ",".join(self._formed(axis, cap, 4) for cap in axis.absolute)

    def _step(self, axis: Axis, value: float) -> None:
        self._demand(axis, axis.demands["POSITION"] + value, what="POSITION")

    def _limit(self, mode: str, axis: Axis, value: float, *, what: str) -> None:
        if not 0.0 < value <= axis.absolute[0 if what == "RATE" else 1]:
            raise CommandError(*LIMIT_EXCEEDED)
        axis.limits[what, _chosen(mode, _MODES).upper()] = value

    def _limit_of(self, mode: str, axis: Axis, *, what: str) -> str:
        return self._formed(axis, axis.limits[what, _chosen(mode, _MODES).upper()], 4)

    def _read_position(self, axis: Axis) -> str:
        true_deg = float(axis.motion.angle_deg(self.now_ns))
        shown_deg = axis.rolled_over(true_deg + self._noise.normal(0.0, POSITION_NOISE_DEG))
        return self.reading(self._formed(axis, shown_deg, 4))

    def _read_rate(self, axis: Axis) -> str:
        true_deg_s = float(axis.motion.rate_deg_s(self.now_ns))
        return self.reading(self._formed(axis, true_deg_s + self._noise.normal(0.0, RATE_NOISE_DEG_S), 4))

    def _formed(self, axis: Axis, value: float, digits: int) -> str:
        """Return a number in figures; as a block of four bytes, of which a bus of text shows the head alone."""
        return "#14...." if self._binary else f"{value * axis.scale:.{digits}f}"

    def _set_format(self, word: str) -> None:
        self._binary = _chosen(word, ("Binary", "Float")) == "Binary"

    def _scale(self, axis: Axis, full: str, factor: str, offset: str, unit: str) -> None:
        axis.scale, axis.unit = _number(factor) / RANGE_DEG, unit.lower()
        axis.range_deg = _number(full) / axis.scale

    def _scaling(self, axis: Axis) -> str:
        full, factor = axis.range_deg * axis.scale, RANGE_DEG * axis.scale
        return f"{full:.4f},{factor:.4f},0.0000,{axis.unit},NR2,NR2,NR2,NR2,NR2"

    def _next_message(self, queue: str) -> str:
        if queue != "QERROR":
            raise CommandError(*BAD_ARGUMENT)
        return ",".join(map(str, self._errors.popleft())) if self._errors else ""


_DEMANDS, _LIMITS = ("POSITION", "RATE"), ("RATE", "ACCELERATION")
_ALIKE = (
    ("DEMAND", _DEMANDS, False, Acutrol3000._demand), ("DEMAND", _DEMANDS, True, Acutrol3000._demand_of),
    ("LIMIT", _LIMITS, False, Acutrol3000._limit), ("LIMIT", _LIMITS, True, Acutrol3000._limit_of),
)  # fmt: skip
Handler = Callable[..., str | None]
_COMMANDS: dict[tuple[str, bool], Handler] = {
    ("INTERLOCK:RESET", False): Acutrol3000._reset,
    ("INTERLOCK:CLOSE", False): Acutrol3000._close,
    ("INTERLOCK:OPEN", False): Acutrol3000._open,
    ("INTERLOCK", True): lambda table, axis: axis.interlock,
    **{(f"MODE:{mode.upper()}", False): partial(Acutrol3000._set_mode, mode=mode.upper()) for mode in _MODES},
    ("MODE", False): lambda table, axis, mode: table._set_mode(axis, mode=mode),
    ("MODE", True): lambda table, axis: axis.mode[0],
    **{
        (f"{group}:{what}", asks): partial(method, what=what) for group, whats, asks, method in _ALIKE for what in whats
    },
    ("READ:POSITION", True): Acutrol3000._read_position,
    ("READ:RATE", True): Acutrol3000._read_rate,
    ("LIMIT:ABSOLUTE", True): Acutrol3000._absolute,
    ("DEMAND:DELTAPOSITION", False): Acutrol3000._step,
    ("DEMAND:OSCILLATOR", False): lambda table, number, magnitude, frequency, phase: None,
    ("CONFIGURE:DEMANDSUM", False): Acutrol3000._sum,
    ("CONFIGURE:DEMANDSUM", True): Acutrol3000._sum_of,
    ("CONFIGURE:SCALING", False): Acutrol3000._scale,
    ("CONFIGURE:SCALING", True): Acutrol3000._scaling,
    ("QUERY:ERROR", True): lambda table, code: _TEXTS.get(code, "UNKNOWN ERROR"),
    ("STATUS:MSG", True): Acutrol3000._next_message,
    ("STATUS:MSGCLR", False): lambda table, queue: table._errors.clear(),
    ("UTILITY:FORMAT", False): Acutrol3000._set_format,
    ("UTILITY:FORMAT", True): lambda table: "BINARY" if table._binary else "FLOAT",
}


def _command(words: list[str], query: bool) -> Handler:
    """Return the function of a header whose words are beginnings of those of a command."""
    for (header, asks), command in _COMMANDS.items():
        whole = header.split(":")
        if asks == query and len(whole) == len(words) and all(map(str.startswith, whole, words)):
            return command
    raise CommandError(*NOT_RECOGNIZED)


def _chosen(text: str, words: Iterable[str]) -> str:
    """Return the word that begins so."""
    found = next((word for word in words if text and word.upper().startswith(text)), None)
    if found is None:
        raise CommandError(*BAD_ARGUMENT)
    return found


def _number(text: str) -> float:
    try:
        value = float(text)
    except ValueError:
        value = math.nan
    if not math.isfinite(value):
        raise CommandError(*BAD_ARGUMENT)
    return value


SIMULATOR = Acutrol3000
