"""The page server as an application: routes, gate, and the hub that lives as long as it does."""

from __future__ import annotations

from collections.abc import AsyncIterator
from contextlib import asynccontextmanager

from starlette.applications import Starlette
from starlette.exceptions import HTTPException
from starlette.middleware import Middleware
from starlette.requests import Request
from starlette.responses import Response

from bench.model.errors import BenchError
from bench.web.hub import Hub
from bench.web.routes import routes
from bench.web.security.gate import Gate
from bench.web.security.refusal import Refusal, on_bench_error
from bench.web.serving import Serving


def create_app(serving: Serving) -> Starlette:
    """Return the application of one server; ``app.state`` holds ``serving`` and ``hub``."""
    hub = Hub(serving)
    hub.lease = serving.lease.document

    @asynccontextmanager
    async def lifespan(app: Starlette) -> AsyncIterator[None]:
        del app
        await hub.start()
        try:
            yield
        finally:
            await hub.stop()

    app = Starlette(
        routes=routes(),
        middleware=[Middleware(Gate, serving=serving)],
        exception_handlers={BenchError: on_bench_error, HTTPException: _on_http_error},
        lifespan=lifespan,
    )
    app.router.redirect_slashes = False  # a redirect would name the path again
    app.state.serving = serving
    app.state.hub = hub
    return app


async def _on_http_error(request: Request, error: Exception) -> Response:
    """No route, or not with this method."""
    del request
    assert isinstance(error, HTTPException)
    return Refusal(error.status_code, "B-WEB-013", "there is no such page").response()
