"""Answers to a page over HTTP: runs, the state of one, history, report, calibrations."""

from __future__ import annotations

import os
from collections.abc import Awaitable, Callable
from pathlib import Path
from typing import Any

from starlette.requests import Request
from starlette.responses import JSONResponse, Response

from bench.model.errors import BenchError
from bench.session.history import chosen_url
from bench.web.hub import Hub
from bench.web.recorded.listing import FILES, content_of
from bench.web.recorded.past import history_query
from bench.web.security.refusal import Refusal

_NOBODY = "B-STORE-007"  # nobody has calibrated yet
_MEDIA = {
    "report": "text/html",
    "pdf": "application/pdf",
    "certificate": "application/xml",
    "specimen": "application/xml",
}


async def runs(request: Request) -> Response:
    """``GET /api/v1/runs``: living runs and sessions, newest first; ``unread`` of them have no title yet."""
    rows, unread = await _hub(request).listed()
    return JSONResponse({"runs": rows, "unread": unread})


async def run(request: Request) -> Response:
    """``GET /api/v1/runs/{run}``: the state document."""
    state = await _hub(request).document(request.path_params["run"])
    return JSONResponse({**state, "role": request.scope["user"].role})


async def history(request: Request) -> Response:
    """``GET /api/v1/runs/{run}/history``: signals over time, binary."""
    query = history_query(request.query_params)
    window = await _hub(request).history(request.path_params["run"], query)
    return Response(window.to_bytes(), media_type="application/octet-stream")


async def figures(request: Request) -> Response:
    """``GET /api/v1/runs/{run}/figures``: Bokeh figures of what the run measures, empty; of a recording its outline."""
    hub = _hub(request)
    state, early = await hub.outline(request.path_params["run"])
    return JSONResponse({**await hub.work(_figures, state), "outline": state if early else None})


def file_of(what: str) -> Callable[[Request], Awaitable[Response]]:
    """Return the answer to ``GET /api/v1/runs/{run}/<what>``: report, PDF or certificate of a session."""
    file, media_type = FILES[what], _MEDIA[what]

    async def answer(request: Request) -> Response:
        hub, name = _hub(request), request.path_params["run"]
        content = await hub.work(content_of, hub.folder(name) / file)
        if content is None:
            command = "certificate" if what in ("certificate", "specimen") else "report"
            raise Refusal(404, "B-WEB-021", f"{name} has no {file}", next_step=f"'bench {command} {name}' writes one")
        headers = {} if what == "report" else {"Content-Disposition": f'attachment; filename="{name}.{file}"'}
        return Response(content, media_type=media_type, headers=headers)

    return answer


async def calibrations(request: Request) -> Response:
    """``GET /api/v1/calibrations``: the calibration history, newest first."""
    hub = _hub(request)
    rows: list[dict[str, Any]] = await hub.work(calibration_rows, hub.serving.history, hub.serving.out)
    return JSONResponse({"calibrations": rows})


def _hub(request: Request) -> Hub:
    hub: Hub = request.app.state.hub
    return hub


def _figures(state: dict[str, Any]) -> dict[str, Any]:
    from bench.web.figures import run_figures  # Bokeh takes a second to import: the server listens before

    return run_figures(state)


def calibration_rows(history: str | None, out: Path) -> list[dict[str, Any]]:
    """Return calibrations, newest first; empty if there is no history.

    Args: history: its URL; None: BENCH_HISTORY or history.sqlite in ``out``.
    Raises: StoreError B-STORE-001 to B-STORE-005.
    """
    from bench.store import Filters, list_calibrations  # SQLAlchemy takes a while: the server listens before

    try:
        return list_calibrations(chosen_url(history, out, os.environ), Filters())[::-1]
    except BenchError as error:
        if error.code == _NOBODY:
            return []
        raise
