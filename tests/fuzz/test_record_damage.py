"""Random damage to segments: no exception, no invented message, nothing lost without being said."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from record_sample import write_sample

from bench.record import Message, SessionReader
from bench.record.recover import recover_session

SEED = 7


def read(folder: Path) -> tuple[list[Message], SessionReader]:
    reader = SessionReader(folder)
    return [message for message in reader.messages() if message.topic != "/chain"], reader


def damaged(content: bytes, rng: np.random.Generator) -> bytes:
    """One to four faults: flipped bits, a wiped, removed, repeated or inserted stretch, a cut end."""
    work = bytearray(content)
    for _ in range(int(rng.integers(1, 5))):
        at = int(rng.integers(0, len(work)))
        size = int(rng.integers(1, 600))
        kind = int(rng.integers(0, 6))
        if kind == 0:
            work[at] ^= 1 << int(rng.integers(0, 8))
        elif kind == 1:
            work[at : at + size] = bytes(len(work[at : at + size]))
        elif kind == 2:
            del work[at : at + size]
        elif kind == 3:
            work[at:at] = work[max(0, at - size) : at]
        elif kind == 4:
            work[at:at] = rng.bytes(size)
        else:
            del work[at:]
        if not work:
            break
    return bytes(work)


def check(folder: Path, rounds: int, seed: int) -> None:
    rng = np.random.default_rng(seed)
    write_sample(folder / "whole", seconds=15)
    whole, _ = read(folder / "whole")
    content = (folder / "whole" / "session.0001.mcap").read_bytes()
    (folder / "bad").mkdir()
    for number in range(rounds):
        place = f"seed {seed}, round {number}"
        (folder / "bad" / "session.0001.mcap").write_bytes(damaged(content, rng))
        got, reader = read(folder / "bad")
        assert set(got) <= set(whole), place
        if got != whole:
            assert reader.damage or reader.unfinished, place
            missing = sum(item.lost or 0 for item in reader.damage)
            assert reader.unfinished or missing >= len(whole) - len(set(got)) or got[-1] != whole[-1], place
        recover_session(folder / "bad")


def test_random_damage(tmp_path: Path) -> None:
    check(tmp_path, 400, SEED)


@pytest.mark.sweep
def test_random_damage_sweep(tmp_path: Path) -> None:
    check(tmp_path, 20_000, SEED + 1)


def test_every_flipped_bit_is_noticed(tmp_path: Path) -> None:
    """Each byte of a finished segment in turn, one bit of it flipped."""
    rng = np.random.default_rng(SEED)
    write_sample(tmp_path / "s", seconds=2)
    whole, _ = read(tmp_path / "s")
    path = tmp_path / "s" / "session.0001.mcap"
    content = path.read_bytes()
    silent = []
    for at in range(len(content)):
        flipped = bytearray(content)
        flipped[at] ^= 1 << int(rng.integers(0, 8))
        path.write_bytes(flipped)
        got, reader = read(tmp_path / "s")
        assert set(got) <= set(whole)
        if not reader.damage and not reader.unfinished:
            silent.append(at)
    assert silent == [], f"seed {SEED}, of {len(content)} bytes"
