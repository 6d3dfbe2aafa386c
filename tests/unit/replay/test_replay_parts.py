"""Records as events tell them, parts on one axis, rows as in the run; and delimited text as loggers write it."""

import math
import operator
import random
import re
from dataclasses import replace
from decimal import Decimal
from itertools import pairwise
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
from imported_logs import LOG, SHORT
from record_sample import FRAME_NS, frame
from rehearsal import tiny_plan

from bench.model.clock import NS, VirtualClock
from bench.model.errors import InputError, SessionDamaged
from bench.model.events import Record, event_of
from bench.model.ports import RecordWindow
from bench.model.quantities import Quality
from bench.model.yamlio import parse_yaml
from bench.plan.language.mapping import LogMapping, mapping_model
from bench.record import RecordRow, SessionWriter
from bench.replay import compare, moved_rows, replay_rows
from bench.replay.delimited import MAX_LINE_BYTES, LogParser, lines_of
from bench.replay.parts import Part, RecordedWindow, intervals_ns, recorded_windows, splices_of, time_shifts_ns
from bench.replay.series import file_lines, survey
from bench.run.control.operator import SimulatedOperator
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


UTC_2024_ns = 1_704_067_200 * 10**9  # 2024-01-01T00:00:00Z


def mapped(*changes: tuple[str, str]) -> LogMapping:
    text = SHORT
    for old, new in changes:
        assert old in text
        text = text.replace(old, new, 1)
    return parse_yaml(text, "m.yaml", mapping_model()).model


def read(content: bytes, mapping: LogMapping, cut: int = 1 << 30) -> tuple[list[Any], LogParser]:
    parser = LogParser(mapping, "log.csv")
    lines = list(lines_of(content[at : at + cut] for at in range(0, len(content), cut)))
    rows = [(parser.last_ns, row) for line in lines if (row := parser.row(line)) is not None]
    at_once = LogParser(mapping, "log.csv")
    blocks = np.concatenate([block for _, block in at_once.read(lines)])
    np.testing.assert_array_equal(blocks, [((t_ns - parser.first_ns) / NS, *row) for t_ns, row in rows] or blocks)
    assert len(blocks) == len(rows)
    told = operator.attrgetter("counts", "size", "first_ns", "last_ns")
    assert told(at_once) == told(parser)
    assert at_once.digest.digest() == parser.digest.digest()
    return rows, parser


def surveyed(tmp_path: Path, content: bytes, mapping: LogMapping | None = None) -> LogParser:
    path = tmp_path / "log.csv"
    path.write_bytes(content)
    return survey(file_lines(path), mapping or mapped(), str(path))[0]


NUMBERS = [
    "format: elapsed, unit: s, start: 2024-01-01T00:00:00Z",
    "format: elapsed, unit: min, start: 2024-01-01T00:00:00Z",
    "format: unix, unit: ms",
    "format: samples, rate: 300 Hz, start: 2024-01-01T00:00:00Z",
]
_ODD = [
    "",
    "# x",
    '"5",1,2',
    "5,1",
    "5,1,2,",
    "5,1_0,2",
    "5,nan,2",
    "5,OL,2",
    "5,9.9e37,2",
    "5,0x10,2",
    "5,1e400,2",
    "\0",
]


@pytest.mark.parametrize("seed", range(60))
def test_a_log_that_is_read_at_once_holds_what_its_lines_do(seed: int) -> None:
    draw = random.Random(seed)
    step = draw.choice(["0.01", "0.001", "1e-9", "0.0000000004", "0.1234567890123456", "86400.25", "4294.967"])
    start = draw.choice([0, 0, 1_714_636_800])
    times = [start + number * Decimal(step) for number in range(300)]
    lines = [f"{t},{draw.gauss(20, 1):.{draw.randint(0, 17)}f}, {draw.gauss(0, 9):g} " for t in times]
    for _ in range(draw.choice([0, 0, 1, 5])):
        lines.insert(draw.randrange(1, len(lines)), draw.choice(_ODD))
    if draw.random() < 0.2:
        at = draw.randrange(1, len(lines) - 1)
        lines[at], lines[at + 1] = lines[at + 1], lines[at]
    end = draw.choice(["\n", "\r\n"])
    content = end.join(["time,T,U", *lines, lines[-1][: draw.choice([0, 3, 9, 99])]])
    mapping = mapped(
        (BY_NUMBER[0], draw.choice(NUMBERS)), ("uut:", draw.choice(["uut:", 'file: {comment: "#"}\nuut:']))
    )
    try:
        rows, _ = read(content.encode(), mapping)
    except InputError as error:
        with pytest.raises(InputError, match=re.escape(str(error))):
            list(LogParser(mapping, "log.csv").read(lines_of([content.encode()])))
    else:
        assert len(rows) >= 290 or start


