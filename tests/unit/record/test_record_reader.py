"""Damage of every kind: reported with its place, never fatal; chunks read by the block; segments that lie."""

import os
import shutil
import struct
import subprocess
import sys
from collections.abc import Callable
from pathlib import Path

import lz4.frame
import numpy as np
import pytest
from record_sample import MANIFEST, NS, ROOT, TEXTS, write_sample

from bench.model.errors import InputError, SessionDamaged
from bench.model.events import Resume
from bench.record import (
    SHORTER,
    Message,
    SessionReader,
    SessionWriter,
    block,
    layout,
    recover_session,
    resume_session,
    scan,
    walk,
)
from bench.record import mcap_format as mcap

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


def test_damage_names_segment_byte_and_loss(session: Path) -> None:
    offsets: list[int] = []

    def flip(content: bytearray) -> None:
        offsets.extend(chunk_offsets(bytes(content)))
        content[offsets[3] + 100] ^= 1

    change(session, flip)
    reader = SessionReader(session)
    first, lost = reader.damage[0], sum(item.lost or 0 for item in reader.damage)
    assert lost + sum(count for topic, count in reader.counts.items() if topic != "/chain") == reader.next_sequence
    assert (first.segment, first.byte) == ("session.0001.mcap", offsets[3])
    assert "session.0001.mcap byte" in str(first)
    said = recover_session(session).as_json()
    assert (said["lost"], said["damage"][0].keys()) == (lost, {"segment", "byte", "what", "lost"})
    assert lost > 0
    with pytest.raises(SessionDamaged, match="B-REC-011") as caught:
        list(SessionReader(session, strict=True).messages())
    assert caught.value.exit_status == 5


@pytest.mark.parametrize(
    ("edit", "lost", "what"),
    [
        (lambda content, at: content.__setitem__(at[5] + 33, content[at[5] + 33] ^ 0xFF), 0, "chunk CRC is wrong"),
        (lambda content, at: content.__delitem__(slice(at[8], at[9])), 1, "messages are missing"),
        (lambda content, at: content.__setitem__(slice(at[9], at[9]), content[at[8] : at[9]]), 0, "goes back"),
        (lambda content, at: content.__setitem__(at[2] + 60, 0xEE), 1, ""),  # the channel's records; later ones do too
        (lambda content, at: content.__setitem__(-60, content[-60] ^ 1), 0, "summary"),
    ],
)
def test_damage_costs_a_chunk(
    session: Path, edit: Callable[[bytearray, list[int]], None], lost: int, what: str
) -> None:
    change(session, lambda content: edit(content, chunk_offsets(bytes(content))))
    reader = SessionReader(session)
    assert len({message.sequence for message in reader.messages(RAW)}) == SECONDS - lost
    assert len(list(reader.events("step"))) == 4
    assert what in reader.damage[0].what
    assert not what or sum(place.lost or 0 for place in reader.damage) == 2 * lost


def written(folder: Path, *seconds: int) -> SessionWriter:
    """Begin a session with a message and a tick in each of these seconds."""
    writer = SessionWriter.create(folder, MANIFEST, TEXTS, t_mono_ns=0)
    for second in seconds:
        writer.raw("port_a", "rx", second * NS, bytes([second % 256]) * 50)
        writer.tick(second * NS)
    return writer


@pytest.mark.parametrize("tail", [b"", bytes(4096), b"\xff" * 777, b"\x06" + bytes(8), b"\x05\x60" + bytes(80)])
def test_an_unfinished_segment_is_whole_up_to_its_last_chunk(tmp_path: Path, tail: bytes) -> None:
    written(tmp_path, 0, 1, 2, 3, 4)
    change(tmp_path, lambda content: content.extend(tail))
    reader = SessionReader(tmp_path)
    assert raw_count(reader) == 5
    assert (reader.damage, reader.unfinished) == ([], ["session.0001.mcap"])


