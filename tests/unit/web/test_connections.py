"""What somebody can hold open before and after logging in, and what it costs the server."""

from __future__ import annotations

import asyncio
import socket
from collections.abc import Callable, Iterator
from typing import Any

import pytest
from starlette.types import Receive, Scope, Send
from uvicorn import Config
from uvicorn.server import ServerState
from web_rig import Page, served
from websockets.frames import Frame, Opcode
from websockets.protocol import State
from websockets.server import ServerProtocol

from bench.model.clock import WallClock
from bench.web import connections
from bench.web.connections import PatientSocket
from bench.web.security import gate
from bench.web.security.gate import Gate
from bench.web.security.tokens import OPERATOR, VIEWER

CUT_S = 30.0  # the test waits no longer


@pytest.fixture(scope="module")
def page(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Page]:
    with served(tmp_path_factory.mktemp("page")) as found:
        yield found


def whole(page: Page) -> bytes:
    return f"GET / HTTP/1.1\r\nHost: 127.0.0.1:{page.port}\r\n\r\n".encode()


def is_cut(stream: socket.socket) -> bool:
    """Wait for the end of a connection; raises TimeoutError if none comes."""
    try:
        while stream.recv(65536):
            pass
    except ConnectionResetError:
        pass
    return True


@pytest.mark.parametrize("begin", [b"", b"G", b"GET / HTTP/1.1\r\nHost: x\r\n", b"answered", b"body"])
def test_a_connection_that_asks_nothing_whole_is_cut(page: Page, monkeypatch: pytest.MonkeyPatch, begin: bytes) -> None:
    monkeypatch.setattr(connections, "HEAD_S", 0.3)
    host = f"Host: 127.0.0.1:{page.port}\r\n".encode()
    known = {
        b"answered": whole(page) + b"GET / HT",  # the second request of a connection that had an answer
        b"body": b"POST /api/v1/commands HTTP/1.1\r\n" + host + b"Content-Length: 60000\r\n\r\n{",  # refused meanwhile
    }
    with socket.create_connection(("127.0.0.1", page.port), CUT_S) as stream:
        stream.sendall(known.get(begin, begin))
        assert is_cut(stream)


