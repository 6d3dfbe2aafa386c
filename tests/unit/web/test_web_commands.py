"""Commands of the page: who may, what reaches the run, and that nothing is done twice."""

import json
import threading
from collections.abc import Iterator
from typing import Any

import pytest
from web_rig import RUN, Answer, Page

from bench.model.clock import VirtualClock, WallClock
from bench.run.control.local_socket import ControlServer, socket_path
from bench.web.command_request import MOST_KEPT
from bench.web.security.logins import AWAY_S, Lease, Login
from bench.web.security.tokens import BENCH, OPERATOR, VIEWER

KIM, LEE = Login("kim", OPERATOR, "1"), Login("lee", OPERATOR, "2")


class Run:
    """What a run has been asked; it answers what it is told to."""

    def __init__(self) -> None:
        self.asked: list[dict[str, Any]] = []
        self.reply: dict[str, Any] = {"ok": True, "text": "the run holds"}
        self.go = threading.Event()
        self.go.set()

    def answer(self, request: dict[str, Any], by: str) -> dict[str, Any]:
        assert "process" in by
        self.asked.append(request)
        self.go.wait(10)
        return self.reply


@pytest.fixture
def run(page: Page) -> Iterator[Run]:
    found = Run()
    server = ControlServer(socket_path(page.serving.out / RUN), found.answer, WallClock())
    yield found
    found.go.set()
    server.close()


def send(page: Page, command: str, command_id: str = "1", *, name: str = "kim", **fields: Any) -> Answer:
    document = {"id": command_id, "run": RUN, "command": command, **fields}
    return page.post("/api/v1/commands", OPERATOR, document, name=name)


def take(page: Page, name: str = "kim", role: str = OPERATOR, wanted: Any = True) -> Answer:
    return page.post("/api/v1/operator", role, {"take": wanted}, name=name)


def test_a_command_reaches_the_run_with_who_and_why(page: Page, run: Run) -> None:
    take(page)
    answer = send(page, "pause", reason="\u3000door\u00a0\u3000opened ")  # wide and hard blanks are blanks
    assert (answer.status, answer.json) == (200, {"id": "1", "ok": True, "text": "the run holds"})
    assert run.asked == [
        {"command": "pause", "reason": "door opened", "by": "kim, operator, 127.0.0.1", "place": "afar"}
    ]
    line = page.audit()[-1]
    who = {"what": "command", "name": "kim", "role": "operator", "address": "127.0.0.1", "t_utc": line["t_utc"]}
    what = {"command": "pause", "run": RUN, "id": "1", "reason": "door opened", "ok": True, "text": "the run holds"}
    assert line == who | what


def test_every_command_has_its_words(page: Page, run: Run) -> None:
    take(page)
    send(page, "resume", "1")
    send(page, "abort", "2", reason="unit needed")
    send(page, "acknowledge", "3", alarm="interlock:air")
    send(page, "answer", "4", prompt="7", value=23.5)
    send(page, "answer", "5", prompt="7", value=None)
    for number, letter in enumerate(("a", "é", "문", "𝔄", '"'), 6):
        assert send(page, "pause", str(number), reason=letter * 500).json["ok"]
        assert run.asked.pop()["reason"] == letter * 500  # it fits into a line of the run in any script
    for one in run.asked:
        del one["by"], one["place"]
    assert run.asked == [
        {"command": "resume", "reason": ""},
        {"command": "abort", "reason": "unit needed"},
        {"command": "acknowledge", "reason": "", "alarm": "interlock:air"},
        {"command": "answer", "reason": "", "prompt": "7", "value": 23.5},
        {"command": "answer", "reason": "", "prompt": "7", "value": None},
    ]