def test_a_plain_log_in_base_units() -> None:
    rows, parser = read(LOG.encode(), mapped())
    assert [t_ns - UTC_2024_ns for t_ns, _ in rows] == [0, 10 * 10**9]
    assert [values for _, values in rows] == [[20.5, 1.0], [20.6, pytest.approx(1.001, rel=1e-15)]]
    assert parser.counts.sentences() == []


@pytest.mark.parametrize(
    ("form", "text"),
    [
        ('delimiter: ";", decimal: ","', "time;T;U\n2024-01-01T00:00:00;20,5;1000\n"),
        ("delimiter: whitespace", "time  T\tU\n2024-01-01T00:00:00   20.5 1000\n"),
        ('delimiter: "\\t"', "time\tT\tU\n2024-01-01T00:00:00\t20.5\t1000\n"),
        ('comment: "#"', "# made by a logger\n\n#\ntime,T,U\n# pause\n2024-01-01T00:00:00,20.5,1000"),
        ("header: 3", "Logger 5\nSerial,12,x,y\ntime,T,U\n2024-01-01T00:00:00,20.5,1000\n"),
        ("encoding: latin-1", "time,T,U,T [\xb0C]\n2024-01-01T00:00:00,20.5,1000,\xb0\n"),
        ("delimiter: ','", '"time","T","U","a ""b"", c"\n"2024-01-01T00:00:00",20.5," 1000 ","x,y"\n'),
        ("delimiter: ','", "\ufefftime , T,U,\r\n2024-01-01T00:00:00,20.5,1000,\r\n"),
    ],
)
def test_forms_of_files(form: str, text: str) -> None:
    encoding = "latin-1" if "latin-1" in form else "utf-8"
    rows, parser = read(text.encode(encoding), mapped(("uut:", f"file: {{{form}}}\nuut:")))
    assert rows == [(UTC_2024_ns, [20.5, 1.0])]
    assert parser.counts.bad_rows == 0


@pytest.mark.parametrize(
    ("column", "text", "after_2024_s"),
    [
        ("format: iso, zone: UTC", "2024-01-01T00:00:00.25", 0.25),
        ("format: iso, zone: +02:00", "2024-01-01 02:00:00", 0.0),
        ("format: iso, zone: UTC", "2023-12-31T19:00:01-05:00", 1.0),
        ("format: unix, unit: ms", "1704067200125", 0.125),
        ("format: elapsed, unit: min, start: 2024-01-01T01:00:00+01:00", "1.5", 90.0),
        ('format: "%d.%m.%Y %H:%M:%S", zone: -01:30', "31.12.2023 22:30:02", 2.0),
        ('format: "%m/%d/%y %I:%M:%S %p", zone: UTC', "01/01/24 12:00:03 AM", 3.0),
        ('format: "%Y%m%d%H%M%S%z"', "20240101010004+0100", 4.0),
    ],
)
def test_times(column: str, text: str, after_2024_s: float) -> None:
    rows, _ = read(f"time,T,U\n{text},20,1\n".encode(), mapped(("format: iso, zone: UTC", column)))
    assert rows[0][0] - UTC_2024_ns == round(after_2024_s * 1e9)


