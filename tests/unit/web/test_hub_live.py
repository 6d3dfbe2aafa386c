"""A living run on a page: a feed made from the protocol document, a real server, a client of its own."""

import asyncio
import json
import socket
import struct
from collections.abc import Awaitable, Callable, Iterator
from contextlib import ExitStack, contextmanager, suppress
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import waiting
from record_sample import write_sample
from top_sample import NAMES, T0, FeedStandIn
from web_rig import RUN, Page, served
from websockets.exceptions import ConnectionClosed
from websockets.sync.client import ClientConnection, connect

from bench.analysis import estimate
from bench.model.clock import WallClock
from bench.record import OPEN_MARKER
from bench.run.control.client import FeedGone
from bench.run.control.local_socket import LIVE, socket_path
from bench.web import live
from bench.web.live import FeedLine, LiveRun
from bench.web.security import gate
from bench.web.security.tokens import OPERATOR, VIEWER


@pytest.fixture
def page(tmp_path: Path) -> Iterator[Page]:
    with served(tmp_path) as found:
        yield found


@pytest.fixture
def feed(page: Page) -> Iterator[FeedStandIn]:
    folder = page.serving.out / RUN
    (folder / OPEN_MARKER).touch()
    stand_in = FeedStandIn(folder)
    stand_in.made = 1000
    yield stand_in
    stand_in.close()


@contextmanager
def watching(page: Page, role: str = VIEWER, run: str = RUN, login_id: str = "") -> Iterator[ClientConnection]:
    url = f"ws://127.0.0.1:{page.port}/ws?run={run}"
    headers = page.cookie(role, login_id=login_id)
    with connect(url, origin=page.origin, additional_headers=headers, proxy=None) as connection:  # type: ignore[arg-type]
        yield connection


def until(connection: ClientConnection, kind: str) -> Any:
    """The next message of a kind: text by its type, or a binary batch."""
    while True:
        message = connection.recv(timeout=10)
        if isinstance(message, bytes):
            if kind == "batch":
                return message
        elif json.loads(message)["type"] == kind:
            return json.loads(message)


def unpacked(batch: bytes, signals: int = len(NAMES)) -> tuple[int, int, np.ndarray[Any, Any], np.ndarray[Any, Any]]:
    first, count, flags = struct.unpack_from("<IHH", batch)
    times = np.frombuffer(batch, "<f8", count, 8)
    return first, flags, times, np.frombuffer(batch, "<f4", offset=8 + 8 * count).reshape(count, signals, 2)


def test_a_page_gets_state_and_the_last_minute_then_what_is_new(page: Page, feed: FeedStandIn) -> None:
    with watching(page) as connection:
        snapshot = until(connection, "snapshot")
        assert snapshot["points"] == {"first": 400, "n": 600}
        assert (snapshot["state"]["state"], snapshot["state"]["role"]) == ("running", "viewer")
        assert snapshot["state"]["title"] == feed.state["title"]
        first, flags, times, pairs = unpacked(until(connection, "batch"))
        assert (first, flags, len(times)) == (400, 0, 600)
        assert np.allclose(times, T0 + np.arange(400, 1000) / 10)
        assert np.array_equal(pairs[0, 3], [403, 404])
        feed.made += 7
        first, flags, times, pairs = unpacked(until(connection, "batch"))
        assert (first, flags, len(times)) == (1000, 0, 7)
        assert np.array_equal(pairs[-1, 0], [1006, 1007])
        feed.state = {**feed.state, "state": "holding", "progress": 0.2, "holds": {"operator": "tea"}, "step": None}
        delta = until(connection, "delta")
        assert delta["seq"] == snapshot["seq"] + 1
        assert delta["patch"] == {"state": "holding", "progress": 0.2, "holds": {"operator": "tea"}, "step": None}
        beat = until(connection, "heartbeat")
        assert 0 <= beat["age_s"] < 3
        feed.made += 5000  # points that are gone are flagged
        first, flags, times, _ = unpacked(until(connection, "batch"))
        assert (first, flags, len(times)) == (5407, 1, 600)


