"""Damage of every kind: reported with its place, never fatal, and every whole message is still delivered."""

from __future__ import annotations

import struct
from collections.abc import Callable
from pathlib import Path

import pytest
from record_sample import MANIFEST, NS, TEXTS, write_sample

from bench.model.errors import InputError, SessionDamaged
from bench.record import SessionReader, SessionWriter

SECONDS = 20
RAW = frozenset({"/link/port_a/rx"})


@pytest.fixture
def session(tmp_path: Path) -> Path:
    write_sample(tmp_path / "s", seconds=SECONDS)
    return tmp_path / "s"


def chunk_offsets(content: bytes) -> list[int]:
    """Offsets of all chunk records, by plain stepping through the file."""
    found, at = [], 8
    while at < len(content) - 8:
        opcode, length = struct.unpack_from("<BQ", content, at)
        if opcode == 6:
            found.append(at)
        if opcode == 15:
            break
        at += 9 + length
    return found


def change(session: Path, edit: Callable[[bytearray], None]) -> None:
    path = session / "session.0001.mcap"
    content = bytearray(path.read_bytes())
    edit(content)
    path.write_bytes(content)


def raw_count(reader: SessionReader) -> int:
    return sum(1 for _ in reader.messages(RAW))


def test_whole_session(session: Path) -> None:
    reader = SessionReader(session, strict=True)
    assert raw_count(reader) == SECONDS
    assert (reader.damage, reader.unfinished) == ([], [])
    assert reader.counts["/instrument/dmm"] == SECONDS
    assert reader.next_sequence == 2 * (1 + 3) + 1 + 2 * SECONDS + 4 + 1  # manifest and texts are there twice


def test_order_and_selection(session: Path) -> None:
    reader = SessionReader(session)
    everything = list(reader.messages())
    assert [m.sequence for m in everything if m.topic != "/chain"] == list(range(len(everything) - 1))
    some = list(reader.messages(frozenset({"/link/", "/event"})))
    assert some == [m for m in everything if m.topic.startswith("/link/") or m.topic == "/event"]
    assert list(reader.select(frozenset({"/link/", "/event"}))) == some
    steps = [(t_ns, fields["number"]) for _, t_ns, fields in reader.events("step")]
    assert steps == [(n * NS, n) for n in (5, 10, 15, 20)]


@pytest.mark.parametrize("place", ["packed", "crc", "length", "opcode", "size", "name", "packed_length"])
def test_a_flipped_bit_costs_at_most_its_chunk(session: Path, place: str) -> None:
    within = {"opcode": 0, "length": 2, "size": 26, "crc": 34, "name": 42, "packed_length": 45, "packed": 120}

    def flip(content: bytearray) -> None:
        content[chunk_offsets(bytes(content))[10] + within[place]] ^= 0x10

    change(session, flip)
    reader = SessionReader(session)
    assert SECONDS - 1 <= raw_count(reader) <= SECONDS
    assert reader.damage
    lost = sum(item.lost or 0 for item in reader.damage)
    assert lost + sum(count for topic, count in reader.counts.items() if topic != "/chain") == reader.next_sequence
    with pytest.raises(SessionDamaged, match="B-REC-011") as caught:
        list(SessionReader(session, strict=True).messages())
    assert caught.value.exit_status == 5


def test_damage_names_segment_byte_and_loss(session: Path) -> None:
    offsets: list[int] = []

    def flip(content: bytearray) -> None:
        offsets.extend(chunk_offsets(bytes(content)))
        content[offsets[3] + 100] ^= 1

    change(session, flip)
    first = SessionReader(session).damage[0]
    assert (first.segment, first.byte) == ("session.0001.mcap", offsets[3])
    assert "session.0001.mcap byte" in str(first)


def test_a_wrong_chunk_crc_alone_loses_nothing(session: Path) -> None:
    def flip(content: bytearray) -> None:
        content[chunk_offsets(bytes(content))[5] + 33] ^= 0xFF

    change(session, flip)
    reader = SessionReader(session)
    assert raw_count(reader) == SECONDS
    assert [item.what for item in reader.damage] == [
        "chunk CRC is wrong", "bytes of this segment were changed (hash chain)"
    ]  # fmt: skip


def test_change_outside_the_messages_is_found_by_the_chain(session: Path) -> None:
    def flip(content: bytearray) -> None:
        offsets = chunk_offsets(bytes(content))
        length = struct.unpack_from("<Q", content, offsets[5] + 1)[0]
        content[offsets[5] + 9 + length + 9 + 8] ^= 1  # a time in the message index behind the chunk

    change(session, flip)
    reader = SessionReader(session)
    assert raw_count(reader) == SECONDS
    assert [item.what for item in reader.damage] == ["bytes of this segment were changed (hash chain)"]


def test_a_removed_chunk_is_missed(session: Path) -> None:
    def remove(content: bytearray) -> None:
        offsets = chunk_offsets(bytes(content))
        del content[offsets[8] : offsets[9]]

    change(session, remove)
    reader = SessionReader(session)
    assert raw_count(reader) == SECONDS - 1
    assert (reader.damage[0].what, reader.damage[0].lost) == ("messages are missing", 2)