def test_a_request_that_drips_is_cut_and_one_that_is_whole_is_answered(
    page: Page, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(connections, "HEAD_S", 0.5)
    with socket.create_connection(("127.0.0.1", page.port), CUT_S) as stream:
        stream.settimeout(0.05)
        sent = 0
        try:
            for _ in range(int(CUT_S / 0.05)):
                stream.sendall(b"X")
                sent += 1
                try:
                    if stream.recv(65536) == b"":
                        break
                except TimeoutError:
                    continue
        except OSError:
            pass
        assert 0 < sent < CUT_S / 0.05, "a byte now and then keeps no connection"
    assert page.ask("GET", "/").status == 401


def test_an_answer_that_takes_long_is_waited_for(page: Page, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(connections, "HEAD_S", 0.1)

    async def slow() -> tuple[list[Any], int]:
        await asyncio.sleep(1.0)
        return [], 0

    monkeypatch.setattr(page.app.state.hub, "listed", slow)
    assert page.ask("GET", "/api/v1/runs", page.cookie(VIEWER)).json == {"runs": [], "unread": 0}


def test_an_answer_that_nobody_reads_is_not_kept_for_ever(page: Page, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(connections, "UNREAD_S", 0.5)
    protocols: list[connections.PatientHttp] = []
    made = connections.PatientHttp.connection_made

    def remembered(self: connections.PatientHttp, transport: Any) -> None:
        made(self, transport)
        protocols.append(self)

    monkeypatch.setattr(connections.PatientHttp, "connection_made", remembered)
    head = "".join(f"{name}: {text}\r\n" for name, text in page.cookie(VIEWER).items())
    with socket.socket() as stream:
        stream.setsockopt(socket.SOL_SOCKET, socket.SO_RCVBUF, 4096)
        stream.connect(("127.0.0.1", page.port))
        ask = f"GET /bokeh/bokeh.min.js HTTP/1.1\r\nHost: 127.0.0.1:{page.port}\r\n{head}\r\n".encode()
        stream.sendall(8 * ask)  # more than the buffers of the system take
        until(lambda: bool(protocols) and protocols[0].transport.get_write_buffer_size() > 0)
        until(lambda: protocols[0] not in protocols[0].connections)


def until(found: Callable[[], bool]) -> None:
    clock = WallClock()
    for _ in range(int(CUT_S / 0.05)):
        if found():
            return
        clock.sleep(0.05)
    raise AssertionError("it did not come")


class Wire:
    """A transport that keeps what is written."""

    def __init__(self) -> None:
        self.written: list[bytes] = []
        self.aborted = False

    def write(self, content: bytes) -> None:
        self.written.append(content)

    def is_closing(self) -> bool:
        return False

    def close(self) -> None:
        """Closing waits for what was written to be read."""

    def abort(self) -> None:
        self.aborted = True


async def pinged(page: Page, *, reads: bool) -> Wire:
    """A WebSocket that has got a thousand pings, and then none of the answers it asked for."""
    config = Config(page.app, log_config=None)
    config.load()
    protocol = PatientSocket(config, ServerState(), {})
    protocol.transport = wire = Wire()  # type: ignore[assignment]
    protocol.conn = ServerProtocol(state=State.OPEN)
    if not reads:
        protocol.pause_writing()
    for _ in range(1000):
        protocol.conn.receive_data(Frame(Opcode.PING, b"x" * 125).serialize(mask=True))
        protocol.handle_events()
    protocol.keepalive_timeout()
    return wire


def test_pings_of_somebody_who_does_not_read_pile_up_nothing(page: Page) -> None:
    wire = asyncio.run(pinged(page, reads=True))
    assert sum(map(len, wire.written)) > 127_000
    wire = asyncio.run(pinged(page, reads=False))
    assert sum(map(len, wire.written)) < 100, "the frame that closes, and no pong"
    assert wire.aborted, "or what was never read would be kept"


async def opened(gate_: Gate, headers: dict[str, str], until: asyncio.Event) -> tuple[asyncio.Task[None], list[Any]]:
    """A WebSocket at the gate that stays open until told, and what it was sent."""
    raw = [(key.lower().encode(), value.encode()) for key, value in headers.items()]
    scope = {"type": "websocket", "path": "/ws", "raw_path": b"/ws", "headers": raw, "client": ("127.0.0.1", 1)}
    sent: list[Any] = []

    async def send(message: Any) -> None:
        sent.append(message)

    async def receive() -> dict[str, str]:
        return {"type": "websocket.connect"}

    task = asyncio.create_task(gate_(scope, receive, send))
    await asyncio.sleep(0)
    return task, sent


def test_viewers_leave_room_for_operators_b_web_023(page: Page, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(gate, "MOST_SOCKETS", 5)
    monkeypatch.setattr(gate, "KEPT_FOR_OPERATORS", 2)
    common = {"Host": f"127.0.0.1:{page.port}", "Origin": page.origin}

    async def crowd() -> list[int]:
        until = asyncio.Event()

        async def route(scope: Scope, receive: Receive, send: Send) -> None:
            await until.wait()

        one = Gate(route, page.serving)
        viewers = [await opened(one, {**common, **page.cookie(VIEWER)}, until) for _ in range(4)]
        operators = [await opened(one, {**common, **page.cookie(OPERATOR)}, until) for _ in range(3)]
        closed = [
            message for _, sent in (*viewers, *operators) for message in sent if message["type"].endswith("close")
        ]
        assert {message["reason"] for message in closed} == {"B-WEB-023"}
        counts = [sum(bool(sent) for _, sent in group) for group in (viewers, operators)]
        until.set()
        await asyncio.gather(*(task for task, _ in (*viewers, *operators)))
        until.clear()
        task, sent = await opened(one, {**common, **page.cookie(VIEWER)}, until)
        assert sent == [], "there is room again"
        until.set()
        await task
        return [*counts, *(message["code"] for message in closed)]

    assert asyncio.run(crowd()) == [1, 1, 4429, 4429]
