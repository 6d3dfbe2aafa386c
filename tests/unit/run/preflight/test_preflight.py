"""The pre-flight as a whole: what it refuses, what it tells, and that no check can raise or hang."""

from __future__ import annotations

import threading
from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import pytest
from preflight_bench import Machine, clock_at_noon, context, in_process_plan, no_answer, served_plan

from bench.model.clock import VirtualClock, WallClock
from bench.model.errors import ExitStatus, InputError, InstrumentError
from bench.model.events import Event
from bench.report.tables import analysis_tables
from bench.run.bench.opener import OpenBench, open_bench
from bench.run.bench.side_by_side import bus_of
from bench.run.guard.lock import BenchLock, bus_keys
from bench.run.preflight import Finding, Preflight, Report, Status
from bench.run.preflight import survey as surveying
from bench.run.preflight.of_bench import interlocks
from bench.run.preflight.of_machine import stay_awake
from bench.run.preflight.survey import Check, examine, survey
from bench.session.happenings import preflight_table

OK = Finding("one", Status.OK, "1", "2", "fine")
WARN = Finding("two", Status.WARN, "", "", "not so fine")
INPUT = Finding("three", Status.FAIL, "3", "4", "no room")
BENCH = Finding("four", Status.FAIL, "5", "6", "wrong one", of_bench=True)


def test_a_warning_does_not_keep_a_run_from_starting() -> None:
    assert Report((OK, WARN)).refusal() is None


def test_one_error_lists_everything_that_does() -> None:
    refusal = Report((OK, INPUT, WARN)).refusal()
    assert isinstance(refusal, InputError)
    assert (refusal.code, refusal.exit_status) == ("B-RUN-080", ExitStatus.BAD_INPUT)
    assert refusal.message == "not started: three: 3 (due: 4), no room"
    both = Report((INPUT, BENCH)).refusal()
    assert isinstance(both, InstrumentError)
    assert (both.code, both.exit_status) == ("B-RUN-081", ExitStatus.SAFE_AFTER_FAULT)
    assert both.message == "not started: three: 3 (due: 4), no room; four: 5 (due: 6), wrong one"


def test_the_event_becomes_a_table_of_the_report() -> None:
    event = Report((OK, WARN)).event()
    assert (event.ok, event.warn, event.fail, event.skipped) == (1, 1, 0, 0)
    (table,) = analysis_tables([preflight_table(event)])
    assert table.rows == (("one", "ok", "1", "2", "fine"), ("two", "warn", "", "", "not so fine"))


def test_a_plan_without_interlocks_is_a_warning(tmp_path: Path) -> None:
    plan = in_process_plan()
    watched, bare = (interlocks(context(tmp_path, plan=each)) for each in (plan, replace(plan, interlocks=())))
    assert (watched.status, watched.text) == (Status.OK, "")
    assert (bare.status, bare.value) == (Status.WARN, "0")
    assert "no interlock is declared" in bare.text


# --- checks that go wrong ---------------------------------------------------------------------------------------------


def looked(tmp_path: Path, *checks: Check) -> Report:
    return survey(context(tmp_path, clock=WallClock()), checks)


def stumbles(_: Any) -> Finding:
    raise ZeroDivisionError("division by  zero")


def unanswered(_: Any) -> Finding:
    raise no_answer()


def test_a_check_that_raises_is_a_finding(tmp_path: Path) -> None:
    checks = [Check("a", stumbles), Check("b", unanswered, on_bus=True), Check("c", lambda _: [OK, WARN])]
    for clock in (WallClock(), VirtualClock()):
        found = survey(context(tmp_path, clock=clock), checks).findings
        assert found[0] == Finding("a", Status.WARN, "unknown", "", "ZeroDivisionError: division by zero")
        assert (found[1].status, found[1].value, found[1].of_bench) == (Status.FAIL, "B-INST-001", True)
        assert found[2:] == (OK, WARN)


