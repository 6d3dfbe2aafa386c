"""Captures and definitions that want more than is there: memory, time, lines without an end, pauses inside a packet."""

from __future__ import annotations

import io
import json
import struct
import tracemalloc
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest

from bench.frame import LinkDecoder, Tables, decode_capture, line_guess, parse_frame
from bench.model.errors import InputError, InputErrors

NUMBERS = {"frame": "numbers", "sync": [], "lines": {"separator": ",", "max": 14}, "crc": {"name": "none"},
           "fields": [{"name": "a", "type": "f64"}, {"name": "b", "type": "f64"}], "golden": "1,2",
           "expect": {"a": 1}}  # fmt: skip
COBS = {"frame": "cobs", "endian": "big", "sync": [], "escape": "cobs", "silence": "50 ms", "expect": {"a": 258},
        "fields": [{"name": "a", "type": "u16"}], "crc": {"name": "sum-8", "over": ["a", "end"]},
        "golden": "04 01 02 03 00"}  # fmt: skip
S = 10**9


def most_MB(work: Callable[[], object]) -> float:
    """Megabytes that were allocated at most, by Python and numpy."""
    tracemalloc.start()
    try:
        work()
        return tracemalloc.get_traced_memory()[1] / 1e6
    finally:
        tracemalloc.stop()


def lines_of(capture: bytes, cut: int) -> tuple[list[tuple[float, float]], int]:
    decoder = parse_frame(json.dumps(NUMBERS), "numbers.yaml").decoder()
    batches = [decoder.feed(capture[at : at + cut]) for at in range(0, len(capture), cut)] + [decoder.finish()]
    frames = [batch.messages["frame"] for batch in batches]
    found = [pair for frame in frames for pair in zip(frame.raw("a").tolist(), frame.raw("b").tolist(), strict=True)]
    return found, decoder.counts.bad


@pytest.mark.parametrize("cut", [1, 3, 100])
@pytest.mark.parametrize(
    ("capture", "numbers", "bad"),
    [
        (b"100000.5,200000.25\n3,4\n", [(3, 4)], 1),
        (b"1,2\n" + b"9" * 200 + b"1,2345678\n3,4\n", [(1, 2), (3, 4)], 1),
        (b"1,2\r7,8\n3,4\r\n", [(3, 4)], 1),
        (b"\n\r\n3,4\n", [(3, 4)], 0),
        (b"1,\x1b2\n3,4\n", [(3, 4)], 1),
    ],
)
def test_the_rest_of_a_rejected_line_is_no_line(
    capture: bytes, numbers: list[tuple[float, float]], bad: int, cut: int
) -> None:
    assert lines_of(capture, cut) == (numbers, bad)


def test_what_comes_behind_a_pause_begins_anew() -> None:
    link = LinkDecoder(parse_frame(json.dumps(NUMBERS | {"silence": "50 ms"}), "numbers.yaml"))
    found = []
    for stamp, chunk in ((0, b"1,2\n12"), (S, b"10"), (S + 1, b"00,200\n")):
        link.push(stamp, chunk)
        found += link.flush().messages["frame"].raw("a").tolist()
    assert found == [1, 1000]
    packets = LinkDecoder(parse_frame(json.dumps(COBS), "cobs.yaml"))
    found = []
    for stamp, chunk in ((0, b"\x04\x01"), (S, b"\x04\x01"), (S + 1, b"\x02\x03\x00")):
        packets.push(stamp, chunk)
        found += packets.flush().messages["frame"].raw("a").tolist()
    assert (found, packets.counts.bad) == ([258], 1)


def test_many_candidates_of_one_length_need_little_memory() -> None:
    fields = [{"name": "l", "type": "u16"}, {"name": "odd", "type": "u3"}, {"name": "fill", "type": "u5"},
              {"name": "r", "type": "bytes", "count": "rest"}]  # fmt: skip
    spec = {"frame": "same", "endian": "big", "sync": [0x55], "fields": fields,
            "length": {"field": "l", "plus": 0, "max": 30000}, "crc": {"name": "crc-16/modbus", "over": ["l", "end"]},
            "golden": "55 00 06 00 00 00", "expect": {"l": 6}}  # fmt: skip
    with pytest.raises(InputErrors) as caught:
        parse_frame(json.dumps(spec), "same.yaml")
    computed = caught.value.errors[0].message.partition(" is 0x")[2][:4]
    golden = bytes.fromhex("5500060000"[:8]) + struct.pack(">H", int(computed, 16))
    definition = parse_frame(json.dumps(spec | {"golden": golden.hex()}), "same.yaml")
    decoder = definition.decoder("numpy")
    assert most_MB(lambda: decoder.feed(b"\x55" * 40_000)) < 150  # 18,000 candidates of 21,845 bytes: 400 at once


