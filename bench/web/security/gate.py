"""The gate before every route: who asks, from where, and what the answer may do in a browser.

Order: Host; login; then for everything that changes something Origin, header, type and size; then the path. What is
refused never reaches a route. One plain ASGI layer, so that WebSockets pass it too: they are accepted and closed
with a code, because a browser cannot tell a refused upgrade from a server that is down.
"""

from __future__ import annotations

import asyncio
import logging
import re
from collections import Counter
from contextlib import suppress
from typing import Any

from starlette.datastructures import Headers
from starlette.requests import Request
from starlette.responses import Response
from starlette.types import ASGIApp, Message, Receive, Scope, Send

from bench.web.live import end_tasks
from bench.web.security.login import login_page
from bench.web.security.logins import Login
from bench.web.security.refusal import Refusal
from bench.web.security.tokens import VIEWER
from bench.web.serving import Serving

LOGIN = "/login"
METRICS = "/metrics"
BY_TOKEN = (METRICS,)  # for programs, which have no cookie
HEADER, HEADER_VALUE = "x-bench-command", "1"
MOST_SOCKETS = 120  # WebSockets that are open at once; the limit of the server's connections does not count them
MOST_OF_ADDRESS = 60  # of them
KEPT_FOR_OPERATORS = 20  # of them: whoever commands must not be shut out by those who look
LARGEST_BODY = 65_536
BODY_S = 10.0
LONGEST_CLOSE_S = 0.1  # for a WebSocket to take the word that it is closed
READING = ("GET", "HEAD")
_BEARER = "send the viewer's token: 'Authorization: Bearer TOKEN'"
_ELSEWHERE = re.compile(rb"%2f|%5c|%00|\\|//|(^|/)\.\.?(/|$)|%2e", re.IGNORECASE)
_CLOSE = {401: 4401, 403: 4403, 404: 4404, 429: 4429}

log = logging.getLogger(__name__)
PAGE_CSP = (
    b"default-src 'self'; script-src 'self'; style-src 'self' 'unsafe-inline'; img-src 'self' data:; "
    b"connect-src 'self'; object-src 'none'; base-uri 'none'; form-action 'self'; frame-ancestors 'none'"
)
# a report comes from a folder that may have come from elsewhere: it is shown, and can do nothing
REPORT_CSP = (
    b"sandbox; default-src 'none'; style-src 'unsafe-inline'; img-src data:; font-src data:; base-uri 'none'; "
    b"form-action 'none'; frame-ancestors 'none'"
)
REPORT = re.compile(r"/api/v1/runs/[^/]*/report")
ASSETS = ("/static/", "/bokeh/")
LOGIN_STATUS = 401
_ALWAYS = {
    b"x-content-type-options": b"nosniff",
    b"cross-origin-opener-policy": b"same-origin",
    b"cross-origin-resource-policy": b"same-origin",
    b"x-frame-options": b"DENY",
    b"permissions-policy": b"camera=(), geolocation=(), microphone=(), payment=(), usb=(), serial=()",
}


