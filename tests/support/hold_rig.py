"""The fake bench of run_rig with points as a campaign has them, and somebody beside the sequencer."""

from __future__ import annotations

from collections.abc import Callable
from contextlib import AbstractContextManager, ExitStack
from pathlib import Path
from types import SimpleNamespace

from run_rig import Instrument, Rig

from bench.model.ports import Effect, action
from bench.model.quality import Quality
from bench.record import Journal
from bench.run.context import RunContext
from bench.run.sequencer import Outcome, Sequencer

SETTLE_S, RECORD_S = 5.0, 10.0
Beside = Callable[[RunContext], AbstractContextManager[object]]


class Source(Instrument):
    """Drives a stimulus: made safe whenever the run stands still. ``level_A`` is what it gives now."""

    level_A = 0.0

    @action(effect=Effect.STIMULUS_ON)
    def operate(self, level: float) -> None:
        self._call("operate", level)
        self.level_A = level

    def make_safe(self) -> None:
        super().make_safe()
        self.level_A = 0.0


class Passive(Instrument):
    """Drives nothing: left alone while the run stands still."""

    operate = None  # type: ignore[assignment]


class HoldRig(Rig):
    """A source, a switch and a supply; ``points`` measuring points, each with a level of its own."""

    never_armed = ""  # what the station declares of arming

    def __init__(self, folder: Path, points: int) -> None:
        super().__init__(folder)
        self.source = Source("source", self)
        self.instruments = {"source": self.source, "supply": Passive("supply", self)}
        for number in range(points):
            first = len(self.steps)
            self.step("call", "source", "operate", level=1.0 + number)
            self.step("settle", duration_s=SETTLE_S, bus_s=0.5)
            conditions = {"channel": 1, "point": number}
            self.step(
                "record", "port_a", seconds=RECORD_S, retry=1, max_lost=0.0, retry_step=first, conditions=conditions
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
