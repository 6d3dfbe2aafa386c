"""What the guard sends to the simulated instruments, when, and what they are afterwards; all in this process."""

from __future__ import annotations

import json
import os
import signal
import threading
from collections.abc import Iterator
from contextlib import suppress
from pathlib import Path
from typing import Any

import pytest
from sim_bench import ADDRESSES, DRIVERS, open_bench

from bench.model.clock import NS, VirtualClock
from bench.model.events import Event
from bench.model.ports import Instrument
from bench.run.bench.opener import open_instrument
from bench.run.guard import act as act_module
from bench.run.guard import lock as lock_module
from bench.run.guard import process
from bench.run.guard.act import act
from bench.run.guard.decision import Action, Address, Brief
from bench.run.guard.diary import DIARY, Diary, read_diary
from bench.run.guard.guarding import GuardTask
from bench.run.guard.health import CHAMBER_AIR, Health
from bench.run.guard.lock import BenchLock, bus_keys
from bench.run.guard.take_over import ask_to_let_go
from bench.run.stop import StopSwitch

ROLES = ("calibrator", "switch", "chamber")
SAFE_S = 5.0  # the deadline of safety
AT_ONCE_S = 0.5  # for what nothing hinders: three instruments on one bus
# Of real time: who is not asleep by then waits for something that is no clock; for a transfer, and for a long sleep.
GRACE_S, LONG_GRACE_S = 0.01, 0.5
pytestmark = pytest.mark.limit(0.1)  # a thread that gets no core for longer lets the shared clock run ahead of it
GONE = Action("gone", "it died")
ON, NOTHING_ON = {"calibrator": True, "switch": 1}, {"calibrator": False, "switch": 0}


class SharedClock(VirtualClock):
    """A virtual clock of several threads: time goes on when the guard's threads and this one all sleep."""

    def __init__(self) -> None:
        super().__init__()
        self._asleep = threading.Condition()
        self._dues_ns: dict[int, int] = {}

    def sleep_until_ns(self, t_mono_ns: int) -> None:
        own = threading.get_ident()
        with self._asleep:
            self._dues_ns[own] = t_mono_ns
            self._asleep.notify_all()
            grace_s = GRACE_S if t_mono_ns - self.now_ns() < 0.4 * NS else LONG_GRACE_S
            while not self._is_next(own) and self._asleep.wait(grace_s):
                pass
            del self._dues_ns[own]
        super().sleep_until_ns(t_mono_ns)  # what falls due may want a lock of one that sleeps
        with self._asleep:
            self._asleep.notify_all()

    def _is_next(self, own: int) -> bool:
        awake = {thread.ident for thread in threading.enumerate() if "_tried_until_safe" in thread.name}
        awake.add(threading.main_thread().ident)
        return awake <= self._dues_ns.keys() and min(self._dues_ns, key=lambda at: (self._dues_ns[at], at)) == own


class Ended:
    """A controller that notes that it was killed."""

    def __init__(self) -> None:
        self.limits_s: list[float] = []

    def end(self, limit_s: float) -> bool:
        self.limits_s.append(limit_s)
        return True


