"""One page server: its runs and its viewers, the server itself (uvicorn), and connections that do not wait for ever.

What somebody can hold open is bounded before it is known who it is. uvicorn ends a connection that is silent after an
answer, but waits without end for the first request, for one that comes byte by byte, and for somebody who does not
read; its limit of connections would then shut out everybody else.
"""

from __future__ import annotations

import asyncio
import logging
import signal
import socket
from collections import Counter
from collections.abc import Callable
from contextlib import suppress
from dataclasses import dataclass, field
from pathlib import Path
from types import FrameType

import uvicorn
from starlette.applications import Starlette
from uvicorn.protocols.http.httptools_impl import HttpToolsProtocol
from uvicorn.protocols.websockets.websockets_sansio_impl import WebSocketsSansIOProtocol

from bench.model.clock import Clock
from bench.web.command_request import SentCommands
from bench.web.security.audit import Audit
from bench.web.security.logins import Cookies, Lease, LoggedOut
from bench.web.security.tokens import LoginLimit, Tokens

MOST_CONNECTIONS = 256
MOST_OF_ADDRESS = 96  # of them: one address does not shut out the others
LARGEST_MESSAGE = 65_536  # bytes of a WebSocket message from a page
LARGEST_HEAD = 65_536  # bytes of a request before its body
HEAD_S = 10.0  # for the head of a request, however it drips
UNREAD_S = 120.0  # for an answer to be taken
DATE_S = 1.0  # between two dates that answers say


@dataclass
class Serving:
    """One page server.

    Args: out: folder of the sessions. hosts: what a Host header may say, with the port where a
        browser sends one. port: it listens on. secure: people reach it by https. behind_proxy: a proxy of ours is the
        only client, and the last entry of its X-Forwarded-For is believed. history: URL of the calibration history,
        None for its default. any_address: it listens on every address of the machine, and each of them is a host too.
    """

    out: Path
    tokens: Tokens
    audit: Audit
    clock: Clock
    hosts: frozenset[str]
    port: int
    secure: bool = False
    behind_proxy: bool = False
    history: str | None = None
    any_address: bool = False
    origins: frozenset[str] = field(init=False)
    cookies: Cookies = field(init=False)
    logged_out: LoggedOut = field(init=False)
    lease: Lease = field(init=False)
    limit: LoginLimit = field(init=False)
    scrape_limit: LoginLimit = field(init=False)  # its own: a scraper with an old token keeps nobody from logging in
    sent: SentCommands = field(init=False)

    def __post_init__(self) -> None:
        self.origins = frozenset(f"{self.scheme}://{host}" for host in self.hosts)
        self.logged_out = LoggedOut(self.audit.folder, self.clock)
        self.cookies = Cookies(self.tokens, self.clock, self.port, self.secure, self.logged_out)
        self.lease = Lease(self.clock)
        self.limit = LoginLimit(self.clock)
        self.scrape_limit = LoginLimit(self.clock)
        self.sent = SentCommands()

    def is_host(self, host: str, arrived_at: tuple[str, int] | None) -> bool:
        """Return True if a Host header may say ``host``. ``arrived_at``: our own end of the connection."""
        return host.lower() in self.hosts or (self.any_address and host in written(arrived_at, self.secure))

    def is_origin(self, origin: str, arrived_at: tuple[str, int] | None) -> bool:
        """Return True if a request may come from a page of this origin."""
        scheme, _, host = origin.partition("://")
        return origin in self.origins or (
            self.any_address and scheme == self.scheme and host in written(arrived_at, self.secure)
        )

    @property
    def scheme(self) -> str:
        """Scheme of the URL that people reach it by."""
        return "https" if self.secure else "http"


def written(place: tuple[str, int] | None, secure: bool) -> frozenset[str]:
    """Return an address and a port as a browser writes them into Host, which leaves the usual port out."""
    if place is None:
        return frozenset()
    name, port = place[0].lower().removeprefix("::ffff:"), place[1]  # an IPv4 address on an IPv6 socket
    name = f"[{name}]" if ":" in name else name
    usual = 443 if secure else 80
    return frozenset({f"{name}:{port}"} | ({name} if port == usual else set()))


class Server(uvicorn.Server):
    """Sleeps until it is told to end, but for the date of its answers; uvicorn would wake ten times a second."""

    _loop: asyncio.AbstractEventLoop | None = None

    def stop(self) -> None:
        """End soon; from a signal handler or another thread too."""
        self.should_exit = True
        if self._loop is not None:
            self._loop.call_soon_threadsafe(self._told.set)

    def handle_exit(self, sig: int, frame: FrameType | None) -> None:
        super().handle_exit(sig, frame)
        self.stop()

    async def main_loop(self) -> None:
        self._told, self._loop = asyncio.Event(), asyncio.get_running_loop()
        while not await self.on_tick(0):
            with suppress(TimeoutError):
                await asyncio.wait_for(self._told.wait(), DATE_S)


