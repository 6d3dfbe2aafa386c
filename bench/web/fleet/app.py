"""The fleet page as an application: one page, one socket, the history; no route of it commands anything."""

from __future__ import annotations

from collections.abc import AsyncIterator, Iterable
from contextlib import asynccontextmanager

from starlette.applications import Starlette
from starlette.exceptions import HTTPException
from starlette.middleware import Middleware
from starlette.routing import Route, WebSocketRoute
from starlette.websockets import WebSocket

from bench.model.errors import BenchError
from bench.web import pages
from bench.web.app import on_bench_error, on_http_error
from bench.web.fleet.calibrated import Calibrated
from bench.web.fleet.fleet import Fleet
from bench.web.fleet.fleet_file import FleetBench
from bench.web.room import Viewer
from bench.web.security import login
from bench.web.security.gate import Gate
from bench.web.serving import Serving
from bench.web.socket import serve_viewer


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

    app = Starlette(
        routes=[
            Route("/", pages.fleet),
            Route("/login", login.login, methods=["GET", "POST"]),
            Route("/logout", login.logout, methods=["POST"]),
            Route("/static/{file}", pages.static),
            Route("/api/v1/session", login.session),
            Route("/api/v1/texts", pages.texts),
            Route("/api/v1/calibrations", calibrated.calibrations),
            Route("/api/v1/due", calibrated.due),
            WebSocketRoute("/ws", _socket),
        ],
        middleware=[Middleware(Gate, serving=serving)],
        exception_handlers={BenchError: on_bench_error, HTTPException: on_http_error},
        lifespan=lifespan,
    )
    app.router.redirect_slashes = False  # a redirect would name the path again
    app.state.serving = serving
    app.state.fleet = fleet
    return app


async def _socket(websocket: WebSocket) -> None:
    """``WS /ws``: one open fleet page."""
    await websocket.accept()
    fleet: Fleet = websocket.app.state.fleet
    viewer = Viewer(websocket.scope["user"].role)
    async with fleet.watching(viewer):
        await serve_viewer(websocket, viewer, fleet)