@pytest.fixture
def blocked() -> Iterator[Any]:
    """A check that comes to no end before the test does."""
    end = threading.Event()

    def wait(_: Any) -> list[Finding]:
        end.wait(60.0)
        return [OK]

    yield wait
    end.set()


def test_a_check_that_hangs_keeps_nobody_waiting(tmp_path: Path, blocked: Any, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(surveying, "BUS_LIMIT_S", 0.05)
    monkeypatch.setattr(surveying, "LIMIT_S", 0.05)
    checks = [Check("disk", blocked), Check("bus", blocked, on_bus=True), Check("next", stumbles, on_bus=True)]
    disk, bus, following = looked(tmp_path, *checks).findings
    assert (disk.status, disk.of_bench) == (Status.WARN, False)
    assert (bus.status, bus.of_bench) == (Status.FAIL, True)
    assert (following.status, following.text) == (Status.SKIPPED, "the bus does not answer")


# --- as a run uses it -------------------------------------------------------------------------------------------------


@pytest.fixture
def rehearsed() -> Iterator[tuple[OpenBench, VirtualClock, list[str]]]:
    """The simulated bench of the shipped station, opened and identified; and every command that reaches it."""
    clock, sent = VirtualClock(), []

    def transcript(role: str, direction: str, text: str, t_mono_ns: int) -> None:
        if direction == "tx":
            sent.append(text)

    bench = open_bench(in_process_plan().station, clock, transcript, seed=1)
    for instrument in bench.instruments.values():
        instrument.identify()
    sent.clear()
    yield bench, clock, sent
    bench.close()


def test_a_rehearsal_asks_no_instrument_and_writes_nothing_of_the_machine(
    tmp_path: Path, rehearsed: tuple[OpenBench, VirtualClock, list[str]]
) -> None:
    bench, clock, sent = rehearsed
    told: list[str] = []
    assert Preflight(told.append, Machine())(in_process_plan(), bench, clock, tmp_path) is None
    assert (told, sent, clock.now_ns()) == ([], [], clock.now_ns())
    assert list(tmp_path.iterdir()) == []


def test_a_run_is_refused_for_another_serial_number(
    tmp_path: Path, rehearsed: tuple[OpenBench, VirtualClock, list[str]]
) -> None:
    bench, clock, _ = rehearsed
    calibrator: Any = bench.instruments["calibrator"]
    calibrator.identity = calibrator.identity.__class__("FLUKE", "5720A", "other", "1")
    with pytest.raises(InstrumentError, match="5720A other") as caught:
        Preflight()(in_process_plan(), bench, clock, tmp_path)
    assert caught.value.code == "B-RUN-081"


def test_a_run_without_room_is_refused(
    tmp_path: Path, rehearsed: tuple[OpenBench, VirtualClock, list[str]], monkeypatch: pytest.MonkeyPatch
) -> None:
    bench, clock, _ = rehearsed
    monkeypatch.setattr("shutil.disk_usage", lambda _: SimpleNamespace(free=0))
    with pytest.raises(InputError, match="B-RUN-080"):
        Preflight()(in_process_plan(), bench, clock, tmp_path)


def test_warnings_are_told_and_the_run_goes_on(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    for name in ("ALWAYS", "ON_THE_BUS", "ON_THE_MACHINE"):
        monkeypatch.setattr(surveying, name, (Check(name, lambda _: [OK, WARN]),))
    bench: Any = SimpleNamespace(instruments={}, links={})
    told: list[str] = []
    event = Preflight(told.append, Machine())(served_plan(), bench, WallClock(), tmp_path)
    assert told == ["pre-flight, warning: two: not so fine"] * 3
    assert (event.ok, event.warn) == (3, 3)


# --- bench check --live -----------------------------------------------------------------------------------------------


def test_a_bench_that_is_in_use_is_not_touched(tmp_path: Path) -> None:
    plan = served_plan()
    keys = bus_keys(entry.resource for entry in plan.station.instruments.values())
    with BenchLock(keys, "run", WallClock()):
        found = examine(plan, clock_at_noon(), tmp_path, Machine())
    assert found.findings[0].name == "second controller"
    assert found.findings[0].status is Status.FAIL
    assert "'run' of" in found.findings[0].text
    assert not [one for one in found.findings if one.name.startswith(("identity", "line", "silence", "10 MHz"))]


IDENTITIES = [f"identity of {role}" for role in served_plan().station.instruments]


def test_a_bench_without_a_visa_library_is_told_completely(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """One line for all of them, with what to do, and none for each instrument."""

    def missing(station: Any) -> Any:
        error = InstrumentError("B-RUN-002", "no VISA library is found", where="station.yaml", next_step="install it")
        return dict.fromkeys(station.instruments, error)

    monkeypatch.setattr(surveying, "missing_buses", missing)
    found = examine(served_plan(), clock_at_noon(), tmp_path, Machine())
    (bus,) = found.of(Status.FAIL)
    assert bus.name == f"bus of {len(IDENTITIES)} instruments"
    assert (bus.value, bus.text) == ("B-RUN-002", "no VISA library is found; install it")
    refusal = found.refusal()
    assert refusal.code == "B-RUN-081"


def test_instruments_that_do_not_open_or_hang_while_they_do(
    tmp_path: Path, blocked: Any, monkeypatch: pytest.MonkeyPatch
) -> None:
    def open_instrument(visa: Any, role: str, *_: Any, **__: Any) -> Any:
        if role == "calibrator":
            return blocked(None)
        raise InstrumentError("B-RUN-002", "does not open", where=role)

    monkeypatch.setattr(surveying, "OPEN_LIMIT_S", 0.05)
    monkeypatch.setattr(surveying, "open_instrument", open_instrument)
    found = examine(served_plan(), clock_at_noon(), tmp_path, Machine())
    assert [one.name for one in found.of(Status.FAIL)] == IDENTITIES
    assert found.findings[1].text == "it does not open within 0.05 s"


def test_instruments_of_different_buses_are_opened_side_by_side(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    plan = served_plan()
    buses = {bus_of(entry.resource) for entry in plan.station.instruments.values()}
    assert len(buses) > 1
    together = threading.Barrier(len(buses), timeout=10.0)

    def open_instrument(visa: Any, role: str, *_: Any, **__: Any) -> Any:
        together.wait()  # nobody passes until all are here
        raise InstrumentError("B-RUN-002", "does not open", where=role)

    monkeypatch.setattr(surveying, "open_instrument", open_instrument)
    found = examine(plan, WallClock(), tmp_path, Machine())
    assert {one.text for one in found.of(Status.FAIL) if one.name in IDENTITIES} == {"does not open"}


# --- awake ------------------------------------------------------------------------------------------------------------


class Run:
    """What an inhibitor sees of a run."""

    def __init__(self, virtual: bool = False) -> None:
        self.clock = SimpleNamespace(virtual=virtual)
        self.plan = served_plan()
        self.events: list[tuple[str, dict[str, Any]]] = []

    def event(self, event: Event) -> None:
        self.events.append((event.kind, event.document()))


def test_an_inhibitor_lives_as_long_as_the_run(tmp_path: Path) -> None:
    run: Any = Run()
    ended = tmp_path / "ended"
    with stay_awake(run, ("sh", "-c", f"cat; touch {ended}")):
        assert run.events == [("inhibit", {"held": True, "text": "the machine stays awake"})]
        assert not ended.exists()
    assert ended.exists()


@pytest.mark.parametrize("word", ["false", "no-such-program"])
def test_a_run_goes_on_without_an_inhibitor(word: str) -> None:
    run: Any = Run()
    with stay_awake(run, (word,)):
        assert [fields["held"] for _, fields in run.events] == [False]


def test_a_rehearsal_takes_no_inhibitor() -> None:
    run: Any = Run(virtual=True)
    with stay_awake(run, ("no-such-program",)):
        assert run.events == []
