"""Chunks read by the block give what looking at each message gives: messages, damage, counts and hash chain."""

from __future__ import annotations

import shutil
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
from record_sample import NS, write_sample

from bench.model.events import Resume
from bench.record import Message, SessionReader, block, layout, resume_session, walk
from bench.record.block import Block

SEED = 17
NAMES = ("session.0001.mcap", "session.0002.mcap")
Harm = Callable[[Path, np.random.Generator], None]
Reading = tuple[list[Message], list[str], list[str], dict[str, int], str, int]


@pytest.fixture(scope="module")
def session(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Two segments of a minute; topics that begin late in both."""
    folder = tmp_path_factory.mktemp("blocks") / "s"
    write_sample(folder, seconds=60)
    writer = resume_session(folder, Resume(start=3, reason="power"), t_mono_ns=100 * NS)
    for second in range(101, 161):
        writer.raw("port_a", "rx", second * NS, bytes(range(second)) * 5)
        if second > 130:
            writer.command("chamber", "tx", f"MON? {second}", second * NS)
        writer.tick(second * NS)
    writer.close("done")
    return folder


@pytest.fixture(autouse=True)
def short_blocks(monkeypatch: pytest.MonkeyPatch) -> None:
    """A session of a minute has several of them."""
    monkeypatch.setattr(block, "FIRST_BYTES", 2_000)
    monkeypatch.setattr(block, "BLOCK_BYTES", 5_000)


def read(folder: Path) -> Reading:
    reader = SessionReader(folder)
    messages = list(reader.messages())
    damage = [str(place) for place in reader.damage]
    return messages, damage, reader.unfinished, reader.counts, reader.sha256, reader.next_sequence


def singly(folder: Path, monkeypatch: pytest.MonkeyPatch) -> Reading:
    """Look at one message after the other."""
    with monkeypatch.context() as patched:
        patched.setattr(walk, "stretches", lambda content: ())
        return read(folder)


def flipped_bits(folder: Path, rng: np.random.Generator) -> None:
    for _ in range(rng.integers(1, 4)):
        path = folder / NAMES[rng.integers(2)]
        content = bytearray(path.read_bytes())
        content[rng.integers(len(content))] ^= 1 << int(rng.integers(8))
        path.write_bytes(content)


def cut(folder: Path, rng: np.random.Generator) -> None:
    path = folder / NAMES[rng.integers(2)]
    content = path.read_bytes()
    path.write_bytes(content[: rng.integers(len(content))])


def bytes_left_out_or_put_in(folder: Path, rng: np.random.Generator) -> None:
    path = folder / NAMES[rng.integers(2)]
    content = path.read_bytes()
    at, size = int(rng.integers(len(content))), int(rng.integers(1, 300))
    more = rng.bytes(size) if rng.integers(2) else content[:size]
    path.write_bytes(content[:at] + content[at + size :] if rng.integers(2) else content[:at] + more + content[at:])


def missing_segment(folder: Path, rng: np.random.Generator) -> None:
    (folder / NAMES[0]).unlink()


@pytest.mark.parametrize(
    ("harm", "times"), [(flipped_bits, 60), (cut, 25), (bytes_left_out_or_put_in, 40), (missing_segment, 1)]
)
def test_damage_is_found_as_by_looking_at_each_message(
    session: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, harm: Harm, times: int
) -> None:
    rng = np.random.default_rng(SEED)
    for number in range(times):
        folder = tmp_path / str(number)
        shutil.copytree(session, folder)
        harm(folder, rng)
        assert read(folder) == singly(folder, monkeypatch), number


def test_a_whole_session_is_read_by_the_block(session: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    expected = singly(session, monkeypatch)
    seen: list[Message] = []
    look = walk.Walk._messages

    def watched(self: walk.Walk, span: walk.Span) -> list[Message]:
        messages = list(look(self, span))
        seen.extend(messages)
        return messages

    monkeypatch.setattr(walk.Walk, "_messages", watched)
    assert read(session) == expected
    assert expected[1] == []
    assert [message.topic for message in seen if message.topic == layout.CHAIN] == [layout.CHAIN] * 2
    assert len(seen) == 2  # nothing else


def test_a_block_with_a_wrong_message_is_not_believed(session: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    real = walk.unpacked

    def altered(content: bytes, stretch: block.Stretch) -> tuple[bytes, np.ndarray] | None:
        plain = real(content, stretch)
        assert plain is not None
        return plain[0][:-1] + bytes([plain[0][-1] ^ 1]), plain[1]

    whole = read(session)
    monkeypatch.setattr(walk, "unpacked", altered)
    assert read(session) == whole  # its chunks are looked at


def test_what_was_seen_singly_is_a_block_too() -> None:
    messages = [Message("/event", 7, 5, b"{}"), Message("/link/a/rx", 9, 6, b"xyz"), Message("/event", 10, 6, b"")]
    both = Block.of(messages)
    assert list(both.messages(None)) == messages
    assert list(both.messages(frozenset({"/link/"}))) == messages[1:2]
    assert [place for place, _ in both.placed(frozenset({"/event"}))] == [0, 2]
    assert both.payloads(both.among(frozenset({"/link/a/rx"}))) == [(6, b"xyz")]
