"""Simulated Fluke 5720A calibrator: DC current into the bench's wiring, with its errors and its trips.

Not SCPI. Faults queue up (15 and an overflow mark) and are read with ``FAULT?``, explained with ``EXPLAIN? n``.
``MA`` is milliampere for a current; before every other unit it is the multiplier mega. An offset or a scale factor of
the front panel (keys OFFSET and SCALE) alters what every entry puts out; of the commands only ``*RST`` ends it. Another
function than that of its compensation (``RCOMP``, two wires of a resistance) ends that.

Source: 5700A/5720A Series II Operators Manual ch. 5 (commands, response syntax, 128-byte input buffer; 5-51: bits of
``ISR?``) and 4-45 to 4-46 (offset and scale), Table 2 of the AF-converter paper (ranges and floors), public programs
(``BOOST``, ``EXTSENSE``, ``RCOMP``, ``XFER``). Placeholders, not confirmed on hardware: fault numbers, settling times,
the trip into an open circuit within the same instant, standby opening the current loop, reply format of ``OUT?`` and
that it tells the entry and not what an offset makes of it.
"""

from __future__ import annotations

import re
from collections import deque
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any, ClassVar

import numpy as np

from bench.model.clock import NS, to_ns
from sim_instruments.bus.live import CommandDevice, CommandError
from sim_instruments.faults.fault import Fault, NamedFaults
from sim_instruments.worlds.common.wiring import TRIP_CURRENT_A

OPERATING_BIT, OFFSET_BIT, SCALE_BIT, SETTLED_BIT = 1 << 0, 1 << 8, 1 << 9, 1 << 12
_SWITCH_BITS = {"EXTGUARD": 1 << 1, "EXTSENSE": 1 << 2, "BOOST": 1 << 3, "RCOMP": 1 << 4, "RANGELCK": 1 << 5, "XFER": 0}
_WORDS = {"CUR_POST": ("NORMAL", "AUX", "IB5725"), **dict.fromkeys(_SWITCH_BITS, ("OFF", "ON"))}  # the first: power-on
FAULT_AVAILABLE = 8  # status byte
QUEUE_LENGTH = 16
LOST_PATH = 502
SETTLE_S = 3.0  # divided, like the next, by the world's option time_constants
RANGE_CHANGE_S = 2.0
UNSETTLED_PART = 1e-3  # how far the current is from its value until it has settled
GAIN_SIGMA = 10e-6
DAY_S = 86_400.0
ON_MIN = 300  # it was switched on so long before the bench
SINCE_CALIBRATION_DAYS = 5
_KEYS = {"OFFSET": "offset_A", "SCALE": "scale"}
_ZERO_A = 1e-12

_FAULTS = """
0 No Error
501 Compliance Voltage Exceeded
502 Current Lost Its Path
503 Output Overloaded
601 Queue Overflow
701 Bad Syntax
702 Unknown Command
703 Invalid Number
704 Value Out Of Range
705 Value Over Entry Limit
706 Value Does Not Fit Locked Range
707 Unit Not Available
708 Not Possible With A Fault Queued
"""
FAULTS = dict(line.split(" ", 1) for line in _FAULTS.strip().splitlines())
_MULTIPLIER = {"": 1.0, "P": 1e-12, "N": 1e-9, "U": 1e-6, "M": 1e-3, "K": 1e3, "MA": 1e6}
_VALUE = re.compile(r"([-+]?(?:\d+\.?\d*|\.\d+)(?:E[-+]?\d+)?)\s*(?:(MA|[PNUMK])?(A|V|HZ|OHM))?", re.IGNORECASE)


@dataclass(frozen=True)
class CurrentRange:
    """One range: full scale it is named after (A), decimals a setting has, 95 % floor of Table 2 (A)."""

    full_scale_A: float
    decimals: int
    floor_A: float


CURRENT_RANGES = (
    CurrentRange(2.2e-4, 10, 6e-9),
    CurrentRange(2.2e-3, 9, 7e-9),
    CurrentRange(2.2e-2, 8, 4e-8),
    CurrentRange(2.2e-1, 7, 7e-7),
    CurrentRange(2.2, 6, 1.2e-5),
)


def _lowest_range(current_A: float) -> int | None:
    """Return the index of the lowest range that holds a current (either sign), None above 2.2 A."""
    return next((i for i, r in enumerate(CURRENT_RANGES) if abs(current_A) <= r.full_scale_A * (1 + 1e-12)), None)


def parse_value(text: str) -> tuple[float, str]:
    """Return number and unit ("A", "V", "HZ", "OHM" or "") of one parameter, multiplier applied."""
    match = _VALUE.fullmatch(text.strip())
    if match is None:
        raise CommandError(703)
    number, multiplier, unit = match.groups()
    return float(number) * _MULTIPLIER[(multiplier or "").upper()], (unit or "").upper()


