"""The definition language: what it can say, and what it refuses with a code and a position; bytes made by struct."""

import re
import struct
from itertools import count
from pathlib import Path
from time import process_time
from types import SimpleNamespace
from typing import Any

import pytest
import yaml
from crccheck.crc import Crc8Smbus, Crc16Modbus, Crc16Xmodem, Crc32

from bench.frame import FrameDefinition, LinkDecoder, load_frame, pace_of, parse_frame
from bench.model.errors import InputError, InputErrors

HEAD = "frame: sample\nendian: big\n"


def sample(
    fields: str = "{name: value, type: u16}", over: str = "[value, end]", body: str = "0007", **keys: str
) -> str:
    """A small frame file with CRC-8/SMBUS over the body, whose golden frame is right unless a key overrides it."""
    golden = "a55a" + body + f"{Crc8Smbus.calc(bytes.fromhex(body)):02x}"
    text = {
        "sync": "[0xA5, 0x5A]",
        "fields": f"[{fields}]",
        "crc": f"{{name: crc-8/smbus, over: {over}}}",
        "golden": f'"{golden}"',
        "expect": "{value: 7}",
    } | keys
    return HEAD + "".join(f"{key}: {value}\n" for key, value in text.items() if value)


def test_every_type_and_byte_order() -> None:
    values = {
        "u8": 200, "u16": 60000, "u24": 0xABCDEF, "u32": 4_000_000_000, "u40": 1 << 39, "u48": (1 << 48) - 2,
        "u56": (1 << 56) - 3, "u64": (1 << 64) - 5, "i8": -100, "i16": -30000, "i24": -8_000_000, "i32": -2_000_000_000,
        "i40": -(1 << 39), "i48": -(1 << 40) - 1, "i56": -(1 << 55) + 1, "i64": -(1 << 63), "f32": 1.5, "f64": -0.1,
    }  # fmt: skip
    fields, wire = [], b""
    for kind, value in values.items():
        for order in ("big", "little"):
            fields.append(f"{{name: {kind}_{order}, type: {kind}, endian: {order}}}")
            if kind[0] == "f":
                code = ("f" if kind == "f32" else "d") if order == "big" else ("<f" if kind == "f32" else "<d")
                wire += struct.pack(code if code[0] == "<" else ">" + code, value)
            else:
                wire += value.to_bytes(int(kind[1:]) // 8, order, signed=kind[0] == "i")  # type: ignore[arg-type]
    text = sample(", ".join(fields), "[u8_big, end]", wire.hex(), expect="{u8_big: 200, f64_little: -0.1}")
    definition = parse_frame(text, "sample.yaml")
    frame = b"\xa5\x5a" + wire + bytes([Crc8Smbus.calc(wire)])
    for engine in ("numpy", "reference"):
        batch = definition.decoder(engine).feed(frame * 3).messages["frame"]  # type: ignore[arg-type]
        for kind, value in values.items():
            for order in ("big", "little"):
                assert batch.raw(f"{kind}_{order}").tolist() == [value] * 3, (engine, kind, order)
    columns = {item.name: batch.raw(item.name)[:1] for item in batch.message.fields}
    assert definition.encode(columns, 1).tobytes() == frame
    assert definition.encode_one(columns) == frame


def test_crc_by_parameters_stored_little_over_a_part() -> None:
    body = bytes.fromhex("0102 0304")
    stored = Crc16Modbus.calc(body[:2]).to_bytes(2, "little").hex()
    crc = (
        "{width: 16, poly: 0x8005, init: 0xffff, refin: true, refout: true, xorout: 0, "
        "over: [value, value], stored: little}"
    )
    fields = "{name: value, type: u16}, {name: free, type: u16}"
    text = sample(fields, crc=crc, golden=f'"a55a{body.hex()}{stored}"', expect="{value: 258}")
    definition = parse_frame(text, "sample.yaml")
    assert definition.encode_one({"value": 258, "free": 772}).hex() == f"a55a{body.hex()}{stored}"


def test_constants_behind_the_sync_extend_the_pattern_and_others_mark_frames_suspect() -> None:
    tail = '{name: tail, type: bytes, count: 1, constant: "ff"}'
    fields = "{name: kind, type: u8, constant: 3}, {name: value, type: u16}, " + tail
    definition = parse_frame(sample(fields, "[kind, end]", "030007ff"), "sample.yaml")
    assert definition.layout.pattern == b"\xa5\x5a\x03"
    odd = bytes.fromhex("0300080f")
    other = bytes.fromhex("040009ff")
    stream = b"".join(b"\xa5\x5a" + body + bytes([Crc8Smbus.calc(body)]) for body in (odd, other))
    for engine in ("numpy", "reference"):
        found = definition.decoder(engine).feed(stream)  # type: ignore[arg-type]
        assert found.messages["frame"].raw("value").tolist() == [8]
        assert found.messages["frame"].suspect.tolist() == [True]
        assert len(found.bad_offset) == 0
    assert definition.encode_one({"value": 7}).hex().startswith("a55a030007ff")


def test_hash_is_of_the_meaning_not_of_the_text() -> None:
    plain = parse_frame(sample(), "a.yaml").sha256
    crc = "{width: 8, poly: 7, init: 0, refin: false, refout: false, xorout: 0, over: [value, end]}"
    assert parse_frame("# a comment\n" + sample(title="Something else"), "b.yaml").sha256 == plain
    assert parse_frame(sample(crc=crc), "b.yaml").sha256 == plain
    assert parse_frame(sample("{name: value, type: u16, scale: 2}", expect="{value: 14}"), "b.yaml").sha256 != plain
    assert parse_frame(sample("{name: value, type: i16}"), "b.yaml").sha256 != plain
    assert parse_frame(sample(rate="2 Hz"), "b.yaml").sha256 != plain


MESSAGES = """frame: sample
endian: big
sync: [0xA5]
fields: [{name: size, type: u8}, {name: kind, type: u8}]
length: {field: size, plus: 0, max: 40}
type: {field: kind}
messages:
  one: {value: 1, fields: [{name: text, type: bytes, count: rest}], golden: "GOLDEN1", expect: {text: "0102"}}
  two: {value: 2, fields: [{name: value, type: u16}], golden: "GOLDEN2", expect: {value: 9}}
crc: {name: crc-8/smbus, over: [size, end]}
"""


def with_crc8(body: str) -> str:
    return f"a5{body}{Crc8Smbus.calc(bytes.fromhex(body)):02x}"


def messages_text(old: str = "", new: str = "") -> str:
    text = MESSAGES.replace("GOLDEN1", with_crc8("06010102")).replace("GOLDEN2", with_crc8("06020009"))
    assert old in text
    return text.replace(old, new)


REFUSALS = yaml.safe_load(Path(__file__).with_name("refusals.yaml").read_text(encoding="utf-8"))


def test_positions_and_all_mistakes_at_once() -> None:
    text = sample("{name: value, type: u16, bits: {a: 16}}, {name: value, type: u8}", "[nothing, end]")
    fields, check = text.splitlines()[3:5]
    with pytest.raises(InputErrors) as caught:
        parse_frame(text, "sample.yaml")
    assert caught.value.exit_status == 2
    assert [(error.code, error.where) for error in caught.value.errors] == [
        ("B-FRAME-004", f"sample.yaml:4:{fields.index('a: 16') + 1}"),
        ("B-FRAME-001", f"sample.yaml:4:{fields.rindex('name: value') + 1}"),
        ("B-FRAME-008", f"sample.yaml:5:{check.index('nothing') + 1}"),
    ]


ENGINES = ("reference", "numpy")


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


TYPED = """
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
    with pytest.raises(InputError, match=r"B-FRAME-021: .*multiple of 2"):
        definition.encode_one({"body": b"a"})
    assert definition.encode_one({"body": b"ab"}) == b"\x01\x02ab" + bytes([(2 + 97 + 98) & 255])


@pytest.mark.parametrize(("case", "how"), REFUSALS.items(), ids=REFUSALS)
def test_refusals(case: str, how: Any, tmp_path: Path) -> None:
    """One error with its place and with what is due or to do, soon; no warning of a library."""
    said = how.pop("said", "") if isinstance(how, dict) else ""
    text = messages_text(*how) if isinstance(how, list) else sample(**how) if isinstance(how, dict) else how
    path, started = tmp_path / "sample.yaml", process_time()
    path.write_bytes(text if isinstance(text, bytes) else text.encode())
    with pytest.raises(InputError, match=re.escape(said) or "^error") as caught:
        load_frame(path)
    assert process_time() - started < 5
    error = caught.value
    assert (str(error).count("\n"), error.code, error.exit_status) == (0, case.rsplit(maxsplit=1)[-1], 2)
    assert re.fullmatch(r".*sample\.yaml:\d+:\d+", error.where)
    assert error.next_step or error.code.startswith("B-YAML")


def test_a_golden_frame_names_the_limit_and_the_check_that_would_be_right() -> None:
    short = typed(1, 5, b"\x07\x00")
    text = TYPED.replace("GOLDEN1", short.hex()).replace("GOLDEN2", typed(15, 0, bytes(6) + b"\x03\0\0\0").hex())
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


PACES = {"1 Hz": "more than 1,000 times its 1 Hz", "": "more than 1,000 frames/s", "1 MHz": "too slow for its 1e+06 Hz"}


@pytest.mark.parametrize(("rate", "told"), PACES.items())
def test_a_pace_is_told_against_the_rate(rate: str, told: str) -> None:
    text = INSIDE + (f"rate: {rate}\n" if rate else "")
    ticking: Any = SimpleNamespace(now_ns=count(0, 10**9).__next__)  # every look takes a second
    pace = pace_of(with_golden(text, inside(b"abc"), "length: 3"), ticking)
    assert str(pace).startswith("inside by numpy, ")
    assert told in str(pace)
    assert "no check" not in str(pace)
