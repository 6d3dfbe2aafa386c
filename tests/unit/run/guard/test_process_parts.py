"""The parts of the guard process: its brief, its diary, its last words, the handle on its controller, its start."""

import json
import math
import os
import signal
import subprocess
import sys
import threading
from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace
from typing import Any
from unittest.mock import MagicMock

import pytest

from bench.model.clock import NS, VirtualClock, WallClock
from bench.model.errors import ExitStatus, InputError, RunError
from bench.model.lab import find_shipped
from bench.model.ports import Effect, Parameter, Tells, action
from bench.model.posix import user_name
from bench.plan import Station, load_station
from bench.plan.language.notices import Notify
from bench.run.bus.opener import OpenBench
from bench.run.guard import last_words as last_words_module
from bench.run.guard.act import act
from bench.run.guard.decision import Action, Address, Brief, Watched
from bench.run.guard.diary import Diary, guard_word, read_diary
from bench.run.guard.drill import drill, latest_drill
from bench.run.guard.drill_controller import source_of, stimulate, stimulated
from bench.run.guard.guarding import brief_of, station_lock
from bench.run.guard.last_words import guard_lines, last_words, terminal_of, write_to_terminal
from bench.run.guard.notice import notice_command
from bench.run.guard.process import OwnReading, _watch
from bench.run.guard.process import _Lines as ReadLines
from bench.run.guard.start import GuardProcess
from bench.run.guard.take_over import TAKE_OVER, ask_to_let_go
from bench.run.stop import LINKS, SEQUENCER, Health, StopSwitch

BRIEF = Brief(
    pid=1,
    visa="@py",
    instruments=(Address("calibrator", "fluke_5720a", "GPIB0::4::INSTR", {"slot": [1, 2]}),),
    limits={"chamber_air_degC": 65.0},
    silence_s=2.0,
    diary="/somewhere/guard.jsonl",
)


def test_a_brief_survives_its_line() -> None:
    line = replace(BRIEF, notify=("mail", "me")).line()
    assert line.count(b"\n") == 1
    assert Brief.of_line(line) == replace(BRIEF, notify=("mail", "me"))


def test_the_brief_of_a_station_is_in_safe_order() -> None:
    station = load_station(find_shipped("stations", "af_bench_sim"))
    brief = brief_of(station, Path("guard.jsonl"))
    assert [address.role for address in brief.instruments] == list(station.safe_order)
    assert (brief.instruments[0].role, brief.instruments[1].role) == ("calibrator", "switch")
    assert Path(brief.diary).is_absolute()
    assert brief.pid == os.getpid()


def test_a_diary_is_read_back_and_a_torn_line_is_not(tmp_path: Path) -> None:
    path = tmp_path / "guard.jsonl"
    diary = Diary(path, WallClock())
    diary.note("act", reason="gone")
    diary.close(5.0)
    with path.open("ab") as stream:
        stream.write(b'{"what":"sa')
    found = read_diary(path)
    assert [(entry["what"], entry["reason"]) for entry in found] == [("act", "gone")]
    assert found[0]["utc"].endswith("+00:00")
    assert read_diary(tmp_path / "none") == []


def test_a_folder_that_is_gone_keeps_no_diary_and_stops_nothing(tmp_path: Path) -> None:
    diary = Diary(tmp_path / "gone" / "guard.jsonl", WallClock())
    diary.note("act")
    diary.close(5.0)


class Instrument:
    """Notes what it is asked for; fails as often as it is told to."""

    def __init__(self, role: str, calls: list[str], failures: int = 0) -> None:
        self._role, self._calls, self._failures = role, calls, failures

    def make_safe(self) -> None:
        self._note("make_safe")

    def _note(self, what: str) -> None:
        self._calls.append(f"{self._role}.{what}")
        self._failures -= 1
        if self._failures >= 0:
            raise RunError("B-TEST-000", "mute")


