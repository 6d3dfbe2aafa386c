"""The step journal, never a step that did not happen; what a damaged session still holds."""

import errno
import json
import zlib
from pathlib import Path

import pytest
from record_sample import MANIFEST, NS, TEXTS, FaultyFiles, io_error, no_space, write_sample

from bench.model.errors import InputError
from bench.record import (
    Journal,
    JournalEntry,
    RecordError,
    SessionWriter,
    read_journal,
    recover_session,
)
from bench.record.journal import JOURNAL_NAME, is_being_written


def written(folder: Path, count: int = 20) -> list[JournalEntry]:
    journal = Journal(folder)
    entries = []
    for number in range(count):
        conditions = {"channel": number % 10 + 1, "temperature_degC": -10.0, "kind": "gyro"}
        journal.step(number, "campaign", number * 1000, conditions)
        entries.append(JournalEntry(number, "campaign", number * 1000, conditions))
    journal.sync()
    journal.close()
    return entries


def test_cut_anywhere_gives_the_whole_lines_before(tmp_path: Path) -> None:
    entries = written(tmp_path, 8)
    path = tmp_path / JOURNAL_NAME
    content = path.read_bytes()
    for stop in range(len(content) + 1):
        path.write_bytes(content[:stop])
        state = read_journal(tmp_path)
        assert list(state.entries) == entries[: content[:stop].count(b"\n")]
        assert state.torn == (stop != state.good_bytes)


def test_flipped_bits_and_lines_out_of_place_end_the_good_part(tmp_path: Path) -> None:
    entries = written(tmp_path, 5)
    path = tmp_path / JOURNAL_NAME
    content = path.read_bytes()
    lines = content.splitlines(keepends=True)
    path.write_bytes(lines[0] + lines[2] + lines[1])
    assert list(read_journal(tmp_path).entries) == entries[:1]
    for at in range(len(content)):
        for bit in (0, 3, 7):
            damaged = bytearray(content)
            damaged[at] ^= 1 << bit
            path.write_bytes(damaged)
            assert list(read_journal(tmp_path).entries) == entries[: content[:at].count(b"\n")]


@pytest.mark.parametrize("tail", [b"00000000 {torn", bytes(500) + b"\n" + b'{"n":4}\n'])
def test_reopened_journal_goes_on_behind_its_good_part(tmp_path: Path, tail: bytes) -> None:
    entries = written(tmp_path, 3)
    path = tmp_path / JOURNAL_NAME
    content = path.read_bytes()
    path.write_bytes(content + tail)
    journal = Journal(tmp_path)
    assert path.read_bytes() == content
    assert list(read_journal(tmp_path).entries) == entries
    journal.step(3, "campaign", 9, {})
    journal.close()
    state = read_journal(tmp_path)
    assert [entry.number for entry in state.entries] == [0, 1, 2, 3]
    assert not state.torn


def test_a_full_disk_keeps_the_lines_before(tmp_path: Path) -> None:
    disk = FaultyFiles(lambda kind, n: {3: 10, 4: no_space()}.get(n) if kind == "write" else None)
    journal = Journal(tmp_path, disk)
    journal.step(0, "campaign", 0, {})
    journal.step(1, "campaign", 1, {})
    for _ in range(2):
        with pytest.raises(RecordError, match="B-REC-005"):
            journal.step(2, "campaign", 2, {})
    journal.step(2, "campaign", 3, {})
    journal.close()
    assert [entry.t_mono_ns for entry in read_journal(tmp_path).entries] == [0, 1, 3]


def test_a_torn_line_that_cannot_be_cut_back_is_cut_before_the_next(tmp_path: Path) -> None:
    """The disk is read-only for a while: neither call is an error nobody foresaw, and no line follows a torn one."""
    read_only = OSError(errno.EROFS, "read-only file system")
    faults = {("write", 2): 10, ("truncate", 1): read_only, ("truncate", 2): read_only}
    journal = Journal(tmp_path, FaultyFiles(lambda kind, n: faults.get((kind, n))))
    journal.step(0, "campaign", 0, {})
    for _ in range(2):
        with pytest.raises(RecordError, match="B-REC-005"):
            journal.step(1, "campaign", 1, {})
    journal.step(1, "campaign", 2, {})
    journal.close()
    state = read_journal(tmp_path)
    assert [entry.t_mono_ns for entry in state.entries] == [0, 2]
    assert not state.torn