def test_overloads_are_left_out_and_counted_never_read_as_numbers() -> None:
    text = "time,T,U\n" + "".join(
        f"2024-01-01T00:00:0{index},20,{value}\n"
        for index, value in enumerate(("1", "9.9E+37", "-1e38", "OL", " ol ", "-999"))
    )
    mapping = mapped(("uut:", "overload: {at_least: 1e37, values: [OL, -999]}\nuut:"))
    rows, parser = read(text.encode(), mapping)
    assert [math.isnan(values[1]) for _, values in rows] == [False, True, True, True, True, True]
    assert (parser.counts.rows, parser.counts.overload_rows, parser.counts.overloads) == (6, 5, {"voltage": 5})
    (said,) = parser.counts.sentences()
    assert said == "5 of 6 rows of the log have a cell that is empty or that the mapping calls an overload (voltage 5)."


@pytest.mark.parametrize(
    ("row", "why"),
    [
        ("2024-01-01T00:00:10,20", "2 fields, 3 are due"),
        ("2024-01-01T00:00:10,20,", "'' is no number"),
        ("2024-01-01T00:00:10,20,1_0", "'1_0' is no number"),
        ("2024-01-01T00:00:10,20,nan", "'nan' is not finite"),
        ("yesterday,20,1", "'yesterday' is no time"),
        ('2024-01-01T00:00:10,20,"1', "quotation marks"),
    ],
)
def test_a_bad_row_is_counted_and_listed_with_its_line(row: str, why: str) -> None:
    rows, parser = read((LOG + row + "\n2024-01-01T00:00:20,21,1002\n").encode(), mapped())
    assert len(rows) == 3
    assert parser.counts.bad_rows == 1
    line, said = parser.counts.bad[0]
    assert line == 4
    assert why in said
    assert "line 4: " in parser.counts.sentences()[0]


def test_numbers_of_the_wrong_decimal_sign_are_bad_rows() -> None:
    _, parser = read(
        b"time;T;U\n2024-01-01T00:00:00;20.5;1\n", mapped(("uut:", 'file: {delimiter: ";", decimal: ","}\nuut:'))
    )
    assert "decimal comma" in parser.counts.bad[0][1]


def test_what_a_survey_says_of_a_file_and_without_one(tmp_path: Path) -> None:
    found = surveyed(tmp_path, LOG.encode())
    assert (found.first_ns, found.last_ns - found.first_ns) == (UTC_2024_ns, 10 * 10**9)
    assert (found.counts.rows, found.size) == (2, len(LOG))
    with pytest.raises(InputError, match=r"B-IMP-001.*cannot be read"):
        list(file_lines(tmp_path / "absent.csv"))
    with pytest.raises(InputError, match=r"B-IMP-001.*is empty"):
        surveyed(tmp_path, b"")


@pytest.mark.parametrize(
    ("content", "refusal"),
    [
        (LOG.encode() + b"\xff\xfe\n", r"B-IMP-002.*log.csv:4: .*byte 1 is not utf-8"),
        (LOG.encode() + b"a\x01b,1,2\n", r"B-IMP-002.*log.csv:4: .*control character U\+0001"),
        (LOG.encode() + b"\x01\xff\n", r"B-IMP-002.*byte 2 is not utf-8. Next: name the exported text file$"),
        (LOG.encode() + b"x" * (MAX_LINE_BYTES + 10), r"B-IMP-002.*log.csv:4: .*longer than"),
        (LOG.replace("time,T,U", "time,t,U").encode(), r"B-IMP-003.*log.csv:1: .*no column 'T'"),
        (LOG.replace("time,T,U", "time,T,T,U").encode(), r"B-IMP-003.*log.csv:1: .*the column 'T' 2 times"),
        (b"time,T,U\n", "B-IMP-004.*no row"),
        (b"time,T,U\nx,y,z\n", "B-IMP-004.*line 2: 'x' is no time"),
        (b"\n\n", "B-IMP-004.*no line of column names"),
        (LOG.encode() + b"x,1,2\n", r"B-IMP-005.*1 of 3 rows cannot be read, 0 % may be: line 4"),
        (LOG.encode() + b"2024-01-01T00:00:05,20,1\n", r"B-IMP-006.*log.csv:4: the time goes back by 5 s after line 3"),
    ],
)
def test_what_cannot_be_read_is_refused_with_its_line(tmp_path: Path, content: bytes, refusal: str) -> None:
    with pytest.raises(InputError, match=refusal):
        surveyed(tmp_path, content)


