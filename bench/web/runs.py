"""What a page asks for by HTTP: runs, the state of one, history, report, calibrations."""

from __future__ import annotations

from pathlib import Path
from typing import Any

from starlette.requests import Request
from starlette.responses import JSONResponse, Response

from bench.web.calibrations import calibration_rows
from bench.web.history_query import history_query
from bench.web.hub import Hub
from bench.web.refusal import Refusal


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


async def report(request: Request) -> Response:
    """``GET /api/v1/runs/{run}/report``: report.html of the session."""
    hub, name = _hub(request), request.path_params["run"]
    content = await hub.work(_content, hub.folder(name) / "report.html")
    if content is None:
        raise Refusal(404, "B-WEB-021", f"{name} has no report", next_step=f"'bench report {name}' writes one")
    return Response(content, media_type="text/html")


async def calibrations(request: Request) -> Response:
    """``GET /api/v1/calibrations``: the calibration history, newest first."""
    hub = _hub(request)
    rows: list[dict[str, Any]] = await hub.work(calibration_rows, hub.serving.history, hub.serving.out)
    return JSONResponse({"calibrations": rows})


def _hub(request: Request) -> Hub:
    hub: Hub = request.app.state.hub
    return hub


def _content(path: Path) -> bytes | None:
    try:
        return None if path.is_symlink() else path.read_bytes()
    except OSError:
        return None
