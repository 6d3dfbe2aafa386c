"""Sessions as the stock MCAP library sees them, and what the writer promises while the disk fails at every call."""

import errno
import hashlib
import json
import os
import struct
import threading
import zlib
from pathlib import Path

import mcap.reader
import mcap.records
import mcap.stream_reader
import numpy as np
import pytest
from record_sample import MANIFEST, NS, TEXTS, FaultyFiles, digest, io_error, no_space, write_sample

from bench.record import RecordError, SessionReader, SessionWriter
from bench.record import writer as writer_module
from bench.record.layout import OsFiles

HOURS = 3


def stock_messages(path: Path) -> list[tuple[str, int, bytes]]:
    """Topic, time and content of every message, read with the stock library and all CRCs checked."""
    with path.open("rb") as stream:
        reader = mcap.reader.make_reader(stream, validate_crcs=True)
        return [(channel.topic, m.log_time, m.data) for _, channel, m in reader.iter_messages(log_time_order=False)]


@pytest.mark.parametrize(("umask", "mode"), [(0o022, 0o750), (0o000, 0o750), (0o077, 0o700)])
def test_the_folder_is_for_its_owner_and_the_group_only(tmp_path: Path, umask: int, mode: int) -> None:
    before = os.umask(umask)
    try:
        SessionWriter.create(tmp_path / "out" / "session", MANIFEST, TEXTS, t_mono_ns=0).close("done")
    finally:
        os.umask(before)
    assert (tmp_path / "out" / "session").stat().st_mode & 0o777 == mode


@pytest.fixture
def long_session(tmp_path: Path) -> Path:
    folder = tmp_path / "long"
    writer = SessionWriter.create(folder, MANIFEST, TEXTS, t_mono_ns=0)
    for second in range(0, HOURS * 3600 + 10, 10):
        writer.raw("port_a", "rx", second * NS, second.to_bytes(4, "big") * 20)
        writer.tick(second * NS)
    writer.close("done")
    return folder


def test_stock_library_reads_every_message_with_all_crcs(tmp_path: Path) -> None:
    given = write_sample(tmp_path / "s")
    (segment,) = (tmp_path / "s").glob("*.mcap")
    read = stock_messages(segment)
    raw = [content[20:] for topic, _, content in read if topic == "/link/port_a/rx"]
    assert raw == given
    with segment.open("rb") as stream:
        records = list(mcap.stream_reader.StreamReader(stream, validate_crcs=True).records)
    statistics = next(record for record in records if isinstance(record, mcap.records.Statistics))
    assert statistics.message_count == len(read)
    assert (statistics.message_start_time, statistics.message_end_time) == (0, 20 * NS)
    ends = [record for record in records if isinstance(record, mcap.records.DataEnd)]
    assert ends[0].data_section_crc != 0


def test_stock_library_seeks_by_topic_and_time(tmp_path: Path) -> None:
    write_sample(tmp_path / "s")
    with (tmp_path / "s" / "session.0001.mcap").open("rb") as stream:
        reader = mcap.reader.make_reader(stream, validate_crcs=True)
        found = list(reader.iter_messages(topics=["/event"], starting_at=10 * NS, ending_before=16 * NS))
        assert [message.log_time for _, _, message in found] == [10 * NS, 15 * NS]
        summary = reader.get_summary()
    assert {channel.topic for channel in summary.channels.values()} >= {"/manifest", "/clock", "/chain"}
    assert all(index.message_index_length > 0 for index in summary.chunk_indexes)


def test_envelope_as_documented(tmp_path: Path) -> None:
    write_sample(tmp_path / "s")
    expected = 0
    for topic, log_time, content in stock_messages(tmp_path / "s" / "session.0001.mcap"):
        crc, sequence, t_ns = struct.unpack("<IQQ", content[:20])
        assert t_ns == log_time
        assert crc == zlib.crc32(content[4:], zlib.crc32(topic.encode()))
        assert sequence == expected
        expected += topic != "/chain"


def test_manifest_and_texts_stand_before_everything_else(tmp_path: Path) -> None:
    write_sample(tmp_path / "s")
    read = stock_messages(tmp_path / "s" / "session.0001.mcap")
    head = [topic for topic, _, _ in read[: 1 + len(TEXTS)]]
    assert head == ["/manifest", *(f"/text/{name}" for name in sorted(TEXTS))]
    assert json.loads(read[0][2][20:]) == MANIFEST
    reader = SessionReader(tmp_path / "s")
    assert reader.manifest == MANIFEST
    assert reader.texts == TEXTS
    _, _, fields = next(iter(reader.events("step")))  # numbers that JSON lacks become null
    assert fields == {"number": 5, "temperature_degC": None, "counts": [0, 1, 2]}


