"""The exchange of a run against the simulated test board, its frames damaged in both directions, on a virtual clock.

The board counts the erases of its FLASH itself: one that is done twice shows in every later answer.
"""

from __future__ import annotations

import struct
from itertools import pairwise

import numpy as np
import pytest
from exchange_rig import MEMORY, SCI, context_of, events, unit_step
from gnc_rig import open_host

from bench.run.steps.dispatch import execute
from sim_instruments.worlds.gnc.board import GncBoard

SEED = 23
DAMAGED = 0.05
SPI_FLASH, ERASE, SECTOR = 2, 1, 4096


class DamagedLine:
    """The board's line; one bit of some frames is flipped, on the way there and back."""

    def __init__(self, board: GncBoard) -> None:
        self._board, self._rng, self.flipped = board, np.random.default_rng(SEED), 0

    def _damaged(self, chunk: bytes) -> bytes:
        if not chunk or self._rng.random() >= DAMAGED:
            return chunk
        at = int(self._rng.integers(len(chunk)))
        if len(chunk) > 10 and self._rng.random() < 0.2:
            at = int(self._rng.integers(8, 10))  # the length
        self.flipped += 1
        return chunk[:at] + bytes([chunk[at] ^ 1 << int(self._rng.integers(8))]) + chunk[at + 1 :]

    @property
    def in_waiting(self) -> int:
        return self._board.waiting("rs422")

    def read(self, size: int = 1) -> bytes:
        return self._damaged(self._board.read("rs422", size))

    def write(self, sent: bytes) -> int:
        self._board.write("rs422", self._damaged(sent))
        return len(sent)

    def close(self) -> None:
        return None


def exchanged(total: int) -> None:
    with open_host(seed=SEED) as host:
        line = DamagedLine(host.board)
        context = context_of(host.clock, line)
        echoes = {}
        for number in range(total):
            if number % 5 == 0:
                payload = struct.pack("<BBBII", SPI_FLASH, 0, ERASE, 0, SECTOR)
                step = unit_step(number, "memory", MEMORY, payload, "memory", timeout=1.0)
            else:
                echoes[number] = number.to_bytes(3, "little") + bytes(number % 40)
                step = unit_step(number, "sci", SCI, echoes[number], "sci")
            execute(context, step)
    told = events(context, "exchange")
    reported = [one for one in told if one["status"] is None]
    erases = [
        struct.unpack("<6I", bytes.fromhex(one["received"]))[5]
        for one in told
        if one["name"] == "memory" and one["status"] == 0
    ]
    print(f"seed {SEED}: {total} exchanges, {line.flipped} damaged, {len(reported)} reported, {erases[-1]} erases")
    assert len(told) == total
    assert all(
        one["received"] == echoes[one["step"]].hex() for one in told if one["name"] == "sci" and one["status"] == 0
    )
    assert {one["status"] for one in told} <= {0, None}
    assert len(reported) <= 3 + total // 200
    assert sum(one["attempts"] > 1 for one in told) > total // 50
    unanswered = sum(one["name"] == "memory" for one in reported)
    assert total // 5 - unanswered <= erases[-1] <= total // 5, "an erase was done twice"
    assert all(later > before for before, later in pairwise(erases))


def test_300_exchanges_with_the_simulated_board() -> None:
    exchanged(300)


@pytest.mark.sweep
def test_2000_exchanges_with_the_simulated_board() -> None:
    exchanged(2000)
