"""The control socket: what it answers, that no client can hold a run up, and alarms that are shelved through it."""

import json
import os
import socket
import stat
import threading
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from run_rig import HoldRig

from bench.commands import control as command
from bench.model.clock import VirtualClock, WallClock
from bench.model.errors import ExitStatus, InputError
from bench.model.events import ClockStep, Deviation, Event, Guard
from bench.plan.language.notices import Notify
from bench.record import RecordError
from bench.run.context import RunContext
from bench.run.control.channel import MOST_REFUSED, Control
from bench.run.control.local_socket import (
    IDLE_S,
    LONGEST_LINE,
    LONGEST_PATH,
    MOST_CLIENTS,
    ControlServer,
    find_socket,
    socket_path,
)
from bench.run.control.notify import Notifier
from bench.run.feed.run_state import RunState
from bench.run.observers import Observer

WAIT_S = 20.0


def controlled(folder: Path) -> tuple[HoldRig, RunContext, Control]:
    rig = HoldRig(folder, 2)
    context = rig.context()
    context.folder = folder
    context.step = rig.steps[2]
    return rig, context, Control(context)


@contextmanager
def served(folder: Path) -> Iterator[tuple[HoldRig, RunContext]]:
    rig, context, _ = controlled(folder)
    context.clock = WallClock()  # type: ignore[assignment]
    with Control(context).listening():
        yield rig, context


def talk(path: Path, *lines: bytes) -> list[dict[str, Any]]:
    with socket.socket(socket.AF_UNIX, socket.SOCK_STREAM) as client:
        client.settimeout(WAIT_S)
        client.connect(str(path))
        client.sendall(b"".join(lines))
        with client.makefile("rb") as replies:
            return [json.loads(replies.readline()) for _ in lines]


def test_status_says_where_the_run_is(tmp_path: Path) -> None:
    answering = controlled(tmp_path)[2]
    told = answering.answer({"command": "status"}, "me")
    assert told == {"ok": True, "state": "running", "step": 2, "reasons": {}, "records": 0, "prompt": None}


def test_pause_resume_abort_are_wishes_and_events(tmp_path: Path) -> None:
    rig, context, answering = controlled(tmp_path)
    assert answering.answer({"command": "pause", "reason": "door"}, "eve (process 7)")["ok"]
    assert context.stop.holds.reasons == {"operator": "door (eve (process 7))"}
    assert answering.answer({"command": "status"}, "me")["state"] == "holding"
    context.stop.holds.hold("interlock air", "too warm")
    reply = answering.answer({"command": "resume"}, "me")
    assert reply["holding"]
    assert "too warm" in reply["text"]
    assert context.stop.holds.reasons == {"interlock air": "too warm"}  # an interlock is not a person's to release
    context.stop.holds.release("interlock air")
    context.stop.holds.hold("early verdict", "bad link")
    assert answering.answer({"command": "resume"}, "me")["ok"]
    assert context.stop.holds.reasons == {}
    assert answering.answer({"command": "abort", "reason": "fire"}, "eve")["ok"]
    assert context.stop.requested == "abort by eve: fire"
    assert answering.answer({"command": "status"}, "me")["state"] == "ending"
    told = [(event["what"], event["by"], event["reason"]) for event in rig.events("control")]
    assert told == [
        ("pause", "eve (process 7)", "door"), ("resume", "me", ""), ("resume", "me", ""), ("abort", "eve", "fire"),
    ]  # fmt: skip


@pytest.mark.parametrize(
    ("request_", "words"),
    [
        ({"command": "pause"}, "needs a reason"),
        ({"command": "pause", "reason": "  "}, "needs a reason"),
        ({"command": "pause", "reason": 7}, "a reason is one line"),
        ({"command": "pause", "reason": "x" * 501}, "a reason is one line"),
        ({"command": "pause", "reason": "x\x1b[31mred"}, "a reason is one line"),
        ({"command": "resume"}, "not holding"),
        ({"command": "launch"}, "no command"),
        ({}, "no command"),
    ],
)
def test_what_cannot_be_done_is_refused_and_changes_nothing(
    tmp_path: Path, request_: dict[str, Any], words: str
) -> None:
    rig, context, answering = controlled(tmp_path)
    reply = answering.answer(request_, "me")
    assert not reply["ok"]
    assert words in reply["error"]
    assert context.stop.holds.reasons == {}
    refused = [(event["what"], event["ok"], event["text"]) for event in rig.events("control")]
    understood = words in ("needs a reason", "not holding")
    assert refused == ([(request_["command"], False, reply["error"])] if understood else [])


