"""The pre-flight: what it refuses and tells, that no check can raise or hang, and what it says about instruments."""

import threading
from collections.abc import Iterator
from contextlib import nullcontext
from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import pytest
from preflight_bench import (
    Instrument,
    Machine,
    calls,
    clock_at_noon,
    context,
    in_process_plan,
    no_answer,
    refuses,
    served_plan,
)

from bench.model.clock import NS, VirtualClock, WallClock
from bench.model.errors import ExitStatus, InputError, InstrumentError
from bench.model.events import Event
from bench.model.ports import Identity, StateRow
from bench.report.tables import analysis_tables
from bench.run.bus.opener import open_bench
from bench.run.bus.side_by_side import bus_of
from bench.run.preflight import Finding, Preflight, Report, Status
from bench.run.preflight import survey as surveying
from bench.run.preflight.context import PreflightContext
from bench.run.preflight.of_instruments import (
    first_contacts,
    generators,
    identities,
    laboratory,
    reference,
    self_calibration,
    settings,
    standards,
    warm_up,
    wiring,
)
from bench.run.preflight.of_machine import stay_awake
from bench.run.preflight.survey import Check, examine, interlocks, survey
from bench.session.happenings import preflight_table

OK = Finding("one", Status.OK, "1", "2", "fine")
WARN = Finding("two", Status.WARN, "", "", "not so fine")
INPUT = Finding("three", Status.FAIL, "3", "4", "no room")
BENCH = Finding("four", Status.FAIL, "5", "6", "wrong one", of_bench=True)


def test_one_error_lists_everything_that_keeps_a_run_from_starting_and_a_warning_does_not() -> None:
    assert Report((OK, WARN)).refusal() is None
    refusal = Report((OK, INPUT, WARN)).refusal()
    assert isinstance(refusal, InputError)
    assert (refusal.code, refusal.exit_status) == ("B-RUN-080", ExitStatus.BAD_INPUT)
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


def test_a_rehearsal_asks_no_instrument_and_writes_nothing_of_the_machine(tmp_path: Path) -> None:
    clock, sent, told = VirtualClock(), [], []
    plan = in_process_plan()
    bench = open_bench(plan.station, clock, lambda role, direction, text, t_mono_ns: sent.append(text), seed=1)
    try:
        for instrument in bench.instruments.values():
            instrument.identify()
        sent.clear()
        assert Preflight(told.append, Machine())(plan, bench, clock, tmp_path, prepared=True) is None
    finally:
        bench.close()
    assert (told, set(sent)) == ([], {"<close>"})
    assert list(tmp_path.iterdir()) == []


