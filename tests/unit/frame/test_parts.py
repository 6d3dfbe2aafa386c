"""Groups, optional parts, items, integers of any bits, and lines of text: against struct, and published sentences."""

import csv
import json
import struct
from functools import reduce
from io import BytesIO
from itertools import pairwise
from operator import xor
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import yaml
from crccheck.crc import Crc16Xmodem
from record_sample import frame as frame_of

from bench.frame import Engine, FrameDefinition, Tables, decode_capture, parse_frame
from bench.model.errors import InputError, InputErrors

MISTAKES = yaml.safe_load(Path(__file__).with_name("mistakes.yaml").read_text(encoding="utf-8"))
SEED = 2020
STATION = "d3 00 13 3e d7 d3 02 02 98 0e de ef 34 b4 bd 62 ac 09 41 98 6f 33 36 0b 98"  # the example of RTCM 10403
HEAD = [{"name": "length", "type": "u8"}, {"name": "flags", "type": "u8", "bits": {"extra": 0, "sets": "1-3"}}]
GROUP = {"group": "sets", "count": "flags.sets", "max": 3,
         "fields": [{"name": "axis", "type": "u8"}, {"name": "rate", "type": "f32", "unit": "deg/s"}]}  # fmt: skip
EXTRA = {"optional": "extra", "when": "flags.extra", "fields": [{"name": "temperature", "type": "i16", "scale": 0.5}]}
ITEMS = {"items": "outputs", "id": "u8", "length": "u8",
         "of": {"force": {"id": 7, "fields": [{"name": "accel", "type": "f64"}]},
                "time": {"id": 8, "required": True, "fields": [{"name": "tick", "type": "u32"}]},
                "mark": {"id": 9}}}  # fmt: skip
LENGTH = {"field": "length", "plus": 0, "max": 200}


def of(parts: list[dict[str, Any]], golden: bytes, **more: Any) -> FrameDefinition:
    spec = {"frame": "parts", "endian": "little", "sync": [0xA5], "length": LENGTH, "fields": [*HEAD, *parts],
            "crc": {"name": "sum-8", "over": ["sync", "end"]}, "golden": golden.hex(),
            "expect": {"flags": golden[2]}}  # fmt: skip
    return parse_frame(
        json.dumps({key: value for key, value in (spec | more).items() if value is not None}), "parts.yaml"
    )


def sealed(flags: int, body: bytes) -> bytes:
    frame = struct.pack("3B", 0xA5, len(body) + 4, flags) + body
    return frame + bytes([sum(frame) % 256])


TWO_SETS = sealed(2 << 1 | 1, struct.pack("<BfBfh", 3, 1.5, 4, -2.5, -41))
NO_SET = sealed(0, b"")


@pytest.mark.parametrize("engine", ["reference", "numpy"])
def test_a_group_and_an_optional_part(engine: Engine) -> None:
    definition = of([GROUP, EXTRA], TWO_SETS)
    batch = definition.decoder(engine).feed(TWO_SETS + NO_SET + TWO_SETS).messages["frame"]
    assert batch.offset.tolist() == [0, len(TWO_SETS), len(TWO_SETS) + len(NO_SET)]
    assert batch.raw("axis").tolist() == [[3, 4, 0], [0, 0, 0], [3, 4, 0]]
    np.testing.assert_array_equal(batch.scaled("rate")[:2], [[1.5, -2.5, np.nan], [np.nan] * 3])
    np.testing.assert_array_equal(batch.scaled("temperature"), [-20.5, np.nan, -20.5])
    assert batch.there("axis").tolist() == [2, 0, 2]  # type: ignore[union-attr]
    assert batch.newest("temperature") == -20.5
    assert np.isnan(definition.decoder(engine).feed(TWO_SETS + NO_SET).messages["frame"].newest("temperature"))


@pytest.mark.parametrize("suffix", [".csv", ".parquet"])
def test_what_a_frame_does_not_hold_is_empty_in_a_table(suffix: str, tmp_path: Path) -> None:
    tags = {"optional": "tags", "when": "flags.extra", "fields": [
        {"name": "tag", "type": "u64"}, {"name": "state", "type": "u8", "bits": {"on": 0}},
        {"name": "label", "type": "bytes", "count": 2}]}  # fmt: skip
    great = 2**63 + 1  # no float holds it
    full = sealed(1 << 1 | 1, struct.pack("<BfQB2s", 3, 1.5, great, 1, b"ab"))
    definition, path = of([GROUP, tags], full), tmp_path / f"t{suffix}"
    with Tables(definition, path) as tables:
        decode_capture(definition, BytesIO(full + NO_SET), tables.write)
    if suffix == ".csv":
        with path.open(newline="", encoding="utf-8") as stream:
            rows = list(csv.DictReader(stream))
        due: list[dict[str, Any]] = [
            {"axis_1": "3", "axis_2": "", "tag": str(great), "state.on": "1", "label": "6162"},
            {"axis_1": "", "axis_2": "", "tag": "", "state.on": "", "label": ""},
        ]
    else:
        rows = pytest.importorskip("pyarrow.parquet").read_table(path).to_pylist()
        due = [{"axis_1": 3, "axis_2": None, "tag": great, "state.on": 1, "label": b"ab"},
               {"axis_1": None, "axis_2": None, "tag": None, "state.on": None, "label": None}]  # fmt: skip
    assert [{name: row[name] for name in due[0]} for row in rows] == due