def test_only_the_token_says_who_is_at_the_bench(page: Page, run: Run) -> None:
    take(page)
    send(page, "answer", "1", prompt="7", value=True, place="bench")  # a browser may say what it wants
    take(page, "lee", BENCH)
    document = {"id": "2", "run": RUN, "command": "answer", "prompt": "7", "value": True}
    assert page.post("/api/v1/commands", BENCH, document, name="lee").status == 200
    assert [(one["by"], one["place"]) for one in run.asked] == [
        ("kim, operator, 127.0.0.1", "afar"), ("lee, bench, 127.0.0.1", "bench"),
    ]  # fmt: skip
    assert page.audit()[-1]["role"] == "bench"
    assert page.ask("GET", "/api/v1/session", page.cookie(BENCH, "lee")).json["role"] == "bench"


def test_what_the_run_refuses_is_passed_on(page: Page, run: Run) -> None:
    take(page)
    run.reply = {"ok": False, "error": "the run is not holding"}
    assert send(page, "resume").json == {"id": "1", "ok": False, "text": "the run is not holding"}
    assert page.audit()[-1]["ok"] is False


def test_an_id_is_done_once(page: Page, run: Run) -> None:
    take(page)
    first = send(page, "pause", reason="door")
    run.reply = {"ok": True, "text": "another reply"}
    assert send(page, "pause", reason="door").json == first.json
    assert len(run.asked) == 1
    other = send(page, "abort", reason="door")
    assert (other.status, other.json["error"]) == (409, "B-WEB-019")
    assert len(run.asked) == 1


def test_an_id_is_done_once_even_while_it_is_under_way(page: Page, run: Run) -> None:
    take(page)
    run.go.clear()
    found: list[Answer] = []
    threads = [threading.Thread(target=lambda: found.append(send(page, "abort", reason="fire"))) for _ in range(4)]
    for thread in threads:
        thread.start()
    while not run.asked:
        pass
    run.go.set()
    for thread in threads:
        thread.join()
    assert [answer.json["ok"] for answer in found] == [True] * 4
    assert len(run.asked) == 1


def test_what_is_kept_of_commands_is_bounded(page: Page, run: Run) -> None:
    take(page)
    kept = page.serving.sent._sent
    send(page, "resume", "first")
    reply = next(iter(kept.values()))
    for number in range(2 * MOST_KEPT):
        page.serving.sent.keep(KIM, reply.command, reply.reply)
        page.serving.sent.keep(Login("kim", OPERATOR, str(number)), reply.command, reply.reply)
    assert len(kept) == MOST_KEPT


def test_without_the_command_nothing_is_done_b_web_016(page: Page, run: Run) -> None:
    nobody = send(page, "abort", reason="now")
    assert (nobody.status, nobody.json["error"]) == (409, "B-WEB-016")
    assert "nobody" in nobody.json["text"]
    take(page, "lee")
    somebody = send(page, "abort", reason="now")
    assert somebody.status == 409
    assert "lee has the command" in somebody.json["text"]
    assert run.asked == []
    assert [line["ok"] for line in page.audit() if line["what"] == "command"] == [False, False]


def test_the_command_is_handed_over(page: Page, run: Run) -> None:
    assert take(page, "lee").json["text"] == "you have the command"
    over = take(page, "kim").json
    assert over["text"] == "taken from lee"
    assert over["operator"]["name"] == "kim"
    assert send(page, "resume", name="lee").status == 409
    assert send(page, "resume", name="kim").status == 200
    assert page.audit()[1]["text"] == "taken from lee"
    assert take(page, "lee", wanted=False).json["text"] == "it was not yours"
    assert take(page, "kim", wanted=False).json == {"ok": True, "text": "given up", "operator": None}


