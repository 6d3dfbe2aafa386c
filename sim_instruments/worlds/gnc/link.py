"""The link of the test board: bytes in, requests out; samples of the module's own clock in, frames out.

The receiver gives up what an interruption has left unfinished.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from bench.frame import FrameBatch, FrameDefinition
from bench.model.arrays import Integers
from bench.model.clock import NS
from sim_instruments.worlds.common.port import Port
from sim_instruments.worlds.gnc.module import GncModule

SILENCE_NS = 50_000_000  # between two bytes of a frame at most
BOARD = 0x10
GYRO, ACCELEROMETER, MAGNETOMETER = 1, 2, 4  # bits of the sensors
HIGHEST_HZ = 200
STREAM_COMMAND = 0x22
AT_ONCE = 20_000  # samples made together at most
MADE_NS = 100_000  # from a sample to its frame
US = 1_000_000


@dataclass(frozen=True)
class Request:
    """One command as it came."""

    source: int
    sequence: int
    command: int
    payload: bytes


class BoardReceiver:
    """Finds commands to this board; a frame with a wrong check costs one byte, not its claimed length."""

    def __init__(self, definition: FrameDefinition) -> None:
        self._decoder = definition.decoder("reference")
        self.heard_ns = 0  # end of the last byte

    def feed(self, received: bytes, end_ns: int) -> list[Request]:
        """Return commands completed by these bytes, the last of which ends at ``end_ns``."""
        self.heard_ns = end_ns
        return _requests(self._decoder.feed(received))

    def silence(self) -> list[Request]:
        """Nothing came for longer than a frame may be interrupted: what was begun is given up, search goes on in it."""
        return _requests(self._decoder.finish())


def _requests(batch: FrameBatch) -> list[Request]:
    commands = batch.messages["command"]
    columns = zip(
        *(commands.raw(name) for name in ("destination", "source", "sequence", "command", "payload")), strict=True
    )
    return [
        Request(int(source), int(sequence), int(command), bytes(payload))
        for destination, source, sequence, command, payload in columns
        if destination == BOARD
    ]


@dataclass
class Stream:
    """One running stream.

    ``start_ns``: bench time of the first sample; ``tick_us``: the module's clock then. ``error``: relative error of
    that clock, constant during the stream. ``limit``: samples to send, 0 = until stopped.
    ``counted``: samples of earlier streams since the boot; the counter goes on behind them.
    """

    module: GncModule
    sensors: int
    rate_Hz: int
    limit: int
    start_ns: int
    tick_us: float
    error: float
    destination: int
    counted: int
    sent: int = 0

    def send(self, upto_ns: int, port: Port, definition: FrameDefinition) -> None:
        """Take and send all samples due at ``upto_ns``."""
        due = self._due(upto_ns)
        while self.sent < due:
            number = np.arange(self.sent, min(due, self.sent + AT_ONCE), dtype=np.int64)
            t_ns = self._times_ns(number)
            port.append(t_ns + MADE_NS, definition.encode(self._columns(number, t_ns), len(number), "stream"))
            self.sent += len(number)

    @property
    def over(self) -> bool:
        """Whether all samples asked for are sent."""
        return bool(self.limit) and self.sent >= self.limit

    def _due(self, upto_ns: int) -> int:
        if upto_ns < self.start_ns:
            return 0
        due = int((upto_ns - self.start_ns) / NS * (1.0 + self.error) * self.rate_Hz) + 2
        while due and int(self._times_ns(np.array([due - 1]))[0]) > upto_ns:
            due -= 1
        return min(due, self.limit) if self.limit else due

    def _times_ns(self, number: Integers) -> Integers:
        """Return bench times of samples: the module counts its own seconds, shorter ones if its clock is fast."""
        own_ns = number * (NS / self.rate_Hz)
        return self.start_ns + np.rint(own_ns / (1.0 + self.error)).astype(np.int64)

    def _columns(self, number: Integers, t_ns: Integers) -> dict[str, object]:
        counts = self.module.samples(t_ns, NS // self.rate_Hz)
        tick_us = np.rint(self.tick_us + number * (US / self.rate_Hz)).astype(np.int64)
        return {
            "destination": self.destination,
            "source": 0x10,
            "sequence": 0,
            "command": STREAM_COMMAND,
            "counter": ((self.counted + number) % 2**32).astype(np.uint32),
            "tick": (tick_us % 2**32).astype(np.uint32),
            "gyro": counts.gyro * bool(self.sensors & GYRO),
            "accel": counts.accel * bool(self.sensors & ACCELEROMETER),
            "mag": counts.mag * bool(self.sensors & MAGNETOMETER),
            "temperature": counts.temperature,
        }
