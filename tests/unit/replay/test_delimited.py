"""Delimited text as loggers write it."""

import math
import operator
import random
import re
from decimal import Decimal
from itertools import pairwise
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from imported_logs import LOG, SHORT

from bench.model.clock import NS
from bench.model.errors import InputError
from bench.model.yamlio import parse_yaml
from bench.plan.language.mapping import LogMapping, mapping_model
from bench.replay.delimited import MAX_LINE_BYTES, LogParser, lines_of
from bench.replay.series import file_lines, survey

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


_ODD = ["", "# x", '"5",1,2', "5,1", "5,1,2,", "5,1_0,2", "5,nan,2", "5,OL,2", "5,0x10,2", "5,1e400,2", ""]


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
    form = draw.choice(["elapsed, unit: s", "elapsed, unit: min", "unix, unit: ms", "samples, rate: 300 Hz"])
    column = f"format: {form}, start: 2024-01-01T00:00:00Z".replace("ms, start: 2024-01-01T00:00:00Z", "ms")
    mapping = mapped((BY_NUMBER[0], column), ("uut:", draw.choice(["uut:", 'file: {comment: "#"}\nuut:'])))
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
        assert parser.counts.sentences()[0].startswith(
            "Lines with blocks of zero bytes, as a loss of power leaves them: 2."
        )
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


def test_a_time_out_of_reach_among_plain_rows_is_a_bad_row() -> None:
    rows, parser = read(b"time,T,U\n1e307,20,1\n5,20,1\n", mapped(COUNTER))
    assert (len(rows), parser.counts.bad_rows) == (1, 1)


def test_declared_bad_rows_and_one_time_twice_are_taken(tmp_path: Path) -> None:
    declared = mapped(("uut:", "bad_rows: 40 %\nuut:"))
    assert surveyed(tmp_path, (LOG + "x,1,2\n").encode(), declared).counts.bad_rows == 1
    assert surveyed(tmp_path, (LOG + "2024-01-01T00:00:10,20,1\n").encode()).counts.rows == 3


@pytest.mark.parametrize("size", [1, 2, 7, 1000])
def test_lines_do_not_depend_on_how_the_bytes_are_cut(size: int) -> None:
    content = b"a\r\n\nbc\n\xc3\xa4 no end"
    chunks = [content[at : at + size] for at in range(0, len(content), size)]
    assert list(lines_of(chunks)) == [b"a\r\n", b"\n", b"bc\n", b"\xc3\xa4 no end"]