class Gate:
    """Puts ``scope["user"]`` (a Login) and ``scope["address"]`` there for the routes behind it."""

    def __init__(self, app: ASGIApp, serving: Serving) -> None:
        self._app = app
        self._serving = serving
        self._sockets: Counter[str] = Counter()  # by address

    async def __call__(self, scope: Scope, receive: Receive, send: Send) -> None:
        if scope["type"] == "http":
            await self._http(scope, receive, send)
        elif scope["type"] == "websocket":
            await self._websocket(scope, receive, send)
        else:
            await self._app(scope, receive, send)

    async def _websocket(self, scope: Scope, receive: Receive, send: Send) -> None:
        try:
            headers = Headers(scope=scope)
            self._check_host(headers, scope)
            scope["address"] = self._address(headers, scope)
            login = self._admit(headers, scope)
            self._check_origin(headers, scope)
            _check_path(scope)
            self._check_room(login, scope["address"])
        except Refusal as refusal:
            await receive()  # the connect message
            await send({"type": "websocket.accept"})
            await send({"type": "websocket.close", "code": _CLOSE[refusal.status], "reason": refusal.code})
            return
        address = scope["address"]
        self._sockets[address] += 1
        try:
            with self._serving.lease.present(login):
                await self._until_logged_out(login, scope, receive, send)
        finally:
            self._sockets[address] -= 1
            if not self._sockets[address]:
                del self._sockets[address]

    async def _until_logged_out(self, login: Login, scope: Scope, receive: Receive, send: Send) -> None:
        """Serve a WebSocket until it ends; a logout of its login, in whatever window, closes it at once."""
        served = asyncio.ensure_future(self._app(scope, receive, send))
        ended = asyncio.create_task(self._serving.logged_out.ended(login))
        try:
            await asyncio.wait((served, ended), return_when=asyncio.FIRST_COMPLETED)
            if served.done():
                served.result()
                return
        finally:
            await end_tasks(served, ended)
        with suppress(OSError, RuntimeError, TimeoutError):  # it went away by itself, or does not read
            async with asyncio.timeout(LONGEST_CLOSE_S):
                await send({"type": "websocket.close", "code": _CLOSE[LOGIN_STATUS], "reason": "B-WEB-008"})

    async def _http(self, scope: Scope, receive: Receive, send: Send) -> None:
        started = False

        async def send_with_rules(message: Message) -> None:
            nonlocal started
            if message["type"] == "http.response.start":
                started = True
                message = {**message, "headers": rules_for(scope["path"], message)}
            await send(message)

        try:
            receive = await self._checked(scope, receive)
            await self._app(scope, receive, send_with_rules)
        except Refusal as refusal:
            await self._refused(scope, refusal)(scope, receive, send_with_rules)
        except Exception:  # whatever a route does, the server goes on, and its answers keep to the rules
            log.exception("a request to %r failed", scope["path"])
            if not started:
                wrong = Refusal(500, "B-WEB-014", "the page server failed at this", next_step="look at its terminal")
                await wrong.response()(scope, receive, send_with_rules)

    async def _checked(self, scope: Scope, receive: Receive) -> Receive:
        """Let the request pass or raise; returns where its body can be read, which is bounded and here already."""
        headers = Headers(scope=scope)
        self._check_host(headers, scope)
        is_login = scope["path"] == LOGIN and scope["method"] == "POST"
        scope["address"] = self._address(headers, scope)
        if not is_login:
            self._admit(headers, scope)
        if scope["method"] not in READING:
            self._check_origin(headers, scope)
            _check_form(headers, is_login)
            receive = _replay(await _body(headers, receive))
        _check_path(scope)
        return receive

    def _admit(self, headers: Headers, scope: Scope) -> Login:
        cookie = "; ".join(headers.getlist("cookie"))
        login = self._serving.cookies.read(cookie) if cookie else None
        if login is None and scope["path"] in BY_TOKEN and (given := headers.getlist("authorization")):
            login = self._program(given, scope["address"])
        if login is None:
            raise Refusal(401, "B-WEB-008", "nobody is logged in", next_step="open the page and log in")
        scope["user"] = login
        return login

    def _program(self, given: list[str], address: str) -> Login:
        """Return a viewer for the viewer's token as bearer: a program has no use for more."""
        limit = self._serving.scrape_limit
        if wait_s := limit.wait_s(address):
            raise Refusal(429, "B-WEB-024", "too many wrong tokens", next_step=_BEARER, wait_s=wait_s)
        scheme, _, token = given[0].partition(" ")
        if len(given) != 1 or scheme.lower() != "bearer" or self._serving.tokens.role_of(token.strip()) != VIEWER:
            limit.failed(address)
            raise Refusal(401, "B-WEB-024", "this is not the viewer's token", next_step=_BEARER)
        return Login("metrics", VIEWER, METRICS)

    def _check_host(self, headers: Headers, scope: Scope) -> None:
        hosts = headers.getlist("host")
        if len(hosts) != 1 or not self._serving.is_host(hosts[0], scope.get("server")):
            advice = "use the address that 'bench serve' prints, with its port"
            raise Refusal(403, "B-WEB-009", "this server is not reached by this name", next_step=advice)

    def _check_origin(self, headers: Headers, scope: Scope) -> None:
        origins = headers.getlist("origin")
        if len(origins) != 1 or not self._serving.is_origin(origins[0], scope.get("server")):
            advice = "only the page itself sends commands"
            raise Refusal(403, "B-WEB-010", "the request comes from elsewhere", next_step=advice)

    def _check_room(self, login: Login, address: str) -> None:
        full = self._sockets.total() >= MOST_SOCKETS - (0 if login.may_command else KEPT_FOR_OPERATORS)
        if full or self._sockets[address] >= MOST_OF_ADDRESS:
            raise Refusal(429, "B-WEB-023", "too many pages are open", next_step="close some; the page tries again")

    def _address(self, headers: Headers, scope: Scope) -> str:
        """Return address of the person's machine; the last entry is the one our proxy has written."""
        if self._serving.behind_proxy and (entries := headers.getlist("x-forwarded-for")):
            return entries[-1].rsplit(",", 1)[-1].strip()[:45]
        client = scope.get("client")
        return str(client[0]) if client else ""

    def _refused(self, scope: Scope, refusal: Refusal) -> Response:
        is_page = scope["method"] in READING and not scope["path"].startswith(("/api/", "/static/", "/bokeh/", METRICS))
        if refusal.status == 401 and is_page:
            return login_page(Request(scope), 401, back_to=scope["path"])
        return refusal.response()


