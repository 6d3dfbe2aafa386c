"""CRC and checksum engines against published check values and crccheck; escaped frames against published vectors."""

import io
import struct
import zlib
from functools import reduce
from itertools import accumulate
from operator import xor
from pathlib import Path

import crccheck.crc
import crcmod.crcmod
import numpy as np
import pytest
import yaml
from crccheck.crc import Crc16Xmodem
from hypothesis import given, settings
from hypothesis import strategies as st

from bench.frame import FrameDefinition, LinkDecoder, decode_capture, parse_frame
from bench.frame.crc import CATALOGUE, CHECKSUMS, Crc, CrcModel, find_checksum, find_model, require_fast_crc
from bench.frame.packets import ESCAPES
from bench.model.errors import InputError, InputErrors

CHECK_TEXT = b"123456789"
ORACLES = {kind._names[0].lower(): kind for kind in crccheck.crc.ALLCRCCLASSES if kind._width <= 64}
SEED = 411


def test_the_catalogue_is_that_of_the_oracle_with_its_aliases() -> None:
    assert set(CATALOGUE) == set(ORACLES)
    assert len(CATALOGUE) == 112
    aliases = [(alias, name) for name, kind in ORACLES.items() for alias in kind._names[1:]]
    assert len(aliases) > 60
    for alias, name in aliases:
        model = find_model(alias)
        assert model is not None
        assert model.name == name


@pytest.mark.validates("112 models of CRC", against="the published check values of the CRC catalogue")
@pytest.mark.parametrize("name", CATALOGUE)
def test_published_check_value_single_and_vectorised(name: str) -> None:
    model = CATALOGUE[name]
    crc = Crc(model)
    assert crc.of(CHECK_TEXT) == model.check
    many = np.tile(np.frombuffer(CHECK_TEXT, np.uint8), (200, 1))  # 200 rows: by tables
    assert set(crc.of_rows(many).tolist()) == {model.check}
    assert crc.of_rows(many[:1]).tolist() == [model.check]


@pytest.mark.validates("CRC of random messages, all models", against="the package crccheck")
@pytest.mark.parametrize("name", CATALOGUE)
def test_random_messages_agree_with_the_oracle(name: str) -> None:
    generator = np.random.default_rng(SEED)
    crc = Crc(CATALOGUE[name])
    for length in (1, 2, 7, 53, 94):
        rows = generator.integers(0, 256, (70, length), dtype=np.uint8)
        due = [ORACLES[name].calc(row.tobytes()) for row in rows[:3]]
        assert crc.of_rows(rows)[:3].tolist() == due
        assert [crc.of(row.tobytes()) for row in rows[:3]] == due
        assert crc.of_rows(rows).tolist() == [crc.of(row.tobytes()) for row in rows]


@pytest.mark.parametrize("width", [1, 5, 8, 11, 16, 17, 24, 31, 32, 40, 63, 64])
@pytest.mark.parametrize(("refin", "refout"), [(False, False), (True, True), (False, True), (True, False)])
def test_any_parameters_agree_with_the_oracle(width: int, refin: bool, refout: bool) -> None:
    generator = np.random.default_rng(SEED + width)
    poly, init, xorout = (int(generator.integers(0, 1 << 63)) * 2 + 1 & ((1 << width) - 1) for _ in range(3))
    crc = Crc(CrcModel("custom", width, poly, init, refin, refout, xorout))
    message = generator.integers(0, 256, 61, dtype=np.uint8)
    due = crccheck.crc.Crc(width, poly, init, refin, refout, xorout).calc(message.tobytes())
    assert crc.of(message.tobytes()) == due
    assert crc.of_rows(np.tile(message, (200, 1)))[-1] == due


def test_long_blocks_strided_rows_and_no_rows() -> None:
    generator = np.random.default_rng(SEED)
    frames = generator.integers(0, 256, (9000, 57), dtype=np.uint8)
    crc = Crc(CATALOGUE["crc-32/iso-hdlc"])
    values = crc.of_rows(frames[:, 2:55])
    for row in (0, 4095, 4096, 8191, 8192, 8999):
        assert values[row] == ORACLES["crc-32/iso-hdlc"].calc(frames[row, 2:55].tobytes())
    for few in (frames[:1, 2:55], frames[:2, 2:55]):
        before = few.tobytes()
        assert Crc(CATALOGUE["crc-15/can"]).of_rows(few)[0] == ORACLES["crc-15/can"].calc(few[0].tobytes())
        assert few.tobytes() == before
    assert Crc(CATALOGUE["crc-16/arc"]).of_rows(np.empty((0, 9), np.uint8)).shape == (0,)
    assert Crc(CATALOGUE["crc-15/can"]).of_rows(np.empty((0, 9), np.uint8)).shape == (0,)


PUBLISHED = yaml.safe_load(Path(__file__).with_name("checksums.yaml").read_text(encoding="utf-8"))


