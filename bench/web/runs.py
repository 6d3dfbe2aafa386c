"""Answers to a page over HTTP: runs, the state of one, history, report, calibrations; what people want of a run.

Commands are passed on to the run, which decides. Nothing is done twice: the reply to an id is kept, and a second
request with it, even while the first is under way, gets the same one. Every attempt goes to the audit.
"""

from __future__ import annotations

import asyncio
import json
import os
from collections.abc import Awaitable, Callable
from pathlib import Path
from typing import Any

from starlette.requests import Request
from starlette.responses import JSONResponse, Response

from bench.model.errors import BenchError
from bench.model.posix import unix_connection
from bench.run.control.local_socket import find_socket
from bench.session.history import chosen_url
from bench.web.command_request import Command, command_of, json_object, taken
from bench.web.hub import Hub
from bench.web.recorded.listing import FILES, content_of, run_folder
from bench.web.recorded.past import history_query
from bench.web.security.logins import Login
from bench.web.security.refusal import Refusal
from bench.web.serving import Serving

ANSWER_S = 5.0
LONGEST_REPLY = 1 << 20


async def commands(request: Request) -> Response:
    """Pass a command on to the control socket of its run, and its reply back."""
    serving: Serving = request.app.state.serving
    who: Login = request.user
    wanted = await json_object(request)
    try:
        _only_operators(who)
        command = command_of(wanted)
        sent = serving.sent.known(who, command)
        if sent is None:
            folder = _permitted(serving, who, command)
            task = asyncio.create_task(_pass_on(serving, who, request.scope["address"], folder, command))
            serving.sent.keep(who, command, task)
        else:
            task = sent.reply
    except Refusal as refusal:
        _audit(serving, request, wanted, refusal)
        raise
    # shielded: a page that goes away does not stop what it has asked for
    return JSONResponse({"id": command.id, **await asyncio.shield(task)})


async def operator(request: Request) -> Response:
    """Take the command or give it up; whoever has had it is named."""
    serving: Serving = request.app.state.serving
    who: Login = request.user
    wanted = await json_object(request)
    try:
        _only_operators(who)
        take = taken(wanted)
    except Refusal as refusal:
        _audit(serving, request, {"command": "operator", "reason": str(wanted.get("take"))}, refusal)
        raise
    if take:
        before = serving.lease.take(who)
        text = f"taken from {before.login.name}" if before else "you have the command"
    else:
        text = "given up" if serving.lease.leave(who) else "it was not yours"
    serving.audit.write("operator", **_person(who, request.scope["address"]), take=take, ok=True, text=text)
    return JSONResponse({"ok": True, "text": text, "operator": serving.lease.document()})


async def _pass_on(serving: Serving, who: Login, address: str, folder: Path, command: Command) -> dict[str, Any]:
    reply = {"ok": False, "text": "the page server was stopped before the run answered"}
    try:
        by = f"{who.name}, {who.role}, {address}"
        answer = await _ask_run(folder, {**command.words, "by": by, "place": who.place})
        reply = {"ok": answer.get("ok") is True, "text": str(answer.get("text") or answer.get("error") or "")}
    except _NoAnswer as silent:
        doubt = "; whether it heard the command is not known" if silent.sent else ""
        reply = {"ok": False, "error": "B-WEB-018", "text": f"no answer: {silent}{doubt}"}
    finally:
        serving.audit.write(
            "command",
            **_person(who, address),
            command=command.name,
            run=command.run,
            id=command.id,
            reason=command.reason,
            **{key: value for key, value in command.words.items() if key in ("alarm", "prompt", "value")},
            **{key: reply[key] for key in ("ok", "text")},
        )
    return reply


def _only_operators(who: Login) -> None:
    if not who.may_command:
        advice = "log in with the operator's token"
        raise Refusal(403, "B-WEB-015", "you may look, but not command", next_step=advice)


def _permitted(serving: Serving, who: Login, command: Command) -> Path:
    holder = serving.lease.holder()
    if holder is None or holder.login.id != who.id:
        whose = "nobody has the command" if holder is None else f"{holder.login.name} has the command"
        raise Refusal(409, "B-WEB-016", whose, next_step="take it on the page first")
    folder = run_folder(serving.out, command.run)
    if folder is None:
        raise Refusal(404, "B-WEB-013", "there is no such run")
    return folder


def _person(who: Login, address: str) -> dict[str, str]:
    return {"name": who.name, "role": who.role, "address": address}


def _audit(serving: Serving, request: Request, wanted: dict[str, Any], refusal: Refusal) -> None:
    asked = {key: str(wanted.get(key, ""))[:200] for key in ("command", "run", "id", "reason")}
    person = _person(request.user, request.scope["address"])
    serving.audit.write("command", **person, **asked, ok=False, text=f"{refusal.code}: {refusal.message}")


class _NoAnswer(Exception):
    """Nobody is there, or whoever is there said nothing that is understood; ``sent``: the run may have heard it."""

    def __init__(self, why: str, sent: bool) -> None:
        super().__init__(why)
        self.sent = sent


async def _ask_run(folder: Path, request: dict[str, Any]) -> dict[str, Any]:
    """Send one request to the run of a session and return its reply. Raises: _NoAnswer after 5 s at most."""
    sent = False
    try:
        async with asyncio.timeout(ANSWER_S):
            reader, writer = await unix_connection(find_socket(folder), LONGEST_REPLY)
            try:
                writer.write(json.dumps(request, ensure_ascii=False).encode() + b"\n")
                sent = True
                reply = json.loads(await reader.readline())
            finally:
                writer.close()
    except TimeoutError as error:
        raise _NoAnswer(f"nothing came within {ANSWER_S:g} s", sent) from error
    except (FileNotFoundError, ConnectionRefusedError) as error:
        raise _NoAnswer("no run of this session is alive", sent) from error
    except (OSError, ValueError) as error:
        raise _NoAnswer(getattr(error, "strerror", None) or "the reply is none", sent) from error
    return reply if isinstance(reply, dict) else {}


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
