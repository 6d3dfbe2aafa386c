"""What a damaged session still holds, and a clean copy of it."""

from __future__ import annotations

import json
from pathlib import Path

import pytest
from record_sample import MANIFEST, NS, TEXTS, write_sample

from bench.model.errors import InputError
from bench.model.events import Resume
from bench.record import Journal, SessionReader, SessionWriter
from bench.record import recover as recover_module
from bench.record.recover import recover_session, resume_session, salvage


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


def test_salvage_copies_every_good_message_and_keeps_the_gap(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(recover_module, "_SALVAGE_SEGMENT_BYTES", 3000)
    monkeypatch.setattr(recover_module, "CHUNK_BYTES", 2000)
    write_sample(tmp_path / "s")
    damage_middle(tmp_path / "s")
    lost = recover_session(tmp_path / "s").lost
    good = [m for m in SessionReader(tmp_path / "s").messages() if m.topic != "/chain"]
    assert salvage(tmp_path / "s", tmp_path / "copy") == len(good)
    copy = SessionReader(tmp_path / "copy")
    assert [m for m in copy.messages() if m.topic != "/chain"] == good
    assert [(item.what, item.lost) for item in copy.damage] == [("messages are missing", lost)]
    assert copy.unfinished == []
    assert len(copy.segments) > 1
    assert copy.manifest == MANIFEST


def test_salvage_of_several_segments_is_whole(tmp_path: Path) -> None:
    writer = SessionWriter.create(tmp_path / "s", MANIFEST, TEXTS, t_mono_ns=0)
    writer.tick(0)
    again = resume_session(tmp_path / "s", Resume(reason="crash"), t_mono_ns=0)
    again.close("done")
    salvage(tmp_path / "s", tmp_path / "copy")
    copy = SessionReader(tmp_path / "copy")
    assert (copy.damage, copy.unfinished) == ([], [])
    assert [kind for kind, _, _ in copy.events()] == ["resume", "closed"]


def test_salvage_does_not_overwrite(tmp_path: Path) -> None:
    write_sample(tmp_path / "s")
    with pytest.raises(InputError, match="B-REC-013"):
        salvage(tmp_path / "s", tmp_path / "s")
