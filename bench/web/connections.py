"""Connections that do not wait for ever: what somebody can hold open is bounded before it is known who it is.

uvicorn ends a connection that is silent after an answer, but waits without end for the first request, for one that
comes byte by byte, and for somebody who does not read; its limit of connections would then shut out everybody else.
"""

from __future__ import annotations

import asyncio

from uvicorn.protocols.http.h11_impl import H11Protocol
from uvicorn.protocols.websockets.websockets_sansio_impl import WebSocketsSansIOProtocol

HEAD_S = 10.0  # for the head of a request, however it drips
UNREAD_S = 120.0  # for an answer to be taken


class PatientHttp(H11Protocol):
    """HTTP/1.1 that is cut when no whole request has come within ``HEAD_S``, or an answer is not read in time."""

    _timer: asyncio.TimerHandle | None = None

    def connection_made(self, transport: asyncio.Transport) -> None:  # type: ignore[override]
        super().connection_made(transport)
        self._cut_after(HEAD_S)

    def data_received(self, data: bytes) -> None:
        super().data_received(data)
        upgraded = self.transport.get_protocol() is not self
        if upgraded or (self.cycle is not None and not self.cycle.response_complete):
            self._leave()
        else:
            self._cut_after(HEAD_S)

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