class Chamber(Instrument):
    @action(effect=Effect.THERMAL)
    def stop(self) -> None:
        self._note("stop")


class Ended:
    """A controller that has left."""

    def end(self, limit_s: float) -> bool:
        return True


class SwiftClock(WallClock):
    """Never waits long."""

    def sleep_until_ns(self, t_mono_ns: int) -> None:
        super().sleep_until_ns(min(t_mono_ns, self.now_ns() + 1_000_000))


def acted(tmp_path: Path, action_: Action, failures: int) -> tuple[list[str], bool, list[dict[str, Any]]]:
    calls: list[str] = []
    made = {"calibrator": Instrument("calibrator", calls, failures), "chamber": Chamber("chamber", calls)}
    addresses = (
        Address("calibrator", "fluke_5720a", "TCPIP0::127.0.0.1::nobody1::INSTR"),
        Address("chamber", "thermotron_3800", "TCPIP0::127.0.0.1::nobody2::INSTR"),
    )
    notify = (sys.executable, "-c", "import sys; sys.stdin.read()")
    brief = replace(BRIEF, instruments=addresses, notify=notify, diary=str(tmp_path / "guard.jsonl"))
    clock = SwiftClock()
    diary = Diary(tmp_path / "guard.jsonl", clock)
    controller: Any = Ended()
    safe = act(action_, brief, controller, lambda address: made[address.role], clock, diary)  # type: ignore[arg-type]
    diary.close(5.0)
    return calls, safe, read_diary(tmp_path / "guard.jsonl")


def test_the_stimulus_goes_off_first_and_what_failed_is_confirmed_twice(tmp_path: Path) -> None:
    calls, safe, diary = acted(tmp_path, Action("gone", "it died"), failures=2)
    assert calls[0] == "calibrator.make_safe"
    assert sorted(calls[1:]) == ["calibrator.make_safe"] * 3 + ["chamber.make_safe"]  # an answer, and one that counts
    assert safe
    kinds = [entry["what"] for entry in diary]
    assert kinds[:3] == ["act", "controller", "lock"]
    assert kinds[-2:] == ["safe", "notify"]
    states = [entry["state"] for entry in diary if entry.get("role") == "calibrator"]
    assert states == ["commanded", "commanded", "confirmed off"]  # failed, answered once, answered for good


def test_a_guard_goes_on_until_somebody_takes_the_bench_over(tmp_path: Path) -> None:
    """Nothing ever answers; the person is named in the diary, and people were told before and at the end."""
    timer = threading.Timer(0.5, lambda: ask_to_let_go({"folder": str(tmp_path)}))
    timer.start()
    calls, safe, diary = acted(tmp_path, Action("gone", "it died"), failures=10**9)
    timer.join()
    assert not safe
    assert len(calls) > 10
    *_, last, told = diary
    assert (last["what"], last["by"], told["what"]) == ("taken over", user_name(), "notify")
    word = guard_word(tmp_path)
    assert (word["safe"], word["unsafe"], word["by"]) == (False, {"calibrator": "commanded"}, user_name())
    assert not (tmp_path / TAKE_OVER).exists()


@pytest.mark.parametrize(
    ("action_", "calls", "kinds"),
    [
        (
            Action("left", "it left", left=("chamber",)),
            ["chamber.make_safe"],
            ["act", "lock", "instrument", "safe", "notify"],  # and nobody is ended
        ),
        (Action("limit", "too hot", heat_off=True), ["chamber.stop", "calibrator.make_safe"], None),
    ],
)
def test_only_what_was_left_is_made_safe_and_heat_goes_off_first_when_it_is_too_hot(
    tmp_path: Path, action_: Action, calls: list[str], kinds: list[str] | None
) -> None:
    done, safe, diary = acted(tmp_path, action_, failures=0)
    assert (done, safe) == (calls, True)
    assert kinds in (None, [entry["what"] for entry in diary])