def test_seconds_that_are_written_together_are_the_same_bytes(tmp_path: Path) -> None:
    for name, stride in (("each", 1), ("together", 7)):
        writer = SessionWriter.create(tmp_path / name, MANIFEST, TEXTS, t_mono_ns=0)
        for second in range(3580, 3630):
            for link in ("port_a", "port_b", "port_c")[: 2 + (second > 3620)]:
                writer.raw(link, "rx", second * NS - 5, second.to_bytes(4, "big") * 20)
            (writer.close_chunk if second % stride else writer.tick)(second * NS)
        writer.close("done")
    assert digest(tmp_path / "each") == digest(tmp_path / "together")
    assert len(list((tmp_path / "together").glob("*.mcap"))) == 2


def test_order_of_keys_does_not_matter(tmp_path: Path) -> None:
    for name, pairs in (("a", [("x", 1), ("y", {"p": 2, "q": 3})]), ("b", [("y", {"q": 3, "p": 2}), ("x", 1)])):
        writer = SessionWriter.create(tmp_path / name, dict(pairs), dict(reversed(TEXTS.items())), t_mono_ns=5)
        writer.event("step", 7, dict(pairs))
        writer.close("done")
    assert digest(tmp_path / "a") == digest(tmp_path / "b")


def test_segments_rotate_on_the_hour_and_stay_untouched(long_session: Path) -> None:
    names = sorted(path.name for path in long_session.iterdir())
    assert names == [f"session.{number:04d}.mcap" for number in range(1, HOURS + 2)]
    for number in range(1, HOURS + 1):
        times = [t for topic, t, _ in stock_messages(long_session / f"session.{number:04d}.mcap") if "link" in topic]
        first = (number - 1) * 3600 + (10 if number > 1 else 0)
        assert (min(times), max(times)) == (first * NS, number * 3600 * NS)


def test_chain_covers_all_segments_in_order(long_session: Path) -> None:
    reader = SessionReader(long_session)
    assert (reader.damage, reader.unfinished) == ([], [])
    chain = b"\0" * 32
    for path in sorted(long_session.iterdir()):
        said = json.loads(stock_messages(path)[-1][2][20:])
        digest_ = hashlib.sha256(chain + path.read_bytes()[: said["bytes"]])
        assert said["previous"] == chain.hex()
        assert said["sha256"] == digest_.hexdigest()
        chain = digest_.digest()
    assert reader.sha256 == chain.hex()


def test_the_end_gives_the_hash_that_the_reader_computes_and_nothing_follows_it(tmp_path: Path) -> None:
    writer = SessionWriter.create(tmp_path, MANIFEST, TEXTS, t_mono_ns=0)
    writer.event("step", NS, {"number": 1})
    sha256 = writer.close("done")
    assert writer.close("again") == sha256 == SessionReader(tmp_path).sha256
    with pytest.raises(RecordError, match="B-REC-002"):
        writer.event("step", 1, {})


def test_threads_may_write_at_once(tmp_path: Path) -> None:
    writer = SessionWriter.create(tmp_path, MANIFEST, TEXTS, t_mono_ns=0)
    stop = threading.Event()

    def send(link: str) -> None:
        for number in range(2000):
            writer.raw(link, "rx", number, number.to_bytes(4, "big"))

    def sync() -> None:
        while not stop.is_set():
            writer.tick(1)
            writer.sync()

    threads = [threading.Thread(target=send, args=(f"link_{k}",)) for k in range(4)]
    background = threading.Thread(target=sync)
    background.start()
    for thread in threads:
        thread.start()
    for thread in threads:
        thread.join()
    stop.set()
    background.join()
    writer.close("done")
    reader = SessionReader(tmp_path)
    for k in range(4):
        sent = [int.from_bytes(m.payload, "big") for m in reader.messages(frozenset({f"/link/link_{k}/rx"}))]
        assert sent == list(range(2000))
    assert reader.damage == []


def test_a_large_batch_closes_its_chunk_before_the_second_ends(tmp_path: Path) -> None:
    writer = SessionWriter.create(tmp_path, MANIFEST, TEXTS, t_mono_ns=0)
    size_before = (tmp_path / "session.0001.mcap").stat().st_size
    writer.raw("port_a", "rx", 1, np.random.default_rng(3).bytes(1_100_000))
    assert (tmp_path / "session.0001.mcap").stat().st_size > size_before + 1_000_000
    writer.close("done")


