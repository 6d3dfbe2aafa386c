"""What a page asks for by HTTP: runs, the state of one, history, report, calibrations."""

from __future__ import annotations

from pathlib import Path
from typing import Any

from starlette.requests import Request
from starlette.responses import JSONResponse, Response

from bench.web.hub import Hub
from bench.web.places import content_of
from bench.web.recorded.history_query import history_query
from bench.web.security.refusal import Refusal


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
    """``GET /api/v1/runs/{run}/figures``: Bokeh figures of what the run measures, empty."""
    hub = _hub(request)
    state = await hub.document(request.path_params["run"])
    return JSONResponse(await hub.work(_figures, state))


async def report(request: Request) -> Response:
    """``GET /api/v1/runs/{run}/report``: report.html of the session."""
    hub, name = _hub(request), request.path_params["run"]
    content = await hub.work(content_of, hub.folder(name) / "report.html")
    if content is None:
        raise Refusal(404, "B-WEB-021", f"{name} has no report", next_step=f"'bench report {name}' writes one")
    return Response(content, media_type="text/html")


async def calibrations(request: Request) -> Response:
    """``GET /api/v1/calibrations``: the calibration history, newest first."""
    hub = _hub(request)
    rows: list[dict[str, Any]] = await hub.work(_calibrations, hub.serving.history, hub.serving.out)
    return JSONResponse({"calibrations": rows})


def _hub(request: Request) -> Hub:
    hub: Hub = request.app.state.hub
    return hub


def _figures(state: dict[str, Any]) -> dict[str, Any]:
    from bench.web.figures import run_figures  # Bokeh takes a second to import: the server listens before

    return run_figures(state)


def _calibrations(history: str | None, out: Path) -> list[dict[str, Any]]:
    from bench.web.recorded.calibrations import calibration_rows  # and so does SQLAlchemy

    return calibration_rows(history, out)
