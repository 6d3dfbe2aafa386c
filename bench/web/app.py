"""The page server as an application: its routes in one table, its gate, and the hub that lives as long as it does."""

from __future__ import annotations

import asyncio
import json
from collections.abc import AsyncIterator, Awaitable, Callable, Sequence
from contextlib import asynccontextmanager, suppress
from typing import Any

from starlette.applications import Starlette
from starlette.exceptions import HTTPException
from starlette.middleware import Middleware
from starlette.requests import Request
from starlette.responses import Response
from starlette.routing import BaseRoute, Route, WebSocketRoute
from starlette.types import Lifespan
from starlette.websockets import WebSocket, WebSocketDisconnect

from bench.model.errors import BenchError
from bench.web import pages, runs
from bench.web.hub import Hub, Watched
from bench.web.live import end_tasks
from bench.web.recorded.listing import FILES, run_folder
from bench.web.room import Viewer
from bench.web.security import login
from bench.web.security.gate import Gate
from bench.web.security.refusal import Refusal, refusal_of
from bench.web.serving import Serving
from bench.web.telemetry import Lookout, Scrapes

_Handler = Callable[[Request], Awaitable[Response]]


def create_app(serving: Serving, tell: Callable[[Lookout], Awaitable[None]] | None = None) -> Starlette:
    """Return the application of one server; ``app.state`` holds ``serving``, ``hub`` and ``lookout``.

    Args: tell: tells others of the runs for as long as the server serves.
    """
    hub = Hub(serving)
    lookout = Lookout(hub)

    @asynccontextmanager
    async def lifespan(app: Starlette) -> AsyncIterator[None]:
        del app
        await hub.start()
        telling = None if tell is None else asyncio.ensure_future(tell(lookout))
        try:
            yield
        finally:
            if telling is not None:
                await end_tasks(telling)
            await lookout.stop()
            await hub.stop()

    app = guarded_app(serving, _routes(Scrapes(lookout)), lifespan)
    app.state.hub = hub
    app.state.lookout = lookout
    return app


def guarded_app(serving: Serving, routes: Sequence[BaseRoute], lifespan: Lifespan[Starlette]) -> Starlette:
    """Return an application behind the gate, whose ``app.state`` holds ``serving``, with what every page needs."""
    common = [
        Route("/login", login.login, methods=["GET", "POST"]),
        Route("/logout", login.logout, methods=["POST"]),
        Route("/static/{file}", pages.static),
        Route("/api/v1/session", login.session),
        Route("/api/v1/texts", pages.texts),
    ]
    app = Starlette(
        routes=[*common, *routes],
        middleware=[Middleware(Gate, serving=serving)],
        exception_handlers={BenchError: on_bench_error, HTTPException: on_http_error},
        lifespan=lifespan,
    )
    app.router.redirect_slashes = False  # a redirect would name the path again
    app.state.serving = serving
    return app


async def on_bench_error(request: Request, error: Exception) -> Response:
    """Answer what a route refused."""
    return pages.refused(request, refusal_of(error))


async def on_http_error(request: Request, error: Exception) -> Response:
    """Answer where there is no route, or not with this method."""
    assert isinstance(error, HTTPException)
    return pages.refused(request, Refusal(error.status_code, "B-WEB-013", "there is no such page"))


def _routes(scrapes: Scrapes) -> list[BaseRoute]:
    """Return paths, methods and who answers; docs/live-protocol.md."""
    return [
        Route("/metrics", scrapes.answer),
        Route("/", pages.index),
        Route("/runs/{run}", _of_a_run(pages.run_page)),
        Route("/bokeh/{file}", pages.bokeh),
        Route("/api/v1/runs", runs.runs),
        Route("/api/v1/runs/{run}", _of_a_run(runs.run)),
        Route("/api/v1/runs/{run}/history", _of_a_run(runs.history)),
        Route("/api/v1/runs/{run}/figures", _of_a_run(runs.figures)),
        *(Route(f"/api/v1/runs/{{run}}/{name}", _of_a_run(runs.file_of(name))) for name in FILES),
        Route("/api/v1/calibrations", runs.calibrations),
        Route("/api/v1/commands", runs.commands, methods=["POST"]),
        Route("/api/v1/operator", runs.operator, methods=["POST"]),
        WebSocketRoute("/ws", socket),
    ]


def _of_a_run(handler: _Handler) -> _Handler:
    """Let a handler see only names of sessions that are there."""

    async def checked(request: Request) -> Response:
        if run_folder(request.app.state.serving.out, request.path_params["run"]) is None:
            raise Refusal(404, "B-WEB-013", "there is no such run", next_step="the first page lists them")
        return await handler(request)

    return checked


NO_SUCH_RUN = 4404
TOO_SLOW = 4408  # has not taken a single message for so long that nobody can be there
LONGEST_SEND_S = 120.0
GONE = (WebSocketDisconnect, RuntimeError)  # the page, or the server's own watch of its pings, has closed it meanwhile


async def socket(websocket: WebSocket) -> None:
    """Serve one page until it goes away; the gate has let it in."""
    hub: Hub = websocket.app.state.hub
    try:
        await websocket.accept()
        viewer = Viewer(websocket.scope["user"].role)
        async with hub.watching(websocket.query_params.get("run", ""), viewer) as watched:
            await serve_viewer(websocket, viewer, watched)
    except BenchError as error:
        with suppress(*GONE):
            await websocket.close(NO_SUCH_RUN, error.code)


async def serve_viewer(websocket: WebSocket, viewer: Viewer, watched: Watched) -> None:
    """Until one of both ends: what the page says, and what it is sent."""
    tasks = [
        asyncio.create_task(_listen(websocket, viewer, watched)),
        asyncio.create_task(_send(websocket, viewer, watched)),
    ]
    try:
        done, _ = await asyncio.wait(tasks, return_when=asyncio.FIRST_COMPLETED)
        for task in done:
            task.result()
    finally:
        await end_tasks(*tasks)


async def _send(websocket: WebSocket, viewer: Viewer, watched: Watched) -> None:
    while True:
        await viewer.wait()
        if viewer.stale:
            viewer.start(watched.room.snapshot(viewer))
        message = viewer.take()
        if message is None:
            continue
        try:
            async with asyncio.timeout(LONGEST_SEND_S):
                await (websocket.send_text(message) if isinstance(message, str) else websocket.send_bytes(message))
        except TimeoutError:
            with suppress(Exception):
                await asyncio.wait_for(websocket.close(TOO_SLOW, "too slow"), 0.1)
            return
        except GONE:
            return


async def _listen(websocket: WebSocket, viewer: Viewer, watched: Watched) -> None:
    with suppress(WebSocketDisconnect):
        while True:
            try:
                said: Any = json.loads(await websocket.receive_text())
            except (ValueError, KeyError, RecursionError):  # no JSON, or no text
                continue
            if not isinstance(said, dict):
                continue
            if said.get("type") == "snapshot":
                viewer.ask_snapshot()
            elif said.get("type") == "replay":
                await watched.move(said)
