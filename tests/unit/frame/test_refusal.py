"""Why frames of a capture are bad, told by cause; and captures that only seem to end inside a frame."""

from __future__ import annotations

import io
import json
import struct
from functools import reduce
from operator import xor
from typing import Any

import pytest
from record_sample import frame as frame_of

from bench.frame import Counted, decode_capture, parse_frame
from bench.model.errors import InputErrors

SPEC: dict[str, Any] = {
    "frame": "unit", "endian": "little", "sync": [0xA5], "length": {"field": "length", "plus": 0, "max": 40},
    "fields": [{"name": "length", "type": "u8"}, {"name": "kind", "type": "u8"}], "type": {"field": "kind"},
    "messages": {
        "sets": {"value": 1, "golden": "", "expect": {"number": 1},
                 "fields": [{"name": "number", "type": "u8"}, {"group": "sets", "count": "number", "max": 3, "fields": [
                     {"name": "rate", "type": "i16"}]}]},
        "items": {"value": 2, "golden": "", "expect": {"tick": 7},
                  "fields": [{"items": "parts", "id": "u8", "length": "u8", "of": {
                      "time": {"id": 8, "required": True, "fields": [{"name": "tick", "type": "u32"}]}}}]},
    },
    "crc": {"name": "sum-8", "over": ["sync", "end"]},
}  # fmt: skip


def sealed(kind: int, body: bytes, length: int | None = None) -> bytes:
    frame = struct.pack("3B", 0xA5, len(body) + 4 if length is None else length, kind) + body
    return frame + bytes([sum(frame) % 256])


SETS = sealed(1, struct.pack("<Bh", 1, -5))
ITEMS = sealed(2, struct.pack("<BBI", 8, 4, 7))
SPEC["messages"]["sets"]["golden"], SPEC["messages"]["items"]["golden"] = SETS.hex(), ITEMS.hex()
DEFINITION = json.dumps(SPEC)


def counted(text: str, capture: bytes) -> Counted:
    return decode_capture(parse_frame(text, "unit.yaml"), io.BytesIO(capture))


@pytest.mark.parametrize(
    ("frame", "cause", "words"),
    [
        (SETS[:-1] + b"\0", "check", "the frame holds 0x00"),
        (sealed(3, b"\0"), "type", "states the type 3 (0x3), due is 1 (0x1, 'sets') or 2 (0x2, 'items')"),
        (sealed(1, bytes(40)), "length", "states 44 bytes (length is 44), 'length: max' is 40"),
        (sealed(1, b"", 3), "length", "states 3 bytes (length is 3), 'sets' has at least 5"),
        (sealed(1, struct.pack("<B4h", 4, 1, 2, 3, 4)), "contents", "states 4 sets of 'sets', 'max' is 3"),
        (sealed(1, struct.pack("<Bh", 2, 1)), "contents", "holds too few bytes for 'sets'"),
        (sealed(2, struct.pack("<BBH", 8, 2, 7)), "contents", "states 2 bytes for the item 'time', which has 4"),
        (sealed(2, struct.pack("<BB", 9, 0)), "contents", "lacks the item 'time'"),
    ],
)
def test_the_cause_is_told_with_value_and_limit(frame: bytes, cause: str, words: str) -> None:
    found = counted(DEFINITION, SETS + frame + ITEMS + frame + SETS)
    assert found.counts.frames == 3
    (kind,) = found.bad
    assert (kind.cause, kind.number, kind.offset) == (cause, 2, len(SETS))
    assert words in kind.text


