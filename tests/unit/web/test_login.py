"""Logging in: the form, the cookie, and the tokens it is held against."""

import json
import os
import stat
from dataclasses import replace
from pathlib import Path

import pytest
from web_rig import COMMAND, FORM, Page, served

from bench.model.clock import VirtualClock, WallClock
from bench.model.errors import InputError
from bench.web.security.audit import Audit
from bench.web.security.logins import LOGOUTS, VALID_S, Cookies, LoggedOut, Login, clean_name
from bench.web.security.tokens import (
    BENCH,
    FILE,
    MOST_IN_ALL,
    OPERATOR,
    VIEWER,
    LoginLimit,
    obtain_tokens,
    private_folder,
)

KIM = Login("kim", OPERATOR, "0123456789abcdef")


def cookies_of(folder: Path, clock: VirtualClock, port: int = 8321, secure: bool = False) -> Cookies:
    return Cookies(obtain_tokens(folder)[0], clock, port, secure)


def sent(header: str) -> str:
    return header.partition(";")[0]


@pytest.mark.parametrize("role", [VIEWER, OPERATOR])
def test_name_and_token_make_a_cookie(page: Page, role: str) -> None:
    answer = page.login("Kim  Min-jun", page.clear[role], back_to="/runs/x")
    assert (answer.status, answer.headers["location"]) == (303, "/runs/x")
    cookie = answer.headers["set-cookie"]
    assert all(word in cookie for word in ("HttpOnly", "SameSite=Strict", "Path=/", f"Max-Age={VALID_S}"))
    assert "Secure" not in cookie
    assert page.clear[role] not in cookie
    session = page.ask("GET", "/api/v1/session", {"Cookie": sent(cookie)}).json
    assert (session["name"], session["role"]) == ("Kim Min-jun", role)
    line = page.audit()[-1]
    assert (line["what"], line["name"], line["role"], line["address"], line["ok"]) == (
        "login",
        "Kim Min-jun",
        role,
        "127.0.0.1",
        True,
    )
    assert page.clear[role] not in (page.folder / "serve.jsonl").read_text()


@pytest.mark.parametrize("way", ["//evil.example", "https://evil.example", "/\\evil", "/api/v1/runs", "/runs/../x", ""])
def test_a_login_leads_nowhere_else(page: Page, way: str) -> None:
    answer = page.login("kim", page.clear[VIEWER], back_to=way)
    assert (answer.status, answer.headers["location"]) == (303, "/")
    answer = page.ask("GET", "/login", page.cookie(VIEWER))  # the form is not for whoever is in
    assert (answer.status, answer.headers["location"]) == (303, "/")
    for body in (b"\xff\xfe", b"a=1&b=2&c=3&d=4&e=5", b"", b"name=kim"):
        page.serving.__post_init__()  # wrong forms are counted
        assert page.ask("POST", "/login", {**FORM, "Origin": page.origin}, body).status == 401


@pytest.mark.parametrize(
    "name", ["", " ", "a" * 41, "a, operator", "a\x07b", "a\x00", "<b>", "(root)", "-x", "a\u202eb"]
)
def test_a_name_that_could_be_taken_for_something_else(page: Page, name: str) -> None:
    for taken in ("kim", "K", "Ana María O'Neill", "김민준", "j.doe@lab-2", "이 A.", "A" * 40):
        assert clean_name(taken) == taken
    assert clean_name("e\u0301") == "é"
    answer = page.login(name, page.clear[OPERATOR])
    assert answer.status == 401
    assert "set-cookie" not in answer.headers
    assert b"A name has up to 40" in answer.body


def test_wrong_tokens_are_limited_and_the_right_one_too(page: Page) -> None:
    for wrong in ("", "x", page.serving.tokens.viewer, page.clear[VIEWER].upper(), "y"):
        answer = page.login("kim", wrong)
        assert answer.status == 401
        assert "set-cookie" not in answer.headers
        assert b"not known" in answer.body
    answer = page.login("kim", page.clear[OPERATOR])
    assert answer.status == 429
    assert 1 <= int(answer.headers["retry-after"]) <= 60
    assert "set-cookie" not in answer.headers
    assert [line["ok"] for line in page.audit()] == [False] * 5  # the one that had to wait is not written
    assert page.ask("GET", "/", page.cookie(VIEWER)).status == 200  # whoever is in stays in


def test_a_copied_cookie_dies_with_the_logout_also_for_a_restarted_server(tmp_path: Path) -> None:
    with served(tmp_path) as page:
        copied, other = page.cookie(OPERATOR), page.cookie(VIEWER)
        assert page.ask("GET", "/api/v1/session", copied).status == 200
        assert page.post("/api/v1/operator", OPERATOR, {"take": True}).json["ok"]
        answer = page.ask("POST", "/logout", {**copied, **COMMAND, "Origin": page.origin}, b"{}")
        assert (answer.status, "Max-Age=0" in answer.headers["set-cookie"]) == (200, True)
        assert page.serving.lease.holder() is None
        assert page.ask("GET", "/api/v1/session", copied).status == 401
        assert page.ask("GET", "/api/v1/session", other).status == 200
    kept = tmp_path / "private" / LOGOUTS
    assert kept.stat().st_mode & 0o777 == 0o600
    clock = WallClock()
    again = Cookies(obtain_tokens(tmp_path / "private")[0], clock, page.port, False, LoggedOut(kept.parent, clock))
    assert again.read(copied["Cookie"]) is None
    assert again.read(other["Cookie"]) is not None


