"""The gate before the page server: every route, every refusal, over a real socket."""

import re
import socket
from pathlib import Path

import pytest
from starlette.routing import Route, WebSocketRoute
from web_rig import COMMAND, RUN, Page, served

from bench.web.security.tokens import OPERATOR, VIEWER

CSP = (
    "default-src 'self'; script-src 'self'; style-src 'self' 'unsafe-inline'; img-src 'self' data:; "
    "connect-src 'self'; object-src 'none'; base-uri 'none'; form-action 'self'; frame-ancestors 'none'"
)
FILLED = {"run": RUN, "file": "bokeh.min.js"}


def paths(page: Page, method: str) -> list[str]:
    """Every path of the application that takes a method, its parameters filled in."""
    found = []
    for route in page.app.routes:
        if isinstance(route, Route):
            assert route.methods is not None
            if method in route.methods:
                found.append(re.sub(r"{(\w+)}", lambda match: FILLED[match[1]], route.path))
    return found


def everything(page: Page) -> list[tuple[str, str]]:
    return [(method, path) for method in ("GET", "HEAD", "POST") for path in paths(page, method)]


def test_the_routes_are_those_of_the_protocol(page: Page) -> None:
    assert len(page.app.routes) == 21
    assert all(isinstance(route, Route | WebSocketRoute) for route in page.app.routes)
    assert set(paths(page, "POST")) == {"/login", "/logout", "/api/v1/commands", "/api/v1/operator"}
    named = re.findall(r"`?(?:GET |POST |, )`?(/api/v1/[a-z/{}]+)", Path("docs/live-protocol.md").read_text())
    routed = {route.path for route in page.app.routes}
    assert {name for name in named if "{" not in name} <= routed


def test_every_route_without_a_login_is_401(page: Page) -> None:
    for method, path in everything(page):
        if path != "/login":
            answer = page.ask(method, path, {"Origin": page.origin, **COMMAND}, b"{}" if method == "POST" else b"")
            assert answer.status == 401, (method, path)
            assert answer.headers["content-security-policy"] == CSP or path.endswith("/report")
    assert page.ask("GET", "/no/such/page").status == 401
    assert page.ask("GET", "/api/v1/session").json["error"] == "B-WEB-008"
    assert page.login("kim", "wrong").status == 401


def test_a_page_without_a_login_is_the_form_and_nothing_else(page: Page) -> None:
    answer = page.ask("GET", f"/runs/{RUN}")
    text = answer.body.decode()
    assert answer.status == 401
    assert '<form method="post" action="/login">' in text
    assert f'name="back_to" value="/runs/{RUN}"' in text
    assert not re.search(r"<script|<img|src=|https?:|onclick|url\(", text)
    assert re.findall(r"<link[^>]*>", text) == ['<link rel="icon" href="data:,">']
    assert answer.headers["referrer-policy"] == "same-origin"  # else the browser sends "Origin: null"
    assert page.ask("GET", "/").body.decode().count('value="/"') == 1


@pytest.mark.parametrize("role", [VIEWER, OPERATOR])
def test_every_route_with_a_login_answers_with_the_rules(page: Page, role: str) -> None:
    for path in paths(page, "GET"):
        answer = page.ask("GET", path, page.cookie(role))
        assert answer.status not in (401, 403), path
        assert answer.headers["x-content-type-options"] == "nosniff"
        assert answer.headers["referrer-policy"] == "no-referrer"
        assert answer.headers["cross-origin-opener-policy"] == "same-origin"
        assert "camera=()" in answer.headers["permissions-policy"]
        assert "server" not in answer.headers
        asset = path.startswith(("/bokeh/", "/static/")) and answer.status == 200
        assert answer.headers["cache-control"] == ("private, no-cache" if asset else "no-store")
        csp = answer.headers["content-security-policy"]
        assert csp.startswith("sandbox; default-src 'none'") if path.endswith("/report") else csp == CSP, path
        assert "unsafe-eval" not in csp
        assert "script-src 'unsafe-inline'" not in csp