SECONDS = 12


def numbers_in(folder: Path) -> list[int]:
    messages = SessionReader(folder).messages(frozenset({"/link/"}))
    return [int.from_bytes(message.payload, "big") for message in messages]


def full(kind: str, n: int) -> OSError | None:
    return no_space() if kind in ("write", "create") else None


def sound(kind: str, n: int) -> None:
    return None


def writing(folder: Path) -> tuple[FaultyFiles, SessionWriter]:
    """Begin a session on a disk whose faults come later."""
    disk = FaultyFiles(sound)
    return disk, SessionWriter.create(folder, MANIFEST, TEXTS, t_mono_ns=0, files=disk)


def run_with(folder: Path, files: FaultyFiles, stride: int = 1) -> list[int]:
    """Write a number a second, ``stride`` seconds together; returns the seconds whose tick raised."""
    writer = SessionWriter.create(folder, MANIFEST, TEXTS, t_mono_ns=0, files=files)
    refused = []
    for second in range(SECONDS):
        writer.raw("port_a", "rx", second * NS, second.to_bytes(4, "big"))
        try:
            (writer.close_chunk if (second + 1) % stride else writer.tick)(second * NS)
        except RecordError:
            refused.append(second)
    writer.close("done")
    return refused


@pytest.mark.parametrize(("short", "stride"), [(False, 1), (True, 1), (False, 4)])
@pytest.mark.parametrize("nth", range(3, 18))
def test_one_failed_write_loses_nothing(tmp_path: Path, nth: int, short: bool, stride: int) -> None:
    """Write 1 and 2 are the head and the first chunk; later ones fail once, after a part of the bytes if ``short``."""

    def fault(kind: str, n: int) -> OSError | int | None:
        if kind != "write" or n not in ((nth, nth + 1) if short else (nth,)):
            return None
        return 7 if short and n == nth else no_space()

    disk = FaultyFiles(fault)
    assert run_with(tmp_path / "s", disk, stride) == []
    reader = SessionReader(tmp_path / "s")
    assert numbers_in(tmp_path / "s") == list(range(SECONDS))
    assert reader.damage == []
    faults = [fields for _, _, fields in reader.events("error")]
    injected = disk.calls["write"] >= nth
    assert reader.segments[-1].name not in reader.unfinished
    assert [fault["code"] for fault in faults] == (["B-REC-004"] if injected else [])
    assert all(fault["errno"] == errno.ENOSPC for fault in faults)


@pytest.mark.parametrize(("error", "stride"), [(no_space, 1), (io_error, 1), (no_space, 4)])
def test_a_disk_that_stays_full_is_refused_and_then_caught_up(tmp_path: Path, error: type, stride: int) -> None:
    disk, writer = writing(tmp_path)
    before = sorted(tmp_path.iterdir())
    disk.fault = lambda kind, n: error() if kind in ("write", "create") else None
    for second in range(8):
        writer.raw("port_a", "rx", second * NS, second.to_bytes(4, "big"))
        if (second + 1) % stride:
            writer.close_chunk(second * NS)
            continue
        with pytest.raises(RecordError, match="B-REC-001") as caught:
            writer.tick(second * NS)
        assert caught.value.exit_status == 3
    assert sorted(tmp_path.iterdir()) == before
    disk.fault = sound
    writer.tick(8 * NS)
    writer.close("done")
    assert numbers_in(tmp_path) == list(range(8))
    assert SessionReader(tmp_path).damage == []


def test_a_failed_truncate_leaves_a_tail_that_is_no_message(tmp_path: Path) -> None:
    def fault(kind: str, n: int) -> OSError | int | None:
        if kind == "write" and n in (5, 6):
            return 60 if n == 5 else no_space()
        return io_error() if kind == "truncate" else None

    assert run_with(tmp_path / "s", FaultyFiles(fault)) == []
    reader = SessionReader(tmp_path / "s")
    assert numbers_in(tmp_path / "s") == list(range(SECONDS))
    assert reader.damage == []
    assert reader.unfinished == ["session.0001.mcap"]


