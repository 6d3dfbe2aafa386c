"""``WS /ws?run=``: one open page. What it is sent is docs/live-protocol.md; what it may say is two words."""

from __future__ import annotations

import asyncio
import json
from contextlib import suppress
from typing import Any

from starlette.websockets import WebSocket, WebSocketDisconnect

from bench.model.errors import BenchError
from bench.web.hub import Hub, Watched
from bench.web.live import end_tasks
from bench.web.room import Viewer

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