def test_a_repeated_chunk_is_noticed(session: Path) -> None:
    def repeat(content: bytearray) -> None:
        offsets = chunk_offsets(bytes(content))
        content[offsets[9] : offsets[9]] = content[offsets[8] : offsets[9]]

    change(session, repeat)
    assert any("goes back" in item.what for item in SessionReader(session).damage)


@pytest.mark.parametrize("tail", [b"", bytes(4096), b"\xff" * 777, b"\x06" + bytes(8), b"\x05\x60" + bytes(80)])
def test_an_unfinished_segment_is_whole_up_to_its_last_chunk(tmp_path: Path, tail: bytes) -> None:
    writer = SessionWriter.create(tmp_path, MANIFEST, TEXTS, t_mono_ns=0)
    for second in range(5):
        writer.raw("port_a", "rx", second * NS, bytes([second]) * 30)
        writer.tick(second * NS)
    change(tmp_path, lambda content: content.extend(tail))
    reader = SessionReader(tmp_path)
    assert raw_count(reader) == 5
    assert (reader.damage, reader.unfinished) == ([], ["session.0001.mcap"])


def test_cut_anywhere_gives_a_prefix(session: Path, tmp_path: Path) -> None:
    whole = [m for m in SessionReader(session).messages() if m.topic != "/chain"]
    content = (session / "session.0001.mcap").read_bytes()
    short = tmp_path / "cut"
    short.mkdir()
    lengths = set()
    for stop in range(0, len(content), 53):
        (short / "session.0001.mcap").write_bytes(content[:stop])
        got = [m for m in SessionReader(short).messages() if m.topic != "/chain"]
        assert got == whole[: len(got)]
        lengths.add(len(got))
    assert max(lengths) == len(whole)
    assert len(lengths) > SECONDS


def test_cut_after_a_later_segment_was_begun_is_damage(tmp_path: Path) -> None:
    writer = SessionWriter.create(tmp_path, MANIFEST, TEXTS, t_mono_ns=0)
    for second in (3599, 3600, 3601):
        writer.raw("port_a", "rx", second * NS, b"x" * 50)
        writer.tick(second * NS)
    writer.close("done")
    assert SessionReader(tmp_path).damage == []
    change(tmp_path, lambda content: content.__delitem__(slice(chunk_offsets(bytes(content))[-2] + 9, None)))
    whats = [item.what for item in SessionReader(tmp_path).damage]
    assert "hash chain does not continue the segment before" in whats


def test_a_missing_segment_is_damage(tmp_path: Path) -> None:
    writer = SessionWriter.create(tmp_path, MANIFEST, TEXTS, t_mono_ns=0)
    for hour in (1, 2, 3):
        writer.raw("port_a", "rx", hour * 3600 * NS, b"x" * 50)
        writer.tick(hour * 3600 * NS)
    writer.close("done")
    (tmp_path / "session.0002.mcap").unlink()
    damage = SessionReader(tmp_path).damage
    assert (damage[0].segment, damage[0].what) == ("session.0002.mcap", "segment is missing")
    assert sum(item.lost or 0 for item in damage) == 1


def test_a_damaged_summary_does_not_matter_for_the_messages(session: Path) -> None:
    change(session, lambda content: content.__setitem__(-60, content[-60] ^ 1))
    reader = SessionReader(session)
    assert raw_count(reader) == SECONDS
    assert "summary" in reader.damage[0].what
    assert len(list(reader.events("step"))) == 4


def test_unknown_channel_after_a_lost_channel_record_is_found_in_the_summary(session: Path) -> None:
    """The records of the link's channel stand in the third chunk; later chunks are readable without it."""
    change(session, lambda content: content.__setitem__(chunk_offsets(bytes(content))[2] + 60, 0xEE))
    assert raw_count(SessionReader(session)) == SECONDS - 1


def test_a_folder_without_a_session(tmp_path: Path) -> None:
    with pytest.raises(InputError, match="B-REC-010"):
        SessionReader(tmp_path)


def test_a_lost_manifest(session: Path) -> None:
    def wipe(content: bytearray) -> None:
        for at in chunk_offsets(bytes(content))[:copies]:
            content[at + 60 : at + 200] = bytes(140)

    copies = 1
    change(session, wipe)
    assert SessionReader(session).manifest["session"] == "sample"
    copies = 2
    change(session, wipe)
    with pytest.raises(SessionDamaged, match="B-REC-012"):
        SessionReader(session).manifest  # noqa: B018
    assert raw_count(SessionReader(session)) == SECONDS


def test_a_file_that_is_no_segment(tmp_path: Path) -> None:
    (tmp_path / "session.0001.mcap").write_bytes(b"PK\x03\x04 something else entirely" * 100)
    reader = SessionReader(tmp_path)
    assert "wrong magic" in reader.damage[0].what
    assert reader.counts == {}