def test_a_controller_is_ended_even_if_it_is_stopped(tmp_path: Path) -> None:
    """The handle is for the parent only, so the child of a child tries it."""
    text = (
        "import os, signal, subprocess, sys, time\n"
        "guard = 'import os,sys; from bench.run.guard.act import Controller; c = Controller(os.getppid());"
        "sys.stdin.readline(); print(c.end(10.0), flush=True)'\n"
        "child = subprocess.Popen([sys.executable, '-c', guard], stdin=subprocess.PIPE)\n"
        "print('ready', flush=True)\n"
        "child.stdin.write(b'now\\n'); child.stdin.flush()\n"
        "os.kill(os.getpid(), signal.SIGSTOP)\n"
        "time.sleep(60)\n"
    )
    with subprocess.Popen([sys.executable, "-c", text], stdout=subprocess.PIPE, text=True) as process:
        assert process.stdout.read().split() == ["ready", "True"]
        assert process.wait() == -signal.SIGKILL


def test_only_its_own_thread_is_a_sign_of_life_of_the_sequencer() -> None:
    """Watchers talk to instruments too; their traffic must not cover up a sequencer that hangs."""
    clock = VirtualClock()
    health = Health(clock)
    health.alive(SEQUENCER)
    clock.sleep(3.0)
    other = threading.Thread(target=lambda: [health.alive(part) for part in (SEQUENCER, LINKS)])
    other.start()
    other.join()
    assert health.silence_s() == {SEQUENCER: 3.0, LINKS: 0.0}
    health.alive(SEQUENCER)
    assert health.silence_s()[SEQUENCER] == 0.0


def test_a_guard_that_does_not_start_is_said(tmp_path: Path) -> None:
    clock = WallClock()
    brief = replace(BRIEF, pid=os.getpid(), visa="@nothing_of_that_name", diary=str(tmp_path / "guard.jsonl"))
    with pytest.raises(RunError) as found:
        GuardProcess(brief, Health(clock), StopSwitch(), clock, lambda event: None).__enter__()
    assert found.value.code == "B-RUN-090"
    assert "B-RUN-002" in found.value.message
    assert found.value.exit_status is ExitStatus.SAFE_AFTER_FAULT


def test_silence_of_a_part_holds_the_heartbeat_back() -> None:
    clock: Any = VirtualClock()
    sent, told = [], []
    health = Health(clock)
    guard = GuardProcess(BRIEF, health, StopSwitch(), clock, lambda event: told.append(event.document()))
    guard._send = sent.append  # type: ignore[method-assign, assignment]
    guard._hear = lambda: None  # type: ignore[method-assign]
    health.alive(SEQUENCER)
    health.alive(LINKS)
    for at_s in (1.4, 1.5, 1.6):
        clock.sleep_until_ns(round(at_s * NS))
        guard.beat()
        assert len(sent) == 1
    assert told == [{"state": "withheld", "parts": [SEQUENCER]}]
    with health.asking():  # a person may take hours, and the links are polled meanwhile
        clock.sleep(3600.0)
        health.alive(LINKS)
        guard.beat()
        assert len(sent) == 2


def test_people_are_told_every_way_the_station_names(tmp_path: Path) -> None:
    told = tmp_path / "told.json"
    write = f"import sys; open({str(told)!r}, 'w').write(sys.stdin.read())"
    notify = Notify.model_validate({"on": ["alarm"], "command": [sys.executable, "-c", write], "heartbeat": "60 s"})
    command = notice_command(notify)
    message = {"kind": "alarm", "event": "guard", "session": "night", "unsafe": []}
    done = subprocess.run(command, input=json.dumps(message), text=True, capture_output=True, check=False)
    assert (done.returncode, done.stderr) == (0, "")
    assert json.loads(told.read_text()) == message
    deaf = notice_command(Notify.model_validate({"command": ["/nowhere"]}))
    done = subprocess.run(deaf, input=json.dumps(message), text=True, capture_output=True, check=False)
    assert done.returncode == 1
    assert "/nowhere" in done.stderr