def test_another_process_that_answers_begins_with_a_snapshot(page: Page, feed: FeedStandIn) -> None:
    with watching(page) as connection:
        until(connection, "batch")
        feed.state = {**feed.state, "boot_id": "f" * 16, "state": "starting"}
        feed.made = 30
        snapshot = until(connection, "snapshot")
        assert snapshot["state"]["boot_id"] == "f" * 16
        assert snapshot["points"] == {"first": 0, "n": 30}


def test_a_page_may_ask_for_a_snapshot_and_says_nothing_else_that_matters(page: Page, feed: FeedStandIn) -> None:
    with watching(page) as connection:
        until(connection, "snapshot")
        for nonsense in ("[]", "{", '{"type": "replay", "speed": 10}', '{"type": 1}', "null"):
            connection.send(nonsense)
        connection.send(b"\0\1")
        connection.send(json.dumps({"type": "snapshot"}))
        assert until(connection, "snapshot")["state"]["state"] == "running"
    assert feed.state["state"] == "running"


def test_many_pages_cost_the_run_one_question(page: Page, feed: FeedStandIn) -> None:
    with watching(page) as one, watching(page, "operator") as two, watching(page) as three:
        for connection in (one, two, three):
            assert until(connection, "snapshot")["points"]["n"] == 600
        assert page.serving.lease._open == {"kim-operator": 1, "kim-viewer": 2}, "an open page keeps the command"
        asked = [request["since"] for request in feed.asked]
        assert asked.count(0) == 1, "all look at the same room"
        assert sum(request["state"] for request in feed.asked) < len(feed.asked) / 2 + 2