def server_of(app: Starlette, cert: Path | None = None, key: Path | None = None) -> Server:
    """Return the server of ``app``, not started: plain HTTP without ``cert``, bounded in everything."""
    serving: Serving = app.state.serving
    config = uvicorn.Config(
        app,
        http=PatientHttp if serving.behind_proxy else _counting(),
        ws=PatientSocket,
        ws_max_size=LARGEST_MESSAGE,
        ws_per_message_deflate=False,  # costs more processor than it saves on points
        lifespan="on",
        log_config=None,
        access_log=False,  # paths and addresses are the audit's business
        proxy_headers=False,  # who a proxy speaks for is decided in gate.py; uvicorn would believe any local process
        server_header=False,
        limit_concurrency=MOST_CONNECTIONS,
        timeout_graceful_shutdown=0,
        ssl_certfile=cert,
        ssl_keyfile=key,
    )
    logging.getLogger("uvicorn.error").addFilter(_Quiet())
    return Server(config)


def serve_until_told(server: Server, listener: socket.socket, announce: Callable[[], None]) -> None:
    """Announce it and serve on a listening socket, until SIGINT or SIGTERM; then nobody is waited for."""

    def stop(number: int, frame: FrameType | None) -> None:
        del number, frame
        server.stop()

    # uvicorn has handlers of its own while it serves and raises the signal again at the end: these make it exit 0
    before = {number: signal.signal(number, stop) for number in (signal.SIGINT, signal.SIGTERM)}
    try:
        announce()
        server.run(sockets=[listener])
    finally:
        for number, handler in before.items():
            signal.signal(number, handler)


class _Quiet(logging.Filter):
    """Connections that are cut at the end are no error: pages come back by themselves."""

    def filter(self, record: logging.LogRecord) -> bool:
        cut = record.exc_info is not None and isinstance(record.exc_info[1], asyncio.CancelledError)
        return not cut and not str(record.msg).startswith("Cancel ")


class PatientHttp(HttpToolsProtocol):
    """HTTP/1.1 that is cut when no whole request has come within ``HEAD_S``, or an answer is not read in time; a head
    of more than ``LARGEST_HEAD`` is refused."""

    _timer: asyncio.TimerHandle | None = None
    _in_head, _head = True, 0  # bytes that came since it began

    def connection_made(self, transport: asyncio.Transport) -> None:  # type: ignore[override]
        super().connection_made(transport)
        self._cut_after(HEAD_S)

    def data_received(self, data: bytes) -> None:
        self._head += len(data)
        super().data_received(data)
        upgraded = self.transport.get_protocol() is not self
        if self._in_head and self._head > LARGEST_HEAD and not upgraded:
            self.send_400_response("The head of the request is too large.")
        if upgraded or (self.cycle is not None and not self.cycle.response_complete):
            self._leave()
        else:
            self._cut_after(HEAD_S)

    def on_message_begin(self) -> None:
        self._in_head, self._head = True, 0
        super().on_message_begin()

    def on_headers_complete(self) -> None:
        self._in_head = False
        super().on_headers_complete()

    def on_response_complete(self) -> None:
        super().on_response_complete()
        if self.cycle.response_complete:  # no other request is under way already
            self._cut_after(UNREAD_S)

    def pause_writing(self) -> None:
        super().pause_writing()
        self._cut_after(UNREAD_S)

    def resume_writing(self) -> None:
        super().resume_writing()
        self._leave()
        self._cut_after(UNREAD_S)

    def connection_lost(self, exc: Exception | None) -> None:
        self._leave()
        super().connection_lost(exc)

    def _cut_after(self, seconds: float) -> None:
        """At the latest; what comes earlier stays."""
        timer = self.loop.call_later(seconds, self.transport.abort)
        if self._timer is not None and self._timer.when() <= timer.when():
            timer.cancel()
            return
        self._leave()
        self._timer = timer

    def _leave(self) -> None:
        if self._timer is not None:
            self._timer.cancel()
            self._timer = None


def _counting() -> type[PatientHttp]:
    """Return the protocol of a server that cuts what an address opens beyond ``MOST_OF_ADDRESS``, before it is read."""
    opened: Counter[str] = Counter()

    class Counted(PatientHttp):
        _address: str | None = None  # that is counted

        def connection_made(self, transport: asyncio.Transport) -> None:  # type: ignore[override]
            super().connection_made(transport)
            address = str((transport.get_extra_info("peername") or ("",))[0])
            if opened[address] >= MOST_OF_ADDRESS:
                transport.abort()
                return
            self._address = address
            opened[address] += 1

        def data_received(self, data: bytes) -> None:
            super().data_received(data)
            if self.transport.get_protocol() is not self:  # a WebSocket now, which the gate counts
                self._count_down()

        def connection_lost(self, exc: Exception | None) -> None:
            self._count_down()
            super().connection_lost(exc)

        def _count_down(self) -> None:
            if self._address is not None:
                opened[self._address] -= 1
                if not opened[self._address]:
                    del opened[self._address]
            self._address = None

    return Counted


class PatientSocket(WebSocketsSansIOProtocol):
    """A WebSocket whose other end gets no answers to its pings while it does not read, and is cut if it is silent."""

    def handle_ping(self) -> None:
        if self.writable.is_set():
            super().handle_ping()
        else:
            self.conn.data_to_send()  # thrown away: answers that nobody reads would pile up

    def keepalive_timeout(self) -> None:
        super().keepalive_timeout()
        self.transport.abort()  # closing would wait until everything is read