def test_cut_after_a_later_segment_was_begun_is_damage(tmp_path: Path) -> None:
    written(tmp_path, 3599, 3600, 3601).close("done")
    assert SessionReader(tmp_path).damage == []
    change(tmp_path, lambda content: content.__delitem__(slice(chunk_offsets(bytes(content))[-2] + 9, None)))
    whats = [item.what for item in SessionReader(tmp_path).damage]
    assert "hash chain does not continue the segment before" in whats


def test_a_missing_segment_is_damage(tmp_path: Path) -> None:
    written(tmp_path, 3600, 2 * 3600, 3 * 3600).close("done")
    (tmp_path / "session.0002.mcap").unlink()
    damage = SessionReader(tmp_path).damage
    assert (damage[0].segment, damage[0].what) == ("session.0002.mcap", "segment is missing")
    assert sum(item.lost or 0 for item in damage) == 1


def test_the_results_know_of_a_last_segment_that_is_missing(tmp_path: Path) -> None:
    whole = written(tmp_path, 3600, 2 * 3600).close("done")
    (tmp_path / "results.json").write_text(f'{{"provenance": {{"session_sha256": "{whole}"}}}}')
    assert SessionReader(tmp_path).damage == []
    (tmp_path / "session.0003.mcap").unlink()
    assert [item.what for item in SessionReader(tmp_path).damage] == [SHORTER]


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


def test_a_folder_without_a_session_an_empty_segment_and_a_file_that_is_none(tmp_path: Path) -> None:
    with pytest.raises(InputError, match="B-REC-010"):
        SessionReader(tmp_path)
    (tmp_path / SEGMENT).touch()
    survey = recover_session(tmp_path)
    assert (survey.unfinished, survey.damaged) == ((SEGMENT,), False)
    (tmp_path / SEGMENT).write_bytes(b"PK\x03\x04 something else entirely" * 100)
    reader = SessionReader(tmp_path)
    assert "wrong magic" in reader.damage[0].what
    assert reader.counts == {}


BLOCKS_SEED = 17
NAMES = ("session.0001.mcap", "session.0002.mcap")
Harm = Callable[[Path, np.random.Generator], None]
Reading = tuple[list[Message], list[str], list[str], dict[str, int], str, int]


@pytest.fixture(scope="module")
def segments(tmp_path_factory: pytest.TempPathFactory) -> Path:
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
    segments: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, harm: Harm, times: int
) -> None:
    rng = np.random.default_rng(BLOCKS_SEED)
    for number in range(times):
        folder = tmp_path / str(number)
        shutil.copytree(segments, folder)
        harm(folder, rng)
        assert read(folder) == singly(folder, monkeypatch), number