def test_logouts_are_forgotten_when_their_cookies_are_too_old_anyway(tmp_path: Path) -> None:
    clock = VirtualClock()
    logged_out = LoggedOut(tmp_path, clock)
    logged_out.add(KIM)
    clock.sleep(9 * 86_400.0)
    logged_out.add(replace(KIM, id="later"))
    assert (KIM.id in logged_out, "later" in logged_out) == (False, True)
    (tmp_path / LOGOUTS).write_text("no json")
    assert "later" not in LoggedOut(tmp_path, clock)  # a damaged file keeps nobody out, and no server from beginning


def test_a_cookie_is_read_back_and_one_of_another_key_or_port_is_none(tmp_path: Path) -> None:
    clock = VirtualClock()
    cookies = cookies_of(tmp_path / "a", clock)
    header = sent(cookies.header(KIM))
    assert cookies.read(header) == KIM
    for other in ("other=1", "x", '_xsrf="a;b', 'j={"a": [1, 2]}', "a b=c", "=", "ü=ö"):
        assert cookies.read(f"{other}; {header}; language=ko") == KIM
    assert cookies_of(tmp_path / "a", clock).read(header) == KIM  # a restarted server
    obtain_tokens(tmp_path / "a", rotate=True)
    rotated = cookies_of(tmp_path / "a", clock)
    assert rotated.read(header) is None
    assert cookies_of(tmp_path / "a", clock, port=8322).read(sent(rotated.header(KIM))) is None
    assert rotated.read("") is None


def test_no_changed_cookie_is_read(tmp_path: Path) -> None:
    cookies = cookies_of(tmp_path / "a", VirtualClock())
    viewer = Login("kim", VIEWER, "1")
    name, _, value = sent(cookies.header(viewer)).partition("=")
    for place, letter in enumerate(value):
        changed = value[:place] + ("A" if letter != "A" else "B") + value[place + 1 :]
        found = cookies.read(f"{name}={changed}")
        # the last letter of a base64 text carries bits that mean nothing: the same cookie, never another one
        assert found is None or (found == viewer and place == len(value) - 1)
    payload, _, rest = value.partition(".")
    other = sent(cookies.header(KIM)).partition("=")[2].partition(".")[0]
    assert payload != other
    assert cookies.read(f"{name}={other}.{rest}") is None


def test_a_cookie_lasts_seven_days_and_survives_clocks_that_are_set(tmp_path: Path) -> None:
    clock = VirtualClock(utc_start_ns=1_800_000_000 * 10**9)
    cookies = cookies_of(tmp_path / "a", clock)
    header = sent(cookies.header(KIM))
    clock.sleep(VALID_S)
    assert cookies.read(header) == KIM
    clock.sleep(1.0)
    assert cookies.read(header) is None
    under_tls = cookies_of(tmp_path / "a", clock, secure=True).header(KIM)
    assert under_tls.startswith("__Host-bench_login_8321=")
    assert under_tls.endswith("; Secure")
    for set_back_s, valid in ((300, True), (86_400, True), (86_401, False)):
        earlier = cookies_of(tmp_path / "a", VirtualClock(utc_start_ns=(1_800_000_000 - set_back_s) * 10**9))
        assert (earlier.read(header) == KIM) is valid


def mode(path: Path) -> int:
    return stat.S_IMODE(path.stat().st_mode)


def test_a_token_opens_its_role_and_nothing_else_does(tmp_path: Path) -> None:
    tokens, clear = obtain_tokens(tmp_path / "a")
    assert tokens.role_of(clear[VIEWER]) == VIEWER
    assert tokens.role_of(clear[OPERATOR]) == OPERATOR
    assert tokens.role_of(clear[BENCH]) == BENCH
    for wrong in ("", clear[VIEWER][:-1], clear[VIEWER] + "x", tokens.viewer, tokens.operator, "\ud800", "0" * 100_000):
        assert tokens.role_of(wrong) is None


@pytest.mark.parametrize("wrong", [0o644, 0o640, 0o604, 0o660])
def test_a_file_that_others_may_use_is_refused_b_web_006(tmp_path: Path, wrong: int) -> None:
    obtain_tokens(tmp_path / "a")
    (tmp_path / "a" / FILE).chmod(wrong)
    with pytest.raises(InputError, match=f"B-WEB-006: .*{wrong:04o}"):
        obtain_tokens(tmp_path / "a")
    obtain_tokens(tmp_path / "a", rotate=True)
    assert mode(tmp_path / "a" / FILE) == 0o600
    (tmp_path / "a").chmod(0o770)
    with pytest.raises(InputError, match="B-WEB-006: "):
        obtain_tokens(tmp_path / "a")


