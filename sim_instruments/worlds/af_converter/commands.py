"""Commands the simulated unit takes on port B, by number, and the texts of its answers."""

from __future__ import annotations

from dataclasses import dataclass
from enum import IntEnum

from bench.frame import FrameDefinition
from sim_instruments.worlds.af_converter.framer import Mode

IDENTITY = b"NGU SIM-1 1.0"  # model, serial number, firmware


class Command(IntEnum):
    """Command numbers of the unit."""

    IDENTIFY = 1  # answer: IDENTITY
    START_STREAM = 2  # payload: one byte of START_MODES, none means 100 Hz
    STOP_STREAM = 3
    ZERO_COUNTERS = 4  # frame counters of both ports start again at 0


class Status(IntEnum):
    """Status byte of an answer."""

    DONE = 0
    UNKNOWN_COMMAND = 1
    BAD_PAYLOAD = 2


START_MODES = {b"": Mode.GATES, b"\x64": Mode.GATES, b"\x00": Mode.INTEGRATED}


@dataclass(frozen=True)
class Request:
    """A command as it came: its number, which may be unknown, and its payload."""

    command: int
    payload: bytes

    def verdict(self) -> Status:
        """Return whether the unit can do it."""
        if self.command not in tuple(Command):
            return Status.UNKNOWN_COMMAND
        allowed = START_MODES if self.command == Command.START_STREAM else (b"",)
        return Status.DONE if self.payload in allowed else Status.BAD_PAYLOAD


class CommandReader:
    """Finds commands in the bytes sent to the unit; bytes with a wrong check are passed over, as the unit does."""

    def __init__(self, definition: FrameDefinition) -> None:
        self._decoder = definition.decoder("reference")

    def feed(self, sent: bytes) -> list[Request]:
        """Return commands completed by these bytes, in order."""
        found = self._decoder.feed(sent).messages.get("command")
        if found is None:
            return []
        numbers, payloads = found.raw("command"), found.raw("payload")
        return [Request(int(number), bytes(payload)) for number, payload in zip(numbers, payloads, strict=True)]
