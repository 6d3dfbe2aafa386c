"""The line to one bench: a WebSocket to its ``bench serve``, or looks at the folder of its sessions.

A line never ends: what breaks is said at the seat, and tried again after a pause that doubles, with a spread by the
name of the bench so that benches behind one router do not come back in one moment.
"""

from __future__ import annotations

import asyncio
import json
import logging
import ssl
from dataclasses import dataclass
from pathlib import Path
from typing import NoReturn
from zlib import crc32

from websockets.asyncio.client import ClientConnection, connect
from websockets.exceptions import ConnectionClosed, InvalidStatus, WebSocketException

from bench.model.clock import Clock, pause
from bench.web.fleet.fleet_file import FleetBench
from bench.web.fleet.overview import LOOK_S, Overview
from bench.web.fleet.seat import (
    FOREIGN,
    MISNAMED,
    REFUSED,
    SILENT,
    SILENT_S,
    UNREACHED,
    UNTRUSTED,
    NotUnderstood,
    Seat,
)
from bench.web.hub import Hub
from bench.web.security.gate import OVERVIEW
from bench.web.telemetry import Lookout

OPEN_S = 4.0
FIRST_RETRY_S, LONGEST_RETRY_S = 0.5, 15.0
REFUSED_RETRY_S = 60.0  # a wrong token is not tried as often: its bench would shut this address out
LARGEST_MESSAGE = 262_144
MOST_WAITING = 2  # messages
_CLOSED = {4401: REFUSED, 4403: MISNAMED}
_ADVICE = {
    REFUSED: "its server refuses the token; it wants its viewer's token, as 'bench serve' of that bench printed it",
    UNTRUSTED: "its certificate is not trusted; SSL_CERT_FILE names those of a laboratory's own authority",
    MISNAMED: "its server is not reached by this name and port; use the address that 'bench serve' there prints",
    FOREIGN: "its server tells no overview of its runs; it needs the same version of inertial-bench",
}

log = logging.getLogger(__name__)


class _Direct(connect):
    """No redirect is followed: what answers elsewhere is another bench."""

    def process_redirect(self, exc: Exception) -> Exception | str:
        return exc


class ServerLine:
    """The line to a server, as one task."""

    def __init__(self, seat: Seat, trusted: ssl.SSLContext) -> None:
        self._seat = seat
        self._bench = seat.bench
        self._trusted = trusted if self._bench.url.startswith("https:") else None
        self._tries = 0
        self._told = ""  # reason that stands in the log
        self._retry_s = FIRST_RETRY_S

    async def follow(self) -> None:
        """Listen until it is cancelled."""
        await pause(FIRST_RETRY_S * self._spread())
        while True:
            why = await self._listened()
            self._seat.lose(why)
            if why in _ADVICE and why != self._told:
                log.error("%s: bench %s: %s", self._bench.where, self._bench.name, _ADVICE[why])
            self._told = why
            await pause((REFUSED_RETRY_S if why == REFUSED else self._retry_s) * (0.75 + 0.5 * self._spread()))
            self._retry_s = min(2 * self._retry_s, LONGEST_RETRY_S)

    def _spread(self) -> float:
        """Return a number from 0 to 1, another one for each bench and try."""
        self._tries += 1
        return crc32(f"{self._bench.name} {self._tries}".encode()) / 2**32

    async def _listened(self) -> str:
        """Listen as long as it is heard; returns why no longer."""
        connection: ClientConnection | None = None
        try:
            connection = await self._open()
            await self._listen(connection)
        except TimeoutError:
            return UNREACHED if connection is None else SILENT
        except ConnectionClosed as closed:
            return UNREACHED if closed.rcvd is None else _CLOSED.get(closed.rcvd.code, UNREACHED)
        except ssl.SSLCertVerificationError:
            return UNTRUSTED
        except InvalidStatus as answer:
            return FOREIGN if answer.response.status_code in (403, 404) else UNREACHED
        except (NotUnderstood, json.JSONDecodeError, UnicodeDecodeError, RecursionError):
            return FOREIGN
        except (OSError, WebSocketException):
            return UNREACHED
        finally:
            if connection is not None:
                connection.transport.abort()  # closing would wait for an end that may not be there

    async def _open(self) -> ClientConnection:
        return await _Direct(
            f"ws{self._bench.url.removeprefix('http')}{OVERVIEW}",
            origin=self._bench.url,  # type: ignore[arg-type]
            additional_headers={"Authorization": f"Bearer {self._bench.token}"},
            ssl=self._trusted,
            proxy=None,
            compression=None,
            open_timeout=OPEN_S,
            ping_interval=None,  # silence is judged by heartbeats
            max_size=LARGEST_MESSAGE,
            max_queue=MOST_WAITING,
        )

    async def _listen(self, connection: ClientConnection) -> NoReturn:
        while True:
            async with asyncio.timeout(SILENT_S):
                message = await connection.recv()
            if isinstance(message, bytes):
                continue  # points, of which there are none
            heard = json.loads(message)
            kind = heard.get("type") if isinstance(heard, dict) else None
            if kind == "snapshot":
                self._seat.hear(heard.get("state"))
                self._retry_s, self._told = FIRST_RETRY_S, ""
            elif kind == "heartbeat":
                self._seat.beat()


@dataclass(frozen=True)
class _Folder:
    """A server's hub for a folder that no server shows."""

    out: Path
    clock: Clock
    history: str | None = None


class FolderLine:
    """Looks at a folder of sessions on this machine, as one task."""

    def __init__(self, seat: Seat, clock: Clock) -> None:
        assert seat.bench.folder is not None
        self._seat = seat
        self._hub = Hub(_Folder(seat.bench.folder, clock))
        self._overview = Overview(self._hub, Lookout(self._hub))

    async def follow(self) -> None:
        """Look each second until it is cancelled."""
        try:
            while True:
                document = await self._overview.look()
                if document is None:
                    self._seat.lose(UNREACHED)
                else:
                    self._seat.hear(document)
                await pause(LOOK_S)
        finally:
            await self._hub.stop()


def line_of(bench: FleetBench, seat: Seat, clock: Clock, trusted: ssl.SSLContext) -> ServerLine | FolderLine:
    """Return the line to a bench, not yet open."""
    return ServerLine(seat, trusted) if bench.folder is None else FolderLine(seat, clock)