def test_no_post_passes_as_a_viewer(page: Page) -> None:
    for path in paths(page, "POST"):
        if path not in ("/login", "/logout"):
            for document in ({}, {"take": True}, {"id": "1", "run": RUN, "command": "abort", "reason": "now"}):
                answer = page.post(path, VIEWER, document)
                assert (answer.status, answer.json["error"]) == (403, "B-WEB-015")
    assert page.serving.lease.holder() is None
    assert all(not line["ok"] for line in page.audit() if line["what"] == "command")


@pytest.mark.parametrize(
    "origin",
    ["", "null", "http://127.0.0.1", "https://127.0.0.1:{port}", "http://127.0.0.1:1", "HTTP://127.0.0.1:{port}",
     "http://127.0.0.1:{port}.evil.example"],
)  # fmt: skip
def test_a_forged_origin_is_refused_on_every_post(page: Page, origin: str) -> None:
    for path in paths(page, "POST"):
        headers = {**page.cookie(OPERATOR), **COMMAND, "Origin": origin.format(port=page.port)}
        if not origin:
            del headers["Origin"]
        answer = page.ask("POST", path, headers, b"{}")
        assert (answer.status, answer.json["error"]) == (403, "B-WEB-010"), path


@pytest.mark.parametrize("host", ["evil.example", "evil.example:{port}", "127.0.0.1", "127.0.0.1:1", "localhost:", ""])
def test_a_forged_host_is_refused_on_every_route(page: Page, host: str) -> None:
    for method, path in everything(page):
        forged = host.format(port=page.port)
        headers = {**page.cookie(OPERATOR), **COMMAND, "Origin": f"http://{forged}", "Host": forged}
        answer = page.ask(method, path, headers, b"{}" if method == "POST" else b"")
        assert answer.status == 403, (method, path)
        assert answer.headers["x-content-type-options"] == "nosniff"
    assert page.ask("GET", "/api/v1/runs", {"Host": "evil.example"}).json["error"] == "B-WEB-009"


def test_a_post_without_our_header_or_as_a_form_is_refused(page: Page) -> None:
    good = {**page.cookie(OPERATOR), "Origin": page.origin}
    for path in set(paths(page, "POST")) - {"/login"}:
        for value in ("", "0", "true"):
            answer = page.ask("POST", path, {**good, **COMMAND, "X-Bench-Command": value}, b"{}")
            assert (answer.status, answer.json["error"]) == (403, "B-WEB-010")
        answer = page.ask("POST", path, {**good, "Content-Type": "application/json"}, b"{}")
        assert answer.status == 403
        for kind in ("text/plain", "application/x-www-form-urlencoded", "multipart/form-data", ""):
            answer = page.ask("POST", path, {**good, **COMMAND, "Content-Type": kind}, b"{}")
            assert (answer.status, answer.json["error"]) == (415, "B-WEB-011")
    answer = page.ask("POST", "/login", {**good, **COMMAND}, b"{}")
    assert answer.status == 415


@pytest.mark.parametrize("method", ["PUT", "DELETE", "PATCH", "OPTIONS", "TRACE"])
def test_other_methods_change_nothing(page: Page, method: str) -> None:
    for _, path in everything(page):
        assert page.ask(method, path).status == 401
        assert page.ask(method, path, page.cookie(OPERATOR)).status == 403
        answer = page.ask(method, path, {**page.cookie(OPERATOR), **COMMAND, "Origin": page.origin}, b"{}")
        assert answer.status == 405


def test_large_bodies_are_refused_b_web_012(page: Page) -> None:
    headers = {**page.cookie(OPERATOR), **COMMAND, "Origin": page.origin}
    answer = page.ask("POST", "/api/v1/commands", headers, b" " * 65_537)
    assert (answer.status, answer.json["error"]) == (413, "B-WEB-012")
    chunked = b"".join(b"1000\r\n" + b" " * 4096 + b"\r\n" for _ in range(17)) + b"0\r\n\r\n"
    whole = {"Host": f"127.0.0.1:{page.port}", **headers, "Transfer-Encoding": "chunked"}
    head = "".join(f"{name}: {value}\r\n" for name, value in whole.items())
    with socket.create_connection(("127.0.0.1", page.port), 10) as stream:
        stream.sendall(f"POST /api/v1/commands HTTP/1.1\r\n{head}\r\n".encode() + chunked)
        assert b" 413 " in stream.recv(65536).splitlines()[0]


