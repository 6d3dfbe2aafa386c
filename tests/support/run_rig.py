"""A bench for tests of the run room: fake instruments, a fake unit on two links, and a list of what happened.

Everything lives on one VirtualClock. The unit ends a gate each 10 ms and needs 0.6 ms to send its frame. A HoldRig has
points as a campaign has them, and somebody beside the sequencer.
"""

from collections.abc import Callable, Mapping
from contextlib import AbstractContextManager, ExitStack
from dataclasses import dataclass, field
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
from plan_sample import planned
from record_sample import frame

from bench.model.clock import NS, VirtualClock
from bench.model.errors import InstrumentError
from bench.model.ports import Effect, Identity, action
from bench.model.quantities import Quality
from bench.plan import Step
from bench.record import Journal, RecordCutter
from bench.run.bus.acquisition import Acquisition
from bench.run.bus.reader import LinkReader
from bench.run.context import RunContext, Timeline
from bench.run.observers import AtTerminal, Observers, Recorder
from bench.run.operator import Answer, Question
from bench.run.sequencer import Outcome, Sequencer
from bench.run.stop import StopSwitch
from bench.run.watch.interlocks import InterlockWatch

ROOT = Path(__file__).resolve().parents[2]
GATE_NS = NS // 100
LINE_NS = 600_000
K0_C = 1.25e-6
BLOCK = 1000  # frames that are encoded at once: a frame costs little, a call of the encoder much


class Instrument:
    """Notes every call with its time; ``fail`` maps a method to the error it raises, ``slow_s`` to its duration."""

    def __init__(self, role: str, rig: "Rig") -> None:
        self.role, self._rig = role, rig
        self.fail: dict[str, Exception] = {}
        self.slow_s: dict[str, float] = {}
        self.answers: dict[str, list[Any]] = {}

    def _call(self, name: str, *arguments: object) -> Any:
        self._rig.calls.append((self._rig.clock.now_ns() / NS, f"{self.role}.{name}", arguments))
        self._rig.clock.sleep(self.slow_s.get(name, 0.0))
        if name in self.fail:
            raise self.fail[name]
        queued = self.answers.get(name)
        return queued.pop(0) if queued else None

    @action(effect=Effect.STIMULUS_SET)
    def output(self, current: float) -> None:
        self._call("output", current)

    @action()
    def operating(self) -> bool:
        return self._call("operating") is not False

    @action(returns="degC")
    def measure(self) -> float | None:
        return self._call("measure")

    @action(effect=Effect.THERMAL)
    def set_temperature(self, temperature: float, ramp: float) -> None:
        self._call("set_temperature", temperature, ramp)

    @action(effect=Effect.THERMAL)
    def run(self) -> None:
        self._call("run")

    @action(returns="degC")
    def measure_air(self) -> float:
        self._call("measure_air")
        return self._rig.air_degC(self._rig.clock.now_ns() / NS)

    def raw(self, text: str) -> None:
        self._call("raw", text)

    def identify(self) -> Identity:
        return Identity("maker", self.role, "1", "1")

    def make_safe(self) -> None:
        self._call("make_safe")

    def close(self) -> None:
        self._call("close")


def nothing(counter: int) -> bool:
    """Drop no frame."""
    return False


