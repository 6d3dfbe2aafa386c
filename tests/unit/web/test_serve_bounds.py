"""What the page server takes from somebody who asks without end, and says when it ends itself."""

from __future__ import annotations

import asyncio
import logging
import socket
from collections.abc import Iterator
from contextlib import suppress

import pytest
from web_rig import Page, served

from bench.web import serving

CUT_S = 30.0  # the test waits no longer


@pytest.fixture(scope="module")
def page(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Page]:
    with served(tmp_path_factory.mktemp("page")) as found:
        yield found


def test_a_page_that_is_cut_at_the_end_leaves_no_traceback(page: Page, caplog: pytest.LogCaptureFixture) -> None:
    uvicorn = logging.getLogger("uvicorn.error")
    for error in (asyncio.CancelledError(), OSError("something else")):
        uvicorn.error("Exception in ASGI application", exc_info=error)
    assert [str(record.exc_info[1]) for record in caplog.records if record.exc_info] == ["something else"]


def test_a_head_without_end_is_refused(page: Page) -> None:
    with socket.create_connection(("127.0.0.1", page.port), CUT_S) as stream:
        stream.sendall(b"GET / HTTP/1.1\r\nX-Long: ")
        sent = 0
        with suppress(OSError):
            while sent < 100 * serving.LARGEST_HEAD:
                sent += stream.send(b"x" * 4096)
        assert sent < 100 * serving.LARGEST_HEAD, "it does not take for ever what has no end"
    assert page.ask("GET", "/").status == 401
