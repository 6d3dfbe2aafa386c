"""The fleet page as an application: one page, one socket, the history; no route of it commands anything."""

from __future__ import annotations

from collections.abc import AsyncIterator, Iterable
from contextlib import asynccontextmanager

from starlette.applications import Starlette
from starlette.routing import Route, WebSocketRoute
from starlette.websockets import WebSocket

from bench.web import pages
from bench.web.app import guarded_app
from bench.web.fleet.calibrated import Calibrated
from bench.web.fleet.fleet import Fleet
from bench.web.fleet.fleet_file import FleetBench
from bench.web.serving import Serving
from bench.web.socket import serve_page


def create_fleet_app(serving: Serving, benches: Iterable[FleetBench]) -> Starlette:
    """Return the application of one fleet page; ``app.state`` holds ``serving`` and ``fleet``.

    Args: serving: its ``history`` is the URL of the history that is shown, None for none.
    """
    fleet = Fleet(benches, serving.clock)
    calibrated = Calibrated(serving.history, serving.clock)

    @asynccontextmanager
    async def lifespan(app: Starlette) -> AsyncIterator[None]:
        del app
        await fleet.start()
        try:
            yield
        finally:
            await fleet.stop()
            calibrated.stop()

    routes = [
        Route("/", pages.fleet),
        Route("/api/v1/calibrations", calibrated.calibrations),
        Route("/api/v1/due", calibrated.due),
        WebSocketRoute("/ws", _socket),
    ]
    app = guarded_app(serving, routes, lifespan)
    app.state.fleet = fleet
    return app


async def _socket(websocket: WebSocket) -> None:
    """``WS /ws``: one open fleet page."""
    await serve_page(websocket, websocket.app.state.fleet.watching)
