"""What holds a run from beside it: a machine that slept, a disk that is late, an instrument that is on and gone."""

import threading
import time
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import pytest
from record_sample import FaultyFiles
from run_rig import Beside, HoldRig, Instrument, Rig, instrument_error, sound

from bench.model import clock as clock_module
from bench.model.clock import NS, VirtualClock, WallClock, to_ns
from bench.model.ports import Effect, action
from bench.record import SessionReader, SessionWriter
from bench.record import writer as writer_module
from bench.run.guard.start import LONGEST_SILENCE_S
from bench.run.stop import LINKS, SEQUENCER, WRITER, Health, StopSwitch
from bench.run.watch import clock as watch_module
from bench.run.watch import disk
from bench.run.watch.clock import SUSPEND_S, ClockWatch, clock_watch
from bench.run.watch.disk import LATE_S, LIMIT_S, disk_watch
from bench.run.watch.outputs import CONTACT_S, CONTACT_WAKE_S, LOST_S, Contact, Declared

AT_S = 8.2  # in the record of the first point


class SleepingRig(HoldRig):
    """Its machine sleeps once, by the boot clock or, ``stopped``, with its monotonic clock going on."""

    def __init__(self, folder: Path, seconds: float, *, stopped: bool = False, at_s: float = AT_S) -> None:
        super().__init__(folder, 2)
        self.asleep_ns = 0
        self.clock.boot_ns = lambda: self.clock.now_ns() + self.asleep_ns  # type: ignore[method-assign]
        self.at(at_s, lambda: self.stop_for(seconds) if stopped else self.sleep_for(seconds))

    def sleep_for(self, seconds: float) -> None:
        self.asleep_ns += to_ns(seconds)

    def stop_for(self, seconds: float) -> None:
        self.clock.pass_to_ns(self.clock.now_ns() + to_ns(seconds))


@pytest.mark.parametrize(("stopped", "seen"), [(False, "boottime"), (True, "late beat")])
@pytest.mark.parametrize("seconds", [2.6, 60.0])
def test_a_suspend_makes_the_stimulus_safe_and_the_point_is_taken_again(
    tmp_path: Path, stopped: bool, seen: str, seconds: float
) -> None:
    rig = SleepingRig(tmp_path, seconds, stopped=stopped)
    outcome = rig.run_beside(clock_watch)
    assert outcome.error is None
    sound(rig, 2)
    (suspend,) = rig.events("suspend")
    assert (suspend["seen"], suspend["seconds"]) == (seen, pytest.approx(seconds, abs=0.5))
    (hold,) = rig.events("hold")
    assert (hold["step"], hold["by"]) == (2, "suspend")
    assert rig.called("source.make_safe")[0] <= max(15.1, AT_S + seconds + 0.1)  # a virtual wait is never sliced
    assert rig.events("release")[0]["seconds"] <= 1.5  # it is let go once it stands still ...
    assert rig.events("armed") == [{"step": 2, "by": "somebody"}]  # ... and somebody arms what follows
    assert [step for step in rig.listener.steps if step == 0] == [0, 0]  # from its relays on
    assert rig.stop.holds.reasons == {}


@pytest.mark.parametrize("stopped", [False, True])
def test_a_machine_with_much_to_do_is_no_suspend(tmp_path: Path, stopped: bool) -> None:
    rig = SleepingRig(tmp_path, SUSPEND_S - 0.51, stopped=stopped)
    assert rig.run_beside(clock_watch).error is None
    assert rig.events("suspend") == rig.events("hold") == []