def test_nobody_is_told_who_does_not_want_to_know() -> None:
    assert notice_command(None) == notice_command(Notify.model_validate({"on": ["end"], "command": ["mail"]})) == ()


def test_a_bench_in_this_process_needs_no_lock() -> None:
    station = load_station(find_shipped("stations", "af_bench_sim"))
    with station_lock(station, "run", WallClock()), station_lock(station, "run", WallClock()):
        pass


@pytest.mark.parametrize("limits", [{"chamber_air_degC": 65.0}, {}])
def test_a_drill_of_a_bench_in_this_process(tmp_path: Path, monkeypatch: pytest.MonkeyPatch, limits: Any) -> None:
    monkeypatch.setattr(Station, "guard_limits_degC", limits)
    path = find_shipped("stations", "af_bench_sim")
    station = load_station(path)
    assert latest_drill(tmp_path, station) is None
    found = drill(station, path, tmp_path, WallClock())
    assert found["passed"]
    (trial,) = found["trials"]
    assert (trial["kill"], trial["still_on"]) == ("LIMIT", {})
    newest = latest_drill(tmp_path, station)
    assert newest["utc"] == found["utc"]
    assert newest["identities"]["calibrator"]["model"] == "5720A"


class Lab:
    """A source of a lab's own driver, whose words are its own."""

    tells = Tells({"LEVEL?": lambda reply: reply != "off"})
    state: Any = "off"

    @action(
        Parameter("current", "A", -1.0, 1.0), Parameter("span", choices=("low", "high")), effect=Effect.STIMULUS_SET
    )
    def drive(self, current: float, span: str) -> None:
        self.set_to = f"{current} A {span}"

    @action(effect=Effect.STIMULUS_ON)
    def connect(self) -> None:
        self.state = self.set_to

    def raw(self, command: str, *, answers: bool) -> str:
        return self.state  # type: ignore[no-any-return]


def test_a_drill_drives_a_source_by_what_its_driver_declares() -> None:
    instruments: Any = {"source": Lab()}
    station: Any = SimpleNamespace(safe_order=["source"], name="s")
    assert stimulated(instruments) == {}
    stimulate(OpenBench(station, instruments, {}, None, lambda: None))
    assert stimulated(instruments) == {"source": "on by LEVEL? 0.0 A low"}


def test_a_bench_without_a_stimulus_has_no_drill() -> None:
    station = load_station(find_shipped("stations", "af_bench_sim"))
    with pytest.raises(InputError, match="B-RUN-095"):
        source_of(station, dict.fromkeys(station.safe_order, Instrument))


def test_a_goodbye_that_comes_with_the_brief_is_heard() -> None:
    read, write = os.pipe()
    os.write(write, b"brief\ngoodbye\nhalf")
    lines = ReadLines(read)
    assert lines.first() == b"brief"
    assert list(lines.next(0.0)) == [b"goodbye"]
    os.write(write, b" a line\n")
    assert list(lines.next(0.0)) == [b"half a line"]
    os.close(write)
    assert (list(lines.next(0.0)), lines.ended) == ([], True)
    with pytest.raises(EOFError):
        lines.first()
    os.close(read)


@pytest.mark.parametrize(("boards", "opened"), [({}, 1), ({"GPIB0": "TCPIP0::h::1234::SOCKET"}, 0)])
def test_a_chamber_behind_an_adapter_is_left_to_the_controller(boards: dict[str, str], opened: int) -> None:
    brief = replace(BRIEF, instruments=(Address("chamber", "thermotron_3800", "GPIB0::7::INSTR"),), boards=boards)
    opener = MagicMock(side_effect=OSError)
    own = OwnReading(brief, opener, WallClock())
    own.look(20.0)
    if own._thread is not None:
        own._thread.join()
    assert opener.call_count == opened