def test_short_frames_of_long_rows_are_read_in_small_blocks() -> None:
    group = {"group": "g", "count": "n", "max": 255, "fields": [{"name": f"v{i}", "type": "u64"} for i in range(30)]}
    spec = {"frame": "wide", "endian": "big", "sync": [0xA5], "fields": [{"name": "n", "type": "u8"}, group],
            "crc": {"name": "none"}, "golden": "a5 00", "expect": {"n": 0}}  # fmt: skip
    definition, capture = parse_frame(json.dumps(spec), "wide.yaml"), io.BytesIO(b"\xa5\0" * 8000)
    assert most_MB(lambda: decode_capture(definition, capture)) < 250  # 8,000 rows of 61,202 bytes: 490
    assert capture.tell() == 16_000
    wider: dict[str, Any] = spec | {
        "fields": [{"name": "n", "type": "u16"}, group | {"max": 4096}],
        "golden": "a5 00 00",
    }
    with pytest.raises(InputErrors, match="the limit is 65535") as caught:
        parse_frame(json.dumps(wider), "wide.yaml")
    assert caught.value.errors[0].code == "B-FRAME-015"


def test_text_that_cannot_be_printed_stays_in_its_row(tmp_path: Path) -> None:
    spec = {"frame": "text", "endian": "big", "sync": [0xA5], "crc": {"name": "none"}, "golden": "a5 61 62 00 00",
            "fields": [{"name": "t", "type": "bytes", "count": 4, "form": "text"}], "expect": {"t": "ab"}}  # fmt: skip
    with Tables(parse_frame(json.dumps(spec), "text.yaml"), tmp_path / "t.csv") as tables:
        definition = parse_frame(json.dumps(spec), "text.yaml")
        decode_capture(definition, io.BytesIO(bytes.fromhex("a5610d6200 a561e90a00")), tables.write)
    assert (tmp_path / "t.csv").read_text().splitlines() == ["offset,t", r"0,a\x0db", r"5,a\xe9\x0a"]


@pytest.mark.parametrize("due", [5, [1], None, True, {"a": 1}])
def test_what_is_expected_of_text_is_text(due: Any) -> None:
    spec = {"frame": "text", "endian": "big", "sync": [0xA5], "crc": {"name": "none"}, "golden": "a5 61",
            "fields": [{"name": "t", "type": "bytes", "count": 1, "form": "text"}], "expect": {"t": due}}  # fmt: skip
    with pytest.raises(InputErrors, match="of the golden frame is 'a'"):
        parse_frame(json.dumps(spec), "text.yaml")


def test_names_with_a_dot_and_nothing_behind_it() -> None:
    spec = {"frame": "dot", "endian": "big", "sync": [0xA5], "crc": {"name": "none"}, "golden": "a5 01",
            "fields": [{"name": "u", "type": "u8", "bits": {"low": 0}}], "expect": {"u.": 1}}  # fmt: skip
    with pytest.raises(InputErrors) as caught:
        parse_frame(json.dumps(spec), "dot.yaml")
    assert caught.value.errors[0].code == "B-FRAME-013"
    definition = parse_frame(json.dumps(spec | {"expect": {"u": 1}}), "dot.yaml")
    with pytest.raises(InputError) as refused:
        definition.encode_one({"u.": 1})
    assert refused.value.code == "B-FRAME-022"


def test_lines_that_nobody_could_read_back_are_not_written() -> None:
    spec = {"frame": "text", "sync": [0x24], "lines": {"separator": ",", "max": 40}, "crc": {"name": "none"},
            "fields": [{"name": "t", "type": "bytes", "count": 5}], "golden": "$ab", "expect": {"t": "ab"}}  # fmt: skip
    definition = parse_frame(json.dumps(spec), "text.yaml")
    with pytest.raises(InputError, match="cannot stand in a line"):
        definition.encode_one({"t": b"a$b\0\0"})
    numbers = [{"name": "t", "type": "f64"}]
    for changes, words in (
        ({"lines": {"separator": "-", "max": 40}, "fields": numbers}, "which separate the values"),
        ({"type": {"field": "t.no"}, "messages": {"m": {"value": "ab", "golden": "$ab", "expect": {"t": "ab"}}},
          "golden": None, "expect": None}, "must be common bytes"),
    ):  # fmt: skip
        text = json.dumps({key: value for key, value in {**spec, **changes}.items() if value is not None})
        with pytest.raises(InputErrors, match=words):
            parse_frame(text, "text.yaml")


def test_a_long_line_of_text_is_looked_at_at_once() -> None:
    assert line_guess((b"x" * 4000 + b"\xb0\n") * 262) is None
    guess = line_guess(b"".join(b"%d,%d\r\n" % (i, 3 * i) for i in range(60)))
    assert guess is not None
    assert (guess.covered, len(guess.lines)) == (1.0, 60)