WRONG = [
    {"command": "stop"},
    {"command": "status"},
    {"command": ["abort"]},
    {"command": "pause"},
    {"command": "pause", "reason": " "},
    {"command": "abort", "reason": ""},
    {"command": "abort", "reason": "a\nb"},
    {"command": "abort", "reason": "x" * 501},
    {"command": "abort", "reason": 5},
    {"command": "abort", "reason": "x", "id": ""},
    {"command": "abort", "reason": "x", "id": "i" * 65},
    {"command": "abort", "reason": "x", "id": None},
    {"command": "abort", "reason": "x", "run": 7},
    {"command": "acknowledge"},
    {"command": "acknowledge", "alarm": True},
    {"command": "answer"},
    {"command": "answer", "prompt": 1},
    {"command": "answer", "prompt": "1", "value": [1]},
    {"command": "answer", "prompt": "1", "value": 1e300},
    {"command": "answer", "prompt": "1", "value": 10**400},
    {"command": "answer", "prompt": "1", "value": float("nan")},
    {"command": "answer", "prompt": "1", "value": float("-inf")},
]


@pytest.mark.parametrize("fields", WRONG, ids=json.dumps)
def test_fields_that_are_wrong_b_web_017(page: Page, run: Run, fields: dict[str, Any]) -> None:
    take(page)
    answer = page.post("/api/v1/commands", OPERATOR, {"id": "1", "run": RUN, **fields})
    assert (answer.status, answer.json["error"]) == (400, "B-WEB-017")
    assert run.asked == []


@pytest.mark.parametrize("body", [b"", b"{", b"[]", b"\xff", b'{"value": NaN', b"[" * 60_000, b"1" * 5000])
def test_bodies_that_are_no_object(page: Page, body: bytes) -> None:
    headers = {**page.cookie(OPERATOR), "X-Bench-Command": "1", "Content-Type": "application/json"}
    for path in ("/api/v1/commands", "/api/v1/operator"):
        answer = page.ask("POST", path, {**headers, "Origin": page.origin}, body)
        assert (answer.status, answer.json["error"]) == (400, "B-WEB-017")
    for wanted in (1, "yes", None):
        assert take(page, wanted=wanted).json["error"] == "B-WEB-017"


def test_a_run_that_is_gone_b_web_018(page: Page) -> None:
    take(page)
    elsewhere = {"id": "1", "run": "../secret", "command": "resume"}
    assert page.post("/api/v1/commands", OPERATOR, elsewhere).status == 404
    answer = send(page, "abort", reason="now").json
    assert (answer["ok"], answer["error"]) == (False, "B-WEB-018")
    gone = ("no run of this session is alive", "the reply is none")  # the second while its socket is being closed
    assert answer["text"] in {f"no answer: {one}" for one in gone}


def test_a_run_that_does_not_answer_b_web_018(page: Page, run: Run, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("bench.web.runs.ANSWER_S", 0.2)
    take(page)
    run.go.clear()
    answer = send(page, "abort", reason="now").json
    assert (answer["ok"], answer["error"]) == (False, "B-WEB-018")
    assert "whether it heard the command is not known" in answer["text"]
    assert page.ask("GET", "/api/v1/session", page.cookie(VIEWER)).status == 200


def test_a_lease_ends_a_minute_after_the_last_socket() -> None:
    clock = VirtualClock()
    lease = Lease(clock)
    lease.take(KIM)
    clock.sleep(AWAY_S)
    assert lease.held_by(KIM)
    with lease.present(KIM):
        clock.sleep(1.0)
        with lease.present(KIM):
            clock.sleep(100_000.0)
        assert lease.held_by(KIM)
        clock.sleep(100_000.0)
        assert lease.held_by(KIM)
    clock.sleep(AWAY_S)
    assert lease.held_by(KIM)
    clock.sleep(0.001)
    assert lease.holder() is None
    assert lease.document() is None
    assert lease.take(LEE) is None


def test_a_lease_belongs_to_a_login_not_to_a_name() -> None:
    clock = VirtualClock()
    lease = Lease(clock)
    lease.take(KIM)
    other = Login("kim", OPERATOR, "3")
    assert not lease.held_by(other)
    assert lease.take(other) is not None
    assert not lease.leave(KIM)
    with lease.present(KIM):  # somebody else's socket does not keep it
        clock.sleep(AWAY_S + 0.1)
    assert lease.holder() is None
    assert not lease._open
    assert lease.take(other) is None
    assert lease.leave(other)