BY_NUMBER = ("format: iso, zone: UTC", "format: rows, rate: 1 Hz, start: 2024-01-01T00:00:00Z")
COUNTER = ("format: iso, zone: UTC", "format: elapsed, unit: us, start: 2024-01-01T00:00:00Z")


@pytest.mark.parametrize("length", [1, 5000, 3 * MAX_LINE_BYTES])
def test_blocks_of_zero_bytes_are_passed_over_and_counted(length: int) -> None:
    block = bytes(length)
    content = LOG.encode() + b"2024-01-" + block + b"2,30,7\n2024-01-01T00:00:20,21,1002\n" + block
    for cut in (len(content), 70_000):
        rows, parser = read(content, mapped(), cut)
        assert [values[0] for _, values in rows] == [20.5, 20.6, 21.0]
        assert parser.counts.sentences()[0].startswith("2 lines of the log hold blocks of zero bytes, ")
    _, parser = read(content, mapped(BY_NUMBER))
    assert parser.counts.bad == [(4, "a block of zero bytes"), (6, "a block of zero bytes")]
    with pytest.raises(InputError, match=r"B-IMP-005.*Next: correct those lines, or cut the file in front of them: .*"):
        parser.finish()


@pytest.mark.parametrize("tail", ["2024-01-01T00:03:20,20.0", "2024-01-01T00:0", "2024-01-01T00:03:20,20,1."])
def test_a_last_line_that_was_not_written_to_its_end_is_left_out(tail: str) -> None:
    lines = [f"2024-01-01T00:0{k // 60}:{k % 60:02},20,1.25" for k in range(120)]
    content = "\n".join(["time,T,U", *lines, tail]).encode()
    for mapping in (mapped(), mapped(BY_NUMBER)):
        rows, parser = read(content, mapping)
        assert len(rows) == 120
        assert parser.counts.sentences() == [
            "Line 122, the last one of the log, was not written to its end and is left out."
        ]
    assert len(read("\n".join(["time,T,U", *lines]).encode(), mapped())[0]) == 120


@pytest.mark.parametrize(("tick", "step"), [("us", 10_000), ("ms", 10), ("0.1 ms", 100)])
def test_a_counter_of_32_bits_is_counted_on(tick: str, step: int) -> None:
    ticks = [(2**32 - 20 * step + k * step) % 2**32 for k in range(40)]
    mapping = mapped((COUNTER[0], COUNTER[1].replace("us", tick)))
    rows, parser = read("\n".join(["time,T,U", *(f"{each},20,1" for each in ticks), ""]).encode(), mapping)
    assert {later[0] - row[0] for row, later in pairwise(rows)} == {10_000_000}
    said = f"The time column is a counter of 32 bits in {tick} that began anew 1 times; it is counted on."
    assert parser.counts.sentences() == [said]
    with pytest.raises(InputError, match="B-IMP-006"):
        read("\n".join(["time,T,U", *(f"{each},20,1" for each in (*ticks[:9], 0)), ""]).encode(), mapping)


def test_declared_bad_rows_and_one_time_twice_are_taken(tmp_path: Path) -> None:
    declared = mapped(("uut:", "bad_rows: 40 %\nuut:"))
    assert surveyed(tmp_path, (LOG + "x,1,2\n").encode(), declared).counts.bad_rows == 1
    assert surveyed(tmp_path, (LOG + "2024-01-01T00:00:10,20,1\n").encode()).counts.rows == 3


@pytest.mark.parametrize("size", [1, 2, 7, 1000])
def test_lines_do_not_depend_on_how_the_bytes_are_cut(size: int) -> None:
    content = b"a\r\n\nbc\n\xc3\xa4 no end"
    chunks = [content[at : at + size] for at in range(0, len(content), size)]
    assert list(lines_of(chunks)) == [b"a\r\n", b"\n", b"bc\n", b"\xc3\xa4 no end"]