def _check_form(headers: Headers, is_login: bool) -> None:
    """A page of somebody else can send a form, but neither our header nor JSON."""
    kind = headers.get("content-type", "").partition(";")[0].strip().lower()
    due = "application/x-www-form-urlencoded" if is_login else "application/json"
    if not is_login and headers.getlist(HEADER) != [HEADER_VALUE]:
        raise Refusal(403, "B-WEB-010", "the header X-Bench-Command is missing", next_step="send it with the value 1")
    if kind != due:
        raise Refusal(415, "B-WEB-011", f"the body is {kind[:40] or 'nothing'!r}", next_step=f"send {due}")


def _check_path(scope: Scope) -> None:
    """No way out of a folder is tried on the disk, and none is left to a route to see through."""
    raw = scope.get("raw_path") or scope["path"].encode()
    if _ELSEWHERE.search(raw) or "\0" in scope["path"]:
        raise Refusal(404, "B-WEB-013", "there is no such page")


async def _body(headers: Headers, receive: Receive) -> bytes:
    length = headers.get("content-length", "0")
    if not length.isdecimal() or int(length) > LARGEST_BODY:
        raise _too_large()
    body = b""
    try:
        async with asyncio.timeout(BODY_S):
            while True:
                message = await receive()
                if message["type"] != "http.request":
                    break
                body += message.get("body", b"")
                if len(body) > LARGEST_BODY:
                    raise _too_large()
                if not message.get("more_body", False):
                    break
    except TimeoutError as error:
        raise Refusal(408, "B-WEB-012", f"the body did not come within {BODY_S:g} s") from error
    return body


def _too_large() -> Refusal:
    return Refusal(413, "B-WEB-012", f"the body is larger than {LARGEST_BODY} bytes")


def _replay(body: bytes) -> Receive:
    messages: list[dict[str, Any]] = [{"type": "http.request", "body": body, "more_body": False}]

    async def receive() -> Message:
        return messages.pop() if messages else {"type": "http.disconnect"}

    return receive


def rules_for(path: str, start: Message) -> list[tuple[bytes, bytes]]:
    """Return headers of the ``http.response.start`` message of an answer to ``path``, with the rules put in."""
    headers = Headers(raw=list(start["headers"]))
    # with "no-referrer" a browser sends the login form with "Origin: null", which is refused
    is_form = start["status"] == LOGIN_STATUS and headers.get("content-type", "").startswith("text/html")
    rules = _ALWAYS | {
        b"content-security-policy": REPORT_CSP if REPORT.fullmatch(path) else PAGE_CSP,
        b"referrer-policy": b"same-origin" if is_form else b"no-referrer",
    }
    if not (path.startswith(ASSETS) and start["status"] in (200, 304)):
        rules[b"cache-control"] = b"no-store"
    return [header for header in headers.raw if header[0] not in rules] + list(rules.items())