@pytest.mark.parametrize(("name", "text", "due"), PUBLISHED)
def test_checksums(name: str, text: str, due: int) -> None:
    check, message = find_checksum(name), bytes.fromhex(text)
    assert check is not None
    assert check.of(message) == due
    assert check.of_rows(np.tile(np.frombuffer(message, np.uint8), (3, 1))).tolist() == [due] * 3


def by_loop(name: str, message: bytes) -> int:
    """Return a checksum as its definition tells it, byte by byte or word by word."""
    kind, bits, *how = name.split("-")
    if kind in ("xor", "adler"):
        return reduce(xor, message) if kind == "xor" else zlib.adler32(message)
    word = 2 if how[:1] == ["words"] or (kind, bits) == ("fletcher", "32") else 1
    padded, order = message + bytes(-len(message) % word), "big" if "big" in how else "little"
    words = [int.from_bytes(padded[at : at + word], order) for at in range(0, len(padded), word)]  # type: ignore[arg-type]
    if kind == "fletcher":
        modulus = int(how[0].removeprefix("mod"))
        return sum(accumulate(words)) % modulus << 8 * word | sum(words) % modulus
    return {"ones": ~sum(words), "twos": -sum(words)}.get(how[-1] if how else "", sum(words)) & (1 << int(bits)) - 1


@pytest.mark.parametrize("name", sorted(set(CHECKSUMS) - {"none"}))
def test_checksums_of_one_message_and_of_many_agree(name: str) -> None:
    generator = np.random.default_rng(SEED)
    for length in (1, 2, 255, 2000):
        rows = generator.integers(0, 256, (5, length), dtype=np.uint8)
        rows[0] = 255
        assert CHECKSUMS[name].of_rows(rows).tolist() == [by_loop(name, row.tobytes()) for row in rows]


def test_missing_compiled_part_is_refused(monkeypatch: pytest.MonkeyPatch) -> None:
    require_fast_crc()
    monkeypatch.setattr(crcmod.crcmod, "_usingExtension", False)
    with pytest.raises(InputError, match="B-FRAME-031"):
        require_fast_crc()


KINDS = tuple(ESCAPES)
TEXT = """
frame: escaped
endian: big
escape: KIND
sync: []
fields: [{name: kind, type: u8}, {name: counter, type: u16, role: counter}, {name: body, type: bytes, count: rest}]
crc: {name: crc-16/xmodem, over: [kind, end]}
"""
# Cheshire and Baker, figures 2 to 4, and the examples of the encyclopaedia that follow them
COBS = {
    "00": "01 01",
    "00 00": "01 01 01",
    "00 11 00": "01 02 11 01",
    "11 22 00 33": "03 11 22 02 33",
    "11 22 33 44": "05 11 22 33 44",
    "11 00 00 00": "02 11 01 01 01",
    bytes(range(1, 255)).hex(): "ff" + bytes(range(1, 255)).hex(),
    bytes(range(255)).hex(): "01ff" + bytes(range(1, 255)).hex(),
    bytes(range(1, 256)).hex(): "ff" + bytes(range(1, 255)).hex() + "02ff",
    (bytes(range(2, 256)) + b"\0").hex(): "ff" + bytes(range(2, 256)).hex() + "0101",
    (bytes(range(3, 256)) + b"\0\1").hex(): "fe" + bytes(range(3, 256)).hex() + "0201",
}


def content(number: int, body: bytes) -> bytes:
    frame = struct.pack(">BH", 7, number % 65536) + body
    return frame + struct.pack(">H", Crc16Xmodem.calc(frame))


def on_the_wire(kind: str, frame: bytes) -> bytes:
    """Byte by byte, as the specifications tell it; COBS from behind."""
    if kind == "slip":
        return (
            b"\xc0"
            + b"".join({0xC0: b"\xdb\xdc", 0xDB: b"\xdb\xdd"}.get(byte, bytes([byte])) for byte in frame)
            + b"\xc0"
        )
    if kind == "hdlc":
        return b"~" + b"".join(bytes([0x7D, byte ^ 0x20]) if byte in b"}~" else bytes([byte]) for byte in frame) + b"~"
    if kind in ("dle", "dle_etx"):
        return (
            b"\x10\x02"[: 2 if kind == "dle" else 1]
            + b"".join(b"\x10\x10" if byte == 0x10 else bytes([byte]) for byte in frame)
            + b"\x10\x03"
        )
    out, place = bytearray(b"\x01"), 0
    for number, byte in enumerate(frame):
        if byte:
            out.append(byte)
            out[place] += 1
        if not byte or (out[place] == 0xFF and number < len(frame) - 1):
            place = len(out)
            out.append(1)
    return bytes(out) + b"\0"


def definition_of(kind: str) -> FrameDefinition:
    golden = on_the_wire(kind, content(1, b"\x10\xc0\x7e\x00"))
    expect = 'expect: {counter: 1, body: "10 c0 7e 00"}'
    return parse_frame(f'{TEXT.replace("KIND", kind)}golden: "{golden.hex(" ")}"\n{expect}\n', "escaped.yaml")


