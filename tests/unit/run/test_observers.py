"""The list of observers: its order, and that nobody in it stops the others or the run."""

from __future__ import annotations

import pytest
from run_rig import Listener, Sink

from bench.model.clock import VirtualClock
from bench.model.errors import OperatorStop
from bench.model.events import Config, Disk, Event, Phase
from bench.record import RecordError
from bench.run.observers import AtTerminal, Observer, Observers, Order, Recorder

PHASE = Phase(name="campaign", t_start_ns=0)
CONFIG = Config(file="a.yaml", change="changed")


class Noting(Observer):
    def __init__(self, told: list[str], name: str, order: Order, error: Exception | None = None) -> None:
        self.told, self.name, self.error = told, name, error
        self.order = order  # type: ignore[misc]

    def event(self, event: Event, t_mono_ns: int) -> None:
        self.told.append(self.name)
        if self.error is not None:
            raise self.error


def test_the_recorder_is_first_wherever_it_comes_in() -> None:
    told: list[str] = []
    observers = Observers(VirtualClock())
    for name, order in (("page", Order.WATCHERS), ("keeper", Order.SAFETY), ("writer", Order.RECORDER)):
        observers.add(Noting(told, name, order))
    observers.event(PHASE)
    assert told == ["writer", "keeper", "page"]


def test_one_that_fails_is_said_once_and_stops_nobody() -> None:
    told: list[str] = []
    broken, listener = Noting(told, "broken", Order.WATCHERS, ValueError("x")), Listener()
    broken.loss = "nobody draws any more"  # type: ignore[misc]
    observers = Observers(VirtualClock(), broken, Noting(told, "next", Order.WATCHERS), AtTerminal(listener))
    observers.event(PHASE)
    observers.event(PHASE)
    assert told == ["broken", "next", "next"]
    assert listener.messages == ["nobody draws any more (ValueError: x); the run goes on"]


def test_what_the_run_cannot_do_without_ends_it_and_a_second_signal_is_not_lost() -> None:
    vital = Noting([], "keeper", Order.SAFETY, ValueError("x"))
    vital.vital = True  # type: ignore[misc]
    with pytest.raises(ValueError, match="x"):
        Observers(VirtualClock(), vital).event(PHASE)
    stop = Noting([], "page", Order.WATCHERS, OperatorStop("B-RUN-011", "stopped"))
    with pytest.raises(OperatorStop):
        Observers(VirtualClock(), stop).event(PHASE)


def test_nobody_acts_on_what_is_not_written_and_a_person_still_hears_of_it() -> None:
    class Full(Sink):
        def event(self, *_: object) -> None:
            raise RecordError("B-REC-003", "full")

    told: list[str] = []
    listener = Listener()
    observers = Observers(VirtualClock(), Recorder(Full()), Noting(told, "page", Order.WATCHERS), AtTerminal(listener))
    with pytest.raises(RecordError):
        observers.event(CONFIG)
    observers.note(CONFIG)
    assert (told, listener.messages) == ([], [CONFIG.sentence])


def test_a_full_disk_is_told_and_not_written() -> None:
    sink, listener = Sink(), Listener()
    Observers(VirtualClock(), Recorder(sink), AtTerminal(listener)).event(Disk(code="B-REC-001", text="full"))
    assert (sink.events, listener.messages) == ([], ["full"])
