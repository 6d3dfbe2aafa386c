"""The feed's socket: the protocol byte by byte, and that no client can hold a run up or grow its memory."""

import errno
import json
import math
import socket
import stat
import struct
import threading
from collections.abc import Callable, Iterator
from contextlib import contextmanager, suppress
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
from run_rig import HoldRig
from waiting import until

from bench.frame import LinkCounts
from bench.model.clock import WallClock
from bench.model.errors import ExitStatus
from bench.model.events import Phase, Reentry
from bench.run.control import live as served_by
from bench.run.control.client import FeedClient, FeedGone
from bench.run.control.live import LONGEST_LINE, FeedServer, links_of, live_feed
from bench.run.control.local_socket import LIVE, MOST_CLIENTS, ControlServer, socket_path
from bench.run.feed.points import PointBatch

WAIT_S = 20.0
HEAD = {"proto": 1, "boot_id": "0123456789abcdef", "signals": 2}
CLOCK = WallClock()


def three_points(since: int) -> PointBatch:
    times = struct.pack("<3d", 1.0, 1.1, 1.2)
    return PointBatch(10, 7, 3, times + struct.pack("<12f", *range(11), math.nan))


@contextmanager
def served(
    folder: Path,
    state: Callable[[], dict[str, Any]] = lambda: {"state": "running"},
    points: Callable[[int], PointBatch] = three_points,
) -> Iterator[FeedServer]:
    server = FeedServer(socket_path(folder, LIVE), HEAD, state, points)
    try:
        yield server
    finally:
        server.close()


def connected(folder: Path) -> socket.socket:
    client = socket.socket(socket.AF_UNIX, socket.SOCK_STREAM)
    client.settimeout(WAIT_S)
    client.connect(str(folder / "live.sock"))
    return client


def exactly(client: socket.socket, count: int) -> bytes:
    received = b""
    while len(received) < count:
        chunk = client.recv(count - len(received))
        assert chunk, "closed"
        received += chunk
    return received


def reply_of(client: socket.socket) -> tuple[dict[str, Any], bytes]:
    """By the words of docs/live-protocol.md."""
    header, points = struct.unpack("<II", exactly(client, 8))
    return json.loads(exactly(client, header)), exactly(client, points)


def test_jumps_of_a_counter_stand_beside_the_lost_frames() -> None:
    decoder = SimpleNamespace(counts=LinkCounts(frames=5, lost=2, jumps=3))
    reader = SimpleNamespace(decoder=decoder, rate_Hz=100.0, lost="unplugged", last_frame_ns=-1)
    seen = SimpleNamespace(readers={"port_a": reader})
    context: Any = SimpleNamespace(health=SimpleNamespace(values=dict), clock=CLOCK, acquisition=seen)
    link = links_of(context, 0)["port_a"]
    assert (link["frames"], link["lost"], link["jumps"]) == (5, 2, 3)


def test_a_reply_byte_by_byte(tmp_path: Path) -> None:
    with served(tmp_path), connected(tmp_path) as client:
        client.sendall(b'{"since": 7, "state": true}\n')
        header, points = reply_of(client)
        assert header == {**HEAD, "seq": 10, "first": 7, "n": 3, "state": {"state": "running"}}
        assert struct.unpack_from("<3d", points) == (1.0, 1.1, 1.2)
        assert struct.unpack_from("<12f", points, 24)[:11] == tuple(range(11))
        assert len(points) == 3 * 8 + 3 * 2 * 2 * 4
        client.sendall(b'{"since": 10, "state": false}\n{"since": 10}\n')
        for _ in range(2):
            assert "state" not in reply_of(client)[0]
        assert stat.S_IMODE((tmp_path / "live.sock").stat().st_mode) == 0o600


def test_the_client_understands_it_and_goes_on_after_a_broken_connection(tmp_path: Path) -> None:
    client = FeedClient(tmp_path)
    with served(tmp_path):
        reply = client.poll(0)
        assert (reply.header["seq"], reply.header["state"]) == (10, {"state": "running"})
        assert reply.t_utc_s.tolist() == [1.0, 1.1, 1.2]
        assert reply.low[:, 0].tolist() == [0.0, 4.0, 8.0]
        assert reply.high[:2, 1].tolist() == [3.0, 7.0]
        assert np.isnan(reply.high[2, 1])
        assert len(reply.packed) == 72
    with served(tmp_path):  # another process of the run answers at the same place
        assert client.poll(0, state=False).header["n"] == 3
    client.close()


