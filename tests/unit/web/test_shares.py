"""What one address may hold open of a page server: connections, and pages."""

from __future__ import annotations

import asyncio
import socket
from pathlib import Path

import pytest
from starlette.types import Receive, Scope, Send
from test_serve import CUT_S, is_cut, opened, until, whole
from web_rig import served

from bench.web import serving
from bench.web.security import gate
from bench.web.security.gate import Gate
from bench.web.security.tokens import OPERATOR, VIEWER


def test_an_address_holds_no_more_connections_than_its_share_and_the_next_one_waits_for_none(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(serving, "MOST_OF_ADDRESS", 3)
    with served(tmp_path) as page:
        place = ("127.0.0.1", page.port)
        held = [socket.create_connection(place, CUT_S) for _ in range(3)]
        for stream in held:
            stream.sendall(whole(page))
            assert stream.recv(12) == b"HTTP/1.1 401"
        with socket.create_connection(place, CUT_S) as beyond:
            assert is_cut(beyond)
        with socket.create_connection(place, CUT_S, source_address=("127.0.0.2", 0)) as other:
            other.sendall(whole(page))
            assert other.recv(12) == b"HTTP/1.1 401"
        held.pop().close()
        until(lambda: page.ask("GET", "/").status == 401)
        for stream in held:
            stream.close()


def test_pages_that_come_and_go_leave_no_connection_counted(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(serving, "MOST_OF_ADDRESS", 2)
    with served(tmp_path) as page:
        for _ in range(5):
            assert page.close_code(page.cookie(VIEWER), origin=page.origin) == 4404  # there is no such run
        assert page.ask("GET", "/").status == 401


def test_an_address_has_no_more_pages_than_its_share_b_web_023(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(gate, "MOST_OF_ADDRESS", 2)
    with served(tmp_path) as page:
        pass
    headers = {"Host": f"127.0.0.1:{page.port}", "Origin": page.origin, **page.cookie(OPERATOR)}

    async def crowd() -> list[bool]:
        over = asyncio.Event()

        async def route(scope: Scope, receive: Receive, send: Send) -> None:
            await over.wait()

        one = Gate(route, page.serving)
        pages = [await opened(one, headers, over) for _ in range(3)]
        refused = [bool(sent) for _, sent in pages]
        over.set()
        await asyncio.gather(*(task for task, _ in pages))
        over.clear()
        again, sent = await opened(one, headers, over)
        refused.append(bool(sent))
        over.set()
        await again
        return refused

    assert asyncio.run(crowd()) == [False, False, True, False]
