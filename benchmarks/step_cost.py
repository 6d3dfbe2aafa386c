"""What one step of a sequence costs, without instrument traffic: this sequencer, bluesky, and one pyvisa call.

The steps are those of the 38-hour campaign (calls, verifications and settle times; no records) under the virtual
clock, each with its flushed journal line and its event. bluesky does checkpoint, mv and trigger_and_read with devices
that do nothing and no callback: it writes no journal. The journal line is also shown alone, and against what it is at
least: its fields dumped and written. The pyvisa call is a query answered by pyvisa-sim.

Run: python -m benchmarks.step_cost. bluesky is shown where it is installed (extra ``benchmark``).
"""

from __future__ import annotations

import json
import os
import sys
from collections.abc import Callable, Iterator, Mapping
from dataclasses import replace
from functools import partial
from pathlib import Path
from tempfile import TemporaryDirectory
from time import process_time
from types import MappingProxyType
from typing import Any, cast

from bench.model.clock import NS, VirtualClock
from bench.plan import Plan, compile_sequence
from bench.record import Journal
from bench.run.context import RunContext, Timeline
from bench.run.sequencer import Sequencer
from bench.run.stop import StopSwitch

KINDS = ("call", "verify", "settle")
PEER_STEPS = 500
QUERIES = 2_000


class Nothing:
    """An instrument, sink, listener or link that takes every call and answers True at once; it has no output to ask."""

    readers: Mapping[str, Any] = MappingProxyType({})
    look = quick = None

    def __getattr__(self, name: str) -> Callable[..., bool]:
        return _yes


def _yes(*_: object, **__: object) -> bool:
    return True


def steps_without_records(plan: Plan) -> Plan:
    """The steps of the campaign that need no unit under test, renumbered."""
    chosen = [step for step in plan.steps if step.phase == "campaign" and step.kind in KINDS]
    return replace(plan, steps=tuple(replace(step, number=number) for number, step in enumerate(chosen)))


def own_steps(plan: Plan, folder: Path) -> float:
    """CPU seconds of one run through the sequencer, from an open journal to the end."""
    clock, stop, nothing = VirtualClock(), StopSwitch(), cast(Any, Nothing())
    roles = {step.role for step in plan.steps if step.role}
    context = RunContext(
        plan=plan, instruments=dict.fromkeys(roles, nothing), acquisition=nothing, cutters={}, clock=clock,
        observers=nothing, operator=nothing, stop=stop, timeline=Timeline(clock, stop, 0),
        measurement_link=plan.measurement_link, watched=lambda context: nothing,
    )  # fmt: skip
    journal = Journal(folder)
    sequencer = Sequencer(context, journal, ())
    start = process_time()
    outcome = sequencer.run()
    spent = process_time() - start
    journal.close()
    journal.path.unlink()
    if outcome.error is not None or outcome.steps_done != len(plan.steps):
        raise SystemExit(f"the run stopped after {outcome.steps_done} steps: {outcome.error}")
    return spent


def journal_lines(plan: Plan, folder: Path) -> float:
    """CPU seconds of the journal lines alone."""
    journal = Journal(folder)
    start = process_time()
    for step in plan.steps:
        journal.step(step.number, step.phase, step.number * NS, step.conditions)
    spent = process_time() - start
    journal.close()
    journal.path.unlink()
    return spent


def bare_lines(plan: Plan, folder: Path) -> float:
    """CPU seconds of the same fields through json.dumps and one write each."""
    descriptor = os.open(folder / "bare", os.O_WRONLY | os.O_CREAT | os.O_APPEND)
    start = process_time()
    for step in plan.steps:
        fields = {"c": step.conditions, "n": step.number, "p": step.phase, "t": step.number * NS}
        os.write(descriptor, (json.dumps(fields) + "\n").encode())
    spent = process_time() - start
    os.close(descriptor)
    return spent