class PortA:
    """Measurement link: per frame ``npp[channel]``, ``ppp[channel]``; counters in ``dropped`` never arrive.

    ``npp`` and ``ppp`` may have a row for each frame of a block.
    """

    def __init__(self, clock: VirtualClock) -> None:
        self.clock, self.definition = clock, frame("ngu_a")
        self.npp, self.ppp = np.zeros(10, np.int64), np.zeros(10, np.int64)
        self.dropped: Callable[[int], bool] = nothing
        self.broken: OSError | None = None
        self._bytes = bytearray()
        self._encoded: tuple[Any, Any] = (None, None)  # the newest block and what it holds
        self._next = 0  # first frame that has not arrived whole
        self._ahead = 0  # bytes of it that have arrived

    @property
    def in_waiting(self) -> int:
        if self.broken is not None:
            raise self.broken
        now = self.clock.now_ns()
        whole = max(self._next, (now - LINE_NS) // GATE_NS)
        arrived = self._frames(self._next, whole)
        since = now - (whole + 1) * GATE_NS
        started = self._frames(whole, whole + 1) if since > 0 else b""
        started = started[: len(started) * since // LINE_NS]
        self._bytes += (arrived + started)[self._ahead :]
        self._next, self._ahead = whole, len(started)
        return len(self._bytes)

    def _frames(self, first: int, stop: int) -> bytes:
        parts = []
        for start in range(first - first % BLOCK, stop, BLOCK):
            counters = range(max(first, start), min(stop, start + BLOCK))
            rows = self._block(start)[counters.start - start : counters.stop - start]
            if self.dropped is not nothing:
                rows = rows[[not self.dropped(counter) for counter in counters]]
            parts.append(rows.tobytes())
        return b"".join(parts)

    def _block(self, start: int) -> Any:
        """Return the frames of a block, (BLOCK, bytes); encoded anew when the counts have changed."""
        key = (start, self.npp.tobytes(), self.ppp.tobytes())
        if self._encoded[0] != key:
            columns = {
                "counter": np.arange(start, start + BLOCK) % 65536, "npp": np.broadcast_to(self.npp, (BLOCK, 10)),
                "ppp": np.broadcast_to(self.ppp, (BLOCK, 10)), "af_clock": 2560, "master_count": 100_000,
                "fg_count": 100_000, "status": 0,
            }  # fmt: skip
            self._encoded = (key, self.definition.encode(columns, BLOCK))
        return self._encoded[1]

    def read(self, size: int = 1) -> bytes:
        size = min(size, self.in_waiting)
        taken = bytes(self._bytes[:size])
        del self._bytes[:size]
        return taken

    def write(self, sent: bytes) -> int:
        return len(sent)

    def close(self) -> None:
        return None


class PortB:
    """Housekeeping each 100 ms from ``degC(seconds)``, and answers: ``answer`` maps a command to (status, delay_s)."""

    def __init__(self, clock: VirtualClock, degC: Callable[[float], float]) -> None:
        self.clock, self.definition, self.degC = clock, frame("ngu_b"), degC
        self.answer: dict[int, tuple[int, float]] = {}
        self.silent = False
        self.accepts: int | None = None
        self.written = b""
        self._pending: list[tuple[int, bytes]] = []
        self._count = 0
        self._bytes = bytearray()
        self._encoded: tuple[Any, Any] = (None, None)  # the newest block of one temperature

    @property
    def in_waiting(self) -> int:
        now = self.clock.now_ns()
        due = now // (10 * GATE_NS)
        if due > self._count and not self.silent:
            raw = [round(100 * self.degC(0.1 * moment)) for moment in range(self._count + 1, due + 1)]
            if len(set(raw)) == 1 and len(raw) <= BLOCK:
                key = (self._count // BLOCK, raw[0])
                if self._encoded[0] != key:
                    self._encoded = (key, self._housekeeping(key[0] * BLOCK, raw[:1] * 2 * BLOCK))
                self._bytes += self._encoded[1][self._count % BLOCK :][: len(raw)].tobytes()
            else:
                self._bytes += self._housekeeping(self._count, raw).tobytes()
        self._count = due
        for due_ns, raw in [one for one in self._pending if one[0] <= now]:
            self._bytes += raw
            self._pending.remove((due_ns, raw))
        return len(self._bytes)

    def _housekeeping(self, first: int, raw: list[int]) -> Any:
        columns = {
            "counter": np.arange(first, first + len(raw)) % 65536,
            "unit_temperature": np.tile(np.array(raw)[:, None], (1, 4)),
            "supply_voltage": 28000, "supply_current": 1800, "rails": np.tile([5000, 15000, 15000], (len(raw), 1)),
            "status": 1,
        }  # fmt: skip
        return self.definition.encode(columns, len(raw), "housekeeping")

    read = PortA.read
    close = PortA.close

    def say(self, command: int, status: int, delay_s: float = 0.0) -> None:
        raw = self.definition.encode_one({"command": command, "status": status, "payload": ()}, "answer")
        self._pending.append((self.clock.now_ns() + round(delay_s * NS), raw))

    def write(self, sent: bytes) -> int:
        self.written += sent
        for command, (status, delay_s) in self.answer.items():
            self.say(command, status, delay_s)
        return len(sent) if self.accepts is None else self.accepts


@dataclass
class Sink:
    events: list[tuple[str, int, dict[str, Any]]] = field(default_factory=list)
    sent: list[tuple[str, str, int]] = field(default_factory=list)

    def raw(self, link: str, direction: str, t_mono_ns: int, chunk: bytes) -> None:
        self.sent.append((link, direction, len(chunk)))

    def command(self, *_: object) -> None:
        return None

    def event(self, kind: str, t_mono_ns: int, fields: Mapping[str, Any]) -> None:
        self.events.append((kind, t_mono_ns, dict(fields)))


class Listener:
    """Notes messages; ``on_step`` is called at the beginning of each step."""

    def __init__(self) -> None:
        self.messages: list[str] = []
        self.steps: list[int] = []
        self.on_step: Callable[[Step], None] = lambda step: None

    def step(self, step: Step, at_s: float) -> None:
        self.steps.append(step.number)
        self.on_step(step)

    def record(self, row: object) -> None:
        return None

    def message(self, text: str) -> None:
        self.messages.append(text)


class Operator:
    """Answers with ``value``, or does what ``act`` does."""

    def __init__(self) -> None:
        self.value: float | None = None
        self.act: Callable[[], None] = lambda: None

    def ask(self, question: Question) -> Answer:
        self.act()
        return Answer("somebody", self.value)


class Rig:
    """The whole fake bench; ``run`` executes steps that were made with ``step``."""

    def __init__(self, folder: Path, *roles: str) -> None:
        self.clock, self.folder = VirtualClock(), folder
        self.calls: list[tuple[float, str, tuple[object, ...]]] = []
        self.air_degC: Callable[[float], float] = lambda t_s: 20.0
        self.unit_degC: Callable[[float], float] = lambda t_s: 20.0
        self.instruments = {role: Instrument(role, self) for role in roles}
        self.port_a = PortA(self.clock)
        self.port_b = PortB(self.clock, lambda t_s: self.unit_degC(t_s))  # noqa: PLW0108 - a test may change it
        self.sink, self.listener, self.operator, self.stop = Sink(), Listener(), Operator(), StopSwitch()
        self.steps: list[Step] = []
        self.ticks: list[int] = []
        self.watched: Callable[[RunContext], InterlockWatch] = lambda context: InterlockWatch((), context)
        self.on_tick: Callable[[int], None] = self.ticks.append
        self.safe_order: tuple[str, ...] = ()  # of what is switched off when the run stands still
        self._at_s = 0.0

    def step(self, kind: Any, role: str = "", name: str = "", *, phase: Any = "campaign", **arguments: Any) -> Step:
        """Append a step; ``duration_s`` and ``conditions`` are taken out of the arguments."""
        if self.steps and self.steps[-1].phase != phase:
            self._at_s = 0.0
        duration_s = float(arguments.pop("duration_s", arguments.get("seconds", arguments.get("slot", 0.0))))
        conditions = arguments.pop("conditions", {})
        made = planned(
            kind, len(self.steps), phase=phase, at_s=self._at_s, duration_s=duration_s, role=role, name=name,
            conditions=conditions, **arguments,
        )  # fmt: skip
        self.steps.append(made)
        self._at_s += duration_s
        return made

    def context(self) -> RunContext:
        plan: Any = SimpleNamespace(
            steps=tuple(self.steps),
            phase=lambda phase: tuple(step for step in self.steps if step.phase == phase),
            measurement_link="port_a",
            interlocks=(),
            units=(),
            unit_of=lambda name: None,
            station=SimpleNamespace(safe_order=self.safe_order, never_armed=""),
            campaign={"rate_Hz": 100.0, "channels": [{"number": n, "k0_C": K0_C} for n in range(1, 11)]},
        )
        cutter = RecordCutter(self.port_a.definition)
        readers = {
            name: LinkReader(name, port, port.definition, self.clock, self.sink, [feed])
            for name, port, feed in (
                ("port_b", self.port_b, cutter.feed_context), ("port_a", self.port_a, cutter.feed)
            )
        }  # fmt: skip
        tick = lambda t_ns: self.on_tick(t_ns)  # noqa: E731, PLW0108 - a test may change it
        acquisition = Acquisition(readers, self.clock, tick, self.stop)
        observers = Observers(self.clock, Recorder(self.sink), AtTerminal(self.listener))
        return RunContext(
            plan, dict(self.instruments), acquisition, {"port_a": cutter}, self.clock, observers, self.operator,
            self.stop, Timeline(self.clock, self.stop, self.clock.now_ns()), "port_a", self.watched,
        )  # fmt: skip

    def run(self, safe_order: tuple[str, ...] = (), operate: Callable[[str, Any], None] | None = None) -> Outcome:
        journal = Journal(self.folder)
        self.ran = self.context()
        self.ran.operate = operate or self.ran.operate
        outcome = Sequencer(self.ran, journal, safe_order).run()
        journal.close()
        return outcome

    def events(self, kind: str) -> list[dict[str, Any]]:
        return [fields for found, _, fields in self.sink.events if found == kind]

    def called(self, name: str) -> list[float]:
        """Times of all calls of ``role.method``."""
        return [at_s for at_s, found, _ in self.calls if found == name]


def instrument_error(code: str = "B-INST-001") -> InstrumentError:
    return InstrumentError(code, "no answer", where="fake")


SETTLE_S, RECORD_S = 5.0, 10.0
Beside = Callable[[RunContext], AbstractContextManager[object]]


class Source(Instrument):
    """Drives a stimulus: made safe whenever the run stands still."""

    @action(effect=Effect.STIMULUS_ON)
    def operate(self, level: float) -> None:
        self._call("operate", level)


class Passive(Instrument):
    """Drives nothing: left alone while the run stands still."""

    operate = None  # type: ignore[assignment]


class HoldRig(Rig):
    """A source, a switch and a supply; ``points`` measuring points, each with a level of its own.

    ``flat``: each step stands alone, as in a timeline, so that a record is taken again without the steps before it.
    """

    never_armed = ""  # what the station declares of arming

    def __init__(self, folder: Path, points: int, *, flat: bool = False) -> None:
        super().__init__(folder)
        self.source = Source("source", self)
        self.instruments = {"source": self.source, "supply": Passive("supply", self)}
        for number in range(points):
            first = len(self.steps)
            self.step("call", "source", "operate", level=1.0 + number)
            self.step("settle", duration_s=SETTLE_S, bus_s=0.5)
            conditions = {"channel": 1, "point": number}
            again = len(self.steps) if flat else first
            self.step(
                "record", "port_a", seconds=RECORD_S, retry=1, max_lost=0.0, retry_step=again, conditions=conditions
            )
            self.step("verify", "source", "operating")

    def run_beside(self, *besides: Beside) -> Outcome:
        """Run with somebody beside the sequencer, who is left before anybody looks at the outcome."""
        context = self.ran = self.context()
        context.folder = self.folder
        roles = tuple(self.instruments)
        context.plan.station = SimpleNamespace(safe_order=roles, never_armed=self.never_armed)  # type: ignore[misc]
        context.plan.link_bytes_s = 1000.0  # type: ignore[misc]
        journal = Journal(self.folder)
        with ExitStack() as stack:
            for beside in besides:
                stack.enter_context(beside(context))
            outcome = Sequencer(context, journal, roles).run()
        journal.close()
        return outcome

    def at(self, t_s: float, act: Callable[[], object]) -> None:
        """Do something once, at a moment of the bench clock."""
        done: list[object] = []

        def once() -> None:
            if not done:
                done.append(act())

        self.clock.every(t_s, once)


def sound(rig: HoldRig, points: int) -> None:
    """Every point has exactly one whole record, in order, taken with its own level on and after its settle time."""
    rows = [row for _, row in sorted(rig.ran.rows.items())]
    assert [row.window.conditions["point"] for row in rows] == list(range(points))
    assert [row.window.number for row in rows] == list(range(1, points + 1))
    changes = [
        (t_s, a[0] if a else 0.0) for t_s, name, a in rig.calls if name in ("source.operate", "source.make_safe")
    ]
    for row in rows:
        assert (row.frames, row.lost, row.quality) == (100 * RECORD_S, 0, Quality.GOOD)
        began_s, ended_s = row.window.t_start_ns / 1e9, row.window.t_end_ns / 1e9
        before = [(t_s, level) for t_s, level in changes if t_s <= ended_s]
        assert before[-1][1] == 1.0 + row.window.conditions["point"]  # on, and not touched during the record
        assert began_s - before[-1][0] >= SETTLE_S - 0.5 - 1e-9