def test_half_a_character_keeps_no_abort_back_and_a_run_that_ends_takes_no_command(tmp_path: Path) -> None:
    rig, context, answering = controlled(tmp_path)
    assert answering.answer({"command": "abort", "reason": "smoke \udcff"}, "me")["ok"]
    assert context.stop.requested == "abort by me: smoke ?"
    assert [event["reason"] for event in rig.events("control")] == ["smoke ?"]
    context.stop.interruptible = False
    assert "put away" in answering.answer({"command": "pause", "reason": "x"}, "me")["error"]
    context.stop.shield()
    assert "ending" in answering.answer({"command": "abort"}, "me")["error"]


def test_the_commands_reach_the_run_and_say_who_asked(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    with served(tmp_path) as (rig, context):
        path = tmp_path / "control.sock"
        assert stat.S_IMODE(path.stat().st_mode) == 0o600
        command.pause(tmp_path, "door")
        (reason,) = context.stop.holds.reasons.values()
        assert f"(process {os.getpid()})" in reason
        assert command.release(tmp_path)
        assert context.stop.holds.reasons == {}
        with pytest.raises(InputError, match=r"B-CTRL-002: .*not holding"):
            command.release(tmp_path)
        command.abort(tmp_path, "")
        assert context.stop.requested.startswith("abort by ")
        told = [(event["what"], event["ok"]) for event in rig.events("control")]
        assert told == [("pause", True), ("resume", True), ("resume", False), ("abort", True)]
    assert not path.exists()
    assert "makes the bench safe" in capsys.readouterr().out


def test_a_dead_run_says_so(tmp_path: Path) -> None:
    with socket.socket(socket.AF_UNIX, socket.SOCK_STREAM) as left_behind:
        left_behind.bind(str(tmp_path / "control.sock"))
    for folder in (tmp_path, tmp_path / "nowhere"):
        for ask in (command.pause, command.abort):
            with pytest.raises(InputError) as caught:
                ask(folder, "x")
            assert caught.value.code == "B-CTRL-001"
            assert caught.value.exit_status == ExitStatus.BAD_INPUT
        assert command.release(folder) is False


def test_a_run_that_does_not_answer_is_not_waited_for(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(command, "ANSWER_S", 0.2)
    with socket.socket(socket.AF_UNIX, socket.SOCK_STREAM) as mute:
        mute.bind(str(tmp_path / "control.sock"))
        mute.listen(1)
        with pytest.raises(InputError, match="B-CTRL-003"):
            command.pause(tmp_path, "x")


def test_a_long_path_gets_a_short_socket(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("XDG_RUNTIME_DIR", "/tmp")
    folder = tmp_path / ("x" * 120)
    folder.mkdir()
    with served(folder):
        assert find_socket(folder) == Path((folder / "control.path").read_text())
        assert len(os.fsencode(find_socket(folder))) <= LONGEST_PATH
        assert not (folder / "control.sock").exists()
        command.pause(folder, "door")
    assert not (folder / "control.path").exists()
    assert find_socket(folder).parent == folder
    exact = tmp_path / ("y" * (LONGEST_PATH - len(os.fsencode(tmp_path.resolve())) - len("control.sock") - 2))
    exact.mkdir()
    assert len(os.fsencode(socket_path(exact))) == LONGEST_PATH
    with served(exact):
        command.pause(exact, "door")


def test_a_hundred_clients_with_garbage_do_nothing(tmp_path: Path) -> None:
    """Half-open, endless, binary, deeply nested, silent: the next honest client is answered."""
    rng = np.random.default_rng(5)
    print("seed 5")
    kinds = [
        lambda: rng.bytes(2000), lambda: b"x" * (2 * LONGEST_LINE), lambda: b'{"command": "pau', lambda: b"",
        lambda: b"[" * 3000 + b"\n", lambda: b"\n" * 500, lambda: b"null\n17\n\"x\"\n", lambda: b"\xff\xfe\n",
    ]  # fmt: skip
    before = threading.active_count()
    with served(tmp_path) as (rig, context):
        clients = []
        for number in range(100):
            client = socket.socket(socket.AF_UNIX, socket.SOCK_STREAM)
            client.connect(str(tmp_path / "control.sock"))
            client.settimeout(WAIT_S)
            with suppress(OSError):  # it may be dropped already
                client.sendall(kinds[number % len(kinds)]())
            clients.append(client)
            if number % 20 == 19:
                (reply,) = talk(tmp_path / "control.sock", b'{"command": "status"}\n')
                assert reply["ok"]
        assert threading.active_count() <= before + 4  # acquisition and control; none per client
        assert context.stop.holds.reasons == {}
        assert context.stop.requested == ""
        assert rig.events("control") == []
        for client in clients:
            client.close()
    assert threading.active_count() <= before + 2


def test_the_longest_reason_fits_in_any_script_and_a_longer_one_is_told(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    with served(tmp_path) as (_, context):
        command.pause(tmp_path, "\U0001f321" * 500)
        assert "\U0001f321" * 500 in context.stop.holds.reasons["operator"]
        for reason, told in (("x" * 501, "at most 500 printable"), ("x" * 100_000, "too long: 100"), ("", "a reason")):
            with pytest.raises(InputError, match=told) as caught:
                command.pause(tmp_path, reason)
            assert caught.value.code == "B-CTRL-002"
            assert "--reason" in str(caught.value)
        command.pause(tmp_path, " door\n\topened\u3000now ")
        assert context.stop.holds.reasons["operator"].startswith("door opened now (")


def test_lines_may_come_in_pieces_and_together(tmp_path: Path) -> None:
    with served(tmp_path) as (_, context):
        replies = talk(tmp_path / "control.sock", b'{"command": "pause", "reason": "a"}\n', b'{"command": "resume"}\n')
        assert [reply["ok"] for reply in replies] == [True, True]
        with socket.socket(socket.AF_UNIX, socket.SOCK_STREAM) as client:
            client.settimeout(WAIT_S)
            client.connect(str(tmp_path / "control.sock"))
            for byte in b'{"command": "pause", "reason": "slow"}\n':
                client.sendall(bytes([byte]))
            assert json.loads(client.recv(LONGEST_LINE))["ok"]
        assert "slow" in context.stop.holds.reasons["operator"]


def test_a_silent_client_is_let_go_and_an_error_of_the_answer_is_a_reply(tmp_path: Path) -> None:
    hour = VirtualClock()
    server = ControlServer(tmp_path / "s", lambda request, by: {"ok": True, "n": 1 // request["by"]}, hour)
    try:
        with socket.socket(socket.AF_UNIX, socket.SOCK_STREAM) as silent:
            silent.settimeout(WAIT_S)
            silent.connect(str(tmp_path / "s"))
            assert talk(tmp_path / "s", b'{"by": 0}\n') == [
                {"ok": False, "error": "ZeroDivisionError: integer division or modulo by zero"}
            ]
            hour.sleep(IDLE_S + 1)
            assert silent.recv(10) == b""
        assert talk(tmp_path / "s", b'{"by": 1}\n')[0]["ok"]
    finally:
        server.close()


def test_another_user_is_not_heard(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("bench.run.control.local_socket.user_id", lambda: 4_000_000)
    monkeypatch.setattr("bench.run.control.local_socket.peer", lambda _: (1, 4_000_001))
    server = ControlServer(tmp_path / "s", lambda *_: {"ok": True}, WallClock())
    try:
        with socket.socket(socket.AF_UNIX, socket.SOCK_STREAM) as stranger:
            stranger.settimeout(WAIT_S)
            stranger.connect(str(tmp_path / "s"))
            assert stranger.recv(10) == b""
    finally:
        server.close()


def test_no_socket_is_no_reason_not_to_run(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    def refused(folder: Path) -> Path:
        raise PermissionError("belongs to somebody else")

    monkeypatch.setattr("bench.run.control.channel.socket_path", refused)
    with served(tmp_path) as (rig, _):
        assert any("no control from another terminal" in text for text in rig.listener.messages)
    assert MOST_CLIENTS < 100


class Told(Observer):
    def __init__(self, state: RunState) -> None:
        self.state = state

    def event(self, event: Event, t_mono_ns: int) -> None:
        self.state.on_event(event, 1.0)


def test_who_speaks_through_another_process_is_journaled_and_acknowledges_an_alarm(tmp_path: Path) -> None:
    rig, _, state, answering = shelving(tmp_path)
    by, peer = "kim, operator, 192.0.2.7", "root (process 12)"
    for alarm in ("2", None, 1):
        assert not answering.answer({"command": "acknowledge", "alarm": alarm, "by": by}, peer)["ok"]
    assert answering.answer({"command": "acknowledge", "alarm": "1", "by": by, "reason": "seen"}, peer)["ok"]
    assert state.document(2.0)["alarms"] == []
    assert not answering.answer({"command": "acknowledge", "alarm": "1", "by": by}, peer)["ok"]
    (done,) = [event for event in rig.events("control") if event["ok"]]
    assert done == {
        "what": "acknowledge", "by": f"{by} via {peer}", "reason": "seen", "alarm": "1", "ok": True,
        "place": "afar",
        "text": "alarm 1 is acknowledged",
    }  # fmt: skip
    count = len(rig.events("control"))
    for name in ("x" * 101, "two\nlines", 7, "\x1b[31m"):
        reply = answering.answer({"command": "pause", "reason": "x", "by": name}, peer)
        assert "'by' is a name" in reply["error"]
    assert len(rig.events("control")) == count
    assert not answering.answer({"command": "answer", "value": 3}, peer)["ok"]  # nobody is asked in this run


def test_refused_commands_do_not_fill_a_disk_and_a_full_one_refuses_none(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    rig, context, answering = controlled(tmp_path)
    for _ in range(MOST_REFUSED + 50):
        answering.answer({"command": "resume"}, "me")
    assert len(rig.events("control")) == MOST_REFUSED

    def full(*_: object) -> None:
        raise RecordError("B-REC-003", "no space", where="x")

    monkeypatch.setattr(rig.sink, "event", full)
    assert answering.answer({"command": "abort", "reason": "fire"}, "me")["ok"]
    assert context.stop.requested == "abort by me: fire"


SHELVE = {"command": "shelve", "alarm": "1", "seconds": 1800.0, "reason": "the clock is being set"}
DEVIATION = Deviation(
    name="air", of="chamber", state="begun", value=53.0, set_point=50.0, limit=2.0, unit="degC", by="its own sensor",
    door=None, action="look",
)  # fmt: skip
START_UTC_S = 946_684_800.0  # of the virtual clock


def shelving(folder: Path) -> tuple[Any, Any, RunState, Control]:
    """Return rig, context, state and control of a run with one alarm."""
    rig, context, _ = controlled(folder)
    state = RunState(rig.steps, {})
    context.observers.add(Told(state))
    context.event(ClockStep(step_s=3.0, t_utc_ns=0))
    return rig, context, state, Control(context, state)


def test_it_is_recorded_and_shown_with_who_why_and_until_when(tmp_path: Path) -> None:
    rig, _, state, answering = shelving(tmp_path)
    reply = answering.answer({**SHELVE, "by": "kim"}, "root (process 12)")
    assert reply["text"] == "alarm 1 is shelved until 2000-01-01T00:30:00Z; nobody is notified of it until then"
    (event,) = rig.events("control")
    assert (event["what"], event["alarm"], event["ok"]) == ("shelve", "1", True)
    assert (event["by"], event["reason"]) == ("kim via root (process 12)", SHELVE["reason"])
    (alarm,) = state.document(START_UTC_S + 10.0)["alarms"]
    assert alarm["shelved"] == {"by": event["by"], "reason": SHELVE["reason"], "until_utc_s": START_UTC_S + 1800.0}
    (alarm,) = state.document(START_UTC_S + 1800.0)["alarms"]
    assert alarm["shelved"] is None


@pytest.mark.parametrize(
    ("changes", "said"),
    [({"reason": " "}, "reason"), ({"alarm": "7"}, "'7'; there are: 1:"), ({"alarm": 1}, "'1'; there are")]
    + [({"seconds": seconds}, "60 s to 8 h") for seconds in (59.0, 28_801.0, 10**400, True, "1800", None)],
)
def test_what_is_wrong_is_refused_and_shelves_nothing(tmp_path: Path, changes: dict[str, Any], said: str) -> None:
    rig, _, state, answering = shelving(tmp_path)
    reply = answering.answer({**SHELVE, **changes}, "me")
    assert said in reply["error"]
    assert rig.events("control")[0]["ok"] is False
    assert state.document(START_UTC_S + 1.0)["alarms"][0]["shelved"] is None


def test_a_fault_is_never_shelved(tmp_path: Path) -> None:
    _, context, _, answering = shelving(tmp_path)
    context.event(Guard(state="acted", reason="limit", text="too hot"))
    assert "never shelved" in answering.answer({**SHELVE, "alarm": "2"}, "me")["error"]


def test_nobody_is_notified_of_what_is_shelved(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    _, context, state, answering = shelving(tmp_path)
    context.event(DEVIATION)
    sent: list[str] = []
    monkeypatch.setattr(Notifier, "_send", lambda self, name, send, message: sent.append(message["event"]))
    notifier = Notifier(Notify(command=["x"]), context, lambda: "", shelved=state.is_shelved)  # type: ignore[call-arg]
    notifier.event(DEVIATION, 0)
    assert answering.answer({**SHELVE, "alarm": "2"}, "me")["ok"]
    notifier.event(DEVIATION, 0)
    notifier.event(replace(DEVIATION, of="another"), 0)
    context.clock.sleep(SHELVE["seconds"])
    notifier.event(DEVIATION, 0)
    notifier.close()
    assert sent == ["alarm"] * 3


def test_a_time_without_its_unit_is_one_clear_error(tmp_path: Path) -> None:
    with pytest.raises(InputError, match="B-CTRL-004"):
        command.shelve(tmp_path, "1", "30", "door")
