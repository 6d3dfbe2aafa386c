"""Records as events tell them, parts on one axis, rows as in the run."""

import math
from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
from record_sample import FRAME_NS, frame
from rehearsal import tiny_plan

from bench.model.clock import NS, VirtualClock
from bench.model.errors import InputError, SessionDamaged
from bench.model.events import Record, event_of
from bench.model.ports import RecordWindow
from bench.model.quantities import Quality
from bench.record import RecordRow, SessionWriter
from bench.replay import compare, moved_rows, replay_rows
from bench.replay.parts import Part, RecordedWindow, intervals_ns, recorded_windows, splices_of, time_shifts_ns
from bench.run.operator import SimulatedOperator
from bench.run.session import conduct
from sim_instruments.faults.switchboard import LinkFaults

UTC = 1_800_000_000 * NS


def record(number: int, first: int, frames: int = 50, link: str = "imu", **more: Any) -> tuple[str, dict[str, Any]]:
    times = {"t_start_ns": 10**9 * number, "t_end_ns": 10**9 * number + 5}
    return "record", {"number": number, "link": link, "first_counter": first, "frames": frames, "conditions": {},
                      **times, **more}  # fmt: skip


def found(*events: tuple[str, dict[str, Any]]) -> list[RecordedWindow]:
    messages: Any = [
        SimpleNamespace(event=lambda one=one: one, t_ns=1000 + k, sequence=k) for k, one in enumerate(events)
    ]
    return recorded_windows(messages)


def test_a_record_follows_only_the_frame_behind_the_one_before_of_its_link_and_part() -> None:
    resume: tuple[str, dict[str, Any]] = ("resume", {})
    kept = found(
        record(1, 100), record(2, 150), record(3, 201), record(4, 251, link="egi"), resume, record(5, 301),
        record(6, 351), record(8, 401),
    )  # fmt: skip
    assert [one.chained for one in kept] == [False, True, False, False, False, True, False]
    assert [one.part for one in kept] == [0, 0, 0, 0, 1, 1, 1]
    assert [one.until_ns for one in kept] == [1000, 1001, 1002, 1003, 1005, 1006, 1007]


def test_what_is_taken_back_or_taken_again_does_not_count() -> None:
    kept = found(record(1, 100), record(2, 150), ("retake", {"record": 2}), record(2, 180), record(3, 230))
    assert [(one.window.number, one.window.first_counter, one.chained) for one in kept] == [
        (1, 100, False), (2, 180, False), (3, 230, True),
    ]  # fmt: skip
    assert found(record(1, 100), record(1, 120))[0].window.first_counter == 120


def test_marks_of_a_record() -> None:
    plain, marked = found(record(1, 0), record(2, 50, step=7, samples=True, pulse_timing=True))
    assert (plain.sampled, plain.timed, plain.window.step) == (False, False, -1)
    assert (marked.sampled, marked.timed, marked.window.step) == (True, True, 7)


@pytest.mark.parametrize(
    "name", ["number", "link", "first_counter", "frames", "t_start_ns", "t_end_ns", "conditions", "step"]
)
@pytest.mark.parametrize("value", ["missing", None, [1]])
def test_a_record_event_that_lacks_a_field_is_damage(name: str, value: Any) -> None:
    kind, fields = record(1, 0, step=3)
    if value == "missing" and name != "step":  # which a record need not have
        del fields[name]
    else:
        fields[name] = value
    with pytest.raises(SessionDamaged, match=f"not complete: {name}") as caught:
        found((kind, fields))
    assert (caught.value.code, caught.value.where) == ("B-RPL-003", "message 0")


def test_what_other_software_writes_with_a_record_is_no_damage() -> None:
    (kept,) = found(record(1, 0, frames=50.0, samples=None, pulse_timing=1, readings="many", color="red"))
    assert (kept.window.frames, kept.sampled, kept.timed) == (50, False, False)


def part(first_s: float, last_s: float, utc_at_0_s: float | None) -> Part:
    offset = None if utc_at_0_s is None else UTC + round(utc_at_0_s * NS)
    return Part(round(first_s * NS), round(last_s * NS), offset)


def row(number: int, first_counter: int, start_s: float, frames: int = 100) -> RecordRow:
    window = RecordWindow(number, "port_a", first_counter, frames, round(start_s * NS), round((start_s + 1) * NS))
    timing = {"npp.first": np.array([first_counter, -1]), "npp.moment1": np.array([5, 0])}
    return RecordRow(window, {"npp": np.array([3, 0])}, frames, 0, 0, Quality.GOOD, timing=timing)


