"""Real pseudo-terminals under the wall clock: a port that goes and comes back or is shared, a disk that stalls."""

import os
import pty
import subprocess
import sys
import threading
import time
import tty
from collections.abc import Callable, Iterator
from contextlib import ExitStack
from functools import partial
from itertools import pairwise
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import pytest
from plan_sample import planned
from record_sample import FaultyFiles, frame

from bench.frame import FrameDefinition, LinkDecoder
from bench.model.clock import NS, WallClock, to_ns
from bench.model.events import Event
from bench.record import SessionReader, SessionWriter
from bench.record.layout import OsFiles
from bench.run.bus.acquisition import Acquisition
from bench.run.bus.opener import open_port
from bench.run.bus.port import PortLink
from bench.run.bus.reader import LinkReader
from bench.run.context import Decided
from bench.run.links.keeper import keep_links
from bench.run.observers import Observers
from bench.run.steps.recording import silent
from bench.run.stop import LINKS, Health, StopSwitch

pytestmark = pytest.mark.waits

LINKS_OF_UNIT = {"port_b": "ngu_b", "port_a": "ngu_a"}
DETECT_S = 1.0
RESUME_S = 5.0
RECORD = planned("record", 7, duration_s=1.0)


CONSTANT: dict[str, dict[str, Any]] = {
    "ngu_a": {
        "npp": [[0] * 10], "ppp": [[0] * 10], "af_clock": 2560, "master_count": 100_000, "fg_count": 100_000,
        "status": 0,
    },
    "ngu_b": {
        "unit_temperature": [[2000] * 4], "supply_voltage": 28_000, "supply_current": 1800, "rails": [[5000] * 3],
        "status": 1,
    },
}  # fmt: skip


def frame_bytes(definition: FrameDefinition, counter: int) -> bytes:
    message = "frame" if definition.name == "ngu_a" else "housekeeping"
    columns = {**CONSTANT[definition.name], "counter": counter % 65536}
    return bytes(definition.encode(columns, 1, message).tobytes())