def test_nobody_answers(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    with pytest.raises(FeedGone) as caught:
        FeedClient(tmp_path).poll(0)
    assert caught.value.code == "B-RUN-100"
    assert caught.value.exit_status == ExitStatus.BAD_INPUT
    with socket.socket(socket.AF_UNIX, socket.SOCK_STREAM) as mute:
        mute.bind(str(tmp_path / "live.sock"))
        mute.listen(1)
        with pytest.raises(FeedGone, match="timed out"):
            FeedClient(tmp_path, answer_s=0.1).poll(0)


REPLY = {"boot_id": "0", "first": 0, "n": 0, "signals": 0, "seq": 0, "state": {}}
WRONG = {"boot_id": None, "first": -1, "n": -1, "signals": True, "seq": "1", "state": None, "proto": 2}
NO_REPLIES = [b"[]", b"{}", b"{", b"[" * 30_000, json.dumps({**REPLY, "n": 3}).encode()] + [
    json.dumps({**REPLY, key: value}).encode() for key, value in WRONG.items()
]


@contextmanager
def answering(folder: Path, header: bytes) -> Iterator[FeedClient]:
    """Somebody at the place of a feed who says one thing once."""
    with socket.socket(socket.AF_UNIX, socket.SOCK_STREAM) as other:
        other.bind(str(folder / "live.sock"))
        other.listen(1)

        def answer() -> None:
            connection, _ = other.accept()
            with connection:
                connection.recv(100)
                connection.sendall(struct.pack("<II", len(header), 0) + header)

        thread = threading.Thread(target=answer)
        thread.start()
        yield FeedClient(folder)
        thread.join(WAIT_S)


@pytest.mark.parametrize("header", [json.dumps(REPLY).encode(), *NO_REPLIES], ids=range(1 + len(NO_REPLIES)))
def test_the_least_that_is_a_reply_and_what_is_none(tmp_path: Path, header: bytes) -> None:
    with answering(tmp_path, header) as client:
        if header in NO_REPLIES:
            with pytest.raises(FeedGone):
                client.poll(0)
        else:
            assert client.poll(0).header["state"] == {}
            client.close()


@pytest.mark.parametrize(
    "line",
    [
        b"null\n", b"17\n", b"{\n", b"\xff\xfe\n", b"[" * 3000 + b"\n", b'{"since": "x"}\n', b'{"since": true}\n',
        b'{"since": 1.5}\n', b'{"state": 1}\n', b"x" * (2 * LONGEST_LINE),
    ],
)  # fmt: skip
def test_what_is_no_request_ends_the_connection(tmp_path: Path, line: bytes) -> None:
    with served(tmp_path), connected(tmp_path) as client:
        client.sendall(line)
        with suppress(ConnectionResetError):
            assert client.recv(10) == b""


def test_one_that_asks_and_never_reads_is_dropped_and_the_others_are_served(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(FeedServer, "idle_s", 0.5)
    large = PointBatch(10, 0, 0, b"\0" * 5_000_000)
    with (
        served(tmp_path, points=lambda since: large if since else three_points(0)) as server,
        connected(tmp_path) as greedy,
        connected(tmp_path) as honest,
    ):
        greedy.sendall(b'{"since": 1}\n' * 50)
        until(lambda: any(len(client.out) > 0 for client in server._clients))
        for _ in range(5):
            honest.sendall(b'{"since": 0}\n')
            assert reply_of(honest)[0]["n"] == 3
            assert sum(len(client.out) for client in server._clients) <= 5_001_000  # one reply, never more
        until(lambda: len(server._clients) <= 1)


def test_one_that_asks_wildly_waits_and_one_that_says_nothing_goes(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(FeedServer, "gap_s", 0.01)
    asked: list[int] = []
    states: list[int] = []

    def state() -> dict[str, Any]:
        states.append(1)
        return {"state": "running"}

    def points(since: int) -> PointBatch:
        asked.append(CLOCK.now_ns())
        return three_points(since)

    with served(tmp_path, state, points), connected(tmp_path) as wild:
        wild.sendall(b'{"since": 0, "state": true}\n' * 40)
        for _ in range(40):
            reply_of(wild)
    late_ns = np.array(asked) - asked[0] - np.arange(40) * 10_000_000  # a moment noted late makes the next seem early
    assert min(late_ns) >= -1_000_000
    assert min(np.diff(asked)) >= 4_000_000
    assert len(states) < 40  # one document serves for a while
    monkeypatch.setattr(FeedServer, "idle_s", 0.1)
    with served(tmp_path) as server, connected(tmp_path) as silent:
        assert silent.recv(10) == b""
        until(lambda: server._clients == [])


def test_an_error_of_the_run_is_no_reply_and_numbers_that_are_not_finite_become_null(tmp_path: Path) -> None:
    states = iter([math.inf, math.inf, math.inf, math.nan])

    def state() -> dict[str, Any]:
        rate_Hz = next(states)
        return {"rate_Hz": rate_Hz} if math.isnan(rate_Hz) else {"error": 1 / 0}

    with served(tmp_path, state):
        for _ in range(3):
            with connected(tmp_path) as client:
                client.sendall(b'{"since": 0, "state": true}\n')
                assert client.recv(10) == b""
        with connected(tmp_path) as client:
            client.sendall(b'{"since": 0}\n{"state": true}\n')
            assert reply_of(client)[0]["n"] == 3
            assert reply_of(client)[0]["state"] == {"rate_Hz": None}


def test_a_hundred_clients_leave_nothing_behind(tmp_path: Path) -> None:
    before = threading.active_count()
    with served(tmp_path) as server:
        clients = [connected(tmp_path) for _ in range(100)]
        until(lambda: len(server._clients) == MOST_CLIENTS)
        assert threading.active_count() <= before + 1
        with connected(tmp_path) as honest:
            honest.sendall(b'{"since": 0}\n')
            assert reply_of(honest)[0]["n"] == 3
        for client in clients:
            client.close()
    assert threading.active_count() <= before


@pytest.fixture
def watched(tmp_path: Path) -> tuple[HoldRig, Any]:
    """The fake run, with what the feed needs to know of its plan."""
    rig = HoldRig(tmp_path, 1)
    context: Any = rig.context()
    context.folder = tmp_path
    context.manifest = {"session": "20000101T000000Z_x_1", "campaign": {}}
    file = SimpleNamespace(graphs=[])
    context.plan.interlocks = ()
    context.plan.station = SimpleNamespace(safe_order=(), file=file, instruments={}, guard_limits_degC={})
    return rig, context


@pytest.mark.parametrize("kind", ["feed", "control"])
def test_without_descriptors_it_does_not_spin(tmp_path: Path, monkeypatch: pytest.MonkeyPatch, kind: str) -> None:
    tried = []

    def accept(_: socket.socket) -> None:
        tried.append(1)
        raise OSError(errno.EMFILE, "too many open files")

    monkeypatch.setattr(socket.socket, "accept", accept)
    path = socket_path(tmp_path, LIVE)
    server = FeedServer(path, HEAD, dict, three_points) if kind == "feed" else ControlServer(path, lambda *_: {}, CLOCK)
    with connected(tmp_path):
        until(lambda: len(tried) > 1)
        before = len(tried)
        CLOCK.sleep(0.5)
        assert len(tried) - before < 20, "a thread that spins holds up the run"
    server.close()


def test_a_run_that_cannot_be_watched_runs(watched: tuple[HoldRig, Any], monkeypatch: pytest.MonkeyPatch) -> None:
    def refused(folder: Path, what: str) -> Path:
        raise PermissionError("belongs to somebody else")

    monkeypatch.setattr("bench.run.control.live.socket_path", refused)
    rig, context = watched
    with live_feed(context):
        assert any("nobody can watch this run" in text for text in rig.listener.messages)


def test_an_error_inside_the_feed_is_said_once_and_is_no_concern_of_the_run(
    tmp_path: Path, watched: tuple[HoldRig, Any]
) -> None:
    rig, context = watched
    with live_feed(context) as feed:
        client = FeedClient(tmp_path)
        assert client.poll(0).header["state"]["state"] == "starting"
        assert client.poll(0, state=False).header["n"] == 0
        feed.state = None  # type: ignore[assignment]
        for _ in range(3):
            context.event(Phase(name="campaign", t_start_ns=0))
        context.observers.step(rig.steps[0], 0.0)
        assert [text for text in rig.listener.messages if "any more" in text] == [
            "nobody can watch this run any more (AttributeError: 'NoneType' object has no attribute 'on_event'); "
            "the run goes on"
        ]
        CLOCK.sleep(served_by.STATE_S * 1.5)
        with pytest.raises(FeedGone):
            client.poll(0)
    assert len(rig.events("phase")) == 3
    assert not (tmp_path / "live.sock").exists()


def test_the_set_point_of_a_run_that_came_back_is_a_point(watched: tuple[HoldRig, Any]) -> None:
    _, context = watched
    with live_feed(context) as feed:
        context.event(Reentry(step=0, target_degC=50.0, unit_degC=23.0, soaked=False, seconds=1.0))
        context.event(Reentry(step=0, target_degC=None, unit_degC=23.0, soaked=False, seconds=1.0))
        assert [value for _, value in feed.points._changes["setpoint"]] == [50.0]
        assert not feed.broken
