"""A session decoded again gives the rows of the run bit for bit, whatever happened on the way; equality of results."""

from __future__ import annotations

import math
from pathlib import Path
from typing import Any

import pytest
from record_sample import FRAME_NS, frame
from rehearsal import tiny_plan

from bench.model.clock import VirtualClock
from bench.model.errors import InputError, SessionDamaged
from bench.model.events import Record
from bench.model.ports import RecordWindow
from bench.record import RecordRow, SessionReader, SessionWriter
from bench.replay import compare, replay_rows
from bench.run.control.operator import SimulatedOperator
from bench.run.session import conduct
from sim_instruments.faults.switchboard import LinkFaults

LINKS = {"port_a": "ngu_a", "port_b": "ngu_b"}
MANIFEST = {"links": {link: f"frames/{name}.yaml" for link, name in LINKS.items()}, "measurement_link": "port_a"}
TEXTS = {f"frames/{name}.yaml": frame(name).text for name in LINKS.values()}


def fields_of(window: RecordWindow) -> dict[str, Any]:
    names = ("number", "link", "first_counter", "frames", "t_start_ns", "t_end_ns", "conditions", "step")
    return {name: getattr(window, name) for name in names}


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


def test_a_link_or_a_frame_file_that_is_missing_is_damage(tmp_path: Path) -> None:
    writer = SessionWriter.create(tmp_path, {**MANIFEST, "links": {}}, TEXTS, t_mono_ns=0)
    writer.event("record", 0, fields_of(RecordWindow(1, "port_a", 0, 10, 0, FRAME_NS)))
    writer.close("done")
    with pytest.raises(InputError, match="B-RPL-001"):
        replay_rows(tmp_path)
    SessionWriter.create(tmp_path / "other", MANIFEST, {}, t_mono_ns=0).close("done")
    with pytest.raises(SessionDamaged, match="B-RPL-002"):
        replay_rows(tmp_path / "other")


def test_reading_leaves_the_session_as_it_is(tmp_path: Path) -> None:
    SessionWriter.create(tmp_path, MANIFEST, TEXTS, t_mono_ns=0).close("done")
    before = {path.name: path.read_bytes() for path in tmp_path.iterdir()}
    replay_rows(tmp_path)
    assert not SessionReader(tmp_path, strict=True).damage
    assert {path.name: path.read_bytes() for path in tmp_path.iterdir()} == before


RESULTS: dict[str, Any] = {
    "session": "s", "estimates": [{"quantity": "dsf_n", "value": 412.31, "n": 14, "limit": None}],
    "quality": {"records": 7},
}  # fmt: skip


def test_the_same_document() -> None:
    assert compare(RESULTS, {**RESULTS}) == []
    assert compare([math.nan, math.inf], [math.nan, math.inf]) == []


def test_a_number_is_not_nan() -> None:
    assert [item.path for item in compare([1.0], [math.nan])] == ["[0]"]


@pytest.mark.parametrize(
    ("first", "second"),
    [
        (0.1 + 0.2, 0.3), (1, 1.0), (0.0, -0.0), ("1", 1), (None, 0), (True, 1), ([1], 1), ({}, []),
        ("ab", ["a", "b"]), (412.31, math.nextafter(412.31, 500.0)),
    ],
)  # fmt: skip
def test_anything_else_differs(first: Any, second: Any) -> None:
    (difference,) = compare({"x": first}, {"x": second})
    assert (difference.path, difference.first, difference.second) == ("x", first, second)


def test_paths_lead_to_the_value() -> None:
    other = {
        "session": "s", "estimates": [{"quantity": "dsf_n", "value": 412.32, "n": 14}, {"quantity": "bias"}],
        "quality": {"records": 7, "splices": 0},
    }  # fmt: skip
    found = [str(difference) for difference in compare(RESULTS, other)]
    assert found == [
        "estimates[0].limit: None != '(absent)'",
        "estimates[0].value: 412.31 != 412.32",
        "estimates[1]: '(absent)' != {'quantity': 'bias'}",
        "quality.splices: '(absent)' != 0",
    ]


RUN_SEED = 3
BIT_ERROR_RATE = 2e-6
FRAME_RATE = 2e-4  # of dropped and of repeated frames


class Silence:
    """Watches a run and says nothing."""

    def __getattr__(self, name: str) -> Any:
        return lambda *_: None


def comparable(row: RecordRow) -> tuple[object, ...]:
    sums = {name: value.tolist() for name, value in row.sums.items()}
    counts = (row.frames, row.lost, row.bad, row.duplicate, row.suspect)
    return row.window, sums, counts, row.quality, dict(row.context)


def test_replay_of_a_run_over_a_noisy_cable(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    plain = LinkFaults.__init__

    def noisy(self: LinkFaults, *args: Any, **options: Any) -> None:
        plain(self, *args, **options)
        self.bit_error_rate, self.drop_rate, self.duplicate_rate = BIT_ERROR_RATE, FRAME_RATE, FRAME_RATE

    monkeypatch.setattr(LinkFaults, "__init__", noisy)
    plan = tiny_plan(tmp_path)
    run = conduct(
        plan, clock=VirtualClock(), seed=RUN_SEED, out=tmp_path, operator=SimulatedOperator(), listener=Silence(),
        keep_events=("retake",),
    )  # fmt: skip
    assert run.outcome.error is None
    again = replay_rows(run.folder, strict=True)
    assert run.counts["frames_bad"] > 0, f"seed {RUN_SEED}"
    assert len(run.events) > 0, f"seed {RUN_SEED}: no record was retaken"
    assert any(row.duplicate for row in run.outcome.rows)
    assert [comparable(row) for row in again.measurement_rows] == [comparable(row) for row in run.outcome.rows]
    assert again.totals == dict(run.counts)
    assert again.session_sha256 == run.session_sha256