class Unit:
    """A unit that streams on a thread of its own; each line can be unplugged and come back under the same name."""

    def __init__(self, folder: Path, clock: WallClock) -> None:
        self.clock = clock
        self.definitions = {link: frame(name) for link, name in LINKS_OF_UNIT.items()}
        self.names = {name: folder / name for name in self.definitions}
        self.sent = dict.fromkeys(self.definitions, 0)
        self.instead: dict[str, bytes] = {}
        self.far: dict[str, int] = {}
        self._lock = threading.Lock()
        self._ended = threading.Event()
        for name in self.definitions:
            self.plug(name)
        self._thread = threading.Thread(target=self._stream, daemon=True)
        self._thread.start()

    def plug(self, name: str) -> None:
        far, near = pty.openpty()
        tty.setraw(near)
        os.set_blocking(far, False)
        fresh = self.names[name].with_suffix(".new")
        fresh.symlink_to(os.ttyname(near))
        fresh.rename(self.names[name])
        with self._lock:
            self.far[name] = far
        self._near = getattr(self, "_near", [])
        self._near.append(near)  # a terminal nobody has opened yet would hang up at once

    def pull(self, name: str) -> None:
        with self._lock:
            os.close(self.far.pop(name))

    def _stream(self) -> None:
        gate, began_ns = 0, self.clock.now_ns()
        while not self._ended.is_set():
            gate += 1
            self.clock.sleep_until_ns(began_ns + gate * NS // 100)
            with self._lock:
                for name, definition in self.definitions.items():
                    if name in self.far and (name == "port_a" or gate % 10 == 0):
                        counter = gate if name == "port_a" else gate // 10
                        os.write(self.far[name], self.instead.get(name) or frame_bytes(definition, counter))
                        self.sent[name] += 1

    def end(self) -> None:
        self._ended.set()
        self._thread.join()
        for descriptor in (*self.far.values(), *self._near):
            os.close(descriptor)


class Bench:
    """Acquisition and keeper over the unit's lines into a real session; the sequencer is the test itself."""

    def __init__(self, folder: Path, files: OsFiles | None = None) -> None:
        self.clock, self.stop = WallClock(), StopSwitch()
        self.unit = Unit(folder, WallClock())
        self.writer = SessionWriter.create(folder / "session", {}, {}, t_mono_ns=self.clock.now_ns(), files=files)
        self.events: list[tuple[int, dict[str, Any]]] = []
        self.links = {
            name: PortLink(partial(open_port, name, str(path), 115_200, exclusive=True))
            for name, path in self.unit.names.items()
        }
        self.readers = {
            name: LinkReader(name, link, self.unit.definitions[name], self.clock, self.writer)
            for name, link in self.links.items()
        }
        self.keeper: Any = None
        self.acquisition = Acquisition(self.readers, self.clock, self.writer.tick, self.stop)
        self.health = Health(self.clock)
        self.context: Any = SimpleNamespace(
            acquisition=self.acquisition, clock=self.clock, stop=self.stop, health=self.health, instruments={},
            unit_answer=None,
            plan=SimpleNamespace(steps=(), campaign={}, units=()), event=self._event, observers=Observers(self.clock),
            decided=Decided(()),
        )  # fmt: skip

    def _event(self, event: Event) -> None:
        assert event.kind == "link"
        self.events.append((self.clock.now_ns(), event.document()))

    def wait(self, done: Callable[[], bool], limit_s: float) -> bool:
        until_ns = self.clock.now_ns() + to_ns(limit_s)
        while not done() and self.clock.now_ns() < until_ns:
            self.stop.check_stop()
            self.clock.sleep(0.01)
        return done()

    def states(self) -> list[str]:
        return [f"{fields['link']} {fields['state']}" for _, fields in self.events if fields["state"] != "open"]

    def good(self, name: str) -> int:
        return self.acquisition.readers[name].decoder.counts.frames

    def end(self) -> None:
        self.acquisition.stop()
        for link in self.links.values():
            link.close()
        self.unit.end()
        self.writer.close("done")


@pytest.fixture
def bench(tmp_path: Path) -> Iterator[Bench]:
    with ExitStack() as stack:
        made = Bench(tmp_path)
        stack.callback(made.end)
        made.keeper = stack.enter_context(keep_links(made.context))
        assert made.wait(lambda: made.good("port_a") > 10 and made.good("port_b") > 1, 10.0)
        made.context.observers.step(RECORD, 0.0)
        yield made


@pytest.mark.parametrize("name", ["port_a", "port_b"])
def test_a_port_that_is_pulled_out_is_noticed_and_comes_back(bench: Bench, name: str) -> None:
    assert bench.events[0][1]["kernel_counts"] is False
    threads = threading.active_count()
    for _ in range(2):
        pulled_ns = bench.clock.now_ns()
        bench.unit.pull(name)
        assert bench.wait(lambda: bool(bench.stop.holds.reasons), DETECT_S)
        print(f"lost noticed after {(bench.events[-1][0] - pulled_ns) / 1e6:.0f} ms")
        assert bench.acquisition.readers[name].lost
        assert list(bench.stop.holds.reasons) == [f"link {name}"]
        bench.clock.sleep(0.7)  # some attempts that find nothing
        plugged_ns = bench.clock.now_ns()
        bench.unit.plug(name)
        assert bench.wait(lambda: not bench.stop.holds.reasons, RESUME_S)
        print(f"back after {(bench.events[-1][0] - plugged_ns) / 1e6:.0f} ms: {bench.events[-1][1]['how']}")
        assert bench.events[-1][1]["how"] == "port opened again; counter went on; identity not asked"
    assert bench.states() == [f"{name} lost", f"{name} back"] * 2
    assert threading.active_count() == threads
    assert bench.stop.fault is None


def test_another_process_that_reads_the_port_is_named_and_waited_for(bench: Bench) -> None:
    take = "import os, sys, time; port = os.open(sys.argv[1], os.O_RDONLY | os.O_NONBLOCK)\nwhile True:\n try:\n  "
    take += "os.read(port, 9)\n except BlockingIOError:\n  time.sleep(0.001)"
    with subprocess.Popen([sys.executable, "-c", take, str(bench.unit.names["port_a"])]) as other, ExitStack() as ended:
        ended.callback(other.kill)
        named = f"process {other.pid} ("
        assert bench.wait(lambda: bench.stop.holds.reasons.get("link port_a", "").startswith(named), 10.0)
        assert bench.stop.holds.reasons["link port_a"].endswith(") has the port open too")
        assert f"Next: end {named}" in str(silent(bench.readers["port_a"], "nothing came"))
    assert bench.wait(lambda: not bench.stop.holds.reasons, RESUME_S)
    assert bench.states()[-2:] == ["port_a shared", "port_a back"]


def test_no_unit_was_silent_or_restarted_while_this_machine_stood_still(
    bench: Bench, monkeypatch: pytest.MonkeyPatch
) -> None:
    sent: list[int] = []
    for kept in bench.keeper._kept:
        monkeypatch.setattr(kept.unit, "again", sent.append)
    bench.unit.instead["port_a"] = b"\xeb\x90" * 28
    assert bench.wait(lambda: bool(bench.stop.holds.reasons), 5.0)
    monkeypatch.setattr(bench.clock, "now_ns", lambda: time.monotonic_ns() + 20 * NS)
    bench.unit.instead.clear()  # what comes now had waited in the kernel
    assert bench.wait(lambda: not bench.stop.holds.reasons, RESUME_S)
    assert bench.states() == ["port_a silent", "port_a back"]
    assert "counter went on" in bench.events[-1][1]["how"]
    assert sent == []


def test_the_links_give_their_sign_of_life(bench: Bench) -> None:
    bench.clock.sleep(1.5)
    assert bench.health.silence_s()[LINKS] < 1.0
    bench.unit.pull("port_a")
    bench.unit.pull("port_b")
    assert bench.wait(lambda: len(bench.stop.holds.reasons) == 2, DETECT_S)
    bench.clock.sleep(1.5)
    assert bench.health.silence_s()[LINKS] < 1.0  # nobody is left to read, and somebody looks for the ports


@pytest.mark.parametrize("seconds", [3.0, pytest.param(10.0, marks=pytest.mark.sweep)])
def test_a_disk_that_stalls_for_some_seconds_costs_nothing(tmp_path: Path, seconds: float) -> None:
    gate = threading.Event()  # every write waits while it is shut
    gate.set()
    bench = Bench(tmp_path, FaultyFiles(lambda kind, _: gate.wait() and None if kind == "write" else None))
    try:
        with keep_links(bench.context):
            assert bench.wait(lambda: bench.good("port_a") > 50 and bench.good("port_b") > 5, 10.0)
            gate.clear()
            bench.clock.sleep(seconds)
            alive_s = bench.health.silence_s()[LINKS]
            gate.set()
            reached = {name: bench.unit.sent[name] for name in bench.readers}
            assert bench.wait(lambda: bench.good("port_a") > reached["port_a"] - 50, 10.0)
            assert bench.stop.fault is None
            assert bench.states() == []
            assert alive_s < 1.0
    finally:
        gate.set()
        bench.end()
    sent = bench.unit.sent
    for name, reader in bench.readers.items():
        counts = reader.decoder.counts
        assert (counts.bad, counts.lost, counts.duplicate, counts.skipped_bytes) == (0, 0, 0, 0)
        assert sent[name] - 20 <= counts.frames <= sent[name]  # those of the end, after the ports were left
    _assert_recorded(tmp_path / "session", bench)


def _assert_recorded(session: Path, bench: Bench) -> None:
    """The session holds every frame, in order, stamped while the disk stood still."""
    for name, reader in bench.readers.items():
        decoder = LinkDecoder(bench.unit.definitions[name])
        stamps: list[int] = []
        for message in SessionReader(session).select(frozenset({f"/link/{name}/rx"})):
            decoder.push(message.t_ns, message.payload)
            stamps.append(message.t_ns)
        decoder.flush()
        assert decoder.counts == reader.decoder.counts
        assert stamps == sorted(stamps)
        longest_s = max(after - before for before, after in pairwise(stamps)) / NS
        print(f"{name}: {decoder.counts.frames} frames, longest time between two stamps {longest_s:.3f} s")
        assert longest_s < 1.5