def test_warnings_are_told_and_the_run_goes_on(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    for name in ("ALWAYS", "ON_THE_BUS", "ON_THE_MACHINE"):
        monkeypatch.setattr(surveying, name, (Check(name, lambda _: [OK, WARN]),))
    rows = [StateRow("unit", "UNIT C", "F", False, ""), StateRow("terminals", "", "REAR", False, "press Front")]
    left = {role: calls([row]) for role, row in zip(("dmm", "rail_dmm"), rows, strict=True)}
    who = Identity("maker", "model", "0", "1")
    instruments = {role: Instrument(who, state_rows=each) for role, each in left.items()}
    bench: Any = SimpleNamespace(instruments=instruments, links={})
    told: list[str] = []
    judge = Preflight(told.append, Machine())
    judge(served_plan(), bench, WallClock(), tmp_path, prepared=False)
    assert told == ["pre-flight: settings of dmm: 1 asked; a run sets unit (F now)"], "before anything is set"
    event = judge(served_plan(), bench, WallClock(), tmp_path, prepared=True)
    warnings = ["settings of rail_dmm: terminals (REAR), press Front", *["two: not so fine"] * 3]
    assert told[1:] == [f"pre-flight, warning: {each}" for each in warnings]
    assert (event.ok, event.warn) == (4, 4)


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


class Run:
    """What an inhibitor sees of a run; ``held`` what it was told."""

    def __init__(self, virtual: bool = False) -> None:
        self.clock = SimpleNamespace(virtual=virtual)
        self.plan = served_plan()
        self.held: list[bool] = []

    def event(self, event: Event) -> None:
        self.held.append(event.document()["held"])


def test_an_inhibitor_lives_as_long_as_the_run(tmp_path: Path) -> None:
    run: Any = Run()
    ended = tmp_path / "ended"
    with stay_awake(run, ("sh", "-c", f"cat; touch {ended}")):
        assert run.held == [True]
        assert not ended.exists()
    assert ended.exists()


@pytest.mark.parametrize(
    ("word", "virtual", "held"), [("false", False, [False]), ("no-such-program", False, [False]), ("false", True, [])]
)
def test_a_run_goes_on_without_an_inhibitor_and_a_rehearsal_takes_none(
    word: str, virtual: bool, held: list[bool]
) -> None:
    run: Any = Run(virtual)
    with stay_awake(run, (word,)):
        assert run.held == held


def test_where_nobody_answers_no_first_contact_is_judged() -> None:
    bench: Any = SimpleNamespace(station=SimpleNamespace(simulated=False), instruments={})
    (found,) = first_contacts(bench)
    assert found.status is Status.SKIPPED


DAY_NS = 86_400 * NS


def on_bench(out: Path, role: str, **answers: Any) -> PreflightContext:
    known = Instrument(Identity("maker", "model", "0", "1"), **answers)
    return context(out, instruments={role: known})


def single(findings: list[Finding]) -> Finding:
    (finding,) = findings
    return finding


@pytest.mark.parametrize(
    ("identity", "status", "value"),
    [
        (Identity("FLUKE", "5720A", "SIM5720", "1"), Status.OK, "5720A SIM5720"),
        (Identity("FLUKE", "5720A", "0", "1"), Status.OK, "5720A (tells no number)"),
        (Identity("FLUKE", "5720A", "7", "1"), Status.FAIL, "5720A 7"),
        (None, Status.FAIL, "B-INST-001"),
    ],
)
def test_identity_and_serial_number_at_the_first_try(
    tmp_path: Path, identity: Identity | None, status: Status, value: str
) -> None:
    hurried: list[float] = []
    calibrator: Any = Instrument(identity, quick=lambda limit_s: nullcontext(hurried.append(limit_s)))
    bench = context(tmp_path, instruments={"calibrator": calibrator})
    others = {role: no_answer() for role in bench.station.instruments if role != "calibrator"}
    findings = identities(replace(bench, absent=others))
    assert (len(findings), hurried) == (10, [1.0])
    assert (findings[0].status, findings[0].value) == (status, value)
    assert all(finding.status is Status.FAIL and finding.of_bench for finding in findings[1:])


def locked(*answers: bool) -> dict[str, Any]:
    left = list(answers)
    return {"reference_locked": lambda: left.pop(0)}


def warm(hours: float) -> dict[str, Any]:
    return {"warm_up_s": 1800.0, "time_on_s": calls(3600.0 * hours)}


def calibrated(days: float) -> dict[str, Any]:
    return {"self_calibration": calls((days, 30.0, "days", "since"))}


UNKNOWN = {"warm_up_s": 1800.0}  # how long it is on
MUTE: dict[str, Any] = dict.fromkeys(("time_on_s", "self_calibration", "reference_locked", "scan"), refuses)


@pytest.mark.parametrize(
    ("check", "role", "answers", "status", "value"),
    [
        (warm_up, "calibrator", warm(7100 / 3600), Status.FAIL, "1.97 h"),  # the plan asks for 2 h
        (warm_up, "calibrator", warm(2.0), Status.OK, ""),
        (warm_up, "calibrator", UNKNOWN | MUTE, Status.WARN, "unknown"),
        (warm_up, "calibrator", UNKNOWN, Status.SKIPPED, ""),  # a prompt asks
        (warm_up, "counter", UNKNOWN, Status.WARN, ""),
        (self_calibration, "calibrator", calibrated(30.0), Status.OK, ""),
        (self_calibration, "calibrator", calibrated(31.0), Status.FAIL, "31 days"),
        (self_calibration, "calibrator", MUTE, Status.WARN, ""),
        (reference, "counter", locked(True), Status.OK, ""),
        (reference, "counter", locked(False, True), Status.WARN, ""),
        (reference, "counter", locked(False, False), Status.FAIL, ""),
        (reference, "dmm", locked(False, False), Status.WARN, ""),
        (reference, "counter", MUTE, Status.WARN, ""),
        (laboratory, "logger", {"scan": calls([22.0, 50.0, 50.0])}, Status.OK, ""),
        (laboratory, "logger", {"scan": calls([24.0, 50.0, 50.0])}, Status.OK, ""),
        (laboratory, "logger", {"scan": calls([24.01, 50.0, 50.0])}, Status.FAIL, ""),
        (laboratory, "logger", {"scan": calls([21.99, 50.0, 50.0])}, Status.FAIL, ""),
        (laboratory, "logger", MUTE, Status.WARN, ""),
        (laboratory, "dmm", {}, Status.WARN, ""),  # nobody measures it
        (generators, "function_generator", {"square": None}, Status.SKIPPED, ""),  # the campaign measures it
    ],
)
def test_what_an_instrument_says_of_itself(
    tmp_path: Path, check: Any, role: str, answers: dict[str, Any], status: Status, value: str
) -> None:
    found = check(on_bench(tmp_path, role, **answers))
    finding = found if isinstance(found, Finding) else single(found)
    assert (finding.status, finding.value if value else "") == (status, value)
    assert finding.of_bench or status is not Status.FAIL or check is laboratory


def test_what_the_last_user_left_is_told_and_only_a_person_mends_some_of_it(tmp_path: Path) -> None:
    rows = [StateRow("scan", "ABOR", "", None, ""), StateRow("unit", "UNIT C", "F", False, "")]
    wrong = StateRow("terminals", "", "REAR", False, "the rear ones; press Front")
    for each, status, value, text in (
        (rows, Status.OK, "1 asked; a run sets unit (F now); a run sets unseen: scan", ""),
        ([*rows, wrong], Status.FAIL, "terminals (REAR)", "the rear ones; press Front"),
    ):
        asked = on_bench(tmp_path, "dmm", state_rows=calls(each), quick=nullcontext)
        found = single(settings(replace(asked, asks_only=True)))
        assert (found.status, found.value, found.text) == (status, value, text)


def test_what_the_plan_does_not_use_is_not_judged(tmp_path: Path) -> None:
    assert warm_up(on_bench(tmp_path, "dmm", warm_up_s=1800.0)) == []
    assert self_calibration(on_bench(tmp_path, "dmm", self_calibration=refuses)) == []


@pytest.mark.parametrize(
    ("days", "status"),
    [(0, Status.OK), (333, Status.OK), (334, Status.WARN), (335, Status.FAIL), (336, Status.FAIL), (-31, Status.FAIL)],
)
def test_certificates_hold_until_the_planned_end(tmp_path: Path, days: int, status: Status) -> None:
    """Calibrated 30 days before the first of March, due 335 days after it; the run takes 3 h, from 22 o'clock."""
    clock = VirtualClock(clock_at_noon().utc_ns() + days * DAY_NS + 10 * 3600 * NS)
    found = standards(context(tmp_path, clock=clock))
    assert found.status is status
    assert ("not valid" in found.value) is (status is Status.FAIL)
    assert not found.of_bench


def test_wiring(tmp_path: Path) -> None:
    found = wiring(context(tmp_path, host=Machine()))
    assert (found.status, found.value) == (Status.OK, "6 records, 3 channels")
    plan = served_plan()
    unwired = replace(plan, steps=tuple(step for step in plan.steps if getattr(step, "purpose", "") != "wiring"))
    assert wiring(context(tmp_path, plan=unwired)).status is Status.WARN
    quiet = replace(unwired, steps=tuple(step for step in unwired.steps if step.name != "operate"))
    assert wiring(context(tmp_path, plan=quiet)).status is Status.SKIPPED
