"""Lines of text: sentences of the u-blox receiver description, empty values, damage, chunks, mistakes."""

from __future__ import annotations

import json
import math
from functools import reduce
from itertools import pairwise
from operator import xor
from typing import Any

import numpy as np
import pytest
from record_sample import frame as frame_of

from bench.frame import FrameDefinition
from bench.frame.definition import parse_frame
from bench.model.errors import InputError, InputErrors

SEED = 2000
GGA = b"$GPGGA,092725.00,4717.11399,N,00833.91590,E,1,08,1.01,499.6,M,48.0,M,,*5B\r\n"
RMC = b"$GPRMC,083559.00,A,4717.11437,N,00833.91522,E,0.004,77.52,091202,,,A*57\r\n"
NO_FIX = b"GNGGA,,,,,,0,,,,M,,M,,"
SPEC: dict[str, Any] = {
    "frame": "lines",
    "sync": [0x23],
    "lines": {"separator": ",;", "check": "*", "max": 100},
    "fields": [
        {"name": "address", "type": "bytes", "count": 3},
        {"name": "sequence", "type": "u16", "role": "counter"},
        {"name": "status", "type": "u16", "form": "hex", "bits": {"ready": 0}},
        {"name": "rate", "type": "f32", "count": 2, "scale": 0.5, "unit": "deg/s"},
        {"name": "temperature", "type": "i8", "unit": "degC"},
    ],
    "crc": {"name": "crc-16/xmodem", "over": ["sync", "end"]},
    "golden": "#IMU,7,00F1;1.5,-2e-3,-40*EF3F",
    "expect": {"sequence": 7, "status.ready": 1, "rate": [0.75, -0.001], "temperature": -40},
}


def nmea(body: bytes) -> bytes:
    return b"$" + body + b"*%02X\r\n" % reduce(xor, body)


def xmodem(text: bytes) -> int:
    value = 0
    for byte in text:
        value ^= byte << 8
        for _ in range(8):
            value = (value << 1 ^ 0x1021 if value & 0x8000 else value << 1) & 0xFFFF
    return value


def of(changes: dict[str, Any]) -> FrameDefinition:
    return parse_frame(json.dumps({**right(), **changes}), "lines.yaml")


def right() -> dict[str, Any]:
    body = "#IMU,7,00F1;1.5,-2e-3,-40"
    return {**SPEC, "golden": f"{body}*{xmodem(body.encode()):04X}"}


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
        nmea(b"GPGGA,242725.00,4717.0,N,00833.0,E,1,08,1,499.6,M,48.0,M,,"),
        nmea(b"GPGGA,092725.00,4717.0,N,00833.0,E,1,08,nan,499.6,M,48.0,M,,"),
        nmea(b"GPGGA,092725.00,4717.0,N,00833.0,E,,08,1,499.6,M,48.0,M,,"),  # an integer must be there
        nmea(b"GPGGA,092725.00,4717.0,N,00833.0,E,256,08,1,499.6,M,48.0,M,,"),
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
    print(f"seed {SEED}")
    draw = np.random.default_rng(SEED)
    for sync in ([0x23], [0x23, 0x49], []):
        golden = right()["golden"]
        spec = {"sync": sync}
        if sync != [0x23]:
            body = "#IMU,7,00F1;1.5,-2e-3,-40"[len(sync) :]
            fields = [{"name": "address", "type": "bytes", "count": 4}, *SPEC["fields"][1:]]
            golden = bytes(sync).decode() + body + f"*{xmodem(bytes(sync) + body.encode()):04X}"
            spec |= {"fields": fields}
        definition = of({**spec, "golden": golden})
        pieces = [golden.encode() + b"\r\n", golden.encode() + b"\n", b"#", b"#I", b"\r", b"\n", b"x" * 120, b"\x80,"]
        for _ in range(100):
            stream = b"".join(pieces[index] for index in draw.integers(0, len(pieces), 12))
            whole, parts = definition.decoder(), definition.decoder()
            found = [*whole.feed(stream).bad_offset, *whole.finish().bad_offset]
            cuts = [0, *sorted(draw.integers(0, len(stream), 8).tolist()), len(stream)]
            batches = [parts.feed(stream[low:high]) for low, high in pairwise(cuts)]
            assert [at for batch in [*batches, parts.finish()] for at in batch.bad_offset] == found
            assert parts.counts == whole.counts


