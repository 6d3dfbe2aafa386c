"""Turns of the virtual clock that are taken at once give what single turns give, byte for byte and stamp for stamp."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import ExitStack, contextmanager
from functools import partial
from typing import Any

import pytest
import pyvisa
import serial
from sim_bench import Bench, station

from bench.frame import LinkBatch, load_frame
from bench.model.clock import NS, VirtualClock
from bench.model.shipped import find_shipped
from bench.record import RecordError
from bench.run.links.acquisition import Acquisition
from bench.run.links.port import PortLink
from bench.run.links.reader import LinkReader
from bench.run.stop import StopSwitch
from sim_instruments.worlds.simulation import open_world

FRAMES = {"port_b": "ngu_b", "port_a": "ngu_a"}
POLL_S = [{"port_a": 1.0, "port_b": 1.0}, {"port_a": 1.0, "port_b": 0.01}]
SEED = 5


class Sink:
    """Notes what is recorded and when a second ends, in order; and every flush with what it gave."""

    def __init__(self) -> None:
        self.noted: list[tuple[Any, ...]] = []
        self.reads = 0

    def raw(self, link: str, direction: str, t_mono_ns: int, chunk: bytes) -> None:
        self.noted.append((link, direction, t_mono_ns, chunk))

    def tick(self, t_mono_ns: int) -> None:
        self.noted.append(("tick", t_mono_ns))

    def decoded(self, link: str, clock: VirtualClock, batch: LinkBatch) -> None:
        self.noted.append((link, clock.now_ns(), [(name, len(part)) for name, part in batch.messages.items()]))


class Calm:
    """Nothing is wrong with the links; notes when it is asked to look after them."""

    calm = True

    def judge(self) -> None: ...

    def service(self) -> None: ...


@pytest.fixture(autouse=True)
def simulated_ports(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(serial, "protocol_handler_packages", [*serial.protocol_handler_packages, "sim_instruments.bus"])


@contextmanager
def acquiring(poll_s: dict[str, float], sink: Sink) -> Iterator[tuple[Bench, Acquisition]]:
    """The simulated unit on its bench, with everything that its links give noted in ``sink``."""
    clock = VirtualClock()
    with ExitStack() as opened:
        world = open_world("af_converter", clock=clock, seed=SEED, station=station(), options={})
        opened.callback(world.close)
        bench = Bench(world, pyvisa.ResourceManager(world.visa_library))
        opened.callback(bench.manager.close)
        readers = {}
        for name, frame in FRAMES.items():
            link = PortLink(lambda name=name: serial.serial_for_url(world.link_url(name), baudrate=921_600, timeout=0))
            opened.callback(link.close)
            definition = load_frame(find_shipped("frames", frame))
            readers[name] = LinkReader(name, link, definition, clock, sink, poll_s=poll_s[name])
            readers[name].listeners.append(partial(sink.decoded, name, clock))
        acquisition = Acquisition(readers, clock, sink.tick, StopSwitch())
        acquisition.watch = Calm()
        yield bench, acquisition
        acquisition.stop()


def watched(poll_s: dict[str, float], monkeypatch: pytest.MonkeyPatch) -> Sink:
    """Eight minutes of the simulated unit: started, silent for a while, over a noisy cable, without supply."""
    sink, read = Sink(), PortLink.read

    def counted(link: PortLink, size: int = 1) -> bytes:
        sink.reads += 1
        return read(link, size)

    with monkeypatch.context() as patched, acquiring(poll_s, sink) as (bench, acquisition):
        patched.setattr(PortLink, "read", counted)
        bench.clock.every(7.3, acquisition.refresh)
        bench.clock.sleep(3.3)
        bench.send("supply", "CURR 2;VOLT 18;:OUTP ON")
        bench.clock.sleep(140.0)
        faults = bench.world.faults.link("port_a")
        faults.silent = True
        bench.clock.sleep(12.5)
        faults.silent = False
        faults.bit_error_rate = 1e-4
        bench.clock.sleep(123.4)
        bench.send("supply", "OUTP OFF")
        bench.clock.sleep(20.0)
        bench.send("supply", "OUTP ON")
        bench.clock.sleep(180.0)
    return sink


@pytest.mark.parametrize("poll_s", POLL_S, ids=str)
def test_the_same_is_recorded_with_fewer_reads(poll_s: dict[str, float], monkeypatch: pytest.MonkeyPatch) -> None:
    at_once = watched(poll_s, monkeypatch)
    monkeypatch.setattr(PortLink, "arrivals", lambda self, turns_ns: ())
    single = watched(poll_s, monkeypatch)
    assert len(single.noted) > 900
    assert at_once.noted == single.noted, f"seed {SEED}"
    assert at_once.reads < single.reads / 2, (at_once.reads, single.reads)


def test_what_a_disk_refuses_in_between_is_recorded_later() -> None:
    refusals = [RecordError("B-REC-003", "the disk takes nothing")]

    class Refusing(Sink):
        def raw(self, link: str, direction: str, t_mono_ns: int, chunk: bytes) -> None:
            if t_mono_ns > 12 * NS and refusals:
                raise refusals.pop()
            super().raw(link, direction, t_mono_ns, chunk)

    taken = []
    for sink in (Sink(), Refusing()):
        with acquiring(POLL_S[0], sink) as (bench, _):
            bench.send("supply", "CURR 2;VOLT 18;:OUTP ON")
            bench.clock.sleep(60.0)
        taken.append([b"".join(noted[3] for noted in sink.noted if noted[:2] == (name, "rx")) for name in FRAMES])
    assert not refusals
    assert taken[0] == taken[1]
    assert len(taken[0][1]) > 200_000


def test_a_port_that_is_gone_knows_nothing_of_the_coming_turns() -> None:
    sink = Sink()
    with acquiring(POLL_S[0], sink) as (bench, acquisition):
        reader = acquisition.readers["port_a"]
        reader.kept = True
        bench.world.faults.link("port_a").unplugged = True
        bench.clock.sleep(10.0)
        assert "unplugged" in reader.lost
