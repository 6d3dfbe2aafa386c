"""Parts of the frame language that no shipped unit needs together, by bytes of struct; every mistake by its code."""

from __future__ import annotations

import struct

import numpy as np
import pytest
from crccheck.crc import Crc16Xmodem, Crc32

from bench.frame import FrameDefinition, pace_of, parse_frame, why_no_kernel
from bench.frame.stream import LinkDecoder
from bench.model.errors import InputError, InputErrors

ENGINES = ("reference", "numpy", *(() if why_no_kernel() else ("kernel",)))


def inside(body: bytes) -> bytes:
    """A frame whose check covers all of it, with zeros where it stands itself, as in the headers of the internet."""
    frame = b"\x7e" + struct.pack(">HI", len(body), 0) + body + b"\x0d\x0a"
    return frame[:3] + struct.pack(">I", Crc32.calc(frame[:3] + bytes(4) + body)) + frame[7:]


INSIDE = """
frame: inside
endian: big
sync: [0x7E]
trailer: [0x0D, 0x0A]
fields: [{name: length, type: u16}, {name: check, type: u32}, {name: body, type: bytes, count: rest}]
length: {field: length, plus: 9, max: 100}
crc: {name: crc-32, field: check, over: [sync, end]}
"""


def with_golden(text: str, golden: bytes, expect: str) -> FrameDefinition:
    return parse_frame(f'{text}golden: "{golden.hex(" ")}"\nexpect: {{{expect}}}\n', "test.yaml")


@pytest.mark.parametrize("engine", ENGINES)
def test_a_check_inside_what_it_covers_and_bytes_behind(engine: str) -> None:
    definition = with_golden(INSIDE, inside(b"abc"), 'body: "61 62 63"')
    frames = [inside(bytes([number]) * number) for number in range(20)]
    damaged = bytearray(b"".join(frames))
    damaged[-1] ^= 1  # of the trailer
    link = LinkDecoder(definition, engine)  # type: ignore[arg-type]
    link.push(0, bytes(damaged))
    batch = link.finish().messages["frame"]
    assert batch.raw("body").tolist() == [bytes([number]) * number for number in range(19)]
    assert (link.counts.frames, link.counts.bad) == (19, 1)
    assert definition.encode_one({"body": b"abc"}) == inside(b"abc")


MESSAGES = """
frame: typed
endian: little
sync: [0xAA]
other: true
fields: [{name: word, type: u16, bits: {kind: "0-3", quarters: "4-15"}}, {name: counter, type: u8, role: own_counter}]
length: {field: word.quarters, times: 4, plus: 0, max: 400}
type: {field: word.kind}
messages:
  short: {value: 1, fields: [{name: n, type: u16}], golden: "GOLDEN1", expect: {counter: 5, n: 7}}
  long: {value: 15, fields: [{name: n, type: u48}, {name: m, type: u32}], golden: "GOLDEN2", expect: {m: 3}}
crc: {name: crc-16/xmodem, over: [sync, end], stored: big}
"""