class Guarded:
    """A simulated bench with stimulus, route and chamber on, as a controller leaves it that dies."""

    def __init__(self, bench: Any, folder: Path) -> None:
        self.folder, self.bench, self.clock = folder, bench, bench.clock
        self.world = bench.world
        self.sent: list[tuple[str, str, int]] = []
        self.told: list[tuple[float, str]] = []
        self.controller = Ended()
        self.addresses = tuple(Address(role, DRIVERS[role], ADDRESSES[role]) for role in ROLES)
        self.limits: dict[str, float] = {}
        self.pid, self.simulated = os.getpid(), False
        instruments: Any = {address.role: self.opened(address) for address in self.addresses}
        instruments["chamber"].set_temperature(temperature=40.0, ramp=1.0)
        instruments["chamber"].run()
        instruments["switch"].route(channel=3, polarity=1)
        instruments["calibrator"].output(current=1e-3, range="lowest_that_holds")
        instruments["calibrator"].operate()
        self.instruments = instruments
        assert self.on() == ON, self.on()
        assert self.is_heating()
        self.sent.clear()
        self.begun_ns = self.clock.now_ns()

    def opened(self, address: Address) -> Instrument:
        def transcript(role: str, direction: str, text: str, t_mono_ns: int) -> None:
            if direction == "tx":
                self.sent.append((role, text, t_mono_ns))

        return open_instrument(self.bench.manager, address.role, address, self.clock, transcript)

    @property
    def brief(self) -> Brief:
        return Brief(
            self.pid, self.world.visa_library, self.addresses, self.limits, 2.0, str(self.folder / DIARY),
            notify=("mail",), simulated=self.simulated,
        )  # fmt: skip

    def acts(self, action: Action = GONE) -> bool:
        """Let the guard act; return whether it says that all is safe."""
        diary = Diary(self.folder / DIARY, self.clock)
        controller: Any = self.controller
        try:
            return act(action, self.brief, controller, self.opened, self.clock, diary)
        finally:
            diary.close(5.0)

    def on(self) -> dict[str, object]:
        """What the stimulus really is."""
        devices = self.world.instruments
        return {"calibrator": devices["calibrator"].operating, "switch": len(devices["switch"].outputs()["closed"])}

    def is_heating(self) -> bool:
        return bool(self.world.instruments["chamber"].mode & 16)

    def after_s(self, role: str, text: str) -> float:
        """Return when an instrument was first sent a text, after the beginning, s."""
        return next((t_ns - self.begun_ns) / NS for to, sent, t_ns in self.sent if to == role and text in sent)

    def talked_to(self) -> list[str]:
        """Return the roles in the order in which they were first talked to."""
        return list(dict.fromkeys(role for role, *_ in self.sent))

    def entries(self, what: str, **fields: object) -> list[dict[str, Any]]:
        """Return what the diary has of a kind with these fields."""
        return [
            entry
            for entry in read_diary(self.folder / DIARY)
            if entry["what"] == what and all(entry.get(name) == value for name, value in fields.items())
        ]

    def later(self, seconds: float, do: Any) -> None:
        """Do something once after some time of the bench."""
        task = self.clock.every(seconds, lambda: (task.cancel(), do()), observer=False)


