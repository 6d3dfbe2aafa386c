"""Sessions as the stock MCAP library sees them, and what the writer promises."""

from __future__ import annotations

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
from record_sample import MANIFEST, NS, TEXTS, digest, write_sample

from bench.record import RecordError, SessionReader, SessionWriter

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
    assert summary is not None
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


def test_same_input_same_bytes_and_another_one_differs(tmp_path: Path) -> None:
    write_sample(tmp_path / "one")
    write_sample(tmp_path / "another-2")
    write_sample(tmp_path / "other", seed=2)
    assert digest(tmp_path / "one") == digest(tmp_path / "another-2")
    assert digest(tmp_path / "one") != digest(tmp_path / "other")


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


def test_a_finished_segment_is_never_touched_again(tmp_path: Path) -> None:
    writer = SessionWriter.create(tmp_path, MANIFEST, TEXTS, t_mono_ns=0)
    writer.raw("port_a", "rx", 3600 * NS, b"one")
    writer.tick(3600 * NS)
    before = (tmp_path / "session.0001.mcap").read_bytes()
    writer.raw("port_a", "rx", 3601 * NS, b"two")
    writer.tick(3601 * NS)
    writer.sync()
    writer.close("done")
    assert (tmp_path / "session.0001.mcap").read_bytes() == before


def test_every_second_is_in_the_file_at_its_tick(tmp_path: Path) -> None:
    writer = SessionWriter.create(tmp_path, MANIFEST, TEXTS, t_mono_ns=0)
    for second in range(1, 6):
        writer.raw("port_a", "rx", second * NS, bytes([second]) * 50)
        writer.tick(second * NS)
        seen = [m.payload for m in SessionReader(tmp_path).messages(frozenset({"/link/"}))]
        assert len(seen) == second
    assert (tmp_path / "session.open").exists()
    writer.close("done")
    assert not (tmp_path / "session.open").exists()


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


def test_close_returns_the_hash_that_the_reader_computes(tmp_path: Path) -> None:
    writer = SessionWriter.create(tmp_path, MANIFEST, TEXTS, t_mono_ns=0)
    writer.event("step", NS, {"number": 1})
    sha256 = writer.close("done")
    assert writer.close("again") == sha256 == SessionReader(tmp_path).sha256


def test_numbers_that_json_lacks_become_null(tmp_path: Path) -> None:
    write_sample(tmp_path / "s", seconds=5)
    ((_, _, fields),) = SessionReader(tmp_path / "s").events("step")
    assert fields == {"number": 5, "temperature_degC": None, "counts": [0, 1, 2]}


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


def test_nothing_can_be_written_after_the_end(tmp_path: Path) -> None:
    writer = SessionWriter.create(tmp_path, MANIFEST, TEXTS, t_mono_ns=0)
    writer.close("done")
    with pytest.raises(RecordError, match="B-REC-002"):
        writer.event("step", 1, {})
