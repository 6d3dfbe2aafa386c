"""What captures show of their own frames, by bytes of struct and crccheck; and what nothing may be read from."""

import ast
import base64
import bisect
import calendar
import dis
import io
import marshal
import struct
import typing
import zlib
from functools import reduce
from operator import xor
from pathlib import Path
from types import ModuleType, SimpleNamespace

import numpy as np
import pytest
from crccheck.crc import Crc16Ibm3740, Crc16Xmodem, Crc32

from bench.commands.frame import explain
from bench.frame import decode_capture, draft, guesses, line_guess, parse_frame
from bench.model.errors import InputError, InputErrors

RNG_SEED = 20
NOISE_BYTES = 200_000


def fixed(rng: np.random.Generator) -> bytes:
    body = rng.bytes(40)
    return b"\xeb\x90" + body + struct.pack(">H", Crc16Ibm3740.calc(body))


def in_front(rng: np.random.Generator) -> bytes:
    body = rng.bytes(int(rng.integers(4, 90)))
    covered = struct.pack("<HH", 4007, len(body) + 8) + body
    return b"$@" + struct.pack("<H", Crc16Xmodem.calc(covered)) + covered


def with_trailer(rng: np.random.Generator) -> bytes:
    body = rng.bytes(int(rng.integers(300, 700)))
    return b"\xa0\xa2" + struct.pack(">H", len(body)) + body + struct.pack(">H", sum(body) & 0x7FFF) + b"\xb0\xb3"


def among_text(rng: np.random.Generator) -> bytes:
    body = b"\x14\x3e" + rng.bytes(50)
    return b"\xfa" + body + struct.pack("<I", Crc32.calc(body)) + b"M,%03d\r\nB,,\r\n" % rng.integers(1000)


KINDS = {
    "fixed": (fixed, "crc-16/ibm-3740"),
    "in_front": (in_front, "crc-16/xmodem"),
    "with_trailer": (with_trailer, "sum-15"),
    "among_text": (among_text, "crc-32/iso-hdlc"),
}


@pytest.fixture(params=KINDS)
def capture(request: pytest.FixtureRequest) -> tuple[bytes, str]:
    make, check = KINDS[request.param]
    rng = np.random.default_rng(RNG_SEED)
    return b"begin of a log\r\n" + b"".join(make(rng) for _ in range(120)), check


def test_a_first_definition_decodes_every_frame(capture: tuple[bytes, str]) -> None:
    data, check = capture
    best = guesses(data)[0]
    assert best.check is not None
    assert best.check.name == check
    definition = parse_frame(draft(best, data, "unit"), "unit.yaml")
    decoder = definition.decoder()
    decoder.feed(data)
    decoder.finish()
    assert (decoder.counts.frames, decoder.counts.bad) == (120, 0)


def test_damage_does_not_hide_a_frame(capture: tuple[bytes, str]) -> None:
    data, check = capture
    rng = np.random.default_rng(RNG_SEED)
    damaged = bytearray(data)
    for at in rng.integers(0, len(data), 8):
        damaged[at] ^= 0x10
    assert guesses(bytes(damaged))[0].check is not None
    assert guesses(bytes(damaged))[0].check.name == check  # type: ignore[union-attr]


@pytest.mark.parametrize("data", [b"", b"\x00", b"\xeb\x90" * 3, np.random.default_rng(1).bytes(NOISE_BYTES),
                                  b"".join(b"$GPGGA,%06d,,\r\n" % (n * n) for n in range(500))])  # fmt: skip
def test_nothing_is_read_from_noise_and_no_check_from_text(data: bytes) -> None:
    assert all(guess.check is None for guess in guesses(data))
    if len(data) == NOISE_BYTES:
        assert not guesses(data)


@pytest.mark.parametrize("module", [ast, bisect, calendar, dis, io, typing])
def test_what_is_regular_but_no_stream_of_frames_is_not_taken_for_one(module: ModuleType) -> None:
    """Code of Python: short pieces that repeat, of which many a hypothesis holds."""
    code = marshal.dumps(compile(Path(module.__file__ or "").read_bytes(), "module.py", "exec"))
    assert not explain._hypotheses(code)
    assert not explain._hypotheses(zlib.compress(code))