def test_what_is_encoded_is_what_struct_makes() -> None:
    definition = of([GROUP, EXTRA], TWO_SETS)
    assert definition.encode_one({"axis": [3, 4], "rate": [1.5, -2.5], "temperature": -41}) == TWO_SETS
    assert definition.encode_one({}) == NO_SET
    assert definition.encode_one({"flags": 0}) == NO_SET
    with pytest.raises(InputError, match=r"B-FRAME-021: .*more than 3 sets"):
        definition.encode_one({"flags": 4 << 1, "axis": [1, 2, 3], "rate": [1, 2, 3]})
    with pytest.raises(InputError, match="no value for the field 'rate'"):
        definition.encode_one({"axis": [3, 4]})
    for values, words in (
        ({"axis": [3, 4], "rate": [1.5]}, "1 values are given for 'rate', 'flags.sets' says 2"),
        ({"axis": [3], "rate": [1.5, 2.5]}, "2 values are given for 'rate', 'flags.sets' says 1"),
        ({"flags": 0, "temperature": 4}, "1 values are given for 'temperature', 'flags.extra' says 0"),
    ):
        with pytest.raises(InputError, match=words) as caught:
            definition.encode_one(values)
        assert caught.value.code == "B-FRAME-020"


@pytest.mark.parametrize("engine", ["reference", "numpy"])
def test_counts_in_front_say_how_long_a_frame_is(engine: Engine) -> None:
    print(f"seed {SEED}")
    draw = np.random.default_rng(SEED)
    whole = of([GROUP, EXTRA], TWO_SETS, length=None)
    pieces = [TWO_SETS, NO_SET, sealed(0x7F, bytes(20)), b"\xa5", b"\xa5\x00", TWO_SETS[:-3], b"\x00"]
    for _ in range(60):
        stream = b"".join(pieces[index] for index in draw.integers(0, len(pieces), 10))
        due = whole.decoder("reference")
        offsets = [*due.feed(stream).messages["frame"].offset, *due.finish().messages["frame"].offset]
        cuts = [0, *sorted(draw.integers(0, len(stream), 6).tolist()), len(stream)]
        parts = whole.decoder(engine)
        found = [parts.feed(stream[low:high]) for low, high in pairwise(cuts)] + [parts.finish()]
        assert [at for batch in found for at in batch.messages["frame"].offset] == offsets
        assert parts.counts == due.counts


@pytest.mark.parametrize("engine", ["reference", "numpy"])
def test_items_in_any_order(engine: Engine) -> None:
    time, force, mark, other = (
        struct.pack("<BBI", 8, 4, 12345),
        struct.pack("<BBd", 7, 8, 9.81),
        b"\x09\x00",
        b"\x63\x02ab",
    )
    golden = sealed(0, other + force + time)
    definition = of([ITEMS], golden)
    batch = definition.decoder(engine).feed(golden + sealed(0, time + mark)).messages["frame"]
    assert batch.raw("tick").tolist() == [12345, 12345]
    assert (batch.raw("force").tolist(), batch.raw("mark").tolist()) == ([1, 0], [0, 1])
    np.testing.assert_array_equal(batch.raw("accel"), [9.81, np.nan])
    assert definition.encode_one({"flags": 0, "tick": 12345, "accel": 9.81}) == sealed(0, force + time)
    bad = [force, time + time, struct.pack("<BBH", 8, 2, 1), time + b"\x07", time + b"\x07\x08\x00"]
    decoder = definition.decoder(engine)
    decoder.feed(b"".join(sealed(0, body) for body in bad))
    assert (decoder.counts.frames, decoder.counts.bad >= len(bad)) == (0, True)


def test_the_published_example_of_a_reference_station() -> None:
    batch = frame_of("rtcm3").decoder().feed(bytes.fromhex(STATION)).messages["station"]
    place = [float(batch.scaled(name)[0]) for name in "xyz"]
    assert place == pytest.approx([1114104.5999, -4850729.7108, 3975521.4643], abs=1e-9)
    assert batch.raw("station").tolist() == [2003]


