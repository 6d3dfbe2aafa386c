"""Logging in: the form, the cookie, what it outlives and what it does not."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path

import pytest
from web_rig import COMMAND, FORM, Page, served

from bench.model.clock import VirtualClock
from bench.web.security.cookie import VALID_S, Cookies, Login, clean_name
from bench.web.security.tokens import OPERATOR, VIEWER, obtain_tokens

KIM = Login("kim", OPERATOR, "0123456789abcdef")


@pytest.fixture(scope="module")
def server(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Page]:
    with served(tmp_path_factory.mktemp("page")) as found:
        yield found


@pytest.fixture
def page(server: Page) -> Page:
    server.forget()
    return server


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


@pytest.mark.parametrize(
    "name", ["", " ", "a" * 41, "a, operator", "a\x07b", "a\x00", "<b>", "(root)", "-x", "a\u202eb"]
)
def test_a_name_that_could_be_taken_for_something_else(page: Page, name: str) -> None:
    answer = page.login(name, page.clear[OPERATOR])
    assert answer.status == 401
    assert "set-cookie" not in answer.headers
    assert b"A name has up to 40" in answer.body


def test_the_form_is_not_for_whoever_is_in(page: Page) -> None:
    answer = page.ask("GET", "/login", page.cookie(VIEWER))
    assert (answer.status, answer.headers["location"]) == (303, "/")
    assert page.ask("GET", "/login").status == 401


def test_names_of_people() -> None:
    for name in ("kim", "K", "Ana María O'Neill", "김민준", "j.doe@lab-2", "이 A.", "A" * 40):
        assert clean_name(name) == name
    assert clean_name("e\u0301") == "é"


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


def test_a_form_that_is_none(page: Page) -> None:
    for body in (b"\xff\xfe", b"a=1&b=2&c=3&d=4&e=5", b"", b"name=kim"):
        assert page.ask("POST", "/login", {**FORM, "Origin": page.origin}, body).status == 401


def test_logging_out_takes_cookie_and_command(page: Page) -> None:
    assert page.post("/api/v1/operator", OPERATOR, {"take": True}).json["ok"]
    answer = page.post("/logout", OPERATOR, {})
    assert "Max-Age=0" in answer.headers["set-cookie"]
    assert page.serving.lease.holder() is None


def test_a_cookie_is_read_back(tmp_path: Path) -> None:
    cookies = cookies_of(tmp_path / "a", VirtualClock())
    header = sent(cookies.header(KIM))
    assert cookies.read(header) == KIM
    for other in ("other=1", "x", '_xsrf="a;b', 'j={"a": [1, 2]}', "a b=c", "=", "ü=ö"):
        assert cookies.read(f"{other}; {header}; language=ko") == KIM
    again = cookies_of(tmp_path / "a", VirtualClock())
    assert again.read(header) == KIM  # a restarted server


def test_a_cookie_of_another_key_or_port_is_none(tmp_path: Path) -> None:
    clock = VirtualClock()
    cookies = cookies_of(tmp_path / "a", clock)
    header = sent(cookies.header(KIM))
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
    for set_back_s, valid in ((300, True), (86_400, True), (86_401, False)):
        earlier = cookies_of(tmp_path / "a", VirtualClock(utc_start_ns=(1_800_000_000 - set_back_s) * 10**9))
        assert (earlier.read(header) == KIM) is valid


def test_under_tls_the_cookie_is_for_tls_only(tmp_path: Path) -> None:
    cookies = cookies_of(tmp_path / "a", VirtualClock(), secure=True)
    header = cookies.header(KIM)
    assert header.startswith("__Host-bench_login_8321=")
    assert header.endswith("; Secure")


def test_an_expired_cookie_is_401_on_the_page(page: Page) -> None:
    old = Cookies(page.serving.tokens, VirtualClock(), page.port, secure=False)  # made in the year 2000
    answer = page.ask("POST", "/api/v1/operator", {"Cookie": sent(old.header(KIM)), **COMMAND, "Origin": page.origin})
    assert answer.status == 401
