"""What a damaged session still holds."""

from __future__ import annotations

import json
import zlib
from pathlib import Path

from record_sample import MANIFEST, NS, TEXTS, write_sample

from bench.record import Journal, SessionReader, SessionWriter
from bench.record.recover import recover_session


def damage_middle(session: Path) -> None:
    path = session / "session.0001.mcap"
    content = bytearray(path.read_bytes())
    middle = len(content) // 3
    content[middle : middle + 40] = bytes(40)
    path.write_bytes(content)


def test_a_whole_session(tmp_path: Path) -> None:
    write_sample(tmp_path / "s")
    found = recover_session(tmp_path / "s")
    assert (found.damaged, found.lost, found.unfinished, found.has_manifest) == (False, 0, (), True)
    assert found.counts["/link/port_a/rx"] == 20
    assert found.span_s == 20.0
    assert "nothing is damaged" in found.lines()


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


def test_a_damaged_session_says_what_is_lost(tmp_path: Path) -> None:
    write_sample(tmp_path / "s")
    damage_middle(tmp_path / "s")
    found = recover_session(tmp_path / "s")
    assert found.damaged
    assert found.lost > 0
    kept = sum(count for topic, count in found.counts.items() if topic != "/chain")
    assert kept + found.lost == SessionReader(tmp_path / "s").next_sequence
    text = found.as_json()
    assert text["lost"] == found.lost
    assert {"segment", "byte", "what", "lost"} == set(text["damage"][0])
