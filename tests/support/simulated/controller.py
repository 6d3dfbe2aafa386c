"""Conducts one sequence on a served bench with a guard: station, sequence, folder, and what to do at the first mark.

Acts: "none"; "slow": who is asked answers after a while; "hang": the sequencer's thread blocks for a minute; "blind":
it never reads the chamber's air itself; "late_disk": the next two fsyncs, of session and step journal, take 8 s each.
"""

import os
import sys
import time
from collections.abc import Callable
from pathlib import Path

from bench.model.clock import WallClock
from bench.plan import Step, check_plan, compile_sequence, load_station
from bench.run.guard.guarding import guard_beside
from bench.run.guard.temperatures import TemperatureWatch
from bench.run.operator import Answer, Question
from bench.run.session import conduct

HANG_S, ANSWER_S, FSYNC_S = 60.0, 5.0, 8.0
MARK = "operate"


class Listener:
    """Says which step begins; hangs where it is told to."""

    def __init__(self, act: str) -> None:
        self._act = act
        self._marked = False
        self._late = 2 if act == "late_disk" else 0

    def fsync(self, descriptor: int, plain: Callable[[int], None] = os.fsync) -> None:
        """A disk that is late for a while."""
        if self._marked and self._late:
            self._late -= 1
            time.sleep(FSYNC_S)
        plain(descriptor)

    def step(self, step: Step, at_s: float) -> None:
        if self._marked and self._act == "hang":
            print("hanging", flush=True)
            time.sleep(HANG_S)
        self._marked = self._marked or step.name == MARK
        print(f"step {step.number} {step.name} at {at_s:.3f} s", flush=True)

    def record(self, row: object) -> None:
        return None

    def message(self, text: str) -> None:
        print(text, flush=True)


class Operator:
    """Answers at once or, if slow, after a while."""

    def __init__(self, slow: bool) -> None:
        self._slow = slow

    def ask(self, question: Question) -> Answer:
        print("asked", flush=True)
        if self._slow:
            time.sleep(ANSWER_S)
        return Answer("somebody")


def main(station: str, sequence: str, out: str, act: str = "none") -> int:
    if act == "blind":
        TemperatureWatch.read = lambda self: None  # type: ignore[method-assign]
    plan = compile_sequence(Path(sequence), load_station(Path(station)), {})
    assert not (findings := check_plan(plan)), findings
    listener = Listener(act)
    os.fsync = listener.fsync  # type: ignore[assignment]
    run = conduct(
        plan, clock=WallClock(), seed=1, out=Path(out), operator=Operator(act == "slow"), listener=listener,
        beside=[guard_beside(plan.station)],
    )  # fmt: skip
    error = run.outcome.error
    print(f"ended: {error or 'done'}; unsafe: {[str(one) for one in run.outcome.unsafe]}", flush=True)
    return 0 if error is None else int(error.exit_status)


if __name__ == "__main__":
    sys.exit(main(*sys.argv[1:]))
