"""The disk fails at every call in turn: what was acknowledged stays, what could not be written waits in memory."""

from __future__ import annotations

import errno
from pathlib import Path

import pytest
from record_sample import MANIFEST, NS, TEXTS, FaultyFiles, io_error, no_space, write_sample

from bench.model.events import Resume
from bench.record import RecordError, SessionReader, SessionWriter
from bench.record import writer as writer_module
from bench.record.files import OsFiles
from bench.record.recover import resume_session

SECONDS = 12


def numbers_in(folder: Path) -> list[int]:
    messages = SessionReader(folder).messages(frozenset({"/link/"}))
    return [int.from_bytes(message.payload, "big") for message in messages]


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


@pytest.mark.parametrize("short", [False, True])
@pytest.mark.parametrize("nth", range(3, 18))
def test_one_failed_write_loses_nothing(tmp_path: Path, nth: int, short: bool) -> None:
    """Write 1 and 2 are the head and the first chunk; later ones fail once, after a part of the bytes if ``short``."""

    def fault(kind: str, n: int) -> OSError | int | None:
        if kind != "write" or n not in ((nth, nth + 1) if short else (nth,)):
            return None
        return 7 if short and n == nth else no_space()

    disk = FaultyFiles(fault)
    assert run_with(tmp_path / "s", disk) == []
    reader = SessionReader(tmp_path / "s")
    assert numbers_in(tmp_path / "s") == list(range(SECONDS))
    assert reader.damage == []
    faults = [fields for _, _, fields in reader.events("error")]
    injected = disk.calls["write"] >= nth
    assert reader.segments[-1].name not in reader.unfinished
    assert [fault["code"] for fault in faults] == (["B-REC-004"] if injected else [])
    assert all(fault["errno"] == errno.ENOSPC for fault in faults)


@pytest.mark.parametrize("nth", range(3, 7))
def test_a_failed_write_of_many_seconds_loses_none(tmp_path: Path, nth: int) -> None:
    disk = FaultyFiles(lambda kind, n: no_space() if kind == "write" and n == nth else None)
    assert run_with(tmp_path / "s", disk, stride=4) == []
    assert numbers_in(tmp_path / "s") == list(range(SECONDS))
    assert [fields["code"] for _, _, fields in SessionReader(tmp_path / "s").events("error")] == ["B-REC-004"]


def test_seconds_of_a_stride_wait_for_a_disk_that_is_full(tmp_path: Path) -> None:
    disk = FaultyFiles(lambda kind, n: None)
    writer = SessionWriter.create(tmp_path, MANIFEST, TEXTS, t_mono_ns=0, files=disk)
    disk.fault = lambda kind, n: no_space() if kind in ("write", "create") else None
    for second in range(8):
        writer.raw("port_a", "rx", second * NS, second.to_bytes(4, "big"))
        writer.close_chunk(second * NS)
        if second % 4 == 3:
            with pytest.raises(RecordError, match="B-REC-001"):
                writer.tick(second * NS)
    disk.fault = lambda kind, n: None
    writer.close("done")
    assert numbers_in(tmp_path) == list(range(8))


def test_short_writes_are_continued(tmp_path: Path) -> None:
    assert run_with(tmp_path / "s", FaultyFiles(lambda kind, n: 100 if kind == "write" else None)) == []
    assert numbers_in(tmp_path / "s") == list(range(SECONDS))
    assert len(list((tmp_path / "s").glob("*.mcap"))) == 1


@pytest.mark.parametrize("error", [no_space, io_error])
def test_a_disk_that_stays_full_is_refused_and_then_caught_up(tmp_path: Path, error: type) -> None:
    disk = FaultyFiles(lambda kind, n: None)
    writer = SessionWriter.create(tmp_path, MANIFEST, TEXTS, t_mono_ns=0, files=disk)
    before = sorted(tmp_path.iterdir())
    disk.fault = lambda kind, n: error() if kind in ("write", "create") else None
    for second in range(3):
        writer.raw("port_a", "rx", second * NS, second.to_bytes(4, "big"))
        with pytest.raises(RecordError, match="B-REC-001") as caught:
            writer.tick(second * NS)
        assert caught.value.exit_status == 3
    assert sorted(tmp_path.iterdir()) == before
    disk.fault = lambda kind, n: None
    writer.tick(3 * NS)
    writer.close("done")
    assert numbers_in(tmp_path) == [0, 1, 2]
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
    disk = FaultyFiles(lambda kind, n: None)
    writer = SessionWriter.create(tmp_path, MANIFEST, TEXTS, t_mono_ns=0, files=disk)
    writer.raw("port_a", "rx", 3600 * NS, b"last")
    writer.tick(3600 * NS)
    disk.fault = lambda kind, n: io_error() if kind == "sync" and n == 1 else None
    writer.sync()
    writer.close("done")
    ((_, _, fields),) = SessionReader(tmp_path).events("error")
    assert (fields["code"], fields["segment"]) == ("B-REC-004", 1)