def test_a_whole_session_is_read_by_the_block(segments: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    expected = singly(segments, monkeypatch)
    seen: list[Message] = []
    look = walk.Walk._messages

    def watched(self: walk.Walk, span: walk.Span) -> list[Message]:
        messages = list(look(self, span))
        seen.extend(messages)
        return messages

    monkeypatch.setattr(walk.Walk, "_messages", watched)
    assert read(segments) == expected
    assert expected[1] == []
    assert [message.topic for message in seen if message.topic == layout.CHAIN] == [layout.CHAIN] * 2
    assert len(seen) == 2  # nothing else


def test_a_block_with_a_wrong_message_is_not_believed(segments: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    real = walk.unpacked

    def altered(content: bytes, stretch: block.Stretch) -> tuple[bytes, np.ndarray] | None:
        plain = real(content, stretch)
        return plain[0][:-1] + bytes([plain[0][-1] ^ 1]), plain[1]

    whole = read(segments)
    monkeypatch.setattr(walk, "unpacked", altered)
    assert read(segments) == whole  # its chunks are looked at


MOST_MB = 200
SEGMENT = "session.0001.mcap"
START = mcap.MAGIC + mcap.record(mcap.HEADER, bytes(8))
PEAK = """
import re, sys
from pathlib import Path
from bench.cli import main
sys.argv = ["bench", *sys.argv[1:]]
status = 0
try:
    main()
except SystemExit as end:
    status = end.code
high_kB = re.search(r"VmHWM:\\s*(\\d+) kB", Path("/proc/self/status").read_text())[1]
print(int(high_kB) // 1000, status)
"""


def chunk(packed: bytes, declared: int, crc: int = 1) -> bytes:
    head = struct.pack("<QQQII", 0, 0, declared, crc, 3) + b"lz4" + struct.pack("<Q", len(packed)) + packed
    return mcap.record(mcap.CHUNK, head)


def bombs(declared: int) -> bytes:
    return START + 7 * chunk(lz4.frame.compress(bytes(256 << 20)), declared)


def unknown_channels() -> bytes:
    """Half a million messages of channels that nothing names."""
    records = b"".join(mcap.record(mcap.MESSAGE, struct.pack("<HIQQ", n % 60000, 0, 0, 0)) for n in range(100_000))
    return START + 5 * chunk(lz4.frame.compress(records), len(records), 0)


CONTENTS: dict[str, Callable[[], bytes]] = {
    "declares 256 MB and holds them": lambda: bombs(256 << 20),
    "declares 1 kB and holds 256 MB": lambda: bombs(1000),
    "declares 60 MB and holds 256 MB": lambda: bombs(60 << 20),
    "declares 4 TB": lambda: START + 7 * chunk(lz4.frame.compress(b"x" * 100), 1 << 42),
    "messages of unknown channels": unknown_channels,
    "a summary that begins in front of everything": lambda: (
        START + bytes(1000) + mcap.record(mcap.FOOTER, struct.pack("<QQI", 9, 0, 0)) + mcap.MAGIC
    ),
}


@pytest.mark.skipif(not Path("/proc/self/status").exists(), reason="the peak of memory is read from /proc")
@pytest.mark.parametrize("what", CONTENTS)
def test_what_a_segment_declares_is_no_reason_to_ask_for_memory(what: str, tmp_path: Path) -> None:
    (tmp_path / SEGMENT).write_bytes(CONTENTS[what]())
    done = subprocess.run(
        [sys.executable, "-c", PEAK, "recover", str(tmp_path)], capture_output=True, text=True, timeout=60.0,
        check=True, cwd=ROOT,
    )  # fmt: skip
    *lines, last = done.stdout.splitlines()
    peak_MB, status = map(int, last.split())
    print(f"{what}: {peak_MB} MB")
    assert peak_MB < MOST_MB
    assert status == 5
    assert len(lines) < 70
    assert any(line.startswith("damaged: ") for line in lines)


def to_link(path: Path) -> None:
    path.symlink_to("/dev/zero")


@pytest.mark.parametrize("make", [os.mkfifo, to_link, Path.mkdir], ids=["pipe", "link to a device", "folder"])
def test_what_is_no_plain_file_is_not_opened(make: Callable[[Path], None], tmp_path: Path) -> None:
    write_sample(tmp_path, 3)
    make(tmp_path / "session.0002.mcap")
    with pytest.raises(SessionDamaged) as caught:
        SessionReader(tmp_path)
    assert (caught.value.code, caught.value.where) == ("B-REC-013", str(tmp_path / "session.0002.mcap"))


def test_a_large_segment_is_read_through_a_window_alike(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    write_sample(tmp_path / "sound", 30)
    shutil.copytree(tmp_path / "sound", tmp_path / "damaged")
    path = tmp_path / "damaged" / SEGMENT
    content = bytearray(path.read_bytes())
    content[len(content) // 2] ^= 0x10
    path.write_bytes(content)
    for name, damaged in (("sound", False), ("damaged", True)):
        whole = recover_session(tmp_path / name)
        messages = list(SessionReader(tmp_path / name).messages())
        with monkeypatch.context() as small:
            small.setattr(mcap, "WHOLE_BYTES", 0)
            small.setattr(mcap, "_PIECE_BYTES", 1000)
            small.setattr(scan, "_SEARCHED_BYTES", 50)
            assert recover_session(tmp_path / name) == whole
            assert list(SessionReader(tmp_path / name).messages()) == messages
        assert whole.damaged == damaged