def test_a_journal_that_may_not_be_on_the_disk_says_so(tmp_path: Path) -> None:
    journal = Journal(tmp_path, FaultyFiles(lambda kind, n: io_error() if kind == "sync" and n == 1 else None))
    journal.step(0, "campaign", 0, {})
    with pytest.raises(RecordError, match="B-REC-005"):
        journal.sync()
    journal.sync()
    journal.close()


def test_two_writers_of_one_journal_and_a_folder_that_is_not_there_are_refused(tmp_path: Path) -> None:
    """The lock is the kernel's: it is gone with its holder, however that ends."""
    assert not is_being_written(tmp_path)
    journal = Journal(tmp_path)
    assert is_being_written(tmp_path)
    with pytest.raises(RecordError, match="B-REC-006"):
        Journal(tmp_path)
    journal.close()
    journal.close()
    assert not is_being_written(tmp_path)
    Journal(tmp_path).close()
    with pytest.raises(RecordError, match="B-REC-005"):
        Journal(tmp_path / "not there")


def test_a_step_that_set_something_says_what(tmp_path: Path) -> None:
    journal = Journal(tmp_path)
    journal.step(0, "campaign", 0, {}, {"calibrator.output": {"current": 0.01}})
    journal.step(1, "campaign", 0, {}, {})
    journal.close()
    set_by = [entry.setpoint for entry in read_journal(tmp_path).entries]
    assert set_by == [{"calibrator.output": {"current": 0.01}}, {}]


def in_another_form(path: Path, change: dict[str, object], first: int = 1) -> bytes:
    """Write the lines from a number on as another version would, with right sums; returns the content."""
    content = b""
    for number, line in enumerate(path.read_bytes().splitlines(), 1):
        fields = json.loads(line[9:])
        fields = {**fields, **change} if number >= first else fields
        text = json.dumps({name: value for name, value in fields.items() if value is not None}).encode()
        content += b"%08x %b\n" % (zlib.crc32(text, number), text)
    path.write_bytes(content)
    return content


@pytest.mark.parametrize(
    "change",
    [{"n": None, "number": 1}, {"v": 2}, {"set": {}}, {"t": "0 s"}, {"c": []}, {"n": True}],
)
@pytest.mark.parametrize("first", [1, 3])
@pytest.mark.parametrize("tail", [b"", b"0123", bytes(40)])
def test_another_version_is_refused_not_cut(tmp_path: Path, change: dict[str, object], first: int, tail: bytes) -> None:
    written(tmp_path, 5)
    path = tmp_path / JOURNAL_NAME
    content = in_another_form(path, change, first) + tail
    path.write_bytes(content)
    for attempt in (lambda: read_journal(tmp_path), lambda: Journal(tmp_path)):
        with pytest.raises(InputError, match="written by another version") as caught:
            attempt()
        assert (caught.value.code, int(caught.value.exit_status)) == ("B-REC-007", 2)
        assert caught.value.where == f"{path}:{first}"
    assert path.read_bytes() == content
    assert not is_being_written(tmp_path)


def test_what_is_no_json_and_has_a_right_sum_is_of_another_version(tmp_path: Path) -> None:
    for text in (b"", b"\x81\xa1n", b"[1]", b"4"):
        (tmp_path / JOURNAL_NAME).write_bytes(b"%08x %b\n" % (zlib.crc32(text, 1), text))
        with pytest.raises(InputError, match="B-REC-007"):
            read_journal(tmp_path)


def test_a_crashed_run(tmp_path: Path) -> None:
    writer = SessionWriter.create(tmp_path, MANIFEST, TEXTS, t_mono_ns=0)
    journal = Journal(tmp_path)
    for number in range(1, 4):
        writer.event("record", number * NS, {"number": number})
        journal.step(number, "campaign", number * NS, {})
        writer.tick(number * NS)
    found = recover_session(tmp_path)
    assert (found.records, found.steps, found.unfinished) == ((1, 2, 3), 3, ("session.0001.mcap",))
    assert any("the run did not end" in line for line in found.lines())
    assert json.loads(json.dumps(found.as_json()))["journal_steps"] == 3


def test_a_journal_of_another_version_is_told_and_the_rest_is_listed(tmp_path: Path) -> None:
    write_sample(tmp_path / "s")
    (tmp_path / "s" / "journal.jsonl").write_bytes(b"%08x {}\n" % zlib.crc32(b"{}", 1))
    found = recover_session(tmp_path / "s")
    assert (found.damaged, found.steps) == (False, 0)
    assert any("B-REC-007" in line for line in found.lines())
    assert "B-REC-007" in found.as_json()["journal_refused"]