def test_a_run_that_does_not_answer_is_lost_and_found_again(
    page: Page, feed: FeedStandIn, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(live, "LOST_S", 0.5)
    with watching(page) as connection:
        until(connection, "snapshot")
        feed.close()
        delta = until(connection, "delta")
        lost = delta["patch"]
        assert (lost["state"], lost["attention"], lost["bench"]["state"]) == ("lost", "much", "unknown")
        assert until(connection, "heartbeat")["age_s"] > 0.5
        again = FeedStandIn(page.serving.out / RUN)
        again.made = 1000
        try:
            assert until(connection, "delta")["patch"]["state"] == "running"
        finally:
            again.close()


def test_a_run_whose_recording_is_closed_has_ended(page: Page, feed: FeedStandIn) -> None:
    with watching(page) as connection:
        until(connection, "snapshot")
        (page.serving.out / RUN / OPEN_MARKER).unlink()
        feed.close()
        assert until(connection, "delta")["patch"]["state"] == "ended"


def test_results_that_come_after_the_end_take_the_place_of_those_so_far(tmp_path: Path) -> None:
    """A run writes them some time after its recording is closed."""
    results: list[dict[str, Any]] = []

    async def gone(since: int, state: bool) -> Any:
        raise AssertionError((since, state))

    async def final() -> dict[str, Any]:
        return {"state": "ended", "estimates": results[0] if results else None}

    async def retries() -> list[Any]:
        live = LiveRun(tmp_path, gone, WallClock(), lambda: {"operator": None, "estimates": {"records": 3}}, final)
        seen = []
        for number in range(4):
            if number == 2:
                results.append({"records": 7, "final": True})
            await live._missed()
            seen.append(live.room.state["estimates"]["records"])
        return seen

    assert asyncio.run(retries()) == [3, 3, 7, 7]


def test_a_replay_has_the_results_of_the_session(page: Page) -> None:
    folder = page.serving.out / "20000101T000000Z_sample_1"
    write_sample(folder)
    row = estimate("dsf_n", "ppm", 3.0, 1.0, {"channel": 1, "unit_temperature_degC": 20.0}, n=3).document
    (folder / "results.json").write_text(
        json.dumps({"campaign": "scale_factor", "estimates": [row], "quality": {"records": 7}})
    )
    with watching(page, run=folder.name) as connection:
        state = until(connection, "snapshot")["state"]
    assert (state["source"], state["estimates"]["records"], state["estimates"]["final"]) == ("replay", 7, True)
    (shown_row,) = state["estimates"]["rows"]
    assert (shown_row["value"], shown_row["conditions"]) == (3.0, {"channel": 1})
    assert shown_row["titles"]["ko"] == "환산계수 오차 N"
    assert shown_row["history"][0][:3] == [7, 3.0, 1.0]


def test_a_frozen_page_keeps_no_more_than_its_queue_and_begins_anew(page: Page, feed: FeedStandIn) -> None:
    url = f"ws://127.0.0.1:{page.port}/ws?run={RUN}"
    narrow = socket.socket()
    narrow.setsockopt(socket.SOL_SOCKET, socket.SO_RCVBUF, 65_536)
    narrow.connect(("127.0.0.1", page.port))
    with connect(
        url, origin=page.origin, additional_headers=page.cookie("viewer"), proxy=None, sock=narrow, max_queue=1,  # type: ignore[arg-type]
        max_size=None, ping_interval=None,
    ) as connection:  # fmt: skip
        until(connection, "snapshot")
        (viewer,) = page.app.state.hub._live[RUN].room.viewers
        for number in range(300):
            feed.made += 1
            feed.state = {**feed.state, "log": [{"t_utc_s": T0, "kind": "reading", "text": f"{number}" * 700_000}]}
            WallClock().sleep(0.05)
            if viewer.dropped:
                break
        assert viewer.dropped == 1
        assert viewer.stale, "nothing waits for it but a snapshot"
        feed.state = {**feed.state, "log": []}
        until(connection, "snapshot")
        assert until(connection, "heartbeat")["age_s"] < 3


def test_the_list_and_the_document_show_a_living_run(page: Page, feed: FeedStandIn) -> None:
    listed = page.ask("GET", "/api/v1/runs", page.cookie("viewer")).json["runs"]
    assert [(row["run"], row["state"], row["live"]) for row in listed] == [(RUN, "running", True)]
    assert listed[0]["records"] == {"done": 3, "planned": 9}
    state = page.ask("GET", f"/api/v1/runs/{RUN}", page.cookie("operator")).json
    assert (state["role"], state["progress"], state["operator"]) == ("operator", 0.1, None)
    page.post("/api/v1/operator", "operator", {"take": True})
    assert page.ask("GET", f"/api/v1/runs/{RUN}", page.cookie("viewer")).json["operator"]["name"] == "kim"
    feed.state = {"state": "running", "signals": [], "boot_id": "x"}  # of a run of another version
    row = page.ask("GET", "/api/v1/runs", page.cookie("viewer")).json["runs"][0]
    assert (row["state"], row["records"]["done"]) == ("running", None)
    feed.close()
    assert page.ask("GET", "/api/v1/runs", page.cookie("viewer")).json["runs"][0]["state"] == "stopped"


def closed_with(connection: ClientConnection) -> tuple[int, str]:
    """Return code and reason, behind all that was sent before; nothing else would ever close it."""
    with pytest.raises(ConnectionClosed) as closed:
        until(connection, "never")
    return closed.value.rcvd.code, closed.value.rcvd.reason


@pytest.mark.parametrize("role", [VIEWER, OPERATOR])
def test_a_logout_closes_every_socket_of_its_login_and_none_of_somebody_else(
    page: Page, feed: FeedStandIn, role: str
) -> None:
    with (
        watching(page, role, login_id="own") as one,
        watching(page, role, login_id="own") as two,
        watching(page, role, login_id="another") as other,
    ):
        for connection in (one, two, other):
            until(connection, "snapshot")
        assert page.post("/logout", role, {}, login_id="own").status == 200
        assert [closed_with(connection) for connection in (one, two)] == [(4401, "B-WEB-008")] * 2
        other.send(json.dumps({"type": "snapshot"}))
        until(other, "snapshot")
        assert page.close_code(page.cookie(role, login_id="own"), RUN, page.origin) == 4401
        assert page.post("/logout", role, {}, login_id="another").status == 200
        assert closed_with(other) == (4401, "B-WEB-008")


OPEN, FULL = (None, None), (4429, "B-WEB-023")


def shown(page: Page, roles: list[str]) -> list[tuple[int | None, str | None]]:
    """Return how pages that these open one behind the other, and keep open, are closed; all are gone then."""
    with ExitStack() as kept:
        found = []
        for role in roles:
            connection = kept.enter_context(watching(page, role))
            with suppress(ConnectionClosed):
                until(connection, "snapshot")
            found.append((connection.close_code, connection.close_reason))
    waiting.until(lambda: not +page.serving.lease._open, "all are gone")
    return found


def test_viewers_leave_room_for_operators_and_an_address_has_its_share_b_web_023(
    page: Page, feed: FeedStandIn, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(gate, "MOST_SOCKETS", 5)
    monkeypatch.setattr(gate, "KEPT_FOR_OPERATORS", 2)
    for _ in range(2):  # those that have gone make room
        assert shown(page, [VIEWER] * 4 + [OPERATOR] * 3) == [OPEN] * 3 + [FULL] + [OPEN] * 2 + [FULL]
    monkeypatch.setattr(gate, "MOST_OF_ADDRESS", 2)
    assert shown(page, [OPERATOR] * 3) == [OPEN, OPEN, FULL]


def test_whoever_logs_out_while_a_page_opens_sees_nothing(page: Page, feed: FeedStandIn) -> None:
    """The gate asks once more behind the opening: a login that has ended by then is closed before its snapshot."""
    entered = page.app.state.hub.watching

    def slow(run: str, viewer: object) -> object:
        page.serving.logged_out.add(page.serving.cookies.read(page.cookie(VIEWER)["Cookie"]))  # type: ignore[arg-type]
        return entered(run, viewer)

    page.app.state.hub.watching = slow
    assert page.close_code(page.cookie(VIEWER), RUN, page.origin) == 4401


Answer = Callable[[int, asyncio.StreamReader, asyncio.StreamWriter], Awaitable[None]]


async def with_answers(folder: Path, answer: Answer, task: Callable[[FeedLine], Awaitable[None]]) -> None:
    """Somebody at the place of a feed, who answers by the number of the connection."""
    count = 0

    async def take(reader: asyncio.StreamReader, writer: asyncio.StreamWriter) -> None:
        nonlocal count
        count += 1
        await answer(count, reader, writer)
        writer.close()
        await writer.wait_closed()

    server = await asyncio.start_unix_server(take, socket_path(folder, LIVE))
    line = FeedLine(folder, answer_s=0.3)
    try:
        await task(line)
    finally:
        line.close()
        server.close()
        await server.wait_closed()


def reply(seq: int) -> bytes:
    header = b'{"boot_id":"0","first":0,"n":0,"signals":0,"seq":%d,"state":{}}' % seq
    return struct.pack("<II", len(header), 0) + header


def test_a_late_answer_is_not_taken_for_the_next_one(tmp_path: Path) -> None:
    async def answer(count: int, reader: asyncio.StreamReader, writer: asyncio.StreamWriter) -> None:
        await reader.readline()
        if count == 1:  # half of an answer, until whoever asks has no patience left
            writer.write(reply(1)[:20])
            await reader.read()
        else:
            writer.write(reply(2))

    async def task(line: FeedLine) -> None:
        with pytest.raises(FeedGone, match="timed out"):
            await line.poll(0)
        assert (await line.poll(0)).header["seq"] == 2

    asyncio.run(with_answers(tmp_path, answer, task))


@pytest.mark.parametrize(
    "told", [b"", reply(1)[:30], struct.pack("<II", 16_000_001, 0), struct.pack("<II", 1, 0) + b"["]
)
def test_what_is_no_answer(told: bytes, tmp_path: Path) -> None:
    async def answer(count: int, reader: asyncio.StreamReader, writer: asyncio.StreamWriter) -> None:
        await reader.readline()
        writer.write(told)

    async def task(line: FeedLine) -> None:
        with pytest.raises(FeedGone, match="B-RUN-100: "):
            await line.poll(0)

    asyncio.run(with_answers(tmp_path, answer, task))
