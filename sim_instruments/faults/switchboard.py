"""Switches of the simulated faults, seeded: of one serial link, of the interface of one instrument."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field
from typing import ClassVar

import numpy as np

from sim_instruments.faults.fault import LINK, ROLE, Fault, NamedFaults, becomes, takes
from sim_instruments.seeds import generator

_RATE = ("RATE", 0.0, 1.0)
_COUNT = ("COUNT", 1, 1_000_000)
_BLOCK = 4096  # frames whose faults are drawn together; frame indexes are absolute, so reads may be cut anywhere


@dataclass
class LinkFaults:
    """Damage of one serial link, a pure function of (seed, link name, frame index).

    ``bit_error_rate`` is per bit, ``drop_rate`` and ``duplicate_rate`` are per frame, all 0 to 1. ``silent``: frames
    of that time never arrive. ``stuck``: these bytes come again and again where frames are due. ``unplugged``: the
    port itself is gone; ``plugs`` counts how often it came, so that an opened one knows it is an earlier one.
    """

    seed: int = 0
    name: str = ""
    bit_error_rate: float = 0.0
    drop_rate: float = 0.0
    duplicate_rate: float = 0.0
    silent: bool = False
    stuck: bytes = b""
    unplugged: bool = False
    plugs: int = 1
    _masks: dict[tuple[int, int, float], np.ndarray] = field(default_factory=dict, repr=False)
    _drawn: dict[int, np.ndarray] = field(default_factory=dict, repr=False)

    named_faults: ClassVar[NamedFaults] = {
        "bit_errors": Fault(
            LINK, (("RATE", 0.0, 0.1),), "bits turned over, per bit",
            takes("bit_error_rate"), becomes(bit_error_rate=0.0)),
        "drop": Fault(
            LINK, (_RATE,), "frames that never arrive, per frame", takes("drop_rate"), becomes(drop_rate=0.0)),
        "duplicate": Fault(
            LINK, (_RATE,), "frames that arrive twice, per frame",
            takes("duplicate_rate"), becomes(duplicate_rate=0.0)),
        "silent": Fault(
            LINK, (), "the cable is off: nothing arrives", becomes(silent=True), becomes(silent=False)),
        "unplug": Fault(
            LINK, (), "the port is gone, with its name",
            lambda link: link.unplug(True), lambda link: link.unplug(False)),
        "replug": Fault(
            LINK, (), "a new port comes under the same name", lambda link: link.unplug(False), ends="unplug"),
        "stuck": Fault(
            LINK, (("BYTES", 0, 0),),
            "these bytes (hexadecimal, such as 55 or AA55) instead of frames, without end",
            takes("stuck"), becomes(stuck=b"")),
    }  # fmt: skip

    @property
    def active(self) -> bool:
        """Whether any fault is switched on."""
        rates = self.bit_error_rate, self.drop_rate, self.duplicate_rate
        return self.silent or self.unplugged or bool(self.stuck) or max(rates) > 0

    def unplug(self, unplugged: bool) -> None:
        """Take the port away or bring it back."""
        self.plugs += self.unplugged and not unplugged
        self.unplugged = unplugged

    def frames(self, first_index: int, frames: np.ndarray) -> np.ndarray:
        """Return frames (n, length) from ``first_index`` on, as they arrive."""
        n, length = frames.shape
        if self.stuck:
            places = first_index * length + np.arange(n * length)
            return np.frombuffer(self.stuck, np.uint8)[places % len(self.stuck)].reshape(n, length)
        if self.bit_error_rate > 0:
            return frames ^ self.flips(first_index, n, length)
        return frames

    def copies(self, first_index: int, n: int) -> np.ndarray:
        """Return how often each of ``n`` frames from ``first_index`` on arrives: (n,) int64 of 0, 1 or 2."""
        if self.silent or self.unplugged:
            return np.zeros(n, np.int64)
        draws = self._by_block(first_index, n, self._draws)
        copies = 1 + (draws[:, 1] < self.duplicate_rate).astype(np.int64)
        copies[draws[:, 0] < self.drop_rate] = 0
        return copies

    def flips(self, first_index: int, n: int, length: int) -> np.ndarray:
        """Return bits to turn over in ``n`` frames of ``length`` bytes: (n, length) uint8 to xor with the frames."""
        return self._by_block(first_index, n, lambda block: self._mask(block, length))

    def _rng(self, what: str, block: int) -> np.random.Generator:
        return generator(self.seed, f"link {self.name} {what}", block)

    def _draws(self, block: int) -> np.ndarray:
        if block not in self._drawn:
            self._drawn = {block: self._rng("frames", block).random((_BLOCK, 2))}
        return self._drawn[block]

    def _mask(self, block: int, length: int) -> np.ndarray:
        key = (block, length, self.bit_error_rate)
        if key not in self._masks:
            rng = self._rng("bits", block)
            bits = _BLOCK * length * 8
            hits = rng.integers(0, bits, rng.binomial(bits, self.bit_error_rate))
            mask = np.zeros(_BLOCK * length, np.uint8)
            np.bitwise_xor.at(mask, hits // 8, (1 << (hits % 8)).astype(np.uint8))
            self._masks = {key: mask.reshape(_BLOCK, length)}
        return self._masks[key]

    @staticmethod
    def _by_block(first: int, n: int, draw: Callable[[int], np.ndarray]) -> np.ndarray:
        parts, at, end = [], first, first + n
        while at < end or not parts:  # once for n = 0, which keeps the shape
            block, start = divmod(at, _BLOCK)
            stop = min(_BLOCK, start + end - at)
            parts.append(draw(block)[start:stop])
            at += stop - start
        return parts[0] if len(parts) == 1 else np.concatenate(parts)


@dataclass
class InstrumentFaults:
    """Faults of one instrument, by role.

    ``mute``: takes every command and answers none (its other physics goes on). ``late_s`` with ``late_replies``: the
    next that many replies come so much later, and a stale one is then read by the next query unless the bus session
    is cleared. ``garbled_replies``: the next that many replies come with damaged characters. ``identity`` replaces
    the answer to the identity question. ``nan_readings``, ``overload_readings``: the next that many readings are no
    numbers. ``hang``: the interface takes what is sent and answers nothing at all, neither serial poll nor clear.
    """

    seed: int = 0
    role: str = ""
    mute: bool = False
    late_s: float = 0.0
    late_replies: int = 0
    garbled_replies: int = 0
    identity: str = ""
    nan_readings: int = 0
    overload_readings: int = 0
    hang: bool = False
    _rng: np.random.Generator | None = field(default=None, repr=False)

    named_faults: ClassVar[NamedFaults] = {
        "mute": Fault(ROLE, (), "takes commands and answers no query", becomes(mute=True), becomes(mute=False)),
        "late": Fault(
            ROLE, (("SECONDS", 0.0, 3600.0), _COUNT), "the next COUNT replies come so much later",
            takes("late_s", "late_replies"), becomes(late_replies=0), default=(1,), counted="late_replies"),
        "garbled": Fault(
            ROLE, (_COUNT,), "the next COUNT replies have damaged characters",
            takes("garbled_replies"), becomes(garbled_replies=0), default=(1,), counted="garbled_replies"),
        "identity": Fault(
            ROLE, (("TEXT", 0, 0),), "answers the identity question with TEXT",
            takes("identity"), becomes(identity="")),
        "nan": Fault(
            ROLE, (_COUNT,), "the next COUNT readings are 'not a number'",
            takes("nan_readings"), becomes(nan_readings=0), default=(1,), counted="nan_readings"),
        "overload": Fault(
            ROLE, (_COUNT,), "the next COUNT readings are overload",
            takes("overload_readings"), becomes(overload_readings=0), default=(1,), counted="overload_readings"),
        "hang": Fault(
            ROLE, (), "takes what is sent and answers nothing, neither serial poll nor device clear",
            becomes(hang=True), becomes(hang=False)),
    }  # fmt: skip

    def take_delay_s(self) -> float:
        """Return extra delay of the reply being made, seconds; counts it."""
        if self.late_replies <= 0:
            return 0.0
        self.late_replies -= 1
        return self.late_s

    def take_reading(self, text: str, not_a_number: str, overload: str) -> str:
        """Return the reading as it is told; counts those that are no number."""
        if self.nan_readings > 0:
            self.nan_readings -= 1
            return not_a_number
        if self.overload_readings > 0:
            self.overload_readings -= 1
            return overload
        return text

    def garble(self, reply: bytes) -> bytes:
        """Return the reply as it arrives: one or more of its bytes turned into other printable ones; counts it."""
        if self.garbled_replies <= 0 or not reply:
            return reply
        self.garbled_replies -= 1
        if self._rng is None:
            self._rng = generator(self.seed, f"garbled replies of {self.role}")
        damaged = bytearray(reply)
        for place in self._rng.choice(len(damaged), size=max(1, len(damaged) // 4), replace=False):
            damaged[place] = ord("#") if damaged[place] != ord("#") else ord("?")
        return bytes(damaged)


@dataclass
class Faults:
    """The fault switches of all links and instruments of one simulated world; everything is off at the start."""

    seed: int = 0
    _links: dict[str, LinkFaults] = field(default_factory=dict, repr=False)
    _instruments: dict[str, InstrumentFaults] = field(default_factory=dict, repr=False)

    def link(self, name: str) -> LinkFaults:
        """Return switches of one serial link (port_a, port_b)."""
        return self._links.setdefault(name, LinkFaults(self.seed, name))

    def instrument(self, role: str) -> InstrumentFaults:
        """Return switches of one instrument, by its role in the station."""
        return self._instruments.setdefault(role, InstrumentFaults(self.seed, role))