def test_what_is_made_for_it_is_the_owners_alone_whatever_the_umask(tmp_path: Path) -> None:
    before = os.umask(0)
    try:
        obtain_tokens(tmp_path / ".config" / "inertial-bench")
        Audit(tmp_path / ".config" / "inertial-bench", VirtualClock()).write("login")
    finally:
        os.umask(before)
    folder = tmp_path / ".config" / "inertial-bench"
    assert [mode(one) for one in (folder.parent, folder)] == [0o700, 0o700]
    assert {mode(one) for one in folder.iterdir()} == {0o600}


@pytest.mark.parametrize(
    "content", ["", "{", "[]", '{"salt": 1}', '{"salt": "zz", "viewer": "", "operator": ""}', "an emptied key"]
)
def test_a_file_that_is_none_of_ours_b_web_007(tmp_path: Path, content: str) -> None:
    obtain_tokens(tmp_path / "a")
    path = tmp_path / "a" / FILE
    emptied = json.dumps({**json.loads(path.read_text()), "cookie_key": ""})  # an emptied hash opens nothing
    path.write_text(emptied if content == "an emptied key" else content)
    with pytest.raises(InputError) as raised:
        obtain_tokens(tmp_path / "a")
    assert raised.value.code == "B-WEB-007"
    assert "--rotate" in raised.value.next_step


def test_a_file_of_before_gets_a_token_of_the_bench_and_keeps_the_others(tmp_path: Path) -> None:
    tokens, clear = obtain_tokens(tmp_path / "a")
    path = tmp_path / "a" / FILE
    kept = json.loads(path.read_text())
    del kept["bench"]
    path.write_text(json.dumps(kept))
    found, new = obtain_tokens(tmp_path / "a")
    assert [found.role_of(clear[role]) for role in (VIEWER, OPERATOR, BENCH)] == [VIEWER, OPERATOR, None]
    assert list(new) == [BENCH]
    assert found.role_of(new[BENCH]) == BENCH
    assert found.cookie_key == tokens.cookie_key  # nobody is logged out
    assert mode(path) == 0o600
    assert obtain_tokens(tmp_path / "a") == (found, {})


def test_a_place_that_cannot_hold_it_b_web_007(tmp_path: Path) -> None:
    (tmp_path / "a").write_text("a file")
    with pytest.raises(InputError, match="B-WEB-007: "):
        obtain_tokens(tmp_path / "a")
    elsewhere = tmp_path / "elsewhere.json"
    elsewhere.write_text("{}")
    elsewhere.chmod(0o600)
    (tmp_path / "b").mkdir(mode=0o700)
    (tmp_path / "b" / FILE).symlink_to(elsewhere)
    with pytest.raises(InputError):
        obtain_tokens(tmp_path / "b")


def test_where_they_are_kept(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("XDG_CONFIG_HOME", str(tmp_path))
    assert private_folder() == tmp_path / "inertial-bench"
    monkeypatch.setenv("HOME", str(tmp_path))
    for relative in ("", "here"):
        monkeypatch.setenv("XDG_CONFIG_HOME", relative)
        assert private_folder() == tmp_path / ".config" / "inertial-bench"


def test_wrong_tokens_have_to_wait_also_from_everywhere() -> None:
    clock = VirtualClock()
    limit = LoginLimit(clock)
    for _ in range(5):
        assert limit.wait_s("a") == 0
        limit.failed("a")
        clock.sleep(1.0)
    assert 55 <= limit.wait_s("a") <= 60
    assert limit.wait_s("b") == 0
    clock.sleep(limit.wait_s("a"))
    assert limit.wait_s("a") == 0
    for number in range(10_000):
        limit.failed(str(number))
    assert limit.wait_s("another") > 0
    assert len(limit._failures) == MOST_IN_ALL
    clock.sleep(61.0)
    assert limit.wait_s("another") == 0


def test_the_audit_is_private_bounded_and_loses_nothing_recent(tmp_path: Path) -> None:
    audit = Audit(tmp_path, VirtualClock(), largest=1000)
    for number in range(100):
        audit.write("command", name="kim\n", number=number)
    files = sorted(path.name for path in tmp_path.iterdir())
    assert files == ["serve.1.jsonl", "serve.2.jsonl", "serve.3.jsonl", "serve.4.jsonl", "serve.jsonl"]
    assert all(path.stat().st_size <= 1000 and mode(path) == 0o600 for path in tmp_path.iterdir())
    order = [f"serve.{number}.jsonl" for number in (4, 3, 2, 1)] + ["serve.jsonl"]
    lines = [json.loads(line) for name in order for line in (tmp_path / name).read_text().splitlines()]
    numbers = [line["number"] for line in lines]
    assert numbers == list(range(numbers[0], 100))
    assert lines[0]["t_utc"] == "2000-01-01T00:00:00Z"


def test_an_audit_that_cannot_be_written_is_told_once(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    audit = Audit(tmp_path / "not_there", VirtualClock())
    audit.write("command")
    audit.write("command")
    assert capsys.readouterr().err.count("is not written") == 1
