"""The same recovery over real connections, HiSLIP and raw sockets on loopback, and calls that do not return."""

import importlib
import threading
from concurrent.futures import ThreadPoolExecutor
from typing import Any

import pytest
from sim_bench import DRIVERS, serve

from bench.model.clock import VirtualClock, WallClock
from bench.model.errors import InstrumentError
from instruments.bus import BUS_FAILED, BusSession
from instruments.ladder import Ladder
from instruments.wire import Aside, NotReturnedError


@pytest.mark.parametrize("gateway", [False, True])
def test_a_first_reply_that_is_late_is_no_answer_to_a_later_question(gateway: bool) -> None:
    """Three supplies at a time; behind a gateway opening again does not lose what still comes."""
    with serve() as served:

        def identified(role: str, late_s: float) -> list[str]:
            resource = served.open_socket(role)
            faults, heard = served.world.faults.instrument(role), []
            driver = importlib.import_module(f"instruments.{DRIVERS[role]}").DRIVER(
                resource, role=role, clock=WallClock(), reopen=(lambda: resource) if gateway else None,
                transcript=lambda _, way, text, __: heard.append(f"{way} {text}"),
            )  # fmt: skip
            if gateway:
                driver.bus.release = lambda *_: None
            faults.late_s, faults.late_replies = late_s, 1
            driver.identify()
            assert driver.drain_errors() == []
            assert ("tx SYST:REM" in heard) is (role != "supply")  # there may be a serial line behind a socket
            return [line for line in heard if "<not used" in line]

        roles = {"supply": 2.5, "rail_dmm": 3.0, "aux_supply": 4.5}
        with ThreadPoolExecutor() as threads:
            assert all(threads.map(identified, roles, roles.values()))


def test_a_call_that_hangs_is_left_and_taken_when_it_comes() -> None:
    come, lives = threading.Event(), []
    call = Aside("opening", lambda: come.wait(30.0) and "here")
    with pytest.raises(NotReturnedError, match=r"opening has not returned for 0\.6 s"):
        call.wait(0.6, lambda: lives.append(1))
    assert lives
    assert call.under_way
    come.set()
    assert call.wait(5.0, lambda: None) == "here"
    with pytest.raises(ZeroDivisionError):
        Aside("dividing", lambda: 1 / 0).wait(5.0, lambda: None)


class Resource:
    """Of a library that hangs in its next read once ``hangs`` is set, whatever its time limit."""

    resource_name = "TCPIP0::192.0.2.1::hislip0::INSTR"

    def __init__(self) -> None:
        self.hangs, self.gone, self.free = False, False, threading.Event()
        self.timeout: float | None = None

    def write(self, command: str) -> None:
        """Take it."""

    def read(self) -> str:
        if self.gone:
            raise OSError("connection reset")
        if self.hangs:
            self.free.wait(30.0)
        return "1"

    def clear(self) -> None:
        """Begin anew."""

    def close(self) -> None:
        self.free.set()


def test_a_library_that_hangs_is_a_bus_that_fails_and_opening_again_helps() -> None:
    lines: list[str] = []
    first, second = Resource(), Resource()
    session: Any = BusSession(first, "dmm", WallClock(), lambda *line: lines.append(line[2]))  # type: ignore[arg-type]
    ladder = Ladder(session, lambda: None, lambda: None, lambda: second, None)  # type: ignore[arg-type, return-value]
    assert session.query("READ?", int, 0.1) == 1
    first.hangs = True
    with pytest.raises(InstrumentError) as failed:
        session.query("READ?", int, 0.1)
    assert (failed.value.code, session.lost) == (BUS_FAILED, BUS_FAILED)
    with pytest.raises(InstrumentError, match="nobody is there"):  # nothing is put behind a call that hangs
        session.query("READ?", int, 0.1)
    session.climb = ladder.climb
    with session.persistent():
        assert session.query("READ?", int, 0.1) == 1
    assert (session.lost, session.silence_s()) == ("", 0.0)
    assert "<open>" in lines


def test_whatever_a_library_raises_is_an_error_of_the_bus() -> None:
    resource: Any = Resource()

    def read() -> str:
        raise KeyError("a table of the library")

    resource.read = read
    session = BusSession(resource, "dmm", WallClock(), lambda *_: None)
    with pytest.raises(InstrumentError) as failed:
        session.query("READ?", int, 0.1)
    assert failed.value.code == BUS_FAILED


def test_one_that_was_not_asked_for_long_is_given_the_whole_ladder_again() -> None:
    """After a loss of all of them each is asked by its next step, when the network is long back."""
    clock, resources = VirtualClock(), [Resource(), Resource()]
    session: Any = BusSession(resources[0], "dmm", clock, lambda *_: None)  # type: ignore[arg-type]
    opened: list[Any] = []

    def opener() -> Any:
        clock.sleep(0.5)
        if not resources[1:]:
            opened.append(resources[0])
            return resources[0]
        raise OSError("no route to host")

    session.climb = Ladder(session, lambda: None, lambda: None, opener, None).climb
    resources[0].gone = True
    for _ in range(2):  # the second time nobody tries to open anything: it has been silent for long enough
        with pytest.raises(InstrumentError):
            session.query("READ?", int, 0.1)
    assert session.silence_s() >= 1.5
    del resources[0]
    clock.sleep(20.0)
    assert session.query("READ?", int, 0.1) == 1
    assert len(opened) == 1


def test_a_watcher_in_a_hurry_hurries_nobody_else() -> None:
    """Two threads on one session, whose hurries overlap: each has its own, and afterwards none is left."""
    session = BusSession(Resource(), "dmm", WallClock(), lambda *_: None)  # type: ignore[arg-type]
    inside, leave = threading.Event(), threading.Event()

    def watch() -> None:
        with session.hurry(0.45):
            inside.set()
            leave.wait(5.0)

    watcher = threading.Thread(target=watch)
    watcher.start()
    inside.wait(5.0)
    assert not session.hurried
    with session.hurry(0.3):
        leave.set()
        watcher.join()
        assert session.hurried
    assert not session.hurried
    with session.persistent():
        assert session.patient
    assert not session.patient
