"""A logout ends what the login has open: every WebSocket of it is closed at once, and none of somebody else."""

from __future__ import annotations

import json
from collections.abc import Iterator
from contextlib import ExitStack
from pathlib import Path

import pytest
from feed_stand_in import FeedStandIn
from web_rig import RUN, Page, served
from websockets.exceptions import ConnectionClosed
from websockets.sync.client import ClientConnection, connect

from bench.web.security.tokens import OPERATOR, VIEWER

AT_ONCE_S = 10.0  # on a machine with much else to do; nothing else would ever close them


@pytest.fixture
def page(tmp_path: Path) -> Iterator[Page]:
    """A server and a run that goes on."""
    with served(tmp_path) as server:
        feed = FeedStandIn(tmp_path / "sessions" / RUN)
        try:
            yield server
        finally:
            feed.close()


def opened(until: ExitStack, page: Page, role: str, login_id: str) -> ClientConnection:
    """Return a WebSocket that has had its snapshot; it stays open ``until``."""
    headers = page.cookie(role, login_id=login_id)
    url = f"ws://127.0.0.1:{page.port}/ws?run={RUN}"
    connecting = connect(url, origin=page.origin, additional_headers=headers, proxy=None)  # type: ignore[arg-type]
    socket = until.enter_context(connecting)
    assert json.loads(socket.recv(timeout=AT_ONCE_S))["type"] == "snapshot"
    return socket


def _read_on(socket: ClientConnection) -> None:
    while True:
        socket.recv(timeout=AT_ONCE_S)


def closed_with(socket: ClientConnection) -> tuple[int, str]:
    """Return code and reason, behind all that was sent before."""
    with pytest.raises(ConnectionClosed) as closed:
        _read_on(socket)
    assert closed.value.rcvd is not None
    return closed.value.rcvd.code, closed.value.rcvd.reason


@pytest.mark.parametrize("role", [VIEWER, OPERATOR])
def test_a_logout_closes_every_socket_of_its_login(page: Page, role: str) -> None:
    with ExitStack() as until:
        own = [opened(until, page, role, "own") for _ in range(2)]
        others = opened(until, page, role, "another")
        assert page.post("/logout", role, {}, login_id="own").status == 200
        assert [closed_with(socket) for socket in own] == [(4401, "B-WEB-008")] * 2
        others.send(json.dumps({"type": "snapshot"}))
        while (
            json.loads(text if isinstance(text := others.recv(timeout=AT_ONCE_S), str) else "{}").get("type")
            != "snapshot"
        ):
            pass
        assert page.close_code(page.cookie(role, login_id="own"), RUN, page.origin) == 4401
        assert page.post("/logout", role, {}, login_id="another").status == 200
        assert closed_with(others) == (4401, "B-WEB-008")


def test_whoever_logs_out_while_a_page_opens_sees_nothing(page: Page) -> None:
    """The gate asks once more behind the opening: a login that has ended by then is closed before its snapshot."""
    entered = page.app.state.hub.watching

    def slow(run: str, viewer: object) -> object:
        page.serving.logged_out.add(page.serving.cookies.read(page.cookie(VIEWER)["Cookie"]))  # type: ignore[arg-type]
        return entered(run, viewer)

    page.app.state.hub.watching = slow
    assert page.close_code(page.cookie(VIEWER), RUN, page.origin) == 4401