@pytest.mark.parametrize(("plain", "packed"), COBS.items())
def test_cobs_as_published(plain: str, packed: str) -> None:
    frame, wire = bytes.fromhex(plain), bytes.fromhex(packed) + b"\0"
    assert ESCAPES["cobs"].packed(frame) == wire == on_the_wire("cobs", frame)
    piece = ESCAPES["cobs"].next_packet(wire, 0, 1000)
    assert piece is not None
    assert (piece.frame, piece.end) == (frame, len(wire))


def test_slip_and_hdlc_as_published() -> None:
    """RFC 1055: END is ESC 0xDC, ESC is ESC 0xDD; RFC 1662, 4.2: 0x7e is 7d 5e, 0x7d is 7d 5d."""
    assert ESCAPES["slip"].packed(b"\xc0\xdb\x00") == bytes.fromhex("c0 dbdc dbdd 00 c0")
    assert ESCAPES["hdlc"].packed(b"\x7e\x7d\x00") == bytes.fromhex("7e 7d5e 7d5d 00 7e")


@settings(max_examples=200, deadline=None)
@given(kind=st.sampled_from(KINDS), frame=st.binary(max_size=700) | st.binary(max_size=4).map(lambda few: few * 150))
def test_two_ways_of_escaping_agree(kind: str, frame: bytes) -> None:
    frame = b"\7" + frame
    wire = ESCAPES[kind].packed(frame)
    assert wire == on_the_wire(kind, frame)
    begin = 1 if kind in ("slip", "hdlc") else 0
    piece = ESCAPES[kind].next_packet(wire, begin, 5000)
    assert piece is not None
    assert piece.frame == frame
    assert piece.end == len(wire)


@pytest.mark.parametrize("kind", KINDS)
def test_frames_of_a_link(kind: str) -> None:
    definition = definition_of(kind)
    rng = np.random.default_rng(21)
    frames = [on_the_wire(kind, content(number, rng.bytes(int(rng.integers(0, 60))))) for number in range(300)]
    hurt = bytearray(frames[100])
    hurt[len(hurt) // 2] ^= 0x02
    frames[100] = bytes(hurt)
    link = LinkDecoder(definition)
    for number, frame in enumerate(frames):
        link.push(number, frame)
    batch = link.flush().messages["frame"]
    assert batch.raw("counter").tolist() == [number for number in range(300) if number != 100]
    assert batch.t_ns is not None
    assert batch.t_ns.tolist() == batch.raw("counter").tolist()
    assert (link.counts.lost, link.counts.suspect) == (1, 0)
    assert link.counts.bad >= 1
    assert link.counts.bytes == sum(map(len, frames))
    assert 0 < link.counts.skipped_bytes <= len(hurt) + 2
    assert definition.encode_one({"kind": 7, "counter": 9, "body": b"a"}) == on_the_wire(kind, content(9, b"a"))


@pytest.mark.parametrize("kind", KINDS)
def test_the_last_packet_of_a_capture_may_lack_its_end(kind: str) -> None:
    definition, wire = definition_of(kind), on_the_wire(kind, content(1, b"\x10y"))
    end = len(ESCAPES[kind].end)
    for cut, good in ((end, 2), (end + 1, 1)):
        found = decode_capture(definition, io.BytesIO((wire * 2)[:-cut]))
        assert (found.counts.frames, found.counts.bad, found.cut_off) == (good, 2 - good, good == 1)


@pytest.mark.parametrize("kind", KINDS)
def test_a_packet_without_an_end_does_not_grow_for_ever(kind: str) -> None:
    definition = definition_of(kind)
    decoder = definition.decoder()
    decoder.feed(on_the_wire(kind, content(0, b"x"))[:-2] + b"\x01" * 300_000)
    frame = on_the_wire(kind, content(1, b"y"))
    found = [decoder.feed(frame), decoder.feed(frame), decoder.finish()]
    assert sum(len(batch.messages["frame"]) for batch in found) >= 1
    assert decoder.counts.bad >= 1


def test_idle_flags_are_no_packets() -> None:
    decoder = definition_of("hdlc").decoder()
    frame = on_the_wire("hdlc", content(3, b"z"))
    found = decoder.feed(b"~" * 200_000 + frame + b"~" * 10).messages["frame"]
    assert (len(found), decoder.counts.bad, decoder.counts.skipped_bytes) == (1, 0, 0)


def test_what_cannot_be_escaped_is_told() -> None:
    definition = definition_of("slip")
    with pytest.raises(InputError, match=r"B-FRAME-020: .*no fixed length"):
        definition.encode({"kind": 1, "counter": 1, "body": b""}, 2)
    with pytest.raises(InputErrors, match="has wrong escapes, or no end"):
        parse_frame(definition.text.replace(' c0"', '"'), "escaped.yaml")
