"""A test board made from the text of the protocol alone: own packing, own search for frames, the CRC of the library."""

import binascii
import struct
from collections import Counter
from collections.abc import Callable
from pathlib import Path
from types import SimpleNamespace
from typing import Any

from plan_sample import planned
from run_rig import Listener, Operator, Sink

from bench.frame import load_frame
from bench.model.clock import NS, Clock
from bench.model.ports import ByteLink
from bench.plan import Step
from bench.run.bus.acquisition import Acquisition
from bench.run.bus.reader import LinkReader
from bench.run.context import RunContext, Timeline
from bench.run.observers import AtTerminal, Observers, Recorder
from bench.run.stop import StopSwitch
from bench.run.watch.interlocks import InterlockWatch

FRAMES = Path(__file__).resolve().parents[2] / "frames"
IDENTIFY, MEMORY, SCI = 0x01, 0x12, 0x18
PASS, BUSY, UNKNOWN = 0, 2, 3
ANSWER, REFUSAL = 0x81, 0x7F
SILENCE_NS = 50_000_000
LONGEST = 1024
WHO = b"\x01GTB-1       GNC-1       \x01\x00"


def wire(kind: int, sequence: int, command: int, payload: bytes) -> bytes:
    """A frame of the board."""
    body = struct.pack("<6BH", 1, 0x01, 0x10, sequence, kind, command, len(payload)) + payload
    return b"\xeb\x90" + body + struct.pack("<H", binascii.crc_hqx(body, 0xFFFF))


class Board:
    """Takes bytes, gives frames; ``done`` counts what was executed, by code and payload.

    A number that was answered last is answered again from memory. ``says`` may replace what an execution gives.
    """

    def __init__(self) -> None:
        self.done: Counter[tuple[int, bytes]] = Counter()
        self.numbers: list[int] = []  # of what was executed
        self.repeated = 0
        self.says: Callable[[int, bytes], tuple[int, int, bytes]] | None = None
        self._bytes = b""
        self._last_ns = 0
        self._remembered: tuple[int, bytes] = (-1, b"")

    def take(self, chunk: bytes, now_ns: int) -> list[bytes]:
        """The answers to what has come."""
        if self._bytes and now_ns - self._last_ns > SILENCE_NS:
            self._bytes = b""
        self._bytes, self._last_ns = self._bytes + chunk, now_ns
        answers = []
        while (frame := self._next()) is not None:
            answers.append(self._answered(frame))
        return answers

    def _next(self) -> bytes | None:
        while len(self._bytes) >= 12:
            length = struct.unpack_from("<H", self._bytes, 8)[0]
            if not self._bytes.startswith(b"\xeb\x90") or length > LONGEST:
                self._bytes = self._bytes[1:]
                continue
            if len(self._bytes) < length + 12:
                return None
            frame = self._bytes[: length + 12]
            if _right(frame):
                self._bytes = self._bytes[length + 12 :]
                return frame
            self._bytes = self._bytes[1:]
        return None

    def _answered(self, frame: bytes) -> bytes:
        sequence, command, payload = frame[5], frame[7], frame[10:-2]
        if sequence == self._remembered[0]:
            self.repeated += 1
            return self._remembered[1]
        kind, status, told = self._execute(command, payload)
        answer = wire(kind, sequence, command, bytes([status]) + told)
        self._remembered = (sequence, answer)
        self.numbers.append(sequence)
        return answer

    def _execute(self, command: int, payload: bytes) -> tuple[int, int, bytes]:
        self.done[command, payload] += 1
        if self.says is not None:
            return self.says(command, payload)
        if command == IDENTIFY:
            return ANSWER, PASS, WHO
        if command in (SCI, MEMORY):
            return ANSWER, PASS, payload
        return REFUSAL, UNKNOWN, b""


def _right(frame: bytes) -> bool:
    return bool(binascii.crc_hqx(frame[2:-2], 0xFFFF) == struct.unpack("<H", frame[-2:])[0])


class VirtualLine:
    """A line under the virtual clock: what the board answers arrives ``delay_s`` later.

    ``passes`` takes the number of a frame from the host and its bytes: what of it reaches the board; ``returns`` does
    the same with an answer: what arrives, each part with its delay in seconds.
    """

    def __init__(self, clock: Clock, board: Board) -> None:
        self.clock, self.board = clock, board
        self.written: list[bytes] = []
        self.answered: list[bytes] = []
        self.passes: Callable[[int, bytes], bytes] = lambda number, frame: frame
        self.returns: Callable[[int, bytes], list[tuple[float, bytes]]] = lambda number, frame: [(0.001, frame)]
        self.broken: OSError | None = None
        self._coming: list[tuple[int, bytes]] = []

    @property
    def in_waiting(self) -> int:
        return sum(len(part) for due_ns, part in self._coming if due_ns <= self.clock.now_ns())

    def read(self, size: int = 1) -> bytes:
        if self.broken is not None:
            raise self.broken
        now_ns = self.clock.now_ns()
        here = [one for one in self._coming if one[0] <= now_ns]
        self._coming = [one for one in self._coming if one[0] > now_ns]
        return b"".join(part for _, part in sorted(here, key=lambda one: one[0]))

    def write(self, sent: bytes) -> int:
        if self.broken is not None:
            raise self.broken
        self.written.append(sent)
        arrived = self.passes(len(self.written), sent)
        for answer in self.board.take(arrived, self.clock.now_ns()) if arrived else []:
            self.answered.append(answer)
            for delay_s, part in self.returns(len(self.answered), answer):
                self.say(delay_s, part)
        return len(sent)

    def say(self, delay_s: float, part: bytes) -> None:
        """Bytes that arrive later."""
        self._coming.append((self.clock.now_ns() + round(delay_s * NS), part))

    def close(self) -> None:
        return None


def context_of(clock: Clock, link: ByteLink, steps: tuple[Step, ...] = ()) -> RunContext:
    """A run with one link, and nothing else."""
    sink, stop = Sink(), StopSwitch()
    reader = LinkReader("rs422", link, load_frame(FRAMES / "gnc_422.yaml"), clock, sink)
    acquisition = Acquisition({"rs422": reader}, clock, lambda t_ns: None, stop)
    plan: Any = SimpleNamespace(
        steps=steps, campaign={}, station=SimpleNamespace(safe_order=()), units=(), unit_of=lambda name: None
    )
    return RunContext(
        plan, {}, acquisition, {}, clock, Observers(clock, Recorder(sink), AtTerminal(Listener())), Operator(),
        stop, Timeline(clock, stop, clock.now_ns()), "rs422", lambda context: InterlockWatch((), context),
    )  # fmt: skip


def unit_step(number: int, name: str, command: int, payload: bytes = b"", item: str = "", **more: Any) -> Step:
    """A step as the plan makes it; with an item it is a test."""
    arguments = {"command": command, "payload": tuple(payload), "timeout": more.pop("timeout", 0.2)}
    arguments |= {"item": item} if item else {}
    return planned("unit", number, role="rs422", name=name, conditions=more, **arguments)


def events(context: RunContext, kind: str) -> list[dict[str, Any]]:
    """The events of a kind, in order."""
    sink: Any = context.acquisition.readers["rs422"].sink
    return [fields for found, _, fields in sink.events if found == kind]