def typed(kind: int, counter: int, body: bytes) -> bytes:
    frame = b"\xaa" + struct.pack("<HB", kind | (len(body) + 6) // 4 << 4, counter) + body
    return frame + struct.pack(">H", Crc16Xmodem.calc(frame))


def typed_definition() -> FrameDefinition:
    short, long = typed(1, 5, struct.pack("<H", 7)), typed(15, 0, struct.pack("<IHI", 1, 0, 3))
    return parse_frame(MESSAGES.replace("GOLDEN1", short.hex()).replace("GOLDEN2", long.hex()), "typed.yaml")


@pytest.mark.parametrize("engine", ENGINES)
def test_messages_by_bits_with_counters_of_their_own_and_others_apart(engine: str) -> None:
    definition = typed_definition()
    stream = b"".join(
        typed(1, number, struct.pack("<H", number)) + typed(9, 77, bytes(10)) + typed(15, 2 * number % 256, bytes(10))
        for number in range(200)
    )
    link = LinkDecoder(definition, engine)  # type: ignore[arg-type]
    link.push(0, stream + typed(1, 200, b"xy")[:-1] + b"!")
    messages = link.finish().messages
    assert [len(batch) for batch in messages.values()] == [200, 200]
    assert (link.counts.other, link.counts.bad, link.counts.lost) == (200, 1, 199)
    assert link.counts.skipped_bytes == 8
    assert messages["long"].counter is not None
    assert np.array_equal(messages["long"].counter, 2 * np.arange(200))
    assert definition.encode_one({"counter": 5, "n": 7}, "short") == typed(1, 5, b"\x07\x00")


def test_a_length_that_the_field_cannot_say() -> None:
    text = """
frame: words
endian: big
sync: [0x01]
fields: [{name: words, type: u8}, {name: body, type: bytes, count: rest}]
length: {field: words, times: 2, plus: 1, max: 50}
crc: {name: sum-8, over: [words, end]}
"""
    definition = with_golden(text, b"\x01\x01\x01", "words: 1")
    with pytest.raises(InputError, match="multiple of 2") as caught:
        definition.encode_one({"body": b"a"})
    assert caught.value.code == "B-FRAME-021"
    assert definition.encode_one({"body": b"ab"}) == b"\x01\x02ab" + bytes([(2 + 97 + 98) & 255])


def test_packets_without_sync_bytes_and_without_check() -> None:
    text = """
frame: packets
endian: big
sync: []
fields: [{name: length, type: u8}, {name: body, type: bytes, count: rest}]
length: {field: length, plus: 1, max: 20}
crc: {name: none}
"""
    definition = with_golden(text, b"\x03abc", 'body: "61 62 63"')
    assert "without a check" in definition.why_no_kernel
    link = LinkDecoder(definition)
    for number, chunk in enumerate((b"\x03ab", b"c\x00\x01x\xff\x02", b"yz\x05ab")):
        link.push(number, chunk)
    batch = link.finish().messages["frame"]
    assert batch.raw("body").tolist() == [b"abc", b"", b"x", b"yz"]
    assert batch.t_ns is not None
    assert batch.t_ns.tolist() == [1, 1, 1, 2]
    assert (link.counts.bad, link.counts.skipped_bytes) == (3, 4)


SOUND = {
    "endian": "big",
    "sync": "[0x01]",
    "fields": "[{name: a, type: u8, bits: {low: '0-3'}}, {name: n, type: u8}]",
    "crc": "{name: sum-8, over: [a, end]}",
    "golden": '"01 02 03 05"',
    "expect": "{a: 2}",
}


@pytest.mark.parametrize(
    ("changed", "code"),
    [
        ({"crc": "{name: none, over: [a, end]}"}, "B-FRAME-008"),
        ({"crc": "{name: sum-8}"}, "B-FRAME-008"),
        ({"crc": "{name: sum-16, field: n, over: [a, end]}"}, "B-FRAME-008"),
        ({"crc": "{name: sum-8, field: m, over: [a, end]}"}, "B-FRAME-008"),
        (
            {
                "fields": "[{name: a, type: u8}, {name: n, type: u8, count: 2}]",
                "crc": "{name: sum-16, field: n, over: [a, end]}",
            },
            "B-FRAME-008",
        ),
        ({"sync": "[]"}, "B-FRAME-006"),
        ({"other": "true"}, "B-FRAME-007"),
        ({"length": "{field: a.high, plus: 0, max: 9}"}, "B-FRAME-006"),
        ({"length": "{field: b.low, plus: 0, max: 9}"}, "B-FRAME-006"),
        ({"trailer": "[0x0D]"}, "B-FRAME-011"),
        ({"crc": "{name: xor-8, over: [a, end]}"}, "B-FRAME-011"),
    ],
)
def test_every_mistake_has_its_code_and_place(changed: dict[str, str], code: str) -> None:
    text = "frame: f\n" + "".join(f"{key}: {value}\n" for key, value in (SOUND | changed).items())
    with pytest.raises(InputErrors) as caught:
        parse_frame(text, "f.yaml")
    assert f"{code}: f.yaml:" in str(caught.value)


def test_a_type_beyond_its_bits() -> None:
    short = typed(1, 5, b"\x07\x00").hex()
    with pytest.raises(InputErrors, match=r"16 does not fit 'word\.kind'"):
        parse_frame(MESSAGES.replace("value: 15", "value: 16").replace("GOLDEN1", short), "typed.yaml")


def test_a_golden_frame_names_the_limit_and_the_check_that_would_be_right() -> None:
    short = typed(1, 5, b"\x07\x00")
    text = MESSAGES.replace("GOLDEN1", short.hex()).replace("GOLDEN2", typed(15, 0, bytes(6) + b"\x03\0\0\0").hex())
    rest = text.replace("{name: m, type: u32}", "{name: m, type: bytes, count: rest}")
    with pytest.raises(InputErrors, match="states 16 bytes \\(word is 4\\), 'length: max' is 12"):
        parse_frame(rest.replace("max: 400", "max: 12")
                    .replace("expect: {m: 3}", "expect: {counter: 0}"), "typed.yaml")  # fmt: skip
    wrong = INSIDE.replace("crc-32,", "crc-32/mpeg-2,").replace("max: 100", "max: 40")
    with pytest.raises(InputErrors, match="fails its check"):
        with_golden(wrong, inside(b"abcdef"), "length: 6")
    plain = b"\x01\x02" + bytes(range(9))
    frame = plain + struct.pack(">I", Crc32.calc(plain))
    head = "frame: f\nendian: big\nsync: [1, 2]\nfields: [{name: body, type: bytes, count: 9}]\n"
    with pytest.raises(
        InputErrors, match="crc-32/iso-hdlc over bytes 0 to 10, with 0 bytes behind it, stored big, would be"
    ):
        with_golden(f"{head}crc: {{name: crc-32, over: [body, end]}}\n", frame, 'body: "00 01 02 03 04 05 06 07 08"')


@pytest.mark.parametrize("engine", ENGINES)
def test_a_type_is_looked_at_where_one_message_is_listed(engine: str) -> None:
    text = """
frame: one
endian: big
sync: [0xAA]
fields: [{name: kind, type: u8}]
type: {field: kind}
messages:
  other: {value: 1, fields: [{name: n, type: u16}], golden: "aa 01 00 07 08", expect: {n: 7}}
crc: {name: sum-8, over: [kind, end]}
"""
    link = LinkDecoder(parse_frame(text, "one.yaml"), engine)  # type: ignore[arg-type]
    link.push(0, b"\xaa\x01\x00\x05\x06" * 20 + b"\xaa\x02\x00\x05\x07" * 10 + b"\xaa\x01\x00\x05\x06" * 20)
    assert link.finish().messages["other"].raw("kind").tolist() == [1] * 40
    assert (link.counts.bad, link.counts.skipped_bytes) == (10, 50)


def test_a_message_may_be_named_other() -> None:
    text = """
frame: named
endian: big
sync: [0xAA]
other: true
fields: [{name: length, type: u8}, {name: kind, type: u8}]
length: {field: length, plus: 0, max: 50}
type: {field: kind}
messages:
  other: {value: 1, fields: [{name: body, type: bytes, count: rest}], golden: "aa 06 01 41 42 8a", expect: {kind: 1}}
crc: {name: sum-8, over: [length, END]}
"""
    with pytest.raises(InputErrors, match="covers 'body', which is no field at a fixed place of the message 'other'"):
        parse_frame(text.replace("END", "body"), "named.yaml")
    link = LinkDecoder(parse_frame(text.replace("END", "end"), "named.yaml"))
    link.push(0, bytes.fromhex("aa 06 01 41 42 8a aa 05 02 41 48"))
    assert link.finish().messages["other"].raw("body").tolist() == [b"AB"]
    assert (link.counts.other, link.counts.bad) == (1, 0)


class Ticking:
    """A clock on which every look takes a second."""

    def __init__(self) -> None:
        self.looks = 0

    def now_ns(self) -> int:
        self.looks += 1
        return self.looks * 10**9


PACES = {"1 Hz": "more than 1,000 times its 1 Hz", "": "more than 1,000 frames/s", "1 MHz": "too slow for its 1e+06 Hz"}


@pytest.mark.parametrize(("rate", "told"), PACES.items())
def test_a_pace_is_told_against_the_rate(rate: str, told: str) -> None:
    text = INSIDE + (f"rate: {rate}\n" if rate else "")
    pace = pace_of(with_golden(text, inside(b"abc"), "length: 3"), Ticking())  # type: ignore[arg-type]
    assert str(pace).startswith("inside by numpy, ")
    assert told in str(pace)
    assert "no check" not in str(pace)