def test_memory_is_bounded_while_the_disk_refuses(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(writer_module, "HELD_BYTES", 10_000)
    disk = FaultyFiles(lambda kind, n: None)
    writer = SessionWriter.create(tmp_path, MANIFEST, TEXTS, t_mono_ns=0, files=disk)
    disk.fault = lambda kind, n: no_space() if kind in ("write", "create") else None
    for second in range(10):
        writer.raw("port_a", "rx", second * NS, bytes(1000))
    with pytest.raises(RecordError, match="B-REC-003"):
        writer.raw("port_a", "rx", 10 * NS, bytes(1000))
    disk.fault = lambda kind, n: None
    writer.tick(30 * NS)
    writer.close("done")
    reader = SessionReader(tmp_path)
    assert reader.damage == []
    assert reader.counts["/link/port_a/rx"] == 10


def test_a_disk_is_waited_for_half_an_hour_and_no_longer(tmp_path: Path) -> None:
    disk = FaultyFiles(lambda kind, n: None)
    writer = SessionWriter.create(tmp_path, MANIFEST, TEXTS, t_mono_ns=0, files=disk)
    writer.clock_pair(0, 946_684_800 * NS)
    disk.fault = lambda kind, n: no_space() if kind in ("write", "create") else None
    with pytest.raises(RecordError, match="until 2000-01-01T00:30:10Z and 64 MB at most; then the run ends"):
        writer.tick(10 * NS)
    writer.raw("port_a", "rx", 1810 * NS, b"in time")
    with pytest.raises(RecordError, match="the disk takes nothing for 30 min"):
        writer.raw("port_a", "rx", 1811 * NS, b"late")
    with pytest.raises(RecordError, match="B-REC-001"):
        writer.close("done")
    disk.fault = lambda kind, n: None
    writer.close("done")  # there is room at last: what was held is kept, and the session is whole
    reader = SessionReader(tmp_path)
    assert (reader.damage, reader.unfinished, reader.counts["/link/port_a/rx"]) == ([], ["session.0001.mcap"], 1)


def test_the_time_for_which_a_disk_is_waited_for_begins_anew_when_it_has_written(tmp_path: Path) -> None:
    disk = FaultyFiles(lambda kind, n: None)
    writer = SessionWriter.create(tmp_path, MANIFEST, TEXTS, t_mono_ns=0, files=disk)
    for begin_s in (10, 2000):
        writer.raw("port_a", "rx", begin_s * NS, b"waits")
        disk.fault = lambda kind, n: no_space() if kind in ("write", "create") else None
        with pytest.raises(RecordError, match="B-REC-001"):
            writer.tick(begin_s * NS)
        disk.fault = lambda kind, n: None
        writer.tick((begin_s + 1000) * NS)
    writer.close("done")
    assert SessionReader(tmp_path).counts["/link/port_a/rx"] == 2


def test_a_folder_that_cannot_be_made(tmp_path: Path) -> None:
    (tmp_path / "file").write_text("in the way")
    with pytest.raises(RecordError, match="B-REC-001"):
        SessionWriter.create(tmp_path / "file", MANIFEST, TEXTS, t_mono_ns=0)


def test_an_existing_session_is_not_overwritten(tmp_path: Path) -> None:
    write_sample(tmp_path / "s", seconds=2)
    before = (tmp_path / "s" / "session.0001.mcap").read_bytes()
    with pytest.raises(RecordError, match="B-REC-001"):
        SessionWriter.create(tmp_path / "s", MANIFEST, TEXTS, t_mono_ns=0)
    assert (tmp_path / "s" / "session.0001.mcap").read_bytes() == before


def test_resume_continues_numbers_and_chain(tmp_path: Path) -> None:
    writer = SessionWriter.create(tmp_path, MANIFEST, TEXTS, t_mono_ns=0)
    writer.raw("port_a", "rx", NS, (0).to_bytes(4, "big"))
    writer.tick(NS)
    crashed = tmp_path / "session.0001.mcap"
    with crashed.open("ab") as stream:
        stream.write(b"\x06\x50\x00\x00\x00\x00\x00\x00\x00torn")
    before = crashed.read_bytes()
    again = resume_session(tmp_path, Resume(reason="power cut"), t_mono_ns=0)
    again.raw("port_a", "rx", NS, (1).to_bytes(4, "big"))
    sha256 = again.close("done")
    reader = SessionReader(tmp_path)
    assert crashed.read_bytes() == before
    assert (reader.damage, reader.unfinished) == ([], ["session.0001.mcap"])
    assert reader.sha256 == sha256
    assert [(fields["reason"], fields["segment"]) for _, _, fields in reader.events("resume")] == [("power cut", 2)]
    assert numbers_in(tmp_path) == [0, 1]


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
