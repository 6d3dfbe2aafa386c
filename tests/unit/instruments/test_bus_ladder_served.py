"""The same recovery over real connections, HiSLIP and raw sockets on loopback, by stock PyVISA and pyvisa-py."""

from __future__ import annotations

import importlib
import socket
import threading
from collections.abc import Iterator
from typing import Any

import numpy as np
import pytest
import pyvisa
from pyvisa.resources import MessageBasedResource
from sim_served import Served, serve

from bench.model.clock import WallClock
from bench.model.errors import InstrumentError

SEED = 42
QUESTIONS = {"VOLT?": "voltage_V", "CURR?": "current_A", "VOLT:PROT?": "trip_V"}


class Supply:
    """The driver of the supply, in a hurry of its own: 0.1 s for a command; counts how often it was opened."""

    def __init__(self, served: Served, address: str) -> None:
        self.opened = 0
        self.served, self.address = served, address
        self.lines: list[str] = []
        self.driver = importlib.import_module("instruments.hp_6632b").DRIVER(
            self.open(), role="supply", clock=WallClock(), reopen=self.open,
            transcript=lambda _, direction, text, __: self.lines.append(f"{direction} {text}"),
        )  # fmt: skip
        self.driver.timeout_s = 0.1

    def open(self) -> Any:
        self.opened += 1
        return self.served.visa.open_resource(self.address, resource_pyclass=MessageBasedResource)


@pytest.fixture
def supply() -> Iterator[Supply]:
    with serve() as served:
        served.no_latency()
        yield Supply(served, served.servers.resources()["supply"])


def test_late_replies_over_hislip(supply: Supply) -> None:
    """Each answer is to its own question; a session that pyvisa-py cannot clear is opened again."""
    supply.driver.identify()
    rng = np.random.default_rng(SEED)
    faults = supply.served.world.faults.instrument("supply")
    device = supply.served.world.instruments["supply"]
    unanswered = 0
    for number in range(40):
        question = list(QUESTIONS)[number % 3]
        wanted = 1.0 + number
        setattr(device, QUESTIONS[question], wanted)
        faults.late_s, faults.late_replies = float(rng.uniform(0.05, 0.3)), int(rng.integers(0, 2))
        try:
            assert supply.driver.ask(question, float) == wanted
        except InstrumentError:
            unanswered += 1
    print(f"seed {SEED}: {unanswered} unanswered, opened {supply.opened} times")
    assert unanswered < 20  # a busy machine has late replies of its own
    assert any("<device clear>" in line for line in supply.lines)


def test_a_connection_that_is_gone_is_opened_again(supply: Supply) -> None:
    supply.driver.timeout_s = 1.0  # nothing is late here, unless the machine is busy
    supply.driver.configure(15.0, 1.5, 18.0)
    supply.driver.output_on()
    before = supply.opened
    for gone in (True, False):
        if gone:
            supply.driver.bus._resource.visalib.sessions[supply.driver.bus._resource.session].interface._sync.shutdown(
                socket.SHUT_RDWR
            )
        assert 14.9 < supply.driver.measure_voltage() < 15.1
    assert supply.opened == before + 1
    assert sum(line == "tx OUTP ON" for line in supply.lines) == 1


class LineServer:
    """An instrument on a raw socket that was written for this test: it answers in order, each after its delay."""

    def __init__(self) -> None:
        self._listener = socket.create_server(("127.0.0.1", 0))
        self.address = f"TCPIP0::127.0.0.1::{self._listener.getsockname()[1]}::SOCKET"
        self.waits: dict[str, list[threading.Event]] = {}
        self.heard: list[str] = []
        self.hang_up = False
        self._thread = threading.Thread(target=self._serve, daemon=True)
        self._thread.start()

    def _serve(self) -> None:
        while True:
            try:
                client, _ = self._listener.accept()
            except OSError:
                return
            with client, client.makefile("rw", newline="\n") as stream:
                for line in stream:
                    self.heard.append(line.strip())
                    if self.hang_up:
                        self.hang_up = False
                        break
                    answers = {"*IDN?": "HEWLETT-PACKARD,6632B,US1,A", "SYST:ERR?": '0,"No error"'}
                    for event in self.waits.pop(line.strip(), []):
                        event.wait(10.0)
                    if "?" in line:
                        stream.write(answers.get(line.strip(), f"{len(self.heard)}.0") + "\n")
                        stream.flush()

    def close(self) -> None:
        self._listener.close()


@pytest.fixture
def server() -> Iterator[LineServer]:
    made = LineServer()
    yield made
    made.close()


def open_driver(server: LineServer, **rungs: Any) -> tuple[Any, list[str]]:
    visa = pyvisa.ResourceManager("@py")
    lines: list[str] = []

    def opened() -> Any:
        return visa.open_resource(server.address, resource_pyclass=MessageBasedResource)

    driver = importlib.import_module("instruments.hp_6632b").DRIVER(
        opened(), role="supply", clock=WallClock(), transcript=lambda _, way, text, __: lines.append(f"{way} {text}"),
        **({"reopen": opened} if rungs.get("reopens") else {}),
    )  # fmt: skip
    driver.timeout_s = 0.2
    return driver, lines


def test_on_a_raw_socket_the_late_reply_is_told_from_the_echo(server: LineServer) -> None:
    """No clear reaches an instrument there: what was asked is answered in order, so the echo comes after it."""
    driver, lines = open_driver(server)
    driver.identify()
    release = threading.Event()
    server.waits["VOLT?"] = [release]
    keep = driver.bus._transcript

    def release_after_the_echo_is_asked(role: str, way: str, text: str, t_ns: int) -> None:
        keep(role, way, text, t_ns)
        if text == "*IDN?":
            threading.Timer(0.05, release.set).start()

    driver.bus._transcript = release_after_the_echo_is_asked
    answer = driver.ask("VOLT?", float)
    late = [line for line in lines if line.startswith("rx <not used")]
    assert late[0] == "rx <not used: 3.0>"  # the third line it heard was the first VOLT?
    assert late[1].startswith("rx <not used: HEWLETT")
    assert answer == server.heard.index("VOLT?", 3) + 1
    driver.close()


def test_a_raw_socket_that_hangs_up_is_opened_again(server: LineServer) -> None:
    driver, _ = open_driver(server, reopens=True)
    driver.identify()
    server.hang_up = True
    assert driver.ask("VOLT?", float) == len(server.heard)
    driver.close()