class _Lines:
    """Heartbeats that come at their times, then nothing; the looks of the guard that take longer than they should."""

    def __init__(self, clock: VirtualClock, beats_s: list[float], away_s: dict[float, float], gone_s: float) -> None:
        self._clock, self._beats_s, self._away_s, self._gone_s = clock, beats_s, away_s, gone_s

    @property
    def ended(self) -> bool:
        return self._clock.now_ns() >= self._gone_s * NS

    def next(self, limit_s: float | None) -> list[bytes]:
        due = [at_s for at_s in self._away_s if at_s * NS <= self._clock.now_ns()]
        self._clock.sleep(self._away_s.pop(due[0]) if due else limit_s or 0.0)
        come = [at_s for at_s in self._beats_s if at_s * NS <= self._clock.now_ns()]
        self._beats_s = self._beats_s[len(come) :]
        return [b'{"values": {}}' if at_s < FOREVER_S else b'{"goodbye": {}}' for at_s in come]


FOREVER_S = 100.0
BEATS_S = [0.5 * turn for turn in range(9)]  # the last one at 4 s


@pytest.mark.parametrize(
    ("beats_s", "away_s", "gone_s", "reason", "acted_s"),
    [
        ([*BEATS_S, 64.4, 64.9], {4.0: 60.0}, math.inf, "silent", 66.9),  # awake again, then it hangs
        (BEATS_S, {4.0: 60.0}, math.inf, "silent", 66.0),  # one that hangs has the limit anew, and no more
        (BEATS_S, {4.0: 60.0, 64.5: 1.4}, math.inf, "silent", 66.0),  # nor once more if the guard is late again
        (BEATS_S, {4.0: 60.0}, 30.0, "gone", 64.0),  # the controller is gone: at once
        (BEATS_S, {}, math.inf, "silent", 6.0),
        (BEATS_S, {4.0: 0.9}, math.inf, "silent", 6.0),  # no more than a machine with much to do
        ([*BEATS_S, 6.3], {4.2: 1.75}, math.inf, "silent", 8.3),  # late, and the controller after it
        ([*BEATS_S, *(4.5 + 0.5 * turn for turn in range(200))], {4.2: 60.0}, math.inf, None, FOREVER_S),
    ],
)
def test_a_guard_that_was_stopped_with_its_controller_begins_to_wait_anew_once(
    tmp_path: Path, beats_s: list[float], away_s: dict[float, float], gone_s: float, reason: str | None, acted_s: float
) -> None:
    clock: Any = VirtualClock()
    lines: Any = _Lines(clock, beats_s, dict(away_s), gone_s)
    diary = Diary(tmp_path / "guard.jsonl", clock)
    state = Watched({}, 2.0, clock.now_ns())
    action = _watch(lines, state, replace(BRIEF, limits={}), lambda address: None, clock, diary)  # type: ignore[arg-type,return-value]
    diary.close(5.0)
    assert (action.reason if action else None) == reason
    assert clock.now_ns() / NS == pytest.approx(acted_s, abs=0.21)
    slept = [entry["seconds"] for entry in read_diary(tmp_path / "guard.jsonl") if entry["what"] == "asleep"]
    longest_s = max(away_s.values(), default=0.0)
    assert slept == ([] if reason != "silent" or longest_s < 1.0 else [pytest.approx(longest_s, abs=0.11)])


UTC = "2026-03-01T01:00:02.123+00:00"
WORD: dict[str, Any] = {"reason": "no heartbeat for 2.05 s", "safe": True, "unsafe": {}, "utc": UTC, "by": ""}


