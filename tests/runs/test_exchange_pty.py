"""Commands over a real pseudo-terminal whose frames are damaged in both directions, under the wall clock.

The board is made for the test (exchange_rig); every 20th frame, on the average, has one flipped bit, its length bytes
among them. Nothing may be done twice, nothing may be answered wrongly, and what is not completed says so.
"""

import os
import pty
import select
import threading
import tty
from collections.abc import Iterator
from contextlib import contextmanager
from functools import partial

import numpy as np
import pytest
from exchange_rig import MEMORY, SCI, Board, context_of, events, unit_step

from bench.model.clock import NS, WallClock
from bench.run.bench.opener import open_port
from bench.run.links.port import PortLink
from bench.run.steps.dispatch import execute

pytestmark = pytest.mark.waits

SEED = 11
DAMAGED = 0.05
IN_LENGTH = 0.2  # of the damaged frames at least: the worst place
BAUD = 921_600
TIMEOUT_S = 0.2  # of the frame definition


class Damage:
    """Flips one bit of some frames; ``in_length`` counts those whose length it falsified."""

    def __init__(self, seed: int) -> None:
        self._rng = np.random.default_rng(seed)
        self.frames = self.flipped = self.in_length = 0

    def __call__(self, frame: bytes) -> bytes:
        self.frames += 1
        if self._rng.random() >= DAMAGED:
            return frame
        at, bit = int(self._rng.integers(len(frame))), int(self._rng.integers(8))
        if self._rng.random() < IN_LENGTH:
            at = int(self._rng.integers(8, 10))
        self.flipped += 1
        self.in_length += at in (8, 9)
        return frame[:at] + bytes([frame[at] ^ 1 << bit]) + frame[at + 1 :]


class DamagedPort:
    """The host's port, its frames damaged on the way out."""

    def __init__(self, port: object, damage: Damage) -> None:
        self._port, self._damage = port, damage

    def write(self, frame: bytes) -> int:
        return len(frame) if self._port.write(self._damage(frame)) == len(frame) else -1  # type: ignore[attr-defined]

    def __getattr__(self, name: str) -> object:
        return getattr(self._port, name)


@contextmanager
def served(board: Board, damage: Damage, clock: WallClock) -> Iterator[str]:
    """The board behind a terminal, on a thread of its own; the terminal's name."""
    far, near = pty.openpty()
    tty.setraw(near)
    ended = threading.Event()

    def serve() -> None:
        while not ended.is_set():
            if not select.select([far], [], [], 0.05)[0]:
                continue
            for answer in board.take(os.read(far, 65_536), clock.now_ns()):
                os.write(far, damage(answer))

    thread = threading.Thread(target=serve)
    thread.start()
    try:
        yield os.ttyname(near)
    finally:
        ended.set()
        thread.join()
        os.close(near)
        os.close(far)


@pytest.mark.limit(TIMEOUT_S)
@pytest.mark.parametrize("total", [300, pytest.param(2000, marks=pytest.mark.sweep)])
def test_exchanges_with_damaged_frames(total: int) -> None:
    clock, board = WallClock(), Board()
    there, back = Damage(SEED), Damage(SEED + 1)
    with served(board, back, clock) as name:
        port = PortLink(partial(open_port, "rs422", name, BAUD, exclusive=True))
        context = context_of(clock, DamagedPort(port, there))  # type: ignore[arg-type]
        began_ns, sent = clock.now_ns(), []
        rng = np.random.default_rng(SEED)
        for number in range(total):
            sent.append(number.to_bytes(4, "little") + rng.bytes(int(rng.integers(0, 60))))
            code = MEMORY if number % 2 else SCI
            execute(context, unit_step(number, "echo", code, sent[-1], "echo", timeout=TIMEOUT_S))
        seconds = (clock.now_ns() - began_ns) / NS
        context.acquisition.stop()
        context.acquisition.readers["rs422"].link.close()
    told = events(context, "exchange")
    completed = [one for one in told if one["status"] == 0]
    reported = [one for one in told if one["status"] is None]
    retried = sum(one["attempts"] > 1 for one in told)
    print(
        f"seed {SEED}: {total} exchanges, {there.flipped + back.flipped} of {there.frames + back.frames} frames "
        f"damaged ({there.in_length + back.in_length} in the length), {retried} retried, {board.repeated} answered "
        f"from memory, {len(completed)} completed, {len(reported)} reported, {seconds:.1f} s"
    )
    assert len(told) == total == len(completed) + len(reported)
    assert all(one["received"] == one["sent"] == sent[one["step"]].hex() for one in completed)
    assert max(board.done.values()) == 1, "a command was done twice"
    assert {payload for (code, payload) in board.done if code in (SCI, MEMORY)} <= set(sent)
    assert len(reported) <= 3 + total // 200  # three attempts fail one time in a thousand
    assert retried > total // 50
    assert board.repeated > 0