def test_how_surely_is_told(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    rng, source = np.random.default_rng(RNG_SEED), tmp_path / "capture.bin"
    source.write_bytes(b"".join(fixed(rng) for _ in range(12)))
    assert explain.new(source, "unit", None) == 0
    assert capsys.readouterr().err == (
        "sync eb 90, 12 frames of 44 (12) bytes, 100 % of the bytes; crc-16/ibm-3740 from byte 2 on, behind it, "
        "0 bytes before the end, big-endian, right in 12 of those tried; "
        "by chance in fewer than one of 10^51 captures of random bytes\n"
    )
    source.write_bytes(base64.encodebytes(source.read_bytes()))
    assert explain.new(source, "unit", None) == 1
    told = capsys.readouterr()
    assert told.out == ""
    assert "the capture is not as it was sent: it is base64 text; undone, its beginning shows sync eb 90" in told.err


def test_frame_new_writes_a_file_once(
    capture: tuple[bytes, str], tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    source, out = tmp_path / "capture.bin", tmp_path / "unit.yaml"
    source.write_bytes(capture[0])
    assert explain.new(source, "unit", out) == 0
    assert explain.new(source, "unit", None) == 0
    assert capsys.readouterr().out == out.read_text(encoding="utf-8")
    with pytest.raises(InputError, match="is there already"):
        explain.new(source, "unit", out)
    with pytest.raises(InputErrors, match="frame"):
        explain.new(source, "Two words", None)
    source.write_bytes(b"")
    assert explain.new(source, "unit", None) == 1
    assert capsys.readouterr().err == "the capture is empty\n"
    with pytest.raises(InputError, match="B-FRAME-030"):
        explain.new(tmp_path / "none", "unit", None)


def test_explain_tells_of_the_definition_and_of_the_capture(
    capture: tuple[bytes, str], tmp_path: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    source = tmp_path / "capture.bin"
    source.write_bytes(capture[0])
    assert explain.explain("vn100_binary", source) == 1
    told = capsys.readouterr().out
    assert "vn100_binary: 0 good" in told
    assert f"{capture[1]} from byte" in " ".join(told.split())
    text = told.partition("the lines of a definition:\n")[2]
    assert parse_frame(text, "told.yaml").name == "vn100_binary"
    monkeypatch.setattr("sys.stdin", SimpleNamespace(buffer=io.BytesIO(capture[0])))
    assert explain.explain("vn100_binary", Path("-")) == 1
    assert capsys.readouterr().out == told
    mistaken = tmp_path / "unit.yaml"
    mistaken.write_text(text.replace(f"name: {capture[1]}", "name: crc-16/usb"), encoding="utf-8")
    with pytest.raises(InputErrors, match="B-FRAME-0"):
        explain.explain(str(mistaken), source)
    assert "as the capture has it" in capsys.readouterr().out


def test_every_draft_is_a_definition_whatever_the_capture() -> None:
    """Few different bytes, repeated: hypotheses that are right by chance, with fields that might overlap."""
    rng = np.random.default_rng(RNG_SEED)
    drafts = 0
    for _ in range(25):
        piece = rng.choice(np.frombuffer(b"\x00\x01\xeb\x90\x05\x07", np.uint8), int(rng.integers(0, 300))).tobytes()
        capture = piece * int(rng.integers(1, 80))
        for guess in guesses(capture):
            parse_frame(draft(guess, capture, "unit"), "unit.yaml")
            drafts += 1
    assert drafts > 5


def test_lines_with_a_check_and_without() -> None:
    rng = np.random.default_rng(RNG_SEED)
    bodies = [f"IMU,{number},{rng.normal():.3f},{rng.integers(90)}".encode() for number in range(60)]
    checked = b"\xb5\x62noise\r\n" + b"".join(b"$%b*%02X\r\n" % (body, reduce(xor, body)) for body in bodies)
    by_crc = b"".join(b"#%b*%04x\n" % (body, Crc16Xmodem.calc(b"#" + body)) for body in bodies)
    plain = b"".join(b"%b\r\n" % body.replace(b",", b";") for body in bodies)
    for capture, check, separator in ((checked, "xor-8", ","), (by_crc, "crc-16/xmodem", ","), (plain, "none", ";")):
        guess = line_guess(capture)
        assert guess is not None
        assert (guess.check, guess.separator, len(guess.lines)) == (check, separator, len(bodies))
        definition = parse_frame(draft(guess, capture, "unit"), "unit.yaml")
        assert decode_capture(definition, io.BytesIO(capture)).counts.frames == len(bodies)
    for odd in (b" 0  %d 0.00 \n", b"\t%d\t2\n", b"1,\t%d\n", b"1e999,%d\n", b",,%d\n", b'"a\\",%d\n', b"{%d},#: @\n"):
        capture = b",,\n" + b"".join(odd % number for number in range(40))
        for guess in explain._hypotheses(capture):
            definition = parse_frame(draft(guess, capture, "unit"), "unit.yaml")
            assert decode_capture(definition, io.BytesIO(capture)).counts.frames > 0
    assert line_guess(rng.bytes(NOISE_BYTES)) is None
    assert line_guess(b"a letter to nobody\n" * 3) is None
    assert line_guess(b",$*" * 300_000) is None  # at once


def test_one_hypothesis_is_not_told_again_shifted() -> None:
    rng = np.random.default_rng(RNG_SEED)
    (best,) = guesses(b"".join(with_trailer(rng) for _ in range(60)))
    assert best.check is not None
    bodies = [rng.bytes(int(rng.integers(5, 9))) for _ in range(60)]
    small = [struct.pack(">HH", 0xA0A2, len(body)) + body + struct.pack(">HH", sum(body), 0xB0B3) for body in bodies]
    (best,) = guesses(b"".join(small))
    assert best.check is not None
    assert {best.check.name, *best.check.also} >= {"sum-15", "sum-16"}  # no sum reaches the sixteenth bit
