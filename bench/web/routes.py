"""Every route of the page server, in one table."""

from __future__ import annotations

from collections.abc import Awaitable, Callable

from starlette.requests import Request
from starlette.responses import Response
from starlette.routing import BaseRoute, Route, WebSocketRoute

from bench.web import assets, commands, pages, runs
from bench.web.places import run_folder
from bench.web.security import login
from bench.web.security.refusal import Refusal
from bench.web.socket import socket

Handler = Callable[[Request], Awaitable[Response]]


def routes() -> list[BaseRoute]:
    """Return paths, methods and who answers; docs/live-protocol.md."""
    return [
        Route("/", pages.index),
        Route("/runs/{run}", of_a_run(pages.run_page)),
        Route("/login", login.login, methods=["GET", "POST"]),
        Route("/logout", login.logout, methods=["POST"]),
        Route("/static/{file}", assets.static),
        Route("/bokeh/{file}", assets.bokeh),
        Route("/api/v1/session", login.session),
        Route("/api/v1/texts", pages.texts),
        Route("/api/v1/runs", runs.runs),
        Route("/api/v1/runs/{run}", of_a_run(runs.run)),
        Route("/api/v1/runs/{run}/history", of_a_run(runs.history)),
        Route("/api/v1/runs/{run}/figures", of_a_run(runs.figures)),
        Route("/api/v1/runs/{run}/report", of_a_run(runs.report)),
        Route("/api/v1/calibrations", runs.calibrations),
        Route("/api/v1/commands", commands.commands, methods=["POST"]),
        Route("/api/v1/operator", commands.operator, methods=["POST"]),
        WebSocketRoute("/ws", socket),
    ]


def of_a_run(handler: Handler) -> Handler:
    """Let a handler see only names of sessions that are there."""

    async def checked(request: Request) -> Response:
        if run_folder(request.app.state.serving.out, request.path_params["run"]) is None:
            raise Refusal(404, "B-WEB-013", "there is no such run", next_step="the first page lists them")
        return await handler(request)

    return checked