class Fluke5720A(CommandDevice):
    """DC current source; the direct-voltage function exists only so that sending it is the mistake it is."""

    identity = "FLUKE,5720A,SIM5720,1.4+B"

    def power_up(self) -> None:
        super().power_up()
        self.faults_queued: deque[int] = deque()
        self.event_status = 128
        self._began_ns = self.now_ns
        self._settled_ns = 0
        self._round = 0  # numbers the settling in progress; a newer one makes the older end without effect
        gain_on = self.world.options.get("calibrator_gain", True)
        self.gain = self.world.rng("calibrator gain").normal(0.0, GAIN_SIGMA) if gain_on else 0.0
        self.world.wiring.on_lost_path = self.trip
        self._power_on_state()

    def _power_on_state(self) -> None:
        self.operating = False
        self.settled = True
        self.unit = "V"
        self.value = 0.0
        self.offset_A, self.scale = 0.0, 1.0
        self.range_index = 0
        self.words = {header: words[0] for header, words in _WORDS.items()}
        self.limits = {"A": (-2.2, 2.2), "V": (-1100.0, 1100.0), "OHM": (0.0, 1e8)}

    # --- physics -----------------------------------------------------------------------------------------------

    def true_current_A(self) -> float:
        """Return the current that the terminals really carry once settled, ampere.

        The entry, altered by the keys SCALE and OFFSET, with the errors of gain, range and level.

        The world's option ``calibrator_drift_ppm`` makes the gain rise by that much a day, from the run's start.
        """
        drift = 1e-6 * float(self.world.options.get("calibrator_drift_ppm", 0.0)) * (self.now_ns - self._began_ns) / NS
        gain = self.gain + drift / DAY_S
        asked_A = self.value * self.scale + self.offset_A
        if not self.world.options.get("calibrator_floor", True):
            return asked_A * (1.0 + gain)
        sigma_A = CURRENT_RANGES[self.range_index].floor_A / 2
        offset_A = self.world.rng("calibrator range offset", self.range_index).normal(0.0, sigma_A)
        level_A = 0.0
        if abs(asked_A) > _ZERO_A:
            level = round(abs(asked_A) * 1e12)
            rng = self.world.rng("calibrator level error", self.range_index, level)
            level_A = float(np.sign(asked_A)) * rng.normal(0.0, sigma_A)
        return float(asked_A * (1.0 + gain) + offset_A + level_A)

    @property
    def elsewhere(self) -> bool:
        """Whether a current comes out of other terminals than those of the bench."""
        return self.words["CUR_POST"] != "NORMAL" or self.words["BOOST"] == "ON"

    def trip(self, number: int = LOST_PATH) -> None:
        """Drop to standby and queue a fault, as the protection does; nothing happens in standby."""
        if self.operating:
            self.error(number)
            self._standby()

    def drop(self) -> None:
        """Fault: the output is off and its setting lost, and the calibrator reports nothing; only readback tells."""
        self._standby()
        self.value = 0.0

    named_faults: ClassVar[NamedFaults] = {
        "trip": Fault("calibrator", (), "the calibrator trips to standby and queues a fault", trip),
        "calibrator_drops": Fault(
            "calibrator", (), "the calibrator's output goes off without a word; readback disagrees", drop),
    }  # fmt: skip

    def press(self, keys: str) -> None:
        key, entered = keys.split()
        setattr(self, _KEYS[key], float(entered))
        if self.operating:
            self._drive(range_changed=True)

    def outputs(self) -> dict[str, Any]:
        return {"operating": self.operating, "set": self.value, "unit": self.unit}

    def _drive(self, range_changed: bool) -> None:
        """Apply the present setting to the wires: nearly there at once, exactly there when it has settled."""
        wiring = self.world.wiring
        current_A = self.true_current_A()
        if self.unit == "A" and abs(current_A) > TRIP_CURRENT_A and (self.elsewhere or not wiring.has_path):
            self.trip(501)
            return
        if self.unit != "A":
            if self.unit == "V" and abs(self.value) > 0 and wiring.has_path:
                self.trip(503)
            self.settled = True
            return
        self.settled = False
        self._round += 1
        wiring.drive(current_A * (1.0 - UNSETTLED_PART), self.now_ns)
        settle_s = (SETTLE_S + (RANGE_CHANGE_S if range_changed else 0.0)) / self.world.time_constants
        mine = self._round
        self._settled_ns = self.now_ns + to_ns(settle_s)
        self.world.after(settle_s, lambda: self._settle(mine, current_A))

    def _settle(self, number: int, current_A: float) -> None:
        if number == self._round and self.operating:
            self.settled = True
            self.world.wiring.drive(current_A, self.now_ns)

    def _standby(self) -> None:
        self._round += 1
        self.operating = False
        self.settled = True
        self.world.wiring.drive(None, self.now_ns)

    # --- messages ----------------------------------------------------------------------------------------------

    def carry_out(self, command: str) -> str | None:
        word, _, parameters = command.upper().partition(" ")
        if word.removesuffix("?") in _WORDS:
            return self._word(word, parameters.strip())
        handler = _COMMANDS.get(word)
        if handler is not None:
            return handler(self, parameters.strip())
        if word:
            raise CommandError(702)
        return None

    def _word(self, header: str, text: str) -> str | None:
        """Tell or take what is one of some words."""
        if header.endswith("?"):
            return self.words[header.removesuffix("?")]
        if text not in _WORDS[header]:
            raise CommandError(701)
        self.words[header] = text
        if self.operating and header in ("CUR_POST", "BOOST"):
            self._drive(range_changed=True)
        return None

    def on_interrupted(self) -> None:
        self.event_status |= 4

    def status_byte(self) -> int:
        return super().status_byte() | (FAULT_AVAILABLE if self.faults_queued else 0)

    def error(self, number: int) -> None:
        self.event_status |= 8
        if len(self.faults_queued) < QUEUE_LENGTH - 1:
            self.faults_queued.append(number)
        elif len(self.faults_queued) < QUEUE_LENGTH:
            self.faults_queued.append(601)

    def _out(self, text: str) -> None:
        parts = [parse_value(part) for part in text.split(",")]
        value, unit = parts[0]
        unit = unit or self.unit
        frequency_Hz = parts[1][0] if len(parts) > 1 else 0.0
        if unit not in self.limits or len(parts) > 2:
            raise CommandError(707)
        if frequency_Hz != 0:
            raise CommandError(704)
        low, high = self.limits[unit]
        if not low <= value <= high:
            raise CommandError(705)
        index = _lowest_range(value) if unit == "A" else self.range_index
        if index is None:
            raise CommandError(704)
        if unit == "A" and self.words["RANGELCK"] == "ON" and self.unit == "A":
            if index > self.range_index:
                raise CommandError(706)
            index = self.range_index
        changed = index != self.range_index or unit != self.unit
        if unit != self.unit:
            self.words["RCOMP"] = "OFF"
            if self.operating:
                self._standby()  # another function is another pair of terminals
        self.value = round(value, CURRENT_RANGES[index].decimals) if unit == "A" else value
        self.unit, self.range_index = unit, index
        if self.operating:
            self._drive(changed)

    def _oper(self, _: str) -> None:
        if self.unit == "V" and abs(self.value) >= 22 and self.faults_queued:
            raise CommandError(708)
        if not self.operating:
            self.operating = True
            self._drive(range_changed=False)

    def _limit(self, text: str) -> None:
        pairs = [parse_value(part) for part in text.split(",")]
        unit = pairs[0][1] or self.unit
        if len(pairs) != 2 or unit not in self.limits or pairs[0][0] < 0 or pairs[1][0] > 0:
            raise CommandError(704)
        self.limits[unit] = (pairs[1][0], pairs[0][0])

    def _explain(self, text: str) -> str:
        if text not in FAULTS:
            raise CommandError(703)
        return f'"{FAULTS[text]}"'

    def _ask_complete(self, _: str) -> str:
        if not self.settled:
            self.reply_at(self._settled_ns)
        return "1"

    def _ask_status(self, _: str) -> str:
        bits = {
            OPERATING_BIT: self.operating,
            OFFSET_BIT: self.offset_A != 0.0,
            SCALE_BIT: self.scale != 1.0,
            SETTLED_BIT: self.settled,
            **{bit: self.words[header] == "ON" for header, bit in _SWITCH_BITS.items()},
        }
        return str(sum(bit for bit, is_set in bits.items() if is_set))

    def _clear_status(self, _: str) -> None:
        self.faults_queued.clear()
        self.event_status = 0

    def _reset(self, _: str) -> None:
        self._standby()
        self._power_on_state()


