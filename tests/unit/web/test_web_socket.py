"""A page that goes away while something is sent to it: no error of the server, and no traceback in its log."""

from __future__ import annotations

import asyncio
import logging
from contextlib import asynccontextmanager
from types import SimpleNamespace
from typing import Any

import pytest
from starlette.websockets import WebSocketDisconnect

from bench.model.errors import InputError
from bench.web import socket as served_socket


class Gone:
    """A socket whose other end is closed at the first message; ``error`` is what sending says then."""

    def __init__(self, hub: Any, error: Exception) -> None:
        self.app = SimpleNamespace(state=SimpleNamespace(hub=hub))
        self.scope, self.query_params = {"user": SimpleNamespace(role="viewer")}, {"run": "one"}
        self._error = error
        self.sent = 0

    async def accept(self) -> None:
        return None

    async def send_text(self, message: str) -> None:
        self.sent += 1
        raise self._error

    send_bytes = send_text

    async def receive_text(self) -> str:
        await asyncio.Event().wait()
        return ""

    async def close(self, code: int, reason: str) -> None:
        await self.send_text(reason)


class Hub:
    """One run with a snapshot; or ``error`` instead."""

    def __init__(self, error: Exception | None = None) -> None:
        self._error = error

    @asynccontextmanager
    async def watching(self, run: str, viewer: Any) -> Any:
        if self._error is not None:
            raise self._error
        viewer.ask_snapshot()
        yield SimpleNamespace(room=SimpleNamespace(snapshot=lambda viewer: ["state"]))


ERRORS = [
    WebSocketDisconnect(1006),
    RuntimeError(
        "Unexpected ASGI message 'websocket.send', after sending 'websocket.close' or response already completed"
    ),
]


@pytest.mark.parametrize("error", ERRORS, ids=["disconnected", "closed already"])
@pytest.mark.parametrize("hub", [Hub(), Hub(InputError("B-WEB-013", "there is no such run"))], ids=["run", "none"])
def test_a_page_that_goes_away_while_it_is_sent_to(
    hub: Hub, error: Exception, caplog: pytest.LogCaptureFixture
) -> None:
    page = Gone(hub, error)
    with caplog.at_level(logging.DEBUG):
        asyncio.run(asyncio.wait_for(served_socket.socket(page), 10.0))  # type: ignore[arg-type]
    assert page.sent == 1
    assert [record for record in caplog.records if record.exc_info] == []