class DoneStatus:
    """A bluesky status that was done and successful from the start."""

    done, success, timeout = True, True, None

    def add_callback(self, callback: Callable[[DoneStatus], None]) -> None:
        """Call back at once."""
        callback(self)

    def exception(self, timeout: float | None = None) -> None:
        """No exception."""


class NullDevice:
    """A bluesky device that moves, triggers and reads without doing anything."""

    parent = None

    def __init__(self, name: str) -> None:
        self.name = name
        self.hints = {"fields": [name]}
        self.position = 0.0

    def set(self, value: float) -> DoneStatus:
        """Arrive at once."""
        self.position = value
        return DoneStatus()

    def trigger(self) -> DoneStatus:
        """Be done at once."""
        return DoneStatus()

    def read(self) -> dict[str, Any]:
        """One reading."""
        return {self.name: {"value": self.position, "timestamp": 0.0}}

    def describe(self) -> dict[str, Any]:
        """One number."""
        return {self.name: {"source": "null", "dtype": "number", "shape": []}}

    def read_configuration(self) -> dict[str, Any]:
        """No configuration."""
        return {}

    def describe_configuration(self) -> dict[str, Any]:
        """No configuration."""
        return {}


def bluesky_steps(count: int) -> float:
    """CPU seconds of ``count`` bluesky steps; the cost of starting and ending a run is taken off."""
    from bluesky import RunEngine
    from bluesky import plan_stubs as stubs
    from bluesky.preprocessors import run_decorator

    motor, detector = NullDevice("motor"), NullDevice("detector")
    engine = RunEngine({})

    @run_decorator()
    def scan(steps: int) -> Iterator[Any]:
        for number in range(steps):
            yield from stubs.checkpoint()
            yield from stubs.mv(motor, float(number))
            yield from stubs.trigger_and_read([detector, motor])

    def spent(steps: int) -> float:
        start = process_time()
        engine(scan(steps))
        return process_time() - start

    spent(50)
    return spent(count + 50) - spent(50)


def pyvisa_queries(count: int) -> float:
    """CPU seconds of ``count`` identity queries through pyvisa and pyvisa-sim's own example instrument."""
    import pyvisa

    opened = pyvisa.ResourceManager("@sim")
    try:
        resource = cast(Any, opened.open_resource("ASRL1::INSTR", read_termination="\n", write_termination="\r\n"))
        start = process_time()
        for _ in range(count):
            resource.query("?IDN")
        return process_time() - start
    finally:
        opened.close()


def microseconds(work: Callable[[], float], count: int, repeats: int = 5) -> float:
    """Least CPU time of a few passes, microseconds per step."""
    return min(work() for _ in range(repeats)) / count * 1e6


def lines(rows: Mapping[str, float]) -> list[str]:
    """The table, with the first row as the unit of comparison."""
    first = next(iter(rows.values()))
    table = [f"{'way':<58}{'us/step':>10}{'x ours':>10}"]
    return table + [f"{name:<58}{cost:>10.1f}{cost / first:>10.1f}" for name, cost in rows.items()]


def main() -> None:
    """Print one table."""
    plan = steps_without_records(compile_sequence("scale_factor_38h"))
    count = len(plan.steps)
    with TemporaryDirectory() as folder:
        ways = {
            "this sequencer, journal line flushed": own_steps,
            "its journal line alone": journal_lines,
            "the fields of that line, bare json.dumps and write": bare_lines,
        }
        rows = {name: microseconds(partial(way, plan, Path(folder)), count) for name, way in ways.items()}
    rows["one pyvisa query answered by pyvisa-sim"] = microseconds(lambda: pyvisa_queries(QUERIES), QUERIES, 3)
    try:
        peer = microseconds(lambda: bluesky_steps(PEER_STEPS), PEER_STEPS, 2)
        rows["bluesky checkpoint + mv + trigger_and_read, no journal"] = peer
    except ImportError:
        sys.stdout.write("bluesky is not installed: left out\n")
    sys.stdout.write("\n".join([f"{count} steps of the 38-hour campaign, CPU time", *lines(rows)]) + "\n")


if __name__ == "__main__":
    main()
