"""Who is told of a run: people, by a real program, web server and mail conversation, and the service manager."""

import json
import os
import socket
import socketserver
import sys
import threading
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import replace
from http.server import BaseHTTPRequestHandler, HTTPServer
from pathlib import Path
from typing import Any

import pytest
from run_rig import HoldRig

from bench.model.clock import VirtualClock
from bench.model.errors import InputErrors
from bench.model.events import End, Error, Hold, Interlock, Phase, Verdict, event_of
from bench.plan.language.notices import Apprise, Mail, Notify, Webhook
from bench.run.context import RunContext
from bench.run.control.notify import LONGEST_QUEUE, Notifier, notifications, occasion, user_notify
from bench.run.control.systemd import ServiceNotice, service_notice
from bench.run.guard import notify_ways
from bench.run.guard.notify_ways import NotSent, by_apprise, by_command, by_mail, by_webhook
from bench.run.stop import SEQUENCER, WRITER

HOLD = Hold(step=3, by="door", reason="open")
TRIPPED = Interlock(
    name="air", signal="chamber_air", of="", value=64.0, limit=63.0, unit="degC", action="warn", state="tripped"
)
END = End(steps=9, records=1, slip_s=0.0, overruns=0, retaken=0, lateness_ms=[0.0, 0.0, 0.0], error=None)
MESSAGE = {"kind": "hold", "session": "a", "utc": "2000-01-01T00:00:00Z"}


class Web(HTTPServer):
    """Keeps what is posted; answers ``statuses`` one after the other, then 200."""

    def __init__(self) -> None:
        super().__init__(("127.0.0.1", 0), _Post)
        self.got: list[tuple[dict[str, Any], str | None]] = []
        self.statuses: list[int] = []
        self.url = f"http://127.0.0.1:{self.server_port}/hook"


class _Post(BaseHTTPRequestHandler):
    server: Web

    def do_POST(self) -> None:
        body = json.loads(self.rfile.read(int(self.headers["Content-Length"])))
        self.server.got.append((body, self.headers["Authorization"]))
        self.send_response(self.server.statuses.pop(0) if self.server.statuses else 200)
        self.send_header("Location", "/elsewhere")
        self.send_header("Content-Length", "0")
        self.end_headers()

    def log_message(self, *_: Any) -> None:
        return None


@contextmanager
def running(server: Any) -> Iterator[Any]:
    thread = threading.Thread(target=server.serve_forever, args=(0.01,))
    thread.start()
    try:
        yield server
    finally:
        server.shutdown()
        thread.join()
        server.server_close()


class _Smtp(socketserver.StreamRequestHandler):
    """The server's side of RFC 5321, as much of it as one mail needs."""

    def handle(self) -> None:
        self.wfile.write(b"220 here\r\n")
        while line := self.rfile.readline():
            self.server.lines.append(line.decode().strip())  # type: ignore[attr-defined]
            if line.upper().startswith(b"DATA"):
                self.wfile.write(b"354 go on\r\n")
                while (text := self.rfile.readline()) not in (b".\r\n", b""):
                    self.server.lines.append(text.decode().strip())  # type: ignore[attr-defined]
            self.wfile.write(b"221 bye\r\n" if line.upper().startswith(b"QUIT") else b"250 ok\r\n")
            if line.upper().startswith(b"QUIT"):
                return


def context_of(folder: Path) -> tuple[HoldRig, RunContext]:
    rig = HoldRig(folder, 1)
    context = rig.context()
    context.folder = folder
    return rig, context


def catcher(folder: Path) -> list[str]:
    """A program that appends its standard input to a file."""
    text = "import sys; open(sys.argv[1], 'a').write(sys.stdin.read() + '\\n')"
    return [sys.executable, "-c", text, str(folder / "caught")]


def on() -> str:
    return "ENERGISED: supply 18 V"


@pytest.mark.parametrize(
    ("asked_for", "kinds"), [({}, ["hold", "alarm", "error", "alarm", "end"]), ({"on": ["end"]}, ["end"])]
)
def test_a_program_gets_what_is_asked_for_and_the_end_of_the_run_waits_for_it(
    tmp_path: Path, asked_for: dict[str, Any], kinds: list[str]
) -> None:
    _, context = context_of(tmp_path)
    notify = Notify(command=catcher(tmp_path), **asked_for)
    with notifications(context, notify, on):
        for event in (
            HOLD, Phase(name="campaign", t_start_ns=4), TRIPPED, replace(TRIPPED, state="released"),
            Error(code="B-RUN-021", text="silent"), Verdict(ok=True), Verdict(ok=False), END,
        ):  # fmt: skip
            context.event(event)
    caught = [json.loads(line) for line in (tmp_path / "caught").read_text().splitlines()]
    assert [one["kind"] for one in caught] == kinds
    if not asked_for:
        assert caught[0] == {
            "kind": "hold", "event": "hold", "step": "3", "by": "door", "reason": "open",
            "bench": "ENERGISED: supply 18 V", "session": tmp_path.name, "utc": "2000-01-01T00:00:00Z",
        }  # fmt: skip