def test_a_candidate_that_began_in_the_block_before(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("bench.frame.capture._BLOCK_BYTES", 7)
    wrong = SETS[:-1] + b"\0"
    found = counted(DEFINITION, (SETS * 9 + wrong) * 5)
    assert [(kind.cause, kind.number, kind.offset) for kind in found.bad] == [("check", 5, 9 * len(SETS))]


def test_no_more_than_a_thousand_are_looked_at() -> None:
    found = counted(DEFINITION, (SETS[:-1] + b"\0") * 1500)
    assert (found.counts.bad, [kind.number for kind in found.bad]) == (1500, [1000])


def test_lines_and_packets() -> None:
    def nmea(body: bytes) -> bytes:
        return b"$%b*%02X\r\n" % (body, reduce(xor, body))

    good = nmea(b"GPVTG,77.52,T,,M,0.004,N,0.008,K,A")
    long = nmea(b"GPVTG,77.52,TT,,M,0.004,N,0.008,K,A")
    capture = good + long + nmea(b"GPVTG,1") + good.replace(b"*06", b"*07")
    found = decode_capture(frame_of("nmea_0183"), io.BytesIO(capture))
    assert [(kind.cause, kind.number) for kind in found.bad] == [("contents", 2), ("check", 1)]
    (without,) = decode_capture(frame_of("nmea_0183"), io.BytesIO(b"$GPVTG,1\r\n")).bad
    assert without.text == "has no check: there is no '*'"
    assert "course_reference: 'TT' has 2 characters, its 'count' is 1" in found.bad[0].text
    escaped = {"frame": "unit", "endian": "big", "sync": [], "escape": "slip", "golden": "c0 01 02 03 c0",
               "fields": [{"name": "a", "type": "u16"}], "expect": {"a": 258},
               "crc": {"name": "sum-8", "over": ["a", "end"]}}  # fmt: skip
    found = counted(json.dumps(escaped), bytes.fromhex("c0010203c0 c0010204c0 c001dbffc0 c00102030405c0"))
    assert [(kind.cause, kind.number) for kind in found.bad] == [("check", 1), ("escape", 1), ("length", 1)]


def test_bytes_behind_the_last_frame_are_no_frame_that_is_cut_off() -> None:
    fields = [{"name": "version", "type": "u8", "constant": 7}, {"name": "a", "type": "u16"}]
    spec = {"frame": "unit", "endian": "big", "sync": [0xAA, 0x55], "fields": fields, "expect": {"a": 258},
            "crc": {"name": "sum-8", "over": ["version", "end"]}, "golden": "aa 55 07 01 02 0a"}  # fmt: skip
    frame, text = bytes.fromhex("aa550701020a"), json.dumps(spec)
    assert not counted(text, frame + bytes(1000)).cut_off
    assert not counted(text, bytes(1000)).cut_off
    assert not counted(text, frame + b"\xaa\x55").cut_off  # perhaps: the version is not there
    assert counted(text, frame + b"\xaa\x55\x07").cut_off


@pytest.mark.parametrize(
    ("fields", "column"),
    [
        ([{"name": "value", "type": "u8", "count": 2}, {"name": "value_2", "type": "u8"}], "value_2"),
        ([{"name": "offset", "type": "u8"}, {"name": "a", "type": "u16"}], "offset"),
    ],
)
def test_two_columns_of_one_name_are_refused(fields: list[dict[str, Any]], column: str) -> None:
    spec = {"frame": "unit", "endian": "big", "sync": [0xAA], "fields": fields, "expect": {"a": 1},
            "crc": {"name": "sum-8", "over": ["sync", "end"]}, "golden": "aa 01 02 03 b0"}  # fmt: skip
    with pytest.raises(InputErrors, match=f"would have the column '{column}' twice"):
        parse_frame(json.dumps(spec), "unit.yaml")


def test_text_in_binary_frames_and_mistakes_of_the_author() -> None:
    spec: dict[str, Any] = {"frame": "unit", "endian": "big", "sync": [0xAA], "fields": [
        {"name": "model", "type": "bytes", "count": 4, "form": "text"}], "crc": {"name": "none"},
        "golden": "aa 4e 47 55 00", "expect": {"model": "NGU"}}  # fmt: skip
    assert counted(json.dumps(spec), bytes.fromhex("aa4e475500")).counts.frames == 1
    for changes, words in (
        ({"expect": {"model": "NG"}}, "model of the golden frame is 'NGU', expected is NG"),
        ({"golden": "aa 4e 47 5g 00"}, "there is 'g' at character 11"),
        ({"fields": [{"name": "model", "type": "u32", "form": "text"}]}, "for bytes, not for u32"),
        ({"fields": [{"name": "model", "type": "f64", "form": "time"}]}, "is for lines of text"),
        ({"feilds": []}, "did you mean 'fields'"),
    ):
        with pytest.raises(InputErrors, match=words):
            parse_frame(json.dumps({**spec, **changes}), "unit.yaml")


def test_nothing_stands_inside_a_group() -> None:
    inner = {"group": "inner", "count": "number", "max": 2, "fields": [{"name": "b", "type": "u8"}]}
    spec = json.loads(DEFINITION)
    spec["messages"]["sets"]["fields"][1]["fields"].append(inner)
    with pytest.raises(InputErrors, match="'group' cannot stand inside a group") as caught:
        parse_frame(json.dumps(spec), "unit.yaml")
    assert len(caught.value.errors) == 1
