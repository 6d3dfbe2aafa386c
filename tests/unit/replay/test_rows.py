"""A session decoded again gives the rows of the run, whatever happened on the way."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from record_sample import FRAME_NS, NS, Stream, frame, housekeeping, stream

from bench.frame import LinkDecoder
from bench.model.errors import InputError, SessionDamaged
from bench.model.events import Record, Resume
from bench.model.ports import RecordWindow
from bench.record import RecordCutter, RecordRow, SessionReader, SessionWriter
from bench.record.recover import resume_session
from bench.replay import replay_rows

LINKS = {"port_a": "ngu_a", "port_b": "ngu_b"}
MANIFEST = {"links": {link: f"frames/{name}.yaml" for link, name in LINKS.items()}, "measurement_link": "port_a"}
TEXTS = {f"frames/{name}.yaml": frame(name).text for name in LINKS.values()}


def fields_of(window: RecordWindow) -> dict[str, Any]:
    names = ("number", "link", "first_counter", "frames", "t_start_ns", "t_end_ns", "conditions", "step")
    return {name: getattr(window, name) for name in names}


class Live:
    """A run in miniature: reads once a second, decodes now and then, cuts records as bench.run does."""

    def __init__(self, writer: SessionWriter, made: Stream, decode_each: int) -> None:
        self.writer = writer
        self.made = made
        self.decode_each = decode_each
        self.decoders = {link: LinkDecoder(frame(name)) for link, name in LINKS.items()}
        self.cutter = RecordCutter(frame("ngu_a"))
        self.second = 0
        self.sent = 0
        self.last_counter = -1
        self.raw = made.frames.tobytes()

    def step(self) -> None:
        """One second passes."""
        self.second += 1
        t_ns = self.second * NS
        arrived = self.raw[self.sent : self.second * 5700 - 20]
        self.sent += len(arrived)
        for link, chunk in (("port_b", housekeeping(10, 10 * self.second)), ("port_a", arrived)):
            if chunk:
                self.writer.raw(link, "rx", t_ns, chunk)
                self.decoders[link].push(t_ns, chunk)
        if self.second % self.decode_each == 0:
            self.decode()
        self.writer.tick(t_ns)

    def decode(self) -> None:
        """Bring everything up to date."""
        self.cutter.feed_context(self.decoders["port_b"].flush())
        batch = self.decoders["port_a"].flush()
        counter = batch.messages["frame"].counter
        if counter is not None and len(counter):
            self.last_counter = int(counter[-1])
        self.cutter.feed(batch)

    def record(self, number: int, seconds: int, wait: int = 0, **conditions: Any) -> RecordRow:
        """Take one record of ``seconds``; ``wait`` more before it is given up."""
        self.decode()
        start_ns = self.second * NS
        window = RecordWindow(
            number, "port_a", self.last_counter + 2, 100 * seconds, start_ns, start_ns + seconds * NS, conditions, 7
        )
        self.cutter.open(window)
        for _ in range(seconds + 1 + wait):
            self.step()
        self.decode()
        self.writer.event("record", self.second * NS, fields_of(window))
        return self.cutter.close(number)


def same(row: RecordRow, other: RecordRow) -> None:
    assert row.window == other.window
    assert {name: value.tolist() for name, value in row.sums.items()} == {
        name: value.tolist() for name, value in other.sums.items()
    }
    assert (row.frames, row.lost, row.bad, row.quality) == (other.frames, other.lost, other.bad, other.quality)
    assert dict(row.context) == dict(other.context)
    assert (row.duplicate, row.suspect) == (other.duplicate, other.suspect)


def damaged_stream(seconds: int, seed: int) -> Stream:
    """Flipped bits in 1 % of the frames."""
    made = stream(seconds * 100, seed=seed)
    rng = np.random.default_rng(seed)
    for k in np.flatnonzero(rng.random(len(made.frames)) < 0.01).tolist():
        made.frames[k, int(rng.integers(0, 57))] ^= 1 << int(rng.integers(0, 8))
    return made


@pytest.mark.parametrize("damage", [False, True])
@pytest.mark.parametrize("decode_each", [1, 7])
def test_rows_of_the_run(tmp_path: Path, decode_each: int, damage: bool) -> None:
    writer = SessionWriter.create(tmp_path, MANIFEST, TEXTS, t_mono_ns=0)
    live = Live(writer, damaged_stream(60, 5) if damage else stream(6000), decode_each)
    for _ in range(3):
        live.step()
    taken = []
    for number in range(1, 6):
        purpose = "wiring" if number == 1 else "measurement"
        taken.append(live.record(number, 3 + number, channel=number, purpose=purpose))
        live.step()
    live.decode()
    counts = {link: decoder.counts for link, decoder in live.decoders.items()}
    sha256 = writer.close("done")
    done = replay_rows(tmp_path, strict=True)
    assert len(done.rows) == 5
    for row, other in zip(taken, done.rows, strict=True):
        same(row, other)
        assert row.context["unit_temperature_degC"] > 0
    assert done.counts == counts
    assert done.session_sha256 == sha256
    assert [row.window.number for row in done.measurement_rows] == [2, 3, 4, 5]
    assert done.totals["frames_bad"] == sum(link.bad for link in counts.values())
    if damage:
        assert sum(row.bad for row in done.rows) > 0
    assert done.manifest == MANIFEST
    assert done.texts == TEXTS


def test_a_record_that_was_given_up(tmp_path: Path) -> None:
    """The unit falls silent inside a record and goes on after the run stopped waiting."""
    made = stream(3000)
    writer = SessionWriter.create(tmp_path, MANIFEST, TEXTS, t_mono_ns=0)
    live = Live(writer, made, 1)
    live.step()
    whole, live.raw = live.raw, live.raw[: 57 * 450]
    short = live.record(1, 8)
    live.raw = whole
    live.step()
    again = live.record(2, 3)
    writer.close("done")
    assert (short.lost > 0, again.lost) == (True, 0)
    done = replay_rows(tmp_path)
    same(short, done.rows[0])
    same(again, done.rows[1])


def test_retaken_records_count_once(tmp_path: Path) -> None:
    writer = SessionWriter.create(tmp_path, MANIFEST, TEXTS, t_mono_ns=0)
    live = Live(writer, stream(3000), 1)
    live.step()
    live.record(1, 2)
    writer.event("retake", live.second * NS, {"record": 1, "reason": "calibrator tripped"})
    second = live.record(1, 2)
    live.record(2, 2)
    writer.event("retake", live.second * NS, {"record": 2, "reason": "calibrator tripped"})
    writer.close("done")
    done = replay_rows(tmp_path)
    assert len(done.rows) == 1
    same(second, done.rows[0])
    assert [event.kind for _, event in done.events].count("retake") == 2


def test_after_a_resume_counters_start_anew(tmp_path: Path) -> None:
    writer = SessionWriter.create(tmp_path, MANIFEST, TEXTS, t_mono_ns=0)
    live = Live(writer, stream(1000, first_counter=60_000), 1)
    live.step()
    before = live.record(1, 4)
    lost = live.record(2, 2)
    writer.tick(live.second * NS)
    again = resume_session(tmp_path, Resume(reason="crash"), t_mono_ns=0)
    resumed = Live(again, stream(1000, seed=9, first_counter=100), 1)
    resumed.step()
    after = resumed.record(2, 4)
    again.close("done")
    done = replay_rows(tmp_path)
    assert len(done.rows) == 2
    same(before, done.rows[0])
    moved, stop = done.rows[1].window, before.window.first_counter + before.window.frames
    assert moved.t_start_ns > lost.window.t_end_ns  # the clock began anew; without UTC the gap is taken for none
    assert moved.t_end_ns - moved.t_start_ns == after.window.t_end_ns - after.window.t_start_ns
    assert moved.first_counter > stop
    same(replace(after, window=moved), done.rows[1])
    assert done.unfinished == ("session.0001.mcap",)
    assert done.damage == ()


def test_a_damaged_chunk_costs_its_frames_only(tmp_path: Path) -> None:
    writer = SessionWriter.create(tmp_path, MANIFEST, TEXTS, t_mono_ns=0)
    live = Live(writer, stream(3000), 1)
    live.step()
    taken = [live.record(number, 4) for number in (1, 2, 3)]
    writer.close("done")
    path = tmp_path / "session.0001.mcap"
    content = bytearray(path.read_bytes())
    at = content.index(b"\x03\x00\x00\x00lz4", len(content) // 2)
    content[at + 300 : at + 340] = bytes(40)
    path.write_bytes(content)
    done = replay_rows(tmp_path)
    assert done.damage
    lost = [row.lost for row in done.rows]
    assert sorted(lost)[:2] == [0, 0]
    assert 0 < max(lost) <= 101
    for row, other in zip(taken, done.rows, strict=True):
        if other.lost == 0:
            same(row, other)
    with pytest.raises(SessionDamaged, match="B-REC-011"):
        replay_rows(tmp_path, strict=True)


def test_a_session_without_links_or_records(tmp_path: Path) -> None:
    SessionWriter.create(tmp_path, {"schema": 1}, {}, t_mono_ns=0).close("done")
    done = replay_rows(tmp_path)
    assert (done.rows, done.counts) == ((), {})


def test_a_definition_that_means_something_else_today_is_noted(tmp_path: Path) -> None:
    manifest = {**MANIFEST, "frame_sha256": {"port_a": "0" * 64, "port_b": frame("ngu_b").sha256}}
    SessionWriter.create(tmp_path, manifest, TEXTS, t_mono_ns=0).close("done")
    (note,) = replay_rows(tmp_path).notes
    assert "port_a" in note


def test_a_record_keeps_the_unit_it_belongs_to(tmp_path: Path) -> None:
    """Behind a splice too; the event of a record of a bench with one unit says nothing of it."""
    writer = SessionWriter.create(tmp_path, MANIFEST, TEXTS, t_mono_ns=0)
    for number, link, uut in ((1, "port_a", None), (2, "port_a", "SN 2"), (3, "", "SN 3")):
        window = RecordWindow(number, link, 10 * number, 10 if link else 0, 0, FRAME_NS, uut=uut)
        event = Record(**vars(window))
        assert ("uut" in event.document()) == (uut is not None)
        writer.event(event.kind, number, event.document())
        writer.event("resume", number, {"reason": "x"})
    writer.close("done")
    assert [row.window.uut for row in replay_rows(tmp_path).rows] == [None, "SN 2", "SN 3"]


def test_a_record_on_an_unknown_link(tmp_path: Path) -> None:
    writer = SessionWriter.create(tmp_path, {**MANIFEST, "links": {}}, TEXTS, t_mono_ns=0)
    writer.event("record", 0, fields_of(RecordWindow(1, "port_a", 0, 10, 0, FRAME_NS)))
    writer.close("done")
    with pytest.raises(InputError, match="B-RPL-001"):
        replay_rows(tmp_path)


def test_a_frame_file_that_is_missing(tmp_path: Path) -> None:
    SessionWriter.create(tmp_path, MANIFEST, {}, t_mono_ns=0).close("done")
    with pytest.raises(SessionDamaged, match="B-RPL-002"):
        replay_rows(tmp_path)


@pytest.mark.parametrize("missing", ["link", "first_counter", "conditions"])
def test_an_incomplete_record_event(tmp_path: Path, missing: str) -> None:
    writer = SessionWriter.create(tmp_path, MANIFEST, TEXTS, t_mono_ns=0)
    fields = fields_of(RecordWindow(1, "port_a", 0, 10, 0, FRAME_NS))
    del fields[missing]
    writer.event("record", 0, fields)
    writer.close("done")
    with pytest.raises(SessionDamaged, match="B-RPL-003"):
        replay_rows(tmp_path)


def test_reading_leaves_the_session_as_it_is(tmp_path: Path) -> None:
    SessionWriter.create(tmp_path, MANIFEST, TEXTS, t_mono_ns=0).close("done")
    before = {path.name: path.read_bytes() for path in tmp_path.iterdir()}
    replay_rows(tmp_path)
    assert not SessionReader(tmp_path, strict=True).damage
    assert {path.name: path.read_bytes() for path in tmp_path.iterdir()} == before