def test_a_reboot_leaves_a_gap_and_time_never_runs_backwards() -> None:
    """100 s of recording, half an hour away, the clock begins again at 5 s."""
    shifts = time_shifts_ns([part(0, 100, 0.0), part(5, 50, 1895.0)])
    assert shifts == [0, 1895 * NS]
    assert 5 * NS + shifts[1] - 100 * NS == 1800 * NS
    assert time_shifts_ns([part(0, 100, 0.0), part(400, 500, 0.0)]) == [0, 0]
    assert time_shifts_ns([part(0, 100, 0.0), part(400, 500, -2.0)]) == [0, 0]
    assert time_shifts_ns([part(0, 100, None), part(5, 50, None)]) == [0, 95 * NS]
    assert time_shifts_ns([part(0, 100, 0.0), part(5, 50, -3600.0)]) == [0, 95 * NS]
    assert time_shifts_ns([Part(), Part()]) == [0, 0]
    shifts = time_shifts_ns([part(0, 100, 0.0), part(5, 50, 1000.0), part(2, 9, 2000.0)])
    assert shifts == [0, 1000 * NS, 2000 * NS]


def test_the_time_away_is_unknown_without_a_sound_utc() -> None:
    """Whether the monotonic clock went on (400 s) or began anew (5 s): without UTC nobody knows which."""
    for first_s in (400, 5):
        assert intervals_ns([part(0, 100, 0.0), part(first_s, 500, -3600.0)]) == [None]
        assert intervals_ns([part(0, 100, None), part(first_s, 500, 0.0)]) == [None]
        assert time_shifts_ns([part(0, 100, 0.0), part(first_s, 500, -3600.0)]) == [0, (100 - first_s) * NS]
    assert intervals_ns([part(0, 100, 0.0), part(5, 50, 1895.0), part(60, 70, 1895.0)]) == [1800 * NS, 10 * NS]
    assert intervals_ns([part(0, 100, 0.0), part(101, 50, -2.0)]) == [1 * NS], "set right, on one running clock"
    begun = replace(part(0, 100, 0.0), last_offset_ns=UTC + 3600 * NS)
    assert intervals_ns([begun, part(5, 50, 3600.0 + 1895.0)]) == [1800 * NS]


def test_counters_go_on_with_the_frames_of_the_gap_and_never_join() -> None:
    before, after = row(1, 500, 10.0), row(2, 7, 5.0)
    moved = moved_rows([(0, before), (1, after), (1, row(3, 107, 6.0))], [0, 1895 * NS])
    assert moved[0] is before
    assert moved[1].window.t_start_ns == 1900 * NS
    assert moved[1].window.first_counter == 601 + ((1900 - 11) * 100)
    assert moved[2].window.first_counter == moved[1].window.first_counter + 100
    assert moved[1].timing["npp.first"].tolist() == [moved[1].window.first_counter, -1]
    assert moved[1].timing["npp.moment1"].tolist() == [5, 0]
    joined = moved_rows([(0, before), (1, replace(after, window=replace(after.window, t_start_ns=11 * NS)))], [0, 0])
    assert joined[1].window.first_counter > 600


def test_splices_are_told_with_what_was_done_again() -> None:
    events: list[tuple[str, int, dict[str, Any]]] = [
        ("resume", 5, {"stopped_utc_ns": 1, "utc_ns": 2, "away_s": 9.0, "start": 7, "reason": "x", "unit_degC": 20.0}),
        ("reentry", 6, {"step": 7, "unit_degC": 18.5, "soaked": True}),
        ("reentry", 8, {"step": 9, "unit_degC": 1.0, "soaked": False}),  # after a hold: another step
        ("resume", 9, {"reason": "by other software"}),
        ("reentry", 9, {"unit_degC": 3.0, "soaked": True}),  # of no step that is known
    ]
    parts = [part(0, 1, 0.0), part(2, 3, 0.0), part(5, 6, 0.0)]
    first, second = splices_of(((t_ns, event_of(kind, fields)) for kind, t_ns, fields in events), parts)
    assert (first.step, first.away_s, first.reason, first.soaked, first.drift_degC) == (7, 9.0, "x", True, -1.5)
    assert (second.step, second.drift_degC, second.stopped_utc_ns) == (-1, None, None)


@pytest.mark.parametrize(
    ("away_s", "utc_s", "expected"),
    [
        (9.0, 20.0, (9.0, True)),
        (-3595.0, -3600.0, (None, False)),
        (-1.0, -2.0, (1.0, True)),
        (None, None, (None, False)),
    ],
)
def test_no_time_away_is_negative(
    away_s: float | None, utc_s: float | None, expected: tuple[float | None, bool]
) -> None:
    resume = event_of("resume", {"reason": "x", "away_s": away_s})
    (splice,) = splices_of([(5, resume)], [part(0, 100, 0.0), part(101, 200, utc_s)])
    assert (splice.away_s, splice.placed) == expected


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


RESULTS: dict[str, Any] = {
    "session": "s", "estimates": [{"quantity": "dsf_n", "value": 412.31, "n": 14, "limit": None}],
    "quality": {"records": 7},
}  # fmt: skip


def test_the_same_document() -> None:
    assert compare(RESULTS, {**RESULTS}) == []
    assert compare([math.nan, math.inf], [math.nan, math.inf]) == []


@pytest.mark.parametrize(
    ("first", "second"),
    [
        (0.1 + 0.2, 0.3), (1.0, math.nan), (1, 1.0), (0.0, -0.0), ("1", 1), (None, 0), (True, 1), ([1], 1), ({}, []),
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