ELSEWHERE = [
    "/static/..%2fapp.py",
    "/static/..\\app.py",
    "/static/%2fetc%2fpasswd",
    "/static/page.js%00.css",
    "/static/.hidden",
    "/bokeh/bokeh.js",
    "/runs/..",
    "/runs/a%00b",
    "/runs/.hidden",
    "/runs/linked",
    "/runs/" + "a" * 300,
    "/api/v1/runs/%2e%2e%2fsecret/report",
    "/api/v1/runs/linked/report",
    "/api/v1/runs/a%5cb/figures",
]


def test_ways_out_of_a_folder_are_404(page: Page) -> None:
    out = page.serving.out
    secret = out.parent / "secret"
    for folder in (secret, out / "no_session", out / ".hidden"):
        folder.mkdir()
    (secret / "session.0001.mcap").touch()
    (out / ".hidden" / "session.0001.mcap").touch()
    (secret / "report.html").write_text("secret")
    (out / "linked").symlink_to(secret)
    for path in ELSEWHERE:
        answer = page.ask("GET", path, page.cookie(OPERATOR))
        assert (answer.status, answer.json["error"]) == (404, "B-WEB-013"), path
        assert b"secret" not in answer.body
        assert page.ask("GET", path).status == 401


def test_what_a_route_did_not_foresee_is_500_without_a_trace(
    page: Page, monkeypatch: pytest.MonkeyPatch, caplog: pytest.LogCaptureFixture
) -> None:
    async def fail(*_: object) -> None:
        raise RuntimeError("secret of the inside")

    monkeypatch.setattr(page.app.state.hub, "listed", fail)
    answer = page.ask("GET", "/api/v1/runs", page.cookie(VIEWER))
    assert (answer.status, answer.json["error"]) == (500, "B-WEB-014")
    assert b"secret" not in answer.body
    assert answer.headers["content-security-policy"] == CSP
    assert "secret of the inside" in caplog.text


def test_a_socket_is_closed_with_a_code(page: Page, tmp_path: Path) -> None:
    good = page.cookie(VIEWER)
    assert page.close_code({}, RUN, page.origin) == 4401
    assert page.close_code({"Cookie": "x=y"}, RUN, page.origin) == 4401
    for origin in (None, "http://evil.example", "null", "http://127.0.0.1:1"):
        assert page.close_code(good, RUN, origin) == 4403
    for run in ("not_there", "..", "linked", "", "%2e%2e%2fsecret"):
        assert page.close_code(good, run, page.origin) == 4404
    with served(tmp_path / "other", hosts=frozenset({"bench.example.org"})) as other:
        assert other.close_code(other.cookie(OPERATOR), RUN, "http://bench.example.org") == 4403


def test_behind_a_proxy_its_address_and_its_entry_are_used(tmp_path: Path) -> None:
    forged = {"X-Forwarded-For": "10.0.0.1, 192.0.2.7"}
    with served(tmp_path / "a", hosts=frozenset({"bench.example.org"}), secure=True, behind_proxy=True) as page:
        headers = {**page.cookie(VIEWER), **COMMAND, **forged, "Host": "bench.example.org"}
        assert page.ask("POST", "/api/v1/operator", {**headers, "Origin": "https://bench.example.org"}).status == 403
        assert page.audit()[-1]["address"] == "192.0.2.7"
    with served(tmp_path / "b") as page:
        headers = {**page.cookie(VIEWER), **COMMAND, **forged, "Origin": page.origin}
        assert page.ask("POST", "/api/v1/operator", headers).status == 403
        assert page.audit()[-1]["address"] == "127.0.0.1"