@pytest.fixture
def guarded(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Iterator[Guarded]:
    """A bench that nobody has made safe; locks lie in a folder of its own, and who is told is noted."""
    locks, folder = tmp_path / "locks", tmp_path / "night"
    locks.mkdir()
    folder.mkdir()
    monkeypatch.setattr(lock_module, "lock_folder", lambda: locks)
    monkeypatch.setattr(act_module, "TURN_S", 30.0)  # of real time, which a busy machine takes; nobody hangs here
    with open_bench(clock=SharedClock()) as bench:
        made = Guarded(bench, folder)

        def told(_: object, **options: Any) -> Any:
            made.told.append(((made.clock.now_ns() - made.begun_ns) / NS, options["input"]))
            return type("Done", (), {"returncode": 0, "stderr": ""})

        monkeypatch.setattr(act_module.subprocess, "run", told)
        yield made


def test_the_stimulus_goes_off_first_and_at_once_behind_a_device_clear(guarded: Guarded) -> None:
    assert guarded.acts()
    assert guarded.on() == NOTHING_ON
    assert guarded.talked_to() == list(ROLES)
    for role, address in ADDRESSES.items():
        if role in ROLES:
            assert next(text for to, text, _ in guarded.sent if to == role) == "<device clear>", address
    assert guarded.after_s("calibrator", "STBY") < guarded.after_s("switch", ":OPEN ALL") <= AT_ONCE_S
    assert guarded.after_s("chamber", "HOLD") <= AT_ONCE_S
    assert [text for _, text, _ in guarded.sent].count("<close>") == len(ROLES)
    assert guarded.controller.limits_s == [act_module.LEAVE_S]
    kinds = [entry["what"] for entry in read_diary(guarded.folder / DIARY)]
    assert kinds == ["act", "controller", "lock", *["instrument"] * 3, "safe", "notify"]
    took_s = {entry["role"]: entry["took_s"] for entry in guarded.entries("instrument", safe=True)}
    assert took_s == {"calibrator": 0.032, "switch": 0.282, "chamber": 1.22}
    ((_, message),) = guarded.told
    assert json.loads(message) == {
        "kind": "alarm", "event": "guard", "session": "night", "reason": "gone", "text": "it died", "unsafe": {},
    }  # fmt: skip


def test_heat_goes_off_first_when_it_is_too_hot(guarded: Guarded) -> None:
    assert guarded.acts(Action("limit", "too hot", heat_off=True))
    assert guarded.talked_to() == ["chamber", "calibrator", "switch"]
    assert guarded.after_s("chamber", "STOP") <= AT_ONCE_S
    assert not guarded.is_heating()
    assert guarded.on() == NOTHING_ON


def test_only_what_was_left_is_touched_and_nobody_is_ended(guarded: Guarded) -> None:
    assert guarded.acts(Action("left", "it left", left=("chamber",)))
    assert guarded.talked_to() == ["chamber"]
    assert guarded.on() == ON
    assert guarded.controller.limits_s == []
    assert guarded.entries("controller") == []


def test_a_network_instrument_gets_no_device_clear(guarded: Guarded, monkeypatch: pytest.MonkeyPatch) -> None:
    """A connection of its own begins clean, and a raw socket has none."""
    calibrator = guarded.instruments["calibrator"]
    act_module._clear(calibrator, "tcpip0::10.0.0.1::inst0::INSTR")
    assert guarded.sent == []
    act_module._clear(calibrator, ADDRESSES["calibrator"])
    assert [text for _, text, _ in guarded.sent] == ["<device clear>"]


def test_a_request_of_before_sends_no_guard_home(guarded: Guarded) -> None:
    ask_to_let_go({"folder": str(guarded.folder)})
    guarded.world.switches.switch("mute", "calibrator")
    guarded.later(4.0, guarded.world.switches.clear)
    assert guarded.acts()
    assert guarded.entries("taken over") == []


@pytest.mark.parametrize("simulated", [True, False])
def test_only_the_guard_of_a_simulated_bench_ends_with_its_folder(guarded: Guarded, simulated: bool) -> None:
    guarded.simulated = simulated
    guarded.world.switches.switch("mute", "calibrator")
    guarded.later(30.0, guarded.world.switches.clear)
    guarded.later(6.0, lambda: guarded.folder.rename(guarded.folder.with_name("gone")))
    assert guarded.acts() is not simulated
    assert guarded.on()["switch"] == 0


def holding(guarded: Guarded) -> BenchLock:
    return BenchLock(bus_keys(ADDRESSES.values()), "run", guarded.clock)


def test_beside_its_controller_that_has_not_left_it_acts_at_once(guarded: Guarded) -> None:
    with holding(guarded):
        assert guarded.acts()
    assert guarded.after_s("switch", ":OPEN ALL") <= act_module.LEAVE_S + AT_ONCE_S
    assert [entry["text"] for entry in guarded.entries("lock")] == [f"held by process {os.getpid()}"]


def test_a_bench_that_somebody_else_has_is_theirs_until_they_leave(guarded: Guarded) -> None:
    guarded.pid = os.getpid() + 1
    held = holding(guarded)
    held.take()
    guarded.later(10.0, held.release)
    assert guarded.acts()
    assert 10.0 <= guarded.after_s("calibrator", "STBY") <= 10.0 + SAFE_S
    assert guarded.on() == NOTHING_ON
    assert [entry["text"] for entry in guarded.entries("lock")] == [f"held by process {os.getpid()}", "taken"]
    with holding(guarded):  # it has given the bench back
        pass


def test_a_lock_that_cannot_be_had_keeps_nobody_safe(
    guarded: Guarded, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(lock_module, "lock_folder", lambda: tmp_path / "nowhere")
    assert guarded.acts()
    assert guarded.on() == NOTHING_ON
    assert guarded.after_s("switch", ":OPEN ALL") <= act_module.LEAVE_S + AT_ONCE_S
    (entry,) = guarded.entries("lock")
    assert "cannot be opened" in entry["text"]


class Watching:
    """As much of a run as a task that guards it needs."""

    def __init__(self, guarded: Guarded) -> None:
        self.instruments, self.clock, self.in_use = guarded.instruments, guarded.clock, {"switch"}
        self.stop, self.health = StopSwitch(), Health(guarded.clock)
        self.events: list[Event] = []
        self.event = self.events.append
        self.unit_temperature_degC = 20.0


def test_a_guard_in_the_run_acts_once_and_leaves_what_a_step_uses(guarded: Guarded) -> None:
    context: Any = Watching(guarded)
    task = GuardTask(context, {CHAMBER_AIR: 65.0})
    for air_degC, is_hot in ((64.9, False), (65.0, True)):
        context.health.note(CHAMBER_AIR, air_degC)
        task.look()
        assert bool(context.events) == is_hot
    assert guarded.talked_to() == ["chamber", "calibrator"]
    assert not guarded.is_heating()
    assert guarded.on() == {"calibrator": False, "switch": 1}
    guarded.sent.clear()
    task.look()
    assert (guarded.sent, len(context.events)) == ([], 1)
    with pytest.raises(Exception, match="B-RUN-094"):
        context.stop.check()


class Told:
    """A guard as a process, in this one: what it is told on its standard input, and what it answers."""

    def __init__(self, guarded: Guarded, monkeypatch: pytest.MonkeyPatch, capfd: pytest.CaptureFixture[str]) -> None:
        self.guarded, self._capfd = guarded, capfd
        self.read, self.write = os.pipe()
        self.signals: list[int] = []
        monkeypatch.setattr(process, "_Lines", lambda _, kind=process._Lines: kind(self.read))
        monkeypatch.setattr(process, "WallClock", lambda: guarded.clock)
        monkeypatch.setattr(process, "Controller", lambda pid: guarded.controller)
        monkeypatch.setattr(process, "_stay_ready", lambda: None)
        monkeypatch.setattr(process, "unheard", self.heard)
        monkeypatch.setattr(process.signal, "signal", lambda number, _: self.signals.append(number))
        monkeypatch.setattr(process.os, "set_blocking", lambda *_: None)

    def heard(self, role: str, direction: str, text: str, t_mono_ns: int) -> None:
        if direction == "tx":
            self.guarded.sent.append((role, text, t_mono_ns))

    def __call__(self, *messages: object) -> tuple[int, str]:
        """Return the exit status after these messages and the end of the controller, and what it answered."""
        lines = b"".join(json.dumps(message).encode() + b"\n" for message in messages)
        os.write(self.write, self.guarded.brief.line() + lines)
        os.close(self.write)
        with suppress(OSError):
            status = process.main()
        os.close(self.read)
        return status, self._capfd.readouterr().out


@pytest.fixture
def told(guarded: Guarded, monkeypatch: pytest.MonkeyPatch, capfd: pytest.CaptureFixture[str]) -> Told:
    return Told(guarded, monkeypatch, capfd)


BEAT = {"values": {}, "at": ["step 7", 0.5], "air_age_s": 0.0}


def test_a_controller_that_ends_without_a_goodbye_leaves_a_safe_bench(guarded: Guarded, told: Told) -> None:
    assert told(BEAT, BEAT) == (0, "ready\n..")
    assert guarded.on() == NOTHING_ON
    assert set(told.signals) >= {signal.SIGINT, signal.SIGTERM, signal.SIGHUP}
    assert [entry["reason"] for entry in guarded.entries("act")] == ["gone"]
    assert guarded.entries("ready", pid=os.getpid(), controller=guarded.pid, silence_s=2.0)


def test_after_a_goodbye_nothing_is_touched(guarded: Guarded, told: Told) -> None:
    assert told(BEAT, {"goodbye": {}}) == (0, "ready\n..")
    assert (guarded.on(), guarded.sent) == (ON, [])
    assert [entry["what"] for entry in read_diary(guarded.folder / DIARY)] == ["ready", "dismissed"]


def test_what_a_goodbye_names_is_gone_on_with_and_its_heat_stopped(guarded: Guarded, told: Told) -> None:
    assert told({"goodbye": {"chamber": "unreachable"}, "heat_off": True})[0] == 0
    assert guarded.talked_to() == ["chamber"]
    assert not guarded.is_heating()


def test_a_hard_limit_in_a_heartbeat_is_acted_on(guarded: Guarded, told: Told) -> None:
    guarded.limits = {CHAMBER_AIR: 65.0}
    assert told(BEAT | {"values": {CHAMBER_AIR: 65.5}})[0] == 0
    assert guarded.talked_to()[0] == "chamber"
    assert not guarded.is_heating()


def test_a_guard_that_was_sent_home_says_so(guarded: Guarded, told: Told) -> None:
    guarded.world.switches.switch("mute", "calibrator")
    guarded.later(5.0, lambda: ask_to_let_go({"folder": str(guarded.folder)}))
    assert told(BEAT)[0] == 3


@pytest.mark.parametrize("answers", [True, False])
def test_it_looks_itself_while_the_reading_of_the_controller_is_old(
    guarded: Guarded, monkeypatch: pytest.MonkeyPatch, answers: bool
) -> None:
    """A thread that hangs in an instrument keeps no process alive; one that fails has no reading."""
    if not answers:
        guarded.world.switches.switch("mute", "chamber")
    threads: list[Any] = []
    real = threading.Thread

    def thread(**options: Any) -> threading.Thread:
        threads.append(real(**options))
        return threads[-1]

    monkeypatch.setattr(process.threading, "Thread", thread)
    own = process.OwnReading(guarded.addresses, guarded.opened, guarded.clock)
    assert own.look(None) is own.look(process.STALE_S - 0.1) is None
    assert threads == []
    for _ in range(3):
        own.look(process.STALE_S)
        threads[-1].join()
        guarded.clock.sleep(1.0)
    assert [made.daemon for made in threads] == [True]  # again after 5 s
    guarded.clock.sleep(process.AGAIN_S)
    own.look(process.STALE_S)
    threads[-1].join()
    assert len(threads) == 2
    newest = own.look(process.STALE_S)
    assert (newest is not None) == answers
    assert newest is None or 15.0 < newest < 45.0
    assert {role for role, *_ in guarded.sent} == {"chamber"}
    assert own.look(0.0) is None