def test_after_a_failed_sync_a_new_segment_begins(tmp_path: Path) -> None:
    disk = FaultyFiles(lambda kind, n: io_error() if kind == "sync" and n == 2 else None)
    writer = SessionWriter.create(tmp_path, MANIFEST, TEXTS, t_mono_ns=0, files=disk)
    for second in range(4):
        writer.raw("port_a", "rx", second * NS, second.to_bytes(4, "big"))
        writer.tick(second * NS)
        writer.sync()
    writer.close("done")
    assert [path.name for path in sorted(tmp_path.iterdir())] == ["session.0001.mcap", "session.0002.mcap"]
    assert numbers_in(tmp_path) == [0, 1, 2, 3]
    ((_, _, fields),) = SessionReader(tmp_path).events("error")
    assert fields["code"] == "B-REC-004"
    assert fields["errno"] == errno.EIO


def test_a_failed_sync_of_a_finished_segment_is_said(tmp_path: Path) -> None:
    disk, writer = writing(tmp_path)
    writer.raw("port_a", "rx", 3600 * NS, b"last")
    writer.tick(3600 * NS)
    disk.fault = lambda kind, n: io_error() if kind == "sync" and n == 1 else None
    writer.sync()
    writer.close("done")
    ((_, _, fields),) = SessionReader(tmp_path).events("error")
    assert (fields["code"], fields["segment"]) == ("B-REC-004", 1)


def test_memory_is_bounded_while_the_disk_refuses(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(writer_module, "HELD_BYTES", 10_000)
    disk, writer = writing(tmp_path)
    disk.fault = full
    for second in range(10):
        writer.raw("port_a", "rx", second * NS, bytes(1000))
    with pytest.raises(RecordError, match="B-REC-003"):
        writer.raw("port_a", "rx", 10 * NS, bytes(1000))
    disk.fault = sound
    writer.tick(30 * NS)
    writer.close("done")
    reader = SessionReader(tmp_path)
    assert reader.damage == []
    assert reader.counts["/link/port_a/rx"] == 10


def test_a_disk_is_waited_for_half_an_hour_and_no_longer(tmp_path: Path) -> None:
    disk, writer = writing(tmp_path)
    writer.clock_pair(0, 946_684_800 * NS)
    disk.fault = full
    with pytest.raises(RecordError, match="until 2000-01-01T00:30:10Z and 64 MB at most; then the run ends"):
        writer.tick(10 * NS)
    writer.raw("port_a", "rx", 1810 * NS, b"in time")
    with pytest.raises(RecordError, match="the disk takes nothing for 30 min"):
        writer.raw("port_a", "rx", 1811 * NS, b"late")
    with pytest.raises(RecordError, match="B-REC-001"):
        writer.close("done")
    disk.fault = sound
    writer.close("done")  # there is room at last: what was held is kept, and the session is whole
    reader = SessionReader(tmp_path)
    assert (reader.damage, reader.unfinished, reader.counts["/link/port_a/rx"]) == ([], ["session.0001.mcap"], 1)


def test_the_time_for_which_a_disk_is_waited_for_begins_anew_when_it_has_written(tmp_path: Path) -> None:
    disk, writer = writing(tmp_path)
    for begin_s in (10, 2000):
        writer.raw("port_a", "rx", begin_s * NS, b"waits")
        disk.fault = full
        with pytest.raises(RecordError, match="B-REC-001"):
            writer.tick(begin_s * NS)
        disk.fault = sound
        writer.tick((begin_s + 1000) * NS)
    writer.close("done")
    assert SessionReader(tmp_path).counts["/link/port_a/rx"] == 2


def test_a_folder_that_cannot_be_made_or_holds_a_session_is_refused(tmp_path: Path) -> None:
    (tmp_path / "file").write_text("in the way")
    with pytest.raises(RecordError, match="B-REC-001"):
        SessionWriter.create(tmp_path / "file", MANIFEST, TEXTS, t_mono_ns=0)
    write_sample(tmp_path / "s", seconds=2)
    before = (tmp_path / "s" / "session.0001.mcap").read_bytes()
    with pytest.raises(RecordError, match="B-REC-001"):
        SessionWriter.create(tmp_path / "s", MANIFEST, TEXTS, t_mono_ns=0)
    assert (tmp_path / "s" / "session.0001.mcap").read_bytes() == before


def test_the_real_disk_makes_names_durable(tmp_path: Path) -> None:
    files = OsFiles()
    file = files.create(tmp_path / "a")
    assert file.write(b"abcdef") == 6
    file.truncate(3)
    assert file.write(b"xyz") == 3
    file.sync()
    file.close()
    file.close()
    files.sync_folder(tmp_path)
    assert (tmp_path / "a").read_bytes() == b"abcxyz"
    files.remove(tmp_path / "a")
    files.remove(tmp_path / "a")
