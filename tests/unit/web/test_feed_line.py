"""The feed asked on the event loop: what the blocking client understands, and no answer is taken for another one's."""

from __future__ import annotations

import asyncio
import struct
from collections.abc import Awaitable, Callable
from pathlib import Path

import numpy as np
import pytest

from bench.run.control.local_socket import LIVE, socket_path
from bench.run.feed.client import FeedClient, FeedGone, FeedReply
from bench.run.feed.points import PointBatch
from bench.run.feed.server import FeedServer
from bench.web.live import FeedLine

HEAD = {"proto": 1, "boot_id": "0123456789abcdef", "signals": 2}
Answer = Callable[[int, asyncio.StreamReader, asyncio.StreamWriter], Awaitable[None]]


def points(since: int) -> PointBatch:
    return PointBatch(10, 7, 3, np.arange(3, dtype="<f8").tobytes() + np.arange(12, dtype="<f4").tobytes())


def served(folder: Path) -> FeedServer:
    return FeedServer(socket_path(folder, LIVE), HEAD, lambda: {"state": "running"}, points)


def polled(line: FeedLine, *questions: tuple[int, bool]) -> list[FeedReply]:
    async def ask() -> list[FeedReply]:
        replies = [await line.poll(since, state) for since, state in questions]
        line.close()
        return replies

    return asyncio.run(ask())


def test_the_same_as_the_blocking_client(tmp_path: Path) -> None:
    server = served(tmp_path)
    client = FeedClient(tmp_path)
    expected = [client.poll(7), client.poll(9, state=False)]
    found = polled(FeedLine(tmp_path), (7, True), (9, False))
    client.close()
    server.close()
    assert [reply.header for reply in found] == [reply.header for reply in expected]
    assert [reply.packed for reply in found] == [reply.packed for reply in expected]
    assert "state" not in found[1].header


def test_nobody_answers_and_then_another_process_does(tmp_path: Path) -> None:
    async def ask() -> None:
        line = FeedLine(tmp_path)
        with pytest.raises(FeedGone, match="No such file"):
            await line.poll(0)
        for _ in range(2):  # the second answers at the same place, where the connection of the first is still kept
            server = served(tmp_path)
            assert (await line.poll(0)).header["n"] == 3
            server.close()
        with pytest.raises(FeedGone):
            await line.poll(0)

    asyncio.run(ask())


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
        with pytest.raises(FeedGone) as caught:
            await line.poll(0)
        assert caught.value.code == "B-RUN-100"

    asyncio.run(with_answers(tmp_path, answer, task))