def test_occasions() -> None:
    kinds = ("hold", "release", "alarm", "end", "error", "record", "verdict")
    assert [occasion(event_of(kind, {})) for kind in kinds] == ["hold", "hold", "alarm", "end", "error", "", ""]


def test_a_web_address_gets_json_with_its_token_and_failures_are_tried_again(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv("HOOK_TOKEN", "secret")
    rig, context = context_of(tmp_path)
    with running(Web()) as web:
        web.statuses = [500, 503]
        notify = Notify(webhook=Webhook(url=web.url, token_env="HOOK_TOKEN"))  # type: ignore[call-arg]
        notifier = Notifier(notify, context, on, pause_s=0.01)
        notifier.event(HOLD, 0)
        notifier.close()
        assert [one["kind"] for one, _ in web.got] == ["hold"] * 3
        assert {token for _, token in web.got} == {"Bearer secret"}
    assert rig.events("notify") == []


def test_what_does_not_get_through_is_an_event_without_secrets(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    rig, context = context_of(tmp_path)
    with running(Web()) as web:
        web.statuses = [404] * 9
        monkeypatch.setenv("HOOK", f"{web.url}?key=secret")
        notify = Notify(webhook=Webhook(url_env="HOOK"))  # type: ignore[call-arg]
        notifier = Notifier(notify, context, on, pause_s=0.0)
        notifier.event(END, 0)
        notifier.close()
        assert len(web.got) == 3
    (event,) = rig.events("notify")
    assert event == {"way": "webhook", "message": "end", "sent": False, "why": "webhook: HTTPError 404"}
    assert "secret" not in json.dumps(rig.sink.events)
    assert "secret" not in " ".join(rig.listener.messages)


def test_a_redirect_is_not_followed() -> None:
    with running(Web()) as web:
        web.statuses = [302]
        with pytest.raises(NotSent, match="302"):
            by_webhook(Webhook(url=web.url), MESSAGE)  # type: ignore[call-arg]
        assert len(web.got) == 1


def test_secrets_and_addresses_from_the_environment_are_checked(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.delenv("NOWHERE", raising=False)
    with pytest.raises(NotSent, match="NOWHERE is not set"):
        by_webhook(Webhook(url_env="NOWHERE"), MESSAGE)  # type: ignore[call-arg]
    monkeypatch.setenv("PLAIN", "http://example.org/secret")
    with pytest.raises(NotSent) as caught:
        by_webhook(Webhook(url_env="PLAIN"), MESSAGE)  # type: ignore[call-arg]
    assert "secret" not in str(caught.value)


def test_apprise_gets_its_addresses_by_the_environment_alone(monkeypatch: pytest.MonkeyPatch) -> None:
    way = Apprise(urls_env="MESSAGES")
    with running(Web()) as web:
        address = web.url.replace("http", "json").replace("127", "me:secret@127")
        monkeypatch.setenv("MESSAGES", f"{address} json://me:secret@127.0.0.1:{web.server_port}/second")
        monkeypatch.setattr("bench.run.guard.notify_ways.TIMEOUT_S", 60.0)  # a busy machine
        by_apprise(way, {**MESSAGE, "kind": "error", "code": "B-RUN-021"})
        assert [(body["title"], body["type"]) for body, _ in web.got] == [("[bench] error: a", "failure")] * 2
        assert web.got[0][0]["message"].splitlines()[:2] == ["kind: error", "session: a"]
        web.statuses = [500] * 2
        with pytest.raises(NotSent, match=r"^apprise: exit status \d$"):
            by_apprise(way, MESSAGE)
    monkeypatch.delenv("MESSAGES")
    with pytest.raises(NotSent, match="MESSAGES is not set"):
        by_apprise(way, MESSAGE)
    monkeypatch.setattr("importlib.util.find_spec", lambda name: None)
    with pytest.raises(NotSent, match=r"inertial-bench\[messages\]"):
        by_apprise(way, MESSAGE)


@pytest.mark.parametrize("text", ["raise SystemExit(3)", "import time; time.sleep(60)", None])
def test_a_program_that_fails_hangs_or_is_missing(text: str | None, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("bench.run.guard.notify_ways.TIMEOUT_S", 0.5)
    words = ["/nowhere/at/all"] if text is None else [sys.executable, "-c", text]
    with pytest.raises(NotSent):
        by_command(words, MESSAGE)


def test_a_mail_is_handed_over_by_the_protocol() -> None:
    server = socketserver.TCPServer(("127.0.0.1", 0), _Smtp)
    server.lines = []  # type: ignore[attr-defined]
    with running(server):
        port, people = server.server_address[1], ["a@example.org"]
        mail = Mail(host="127.0.0.1", port=port, security="none", sender="b@example.org", to=people)
        by_mail(mail, MESSAGE)
    lines = server.lines  # type: ignore[attr-defined]
    assert any(line.upper().startswith("MAIL FROM:<B@EXAMPLE.ORG>") for line in lines)
    assert any(line.upper().startswith("RCPT TO:<A@EXAMPLE.ORG>") for line in lines)
    assert "Subject: [bench] hold: a" in lines
    with pytest.raises(NotSent, match="mail"):
        by_mail(mail, MESSAGE)  # nobody listens any more


def test_a_way_that_hangs_keeps_nobody_waiting_and_the_queue_is_bounded(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("bench.run.control.notify.LAST_WORDS_S", 0.2)
    go_on, sent = threading.Event(), []

    def hang(words: list[str], message: dict[str, Any]) -> None:
        go_on.wait(20.0)
        sent.append(message)

    monkeypatch.setitem(notify_ways._WAYS, "command", hang)
    _, context = context_of(tmp_path)
    notifier = Notifier(Notify(command=["x"]), context, on)  # type: ignore[call-arg]
    for number in range(LONGEST_QUEUE + 50):
        notifier.event(replace(HOLD, step=number), 0)
    notifier.beat()  # it would only have to wait
    notifier.close()  # returns although nothing was sent
    assert sent == []
    go_on.set()
    notifier._thread.join()
    assert len(sent) <= LONGEST_QUEUE + 1
    assert sent[-1]["step"] == str(LONGEST_QUEUE + 49)
    assert sum(message.get("left_out", 0) for message in sent) == LONGEST_QUEUE + 50 - len(sent)
    assert not any(message["kind"] == "heartbeat" for message in sent)


def test_a_sign_of_life_goes_out_regularly(tmp_path: Path) -> None:
    _, context = context_of(tmp_path)
    assert isinstance(context.clock, VirtualClock)
    notify = Notify(command=catcher(tmp_path), heartbeat="60 s")  # type: ignore[arg-type,call-arg]
    with notifications(context, notify, on) as notifier:
        for _ in range(3):
            while notifier._queue:
                threading.Event().wait(0.01)
            context.clock.sleep(60.0)
    caught = [json.loads(line)["kind"] for line in (tmp_path / "caught").read_text().splitlines()]
    assert caught == ["heartbeat"] * 4


def test_the_users_own_file_is_found_and_its_mistakes_have_a_place(tmp_path: Path) -> None:
    folder = tmp_path / ".config" / "inertial-bench"
    folder.mkdir(parents=True)
    assert user_notify({"HOME": str(tmp_path)}) is None
    (folder / "notify.yaml").write_text("on: [end]\ncommand: [mail-me]\n")
    for environment in ({"HOME": str(tmp_path)}, {"XDG_CONFIG_HOME": str(tmp_path / ".config"), "HOME": "/nowhere"}):
        found = user_notify(environment)
        assert (found.on, found.command) == (["end"], ["mail-me"])
    (folder / "notify.yaml").write_text("on: [end]\npassword: secret\n")
    with pytest.raises(InputErrors, match="unknown key 'password'") as caught:
        user_notify({"HOME": str(tmp_path)})
    assert "notify.yaml:2:1" in caught.value.where


@contextmanager
def manager(address: str) -> Iterator[socket.socket]:
    with socket.socket(socket.AF_UNIX, socket.SOCK_DGRAM) as receiver:
        receiver.setblocking(False)
        receiver.bind(f"\0{address[1:]}" if address.startswith("@") else address)
        yield receiver


def received(receiver: socket.socket) -> list[str]:
    found = []
    while True:
        try:
            found.append(receiver.recv(4096).decode())
        except BlockingIOError:
            return found


@pytest.mark.parametrize("abstract", [False, True])
def test_the_watchdog_is_fed_while_every_part_is_well(tmp_path: Path, abstract: bool) -> None:
    address = f"@inertial-bench-{os.getpid()}" if abstract else str(tmp_path / "notify")
    rig = HoldRig(tmp_path, 2)
    context = rig.context()
    environment = {"NOTIFY_SOCKET": address, "WATCHDOG_USEC": "20000000"}
    with manager(address) as receiver:
        with service_notice(context, environment):
            assert received(receiver) == ["READY=1"]
            context.step = rig.steps[2]
            context.health.alive(SEQUENCER)
            context.health.alive(WRITER)
            rig.clock.sleep(9.0)
            context.health.alive(SEQUENCER)
            context.health.alive(WRITER)
            rig.clock.sleep(1.0)  # half of the time the manager allows
            assert received(receiver) == ["STATUS=step 2 of 8\nWATCHDOG=1"]
            rig.clock.sleep(9.0)
            context.health.alive(SEQUENCER)  # the writer is silent
            context.stop.holds.hold("door", "it is open")
            rig.clock.sleep(1.0)
            assert received(receiver) == ["STATUS=holding at step 2 of 8: it is open"]
        assert received(receiver) == ["STOPPING=1"]


def test_nobody_is_told_where_nobody_asks(tmp_path: Path) -> None:
    assert not ServiceNotice({}).there
    assert ServiceNotice({}).watchdog_s is None
    assert ServiceNotice({"WATCHDOG_USEC": "4000000"}).watchdog_s == 2.0
    assert ServiceNotice({"WATCHDOG_USEC": "4000000", "WATCHDOG_PID": "1"}).watchdog_s is None
    ServiceNotice({}).tell("READY=1")
    ServiceNotice({"NOTIFY_SOCKET": str(tmp_path / "nobody")}).tell("READY=1")