@pytest.mark.parametrize(
    ("changes", "confirmed", "named"),
    [
        ({}, True, ["bench resume night"]),
        ({"safe": False, "unsafe": {"calibrator": "unreachable"}}, False, ["calibrator (unreachable)", "front panels"]),
        ({"safe": None, "unsafe": {}}, False, ["any instrument", "hands off"]),
        ({"safe": None, "unsafe": {"calibrator": "unreachable"}}, False, ["calibrator (unreachable)", "hands off"]),
        ({"safe": False, "unsafe": {"calibrator": ""}, "by": "kim"}, False, ["kim took the bench over", "calibrator"]),
    ],
)
def test_why_it_acted_what_is_confirmed_and_what_to_do(
    changes: dict[str, Any], confirmed: bool, named: list[str]
) -> None:
    text = last_words({**WORD, **changes}, "night")
    assert ("Confirmed" in text, "NOT confirmed" in text) == (confirmed, not confirmed)
    missing = [
        word for word in ["night", "no heartbeat for 2.05 s", "2026-03-01T01:00:02Z", *named] if word not in text
    ]
    assert missing == []


@pytest.mark.parametrize(
    ("entries", "safe"),
    [
        ([{"what": "safe"}], True),
        ([{"what": "instrument", "role": "dmm"}], None),
        ([{"what": "safe", "instruments": ["dmm"]}], False),
        ([{"what": "safe"}, {"what": "taken over", "by": "kim"}], False),
        ([{"what": "unsafe"}], False),
    ],
)
def test_a_word_that_contradicts_itself_confirms_nothing(
    entries: list[dict[str, Any]], safe: bool | None, tmp_path: Path
) -> None:
    lines = [json.dumps(entry) + "\n" for entry in ({"what": "act", "text": "too hot"}, *entries)]
    (tmp_path / "guard.jsonl").write_text("".join(lines))
    assert guard_word(tmp_path)["safe"] is safe


def test_a_guard_that_did_not_act_has_no_words(tmp_path: Path) -> None:
    assert guard_lines(tmp_path) == []
    (tmp_path / "guard.jsonl").write_text('{"what":"act","text":"too hot","utc":"2026-03-01T01:00:02+00:00"}\n')
    (line,) = guard_lines(tmp_path)
    assert line.startswith(f"The guard of {tmp_path} has acted (too hot), last heard of at 2026-03-01T01:00:02Z.")


@pytest.mark.parametrize("by_path", [True, False])
def test_a_terminal_shows_one_line_and_its_cursor_and_obeys_no_text(by_path: bool) -> None:
    controller, terminal = os.openpty()
    try:
        place = terminal_of(terminal) if by_path else terminal
        assert write_to_terminal(place, "ended\nby its\x1b[31m guard \x07")
        assert os.read(controller, 4096).replace(b"\r\r\n", b"\r\n") == b"\r\n\x1b[?25hended by its?[31m guard ?\r\n"
        os.fstat(terminal)  # it stays open
    finally:
        os.close(controller)
        os.close(terminal)


def test_a_file_gets_the_paragraph_behind_what_it_has(tmp_path: Path) -> None:
    log = tmp_path / "run.log"
    with log.open("w") as stream:
        stream.write("record 50/765")
        stream.flush()
        assert terminal_of(stream.fileno()) == str(log)
    assert write_to_terminal(log, "ended by its guard")
    assert log.read_text() == "record 50/765\nended by its guard\n"


def test_a_pipe_has_no_path_and_a_place_that_is_gone_takes_nothing(tmp_path: Path) -> None:
    ends = os.pipe()
    assert terminal_of(ends[1]) == ""
    for end in ends:
        os.close(end)
    assert terminal_of(ends[1]) == ""
    assert not write_to_terminal("", "x")
    assert not write_to_terminal(tmp_path / "gone", "x")
    assert not (tmp_path / "gone").exists()


def test_a_place_that_takes_nothing_is_not_waited_for(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(last_words_module, "WRITE_S", 0.05)
    place = tmp_path / "stopped"
    os.mkfifo(place)  # nobody reads it: opening it waits, as a write to a terminal that was stopped does
    assert not write_to_terminal(place, "x")
    os.close(os.open(place, os.O_RDONLY | os.O_NONBLOCK))  # the thread that waits there may leave
