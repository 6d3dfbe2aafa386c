"""Ctrl-C once or twice and SIGTERM at random instants of a run in real time: safe within 5 s, session closed."""

import os
import signal
import threading
from collections.abc import Callable, Iterator
from pathlib import Path

import numpy as np
import pytest
from rehearsal import ROOT, Rehearsal, Watched, assert_safe, rehearsed

from bench.model.clock import NS, WallClock
from bench.plan import Plan, compile_sequence
from bench.record import SessionReader
from bench.record.layout import INSTRUMENT
from bench.record.writer import OPEN_MARKER

pytestmark = pytest.mark.waits

SAFE_S = 5.0
OFF = {"calibrator": "STBY", "switch": ":OPEN ALL", "supply": "OUTP OFF"}
EARLY = (0, 3, 11)  # SIGTERM and SIGINT behind it, SIGINT, SIGTERM
LATEST_S = 9.0  # after the first step: preparation, wiring check, soak, the first points


@pytest.fixture(scope="module")
def plan() -> Plan:
    return compile_sequence(ROOT / "sequences" / "scale_factor_wall_30s.yaml", None, {})


@pytest.fixture(autouse=True)
def _deaf() -> Iterator[None]:
    """A signal that comes when the run is over already ends no test."""
    before = {number: signal.signal(number, signal.SIG_IGN) for number in (signal.SIGINT, signal.SIGTERM)}
    yield
    for number, handler in before.items():
        signal.signal(number, handler)


class Signals(Watched):
    """Listener that sends signals: (seconds after the first step, which) in order of time."""

    def __init__(self, due: list[tuple[float, signal.Signals]], clock: WallClock) -> None:
        super().__init__()
        self._due, self._clock = due, clock
        self.sent_ns: list[int] = []
        self.over = threading.Event()
        self._thread = threading.Thread(target=self._send)

    def step(self, *_: object) -> None:
        if not self._thread.is_alive() and not self.sent_ns:
            self._began_ns = self._clock.now_ns()
            self._thread.start()
            self.step: Callable[..., None] = lambda *_: None  # type: ignore[method-assign]

    def _send(self) -> None:
        for at_s, which in self._due:
            left_s = at_s - (self._clock.now_ns() - self._began_ns) / NS
            if self.over.wait(max(0.0, left_s)):
                return
            self.sent_ns.append(self._clock.now_ns())
            os.kill(os.getpid(), which)

    def join(self) -> None:
        self.over.set()
        self._thread.join()


def stopped(plan: Plan, out: Path, seed: int) -> tuple[Rehearsal, Signals]:
    rng = np.random.default_rng(seed)
    due = [(float(rng.uniform(0.0, LATEST_S)), signal.Signals(int(rng.choice([signal.SIGINT, signal.SIGTERM]))))]
    if rng.random() < 0.5:
        due.append((due[0][0] + float(rng.exponential(0.3)), signal.SIGINT))
    print(f"seed {seed}: {due}")
    clock = WallClock()
    signals = Signals(due, clock)
    done = rehearsed(out, plan, clock=clock, seed=seed, watched=signals)
    signals.join()
    return done, signals


def last_off(reader: SessionReader) -> dict[str, int]:
    """When stimulus, relays and supply of the unit were told to be off the last time: they obey at once."""
    found = {}
    for message in reader.messages():
        role = message.topic.removeprefix(INSTRUMENT)
        if role in OFF and message.document() == {"direction": "tx", "text": OFF[role]}:
            found[role] = message.t_ns
    assert found.keys() == OFF.keys()
    return found


@pytest.mark.slow
@pytest.mark.parametrize(
    "seed", [*EARLY, *(pytest.param(n, marks=pytest.mark.sweep) for n in set(range(210)) - set(EARLY))]
)
def test_signals_at_random_instants(tmp_path: Path, plan: Plan, seed: int) -> None:
    done, signals = stopped(plan, tmp_path, seed)
    run = done.run
    assert run.outcome.error.code in ("B-RUN-010", "B-RUN-011")
    assert run.outcome.error.exit_status == 4
    assert run.outcome.unsafe == ()
    assert_safe(done.world)
    assert not (run.folder / OPEN_MARKER).exists()
    reader = SessionReader(run.folder, strict=True)
    took_s = {role: (t_ns - signals.sent_ns[0]) / NS for role, t_ns in last_off(reader).items()}
    (safe_ns,) = [t_ns for kind, t_ns, _ in run.events if kind == "safe"]
    print(f"off after {took_s} s, all confirmed after {(safe_ns - signals.sent_ns[0]) / NS} s")
    assert max(took_s.values()) <= SAFE_S
    closed = [fields["reason"] for _, _, fields in reader.events("closed")]
    assert closed == [run.outcome.error.code]
    assert reader.damage == []
    assert reader.unfinished == []
    assert reader.sha256 == run.session_sha256
