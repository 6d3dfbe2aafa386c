"""What the service manager is told, received by a socket as sd_notify(3) describes it."""

from __future__ import annotations

import os
import socket
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

import pytest
from hold_rig import HoldRig

from bench.run.control.systemd import ServiceNotice, service_notice
from bench.run.guard.health import SEQUENCER, WRITER
from bench.run.observers import Following


@contextmanager
def manager(address: str) -> Iterator[socket.socket]:
    with socket.socket(socket.AF_UNIX, socket.SOCK_DGRAM) as receiver:
        receiver.setblocking(False)
        receiver.bind(f"\0{address[1:]}" if address.startswith("@") else address)
        yield receiver


def received(receiver: socket.socket) -> list[str]:
    found = []
    while True:
        try:
            found.append(receiver.recv(4096).decode())
        except BlockingIOError:
            return found


@pytest.mark.parametrize("abstract", [False, True])
def test_the_watchdog_is_fed_while_every_part_is_well(tmp_path: Path, abstract: bool) -> None:
    address = f"@inertial-bench-{os.getpid()}" if abstract else str(tmp_path / "notify")
    rig = HoldRig(tmp_path, 2)
    context = rig.context()
    following = Following(context.observers)
    environment = {"NOTIFY_SOCKET": address, "WATCHDOG_USEC": "20000000"}
    with manager(address) as receiver:
        with service_notice(context, environment, following):
            assert received(receiver) == ["READY=1"]
            following.step(rig.steps[2], 0.0)
            context.health.alive(SEQUENCER)
            context.health.alive(WRITER)
            rig.clock.sleep(9.0)
            context.health.alive(SEQUENCER)
            context.health.alive(WRITER)
            rig.clock.sleep(1.0)  # half of the time the manager allows
            assert received(receiver) == ["STATUS=step 2 of 8\nWATCHDOG=1"]
            rig.clock.sleep(9.0)
            context.health.alive(SEQUENCER)  # the writer is silent
            context.stop.holds.hold("door", "it is open")
            rig.clock.sleep(1.0)
            assert received(receiver) == ["STATUS=holding at step 2 of 8: it is open"]
        assert received(receiver) == ["STOPPING=1"]


def test_nobody_is_told_where_nobody_asks(tmp_path: Path) -> None:
    assert not ServiceNotice({}).there
    assert ServiceNotice({}).watchdog_s is None
    assert ServiceNotice({"WATCHDOG_USEC": "4000000"}).watchdog_s == 2.0
    assert ServiceNotice({"WATCHDOG_USEC": "4000000", "WATCHDOG_PID": "1"}).watchdog_s is None
    ServiceNotice({}).tell("READY=1")
    ServiceNotice({"NOTIFY_SOCKET": str(tmp_path / "nobody")}).tell("READY=1")