@pytest.mark.parametrize("endian", ["big", "little"])
def test_integers_of_any_number_of_bits(endian: str) -> None:
    print(f"seed {SEED}")
    draw = np.random.default_rng(SEED)
    for _ in range(200):
        widths = draw.integers(1, 54, int(draw.integers(1, 8))).tolist()
        widths += [8 - sum(widths) % 8] if sum(widths) % 8 else []
        body = draw.bytes(sum(widths) // 8)
        bits = int.from_bytes(body, endian)  # type: ignore[arg-type]
        due, at = [], 0
        for width in widths:
            low = sum(widths) - at - width if endian == "big" else at
            due.append(bits >> low & (1 << width) - 1)
            at += width
        fields = [{"name": f"f{number}", "type": f"{'ui'[number % 2]}{width}"} for number, width in enumerate(widths)]
        golden = sealed(0, body)
        for engine in ("reference", "numpy"):
            batch = of(fields, golden, endian=endian).decoder(engine).feed(golden).messages["frame"]  # type: ignore[arg-type]
            for number, (width, value) in enumerate(zip(widths, due, strict=True)):
                signed = value - (1 << width) if number % 2 and value >> width - 1 else value
                assert int(batch.raw(f"f{number}")[0]) == signed


def test_bytes_in_front_of_the_sync_bytes() -> None:
    spec = {"frame": "behind", "endian": "big", "sync": [0xAA, 0x55], "sync_at": 2,
            "fields": [{"name": "count", "type": "u16"}, {"name": "value", "type": "u8"}],
            "crc": {"name": "sum-8", "over": ["count", "end"]}, "golden": "", "expect": {"count": 258}}  # fmt: skip
    frame = bytes.fromhex("01 02 aa 55 07 09")
    definition = parse_frame(json.dumps(spec | {"golden": (frame[:5] + bytes([sum(frame[:5]) % 256])).hex()}), "s.yaml")
    frame = definition.encode_one({"count": 258, "value": 7})
    assert frame[:5] == bytes.fromhex("0102aa5507")
    for engine in ("reference", "numpy"):
        decoder = definition.decoder(engine)  # type: ignore[arg-type]
        batch = decoder.feed(b"\xaa\x55\x00" + frame + b"\x00" + frame).messages["frame"]
        assert batch.offset.tolist() == [3, 4 + len(frame)]
    for changes, words in (({"sync_at": 1}, "lies over the sync bytes"), ({"sync_at": 3}, "no field stands behind"),
                           ({"sync": []}, "no sync bytes")):  # fmt: skip
        with pytest.raises(InputErrors, match=words):
            parse_frame(json.dumps(spec | changes), "s.yaml")


@pytest.mark.parametrize(("parts", "more", "code", "words"), MISTAKES["parts"])
def test_mistakes_say_what_to_do(parts: list[Any], more: dict[str, Any], code: str, words: str) -> None:
    with pytest.raises(InputErrors) as caught:
        of(parts, bytes.fromhex(more.pop("golden", TWO_SETS.hex())), **more)
    assert any(error.code == code and words in error.message + error.next_step for error in caught.value.errors)


LINES_SEED = 2000
GGA = b"$GPGGA,092725.00,4717.11399,N,00833.91590,E,1,08,1.01,499.6,M,48.0,M,,*5B\r\n"
RMC = b"$GPRMC,083559.00,A,4717.11437,N,00833.91522,E,0.004,77.52,091202,,,A*57\r\n"
NO_FIX = b"GNGGA,,,,,,0,,,,M,,M,,"
SPEC: dict[str, Any] = yaml.safe_load(Path(__file__).with_name("lines.yaml").read_text(encoding="utf-8"))


def nmea(body: bytes) -> bytes:
    return b"$" + body + b"*%02X\r\n" % reduce(xor, body)


def line_of(changes: dict[str, Any]) -> FrameDefinition:
    return parse_frame(json.dumps({**right(), **changes}), "lines.yaml")


def right() -> dict[str, Any]:
    body = "#IMU,7,00F1;1.5,-2e-3,-40"
    return {**SPEC, "golden": f"{body}*{Crc16Xmodem.calc(body.encode()):04X}"}


def test_sentences_of_the_receiver_description() -> None:
    definition = frame_of("nmea_0183")
    batches = definition.decoder().feed(GGA + RMC + nmea(b"GPGSV,1,1,00")).messages
    assert batches["gga"].raw("latitude").tolist() == [pytest.approx(47 + 17.11399 / 60, abs=1e-12)]
    assert batches["gga"].raw("tick").tolist() == [9 * 3600 + 27 * 60 + 25]
    assert batches["rmc"].raw("address")[0].tobytes() == b"GPRMC"
    assert batches["rmc"].scaled("speed")[0] == pytest.approx(0.004 * 1852 / 3600)


def test_empty_values_other_sentences_and_noise() -> None:
    decoder = frame_of("nmea_0183").decoder()
    south = nmea(b"GPGGA,000000.00,0130.0,S,12030.0,W,1,8,1,5,M,4,M,,")
    batch = decoder.feed(b"\xb5\x62\x01noise" + nmea(NO_FIX) + nmea(b"PUBX,00,1") + south).messages["gga"]
    assert np.isnan(batch.raw("latitude")).tolist() == [True, False]
    assert np.isnan(batch.raw("satellites")).tolist() == [True, False]
    assert (batch.raw("latitude")[1], batch.raw("longitude")[1]) == (-1.5, -120.5)
    counts = decoder.counts
    assert (counts.frames, counts.other, counts.bad, counts.skipped_bytes) == (2, 1, 0, 8)


@pytest.mark.parametrize(
    "line",
    [
        GGA.replace(b"499.6", b"499.7"),  # the check
        GGA.replace(b"*5B", b""),
        nmea(b"GPGGA,092725.00,4760.0,N,00833.0,E,1,08,1,499.6,M,48.0,M,,"),  # sixty minutes
        nmea(b"GPGGA,092725.00,4717.0,E,00833.0,E,1,08,1,499.6,M,48.0,M,,"),  # a latitude to the east
        nmea(b"GPGGA,092725.00,4717.0,N,00833.0,E,1,08,nan,499.6,M,48.0,M,,"),
        nmea(b"GPGGA,092725.00,4717.0,N,00833.0,E,,08,1,499.6,M,48.0,M,,"),  # an integer must be there
        nmea(b"GPGGA,092725.00,4717.0,N"),
        GGA.replace(b"M,48", b"\xcd,48"),
        GGA[:30],
    ],
)
def test_a_line_that_is_none_is_one_bad(line: bytes) -> None:
    decoder = frame_of("nmea_0183").decoder()
    batch = decoder.feed(GGA + line + RMC)
    assert (decoder.counts.frames, decoder.counts.bad, decoder.counts.other) == (2, 1, 0)
    assert batch.bad_offset.tolist() == [len(GGA)]


def test_chunks_make_no_difference() -> None:
    print(f"seed {LINES_SEED}")
    draw = np.random.default_rng(LINES_SEED)
    for sync in ([0x23], [0x23, 0x49], []):
        golden = right()["golden"]
        spec = {"sync": sync}
        if sync != [0x23]:
            body = "#IMU,7,00F1;1.5,-2e-3,-40"[len(sync) :]
            fields = [{"name": "address", "type": "bytes", "count": 4}, *SPEC["fields"][1:]]
            golden = bytes(sync).decode() + body + f"*{Crc16Xmodem.calc(bytes(sync) + body.encode()):04X}"
            spec |= {"fields": fields}
        definition = line_of({**spec, "golden": golden})
        pieces = [golden.encode() + b"\r\n", golden.encode() + b"\n", b"#", b"#I", b"\r", b"\n", b"x" * 120, b"\x80,"]
        for _ in range(100):
            stream = b"".join(pieces[index] for index in draw.integers(0, len(pieces), 12))
            whole, parts = definition.decoder(), definition.decoder()
            found = [*whole.feed(stream).bad_offset, *whole.finish().bad_offset]
            cuts = [0, *sorted(draw.integers(0, len(stream), 8).tolist()), len(stream)]
            batches = [parts.feed(stream[low:high]) for low, high in pairwise(cuts)]
            assert [at for batch in [*batches, parts.finish()] for at in batch.bad_offset] == found
            assert parts.counts == whole.counts


def test_numbers_of_a_line_are_read_to_the_last_bit() -> None:
    draw, definition = np.random.default_rng(LINES_SEED), line_of({})
    rates = draw.integers(0, 1 << 32, (200, 2), np.uint32).view(np.float32)
    rates[~np.isfinite(rates)] = 0
    for number, pair in enumerate(rates):
        body = f"#IMU,{number},{number:04x},{pair[0]},{pair[1]!s},-40"
        batch = definition.decoder().feed(f"{body}*{Crc16Xmodem.calc(body.encode()):04X}\n".encode()).messages["frame"]
        np.testing.assert_array_equal(batch.raw("rate")[0], pair)
        assert (batch.raw("sequence")[0], batch.raw("status")[0]) == (number, number)
    with pytest.raises(InputError, match=r"B-FRAME-020: .*lines are read, and not written"):
        definition.encode_one({})


@pytest.mark.parametrize(("changes", "code", "words"), MISTAKES["lines"])
def test_mistakes_in_lines_say_what_to_do(changes: dict[str, Any], code: str, words: str) -> None:
    with pytest.raises(InputErrors) as caught:
        line_of(changes)
    assert any(error.code == code and words in error.message for error in caught.value.errors), caught.value