def test_no_step_ends_between_a_suspend_and_the_next_look(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """The machine wakes up at 14.9 s, the record ends at 15.0 s, and the next look is at 15.4 s."""
    monkeypatch.setattr(watch_module, "LOOK_S", 0.7)
    rig = SleepingRig(tmp_path, 60.0, at_s=14.9)
    assert rig.run_beside(clock_watch).error is None
    assert rig.events("hold")[0]["step"] == 2
    sound(rig, 2)


def test_a_run_that_stands_still_already_is_let_go_too(tmp_path: Path) -> None:
    rig = SleepingRig(tmp_path, 60.0, at_s=30.2)
    rig.at(8.0, lambda: rig.stop.holds.hold("door", "it is open"))
    rig.at(40.0, lambda: rig.stop.holds.release("door"))
    assert rig.run_beside(clock_watch).error is None
    assert len(rig.events("suspend")) == len(rig.events("hold")) == 1
    assert rig.events("release")[0]["seconds"] == pytest.approx(40.0 - 15.0, abs=1.0)
    sound(rig, 2)


def test_whoever_armed_the_bench_before_a_suspend_has_not_seen_it() -> None:
    virtual: Any = VirtualClock()
    stop = StopSwitch()
    watch = ClockWatch(SimpleNamespace(clock=virtual, stop=stop, note=lambda event: None))  # type: ignore[arg-type]
    stop.holds.hold("operator", "lunch")
    stop.holds.let_go(["operator"], armed_by="kim")
    assert stop.holds.armed_by == "kim"
    virtual.boot_ns = lambda: virtual.now_ns() + 10 * NS
    watch.look()
    assert list(stop.holds.reasons) == ["suspend"]
    assert stop.holds.armed_by == ""
    watch.look()
    assert list(stop.holds.reasons) == ["suspend"]  # nobody has stood still for it yet


def test_the_end_of_a_run_is_told_of_a_suspend_and_not_held_up(tmp_path: Path) -> None:
    rig = SleepingRig(tmp_path, 60.0, at_s=33.0)
    rig.step("settle", duration_s=30.0, bus_s=0.0, phase="finally")
    assert rig.run_beside(clock_watch).error is None
    assert len(rig.events("suspend")) == 1
    assert rig.events("hold") == []


def test_the_boot_clock_is_that_of_the_system_or_the_monotonic_one(monkeypatch: pytest.MonkeyPatch) -> None:
    clock = WallClock()
    before_ns, boot_ns, after_ns = clock.now_ns(), clock.boot_ns(), clock.now_ns()
    assert boot_ns >= before_ns
    monkeypatch.setattr(clock_module, "_BOOT", None)  # a system that has none
    assert before_ns <= clock.boot_ns() <= after_ns + NS
    assert clock.boot_ns() - time.monotonic_ns() < NS
    assert VirtualClock().boot_ns() == 0


def slow_disk(rig: HoldRig, seconds: float, from_s: float, to_s: float) -> Beside:
    """Each fsync that begins from ``from_s`` to ``to_s`` of the bench clock takes ``seconds``."""

    def sync() -> None:
        if from_s <= rig.clock.now_ns() / 1e9 < to_s:
            rig.clock.sleep(seconds)

    return lambda context: disk_watch(context, {"session": sync, "step journal": sync})


@pytest.mark.parametrize(("seconds", "holds"), [(2.4, 0), (8.0, 1), (600.0, 1)])
def test_two_files_that_are_late_together_hold_the_run_until_the_disk_is_in_time(
    tmp_path: Path, seconds: float, holds: int
) -> None:
    """8 s each: none is slow enough for a limit of 15 s, both together are."""
    rig = HoldRig(tmp_path, 3)
    assert rig.run_beside(slow_disk(rig, seconds, 7.5, 8.5 + seconds)).error is None
    sound(rig, 3)
    held = rig.events("hold")
    assert [hold["by"] for hold in held] == ["disk"] * holds
    if holds:
        assert "waiting for the session since 00:00:08 UTC" in held[0]["reason"]
        assert rig.events("armed") == [{"step": held[0]["step"], "by": "somebody"}]
    assert rig.stop.holds.reasons == {}


def test_a_disk_that_is_slow_each_time_ends_the_run_safely_after_half_an_hour(tmp_path: Path) -> None:
    rig = HoldRig(tmp_path, 2)
    outcome = rig.run_beside(slow_disk(rig, 8.0, 7.5, 1e9))
    assert outcome.error.code == "B-RUN-070"
    assert "an fsync is not over after 5 s" in outcome.error.message
    assert len(rig.events("hold")) == 1  # not let go and held again with each round
    end_s = rig.called("source.make_safe")[-1]
    assert 7.5 + LATE_S + LIMIT_S <= end_s <= 7.5 + LATE_S + LIMIT_S + 60.0


def test_a_disk_that_is_late_at_the_end_of_a_run_holds_nothing_up(tmp_path: Path) -> None:
    rig = HoldRig(tmp_path, 1)
    rig.step("settle", duration_s=30.0, bus_s=0.0, phase="finally")
    assert rig.run_beside(slow_disk(rig, 8.0, 15.5, 24.5)).error is None
    assert rig.events("hold") == []


@pytest.mark.waits
def test_a_hanging_fsync_takes_no_memory_and_no_sign_of_life(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """In real time, with the limits a tenth of a second: what comes meanwhile goes on into the file."""
    for name in ("SYNC_S", "LOOK_S", "LATE_S"):
        monkeypatch.setattr(disk, name, 0.1)
    monkeypatch.setattr(writer_module, "HELD_BYTES", 20_000)
    clock, stop, gate = WallClock(), StopSwitch(), threading.Event()
    files = FaultyFiles(lambda kind, _: gate.wait(30.0) and None if kind == "sync" else None)  # every fsync waits
    writer = SessionWriter.create(tmp_path / "s", {}, {}, t_mono_ns=clock.now_ns(), files=files)
    context: Any = SimpleNamespace(clock=clock, stop=stop, health=Health(clock), event=lambda event: None)
    with disk_watch(context, {"session": writer.sync}):
        for turn in range(100):
            writer.raw("port_a", "rx", clock.now_ns(), bytes(10_000))
            writer.tick(clock.now_ns())
            assert writer._buffer.size < 20_000
            clock.sleep(0.005 if turn else 0.5)
        assert list(stop.holds.reasons) == ["disk"]
        assert context.health.silence_s()[WRITER] < 0.4  # systemd's watchdog is fed on
        gate.set()
        deadline_ns = clock.now_ns() + 5 * NS
        while stop.holds.reasons and clock.now_ns() < deadline_ns:
            clock.sleep(0.05)
        assert stop.holds.reasons == {}
    assert stop.fault is None
    writer.close("done")
    payloads = [message.payload for message in SessionReader(tmp_path / "s").select(frozenset({"/link/port_a/rx"}))]
    assert [len(payload) for payload in payloads] == [10_000] * 100


def test_the_guard_ends_no_run_that_waits_for_a_disk() -> None:
    assert set(LONGEST_SILENCE_S) == {SEQUENCER, LINKS}


class Calibrator(Instrument):
    """Answers, until it is gone."""

    gone, asked, heard_ns, silent_ns = False, 0, 0, -1

    @action(effect=Effect.STIMULUS_ON)
    def operate(self) -> None:
        """Switch on."""

    @action(effect=Effect.STIMULUS_OFF)
    def standby(self) -> None:
        """Switch off."""

    def look(self) -> None:
        self.asked += 1
        now_ns = self._rig.clock.now_ns()
        if self.gone:
            self.silent_ns = now_ns if self.silent_ns < 0 else self.silent_ns
            raise instrument_error("B-INST-003")
        self.heard_ns, self.silent_ns = now_ns, -1

    def heard_s(self) -> float:
        return (self._rig.clock.now_ns() - self.heard_ns) / NS

    def silence_s(self) -> float:
        return 0.0 if self.silent_ns < 0 else (self._rig.clock.now_ns() - self.silent_ns) / NS


def located(rig: Rig) -> Any:
    """Return the context of the steps made so far, whose station has the calibrator."""
    context = rig.context()
    entry = SimpleNamespace(driver="fluke_5720a", resource="TCPIP0::a::hislip0::INSTR")
    context.plan.station = SimpleNamespace(instruments={"calibrator": entry})  # type: ignore[misc]
    return context


@pytest.fixture
def watched(tmp_path: Path) -> tuple[Rig, Calibrator, Any, Declared]:
    rig = Rig(tmp_path)
    calibrator: Any = Calibrator("calibrator", rig)
    rig.instruments = {"calibrator": calibrator}
    context = located(rig)
    declared = Declared(context)
    rig.clock.every(CONTACT_WAKE_S, Contact(context, declared).take)
    return rig, calibrator, context, declared


def on(declared: Declared, reply: str) -> None:
    declared.traffic("calibrator", "tx", "ISR?", 0)
    declared.traffic("calibrator", "rx", reply, 0)


def test_one_that_is_on_and_gone_holds_the_run_in_time(watched: tuple[Rig, Calibrator, Any, Declared]) -> None:
    rig, calibrator, context, declared = watched
    on(declared, "4097")
    rig.clock.sleep(10.0)
    assert 8 <= calibrator.asked <= 10
    assert context.stop.holds.reasons == {}
    calibrator.gone = True
    lost_ns = rig.clock.now_ns()
    while not context.stop.holds.reasons:
        rig.clock.sleep(0.05)
    assert (rig.clock.now_ns() - lost_ns) / NS <= CONTACT_S + LOST_S + 3 * CONTACT_WAKE_S
    assert set(context.stop.holds.reasons) == {"instrument calibrator"}
    assert context.away == {"calibrator"}


def test_a_glitch_is_none_of_its_business(watched: tuple[Rig, Calibrator, Any, Declared]) -> None:
    rig, calibrator, context, declared = watched
    on(declared, "4097")
    rig.clock.sleep(5.0)
    calibrator.gone = True
    rig.clock.sleep(CONTACT_S + 0.5)
    calibrator.gone = False
    rig.clock.sleep(5.0)
    assert context.stop.holds.reasons == {}


@pytest.mark.parametrize("why", ["off", "in use", "over"])
def test_nobody_else_is_asked(watched: tuple[Rig, Calibrator, Any, Declared], why: str) -> None:
    rig, calibrator, context, declared = watched
    on(declared, "4096" if why == "off" else "4097")
    if why == "over":
        context.stop.shield()
    with context.in_use.take("calibrator" if why == "in use" else "dmm"):
        rig.clock.sleep(10.0)
    assert calibrator.asked == 0


@pytest.mark.parametrize(("done", "held"), [("measure", True), ("operate", False)])
def test_what_is_on_and_no_step_switches_on_holds_the_run_once(
    watched: tuple[Rig, Calibrator, Any, Declared], done: str, held: bool
) -> None:
    rig, _, _, _ = watched
    step = rig.step("call", "calibrator", done)
    context = located(rig)
    declared = Declared(context)
    for asked in (lambda: None, lambda: declared.step(step, 0.0)):
        asked()
        on(declared, "4097")  # as the last user left it
        assert context.stop.holds.reasons == {}
    on(declared, "4096")
    assert context.stop.holds.reasons == {}
    for _ in range(2):
        on(declared, "4097")
        assert set(context.stop.holds.reasons) == ({"undeclared effect"} if held else set())
        context.stop.holds.release("undeclared effect")
        held = False


@pytest.mark.parametrize(
    ("begun", "held"),
    [
        ([0], False),
        ([0, 1], False),  # switching off is under way
        ([0, 1, 2], True),
        ([0, 2], False),  # a decision has left standby out
        ([0, 1, 3], False),
        ([0, 1, 5], False),  # what it has left out may have been done
        ([0, 1, 2, 3, 4, 5], True),
        ([0, 1, 2, 3, 2], True),  # the point is taken again
        ([0, 1, 2, 3, 4, 5, 4], False),
    ],
)
def test_what_a_step_has_switched_off_and_answers_on_holds_the_run(
    watched: tuple[Rig, Calibrator, Any, Declared], begun: list[int], held: bool
) -> None:
    rig, _, _, _ = watched
    steps = [rig.step("call", "calibrator", name) for name in 2 * ("operate", "standby", "measure")]
    context = located(rig)
    for on_the_way_back in (True, False):
        declared = Declared(context)
        for number in begun:
            declared.step(steps[number], 0.0)
        context.stop.deferred = on_the_way_back
        on(declared, "4097")
        assert bool(context.stop.holds.reasons) == (held and not on_the_way_back)