_COMMANDS: dict[str, Callable[[Fluke5720A, str], str | None]] = {
    "*IDN?": lambda self, _: self.told_identity,
    "*RST": Fluke5720A._reset,
    "*CLS": Fluke5720A._clear_status,
    "*OPC?": Fluke5720A._ask_complete,
    "*ESR?": lambda self, _: self.read_out("event_status"),
    "*STB?": lambda self, _: str(self.status_byte()),
    "OUT": Fluke5720A._out,
    "OUT?": lambda self, _: f"{self.value:.7E},{self.unit},0.00E+00",
    "OPER": Fluke5720A._oper,
    "STBY": lambda self, _: self._standby(),
    "ISR?": Fluke5720A._ask_status,
    "ONTIME?": lambda self, _: str(ON_MIN + (self.now_ns - self._began_ns) // (60 * NS)),
    "CAL_DAYS?": lambda self, _: str(SINCE_CALIBRATION_DAYS),
    "FAULT?": lambda self, _: str(self.faults_queued.popleft() if self.faults_queued else 0),
    "EXPLAIN?": Fluke5720A._explain,
    "LIMIT": Fluke5720A._limit,
    "LIMIT?": lambda self, _: ",".join(f"{v:.3E}" for v in reversed(self.limits.get(self.unit, (0, 0)))),
}

SIMULATOR = Fluke5720A
