"""Questions to all instruments: in order on a bus, buses beside each other, one after the other in a rehearsal."""

from __future__ import annotations

import threading

from bench.model.clock import VirtualClock, WallClock
from bench.run.bench.safety import QUICK_S, make_safe
from bench.run.bench.side_by_side import asked, bus_of

RESOURCES = {"a": "GPIB0::4::INSTR", "b": "TCPIP0::1.2.3.4::INSTR", "c": "gpib0::5::INSTR", "d": "GPIB1::4::INSTR"}


def test_a_board_is_one_bus_and_everything_else_its_own() -> None:
    assert [bus_of(resource) for resource in RESOURCES.values()] == ["GPIB0", RESOURCES["b"].upper(), "GPIB0", "GPIB1"]


def test_different_buses_are_asked_at_the_same_time_and_one_bus_in_order() -> None:
    together = threading.Barrier(3, timeout=10.0)  # of a, b and d; c waits for a
    heard: list[str] = []

    def ask(role: str) -> str:
        if role != "c":
            together.wait()
        heard.append(role)
        return role.upper()

    assert asked(RESOURCES, ask, WallClock()) == {"a": "A", "b": "B", "c": "C", "d": "D"}
    assert heard.index("a") < heard.index("c")


def test_a_rehearsal_asks_in_the_order_of_the_station() -> None:
    heard: list[str] = []
    asked(RESOURCES, heard.append, VirtualClock())
    assert heard == list(RESOURCES)


class Mute:
    """Never safe; ``limits_s`` holds the time it was given in each attempt, None: as long as it takes."""

    role = "mute"

    def __init__(self) -> None:
        self.limits_s: list[float | None] = []
        self._limit_s: float | None = None

    def quick(self, limit_s: float) -> Mute:
        self._limit_s = limit_s
        return self

    def __enter__(self) -> None:
        return None

    def __exit__(self, *_: object) -> None:
        return None

    def make_safe(self) -> None:
        self.limits_s.append(self._limit_s)
        self._limit_s = None
        raise RuntimeError("no answer")


def test_one_that_was_mute_to_everything_is_not_waited_for_again() -> None:
    for mute, limits_s in (((), [QUICK_S, None, None]), (("mute",), [QUICK_S] * 3)):
        instrument = Mute()
        failures = make_safe({"mute": instrument}, [], VirtualClock(), mute)  # type: ignore[dict-item]
        assert [failure.code for failure in failures] == ["B-RUN-060"]
        assert instrument.limits_s == limits_s