def test_what_is_written_is_read() -> None:
    print(f"seed {SEED}")
    draw = np.random.default_rng(SEED)
    definition = of({})
    for _ in range(200):
        rate = draw.integers(0, 1 << 32, 2, np.uint32).view(np.float32)
        rate[~np.isfinite(rate)] = math.nan
        due = {"address": np.bytes_(b"IMU"), "sequence": int(draw.integers(1 << 16)), "rate": rate,
               "status": int(draw.integers(1 << 16)), "temperature": int(draw.integers(-128, 128))}  # fmt: skip
        batch = definition.decoder().feed(definition.encode_one(due)).messages["frame"]
        np.testing.assert_array_equal(batch.raw("rate")[0], rate)
        for name in ("sequence", "status", "temperature"):
            assert batch.raw(name).tolist() == [due[name]]
    nmea_0183 = frame_of("nmea_0183")
    values = nmea_0183.decoder().feed(GGA).messages["gga"].columns()
    again = nmea_0183.decoder().feed(nmea_0183.encode_one({name: column[0] for name, column in values.items()}, "gga"))
    assert again.messages["gga"].raw("latitude")[0] == pytest.approx(values["latitude"][0], abs=1e-11)


@pytest.mark.parametrize(
    ("name", "value"), [("rate", [math.inf, 0]), ("address", np.bytes_(b"a,b")), ("address", np.bytes_(b"\xe9bc"))]
)
def test_what_cannot_stand_in_a_line(name: str, value: object) -> None:
    values = {"address": np.bytes_(b"IMU"), "sequence": 1, "status": 1, "rate": [0, 0], "temperature": 1}
    with pytest.raises(InputError, match="cannot stand in a line") as caught:
        of({}).encode_one({**values, name: value})
    assert caught.value.code == "B-FRAME-021"


@pytest.mark.parametrize(
    ("changes", "code", "words"),
    [
        ({"lines": None}, "B-FRAME-006", "order of bytes"),
        ({"lines": {"max": 100}}, "B-FRAME-008", "the character before it"),
        ({"trailer": [1]}, "B-FRAME-006", "lines have no 'trailer'"),
        ({"sync": [0x80]}, "B-FRAME-006", "printable"),
        ({"crc": {"name": "xor-8", "over": ["sequence", "end"]}}, "B-FRAME-008", "covers it from"),
        ({"crc": {"name": "xor-8", "over": ["sync", "end"], "stored": "big"}}, "B-FRAME-008", "hex digits"),
        ({"fields": [{"name": "a", "type": "bytes", "count": "rest"}]}, "B-FRAME-002", "no 'rest'"),
        ({"fields": [{"name": "a", "type": "f32", "form": "time"}]}, "B-FRAME-002", "is for f64"),
        ({"golden": "IMU,7*00"}, "B-FRAME-011", "does not begin with '#'"),
        ({"golden": "#IMU,7*00"}, "B-FRAME-011", "stands '00'"),
        ({"golden": f"#IMU,7*{xmodem(b'#IMU,7'):04X}"}, "B-FRAME-011", "has 2 values, 'frame' has 6"),
        ({"type": {"field": "sequence"}}, "B-FRAME-006", "the type of a line"),
    ],
)
def test_mistakes_say_what_to_do(changes: dict[str, Any], code: str, words: str) -> None:
    with pytest.raises(InputErrors) as caught:
        of(changes)
    assert any(error.code == code and words in error.message for error in caught.value.errors), caught.value
