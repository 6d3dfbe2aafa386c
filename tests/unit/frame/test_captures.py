"""Raw captures: as tables, why frames are bad, and those that want more memory or time than is there."""

import base64
import csv
import gzip
import io
import json
import struct
import tracemalloc
from collections.abc import Callable
from functools import reduce
from operator import xor
from pathlib import Path
from time import process_time
from typing import Any

import numpy as np
import pytest
from record_sample import captured, frame, golden_bytes

from bench.commands.frame.decode import decode
from bench.frame import Counted, FrameDefinition, LinkDecoder, Tables, decode_capture, line_guess, parse_frame
from bench.model.errors import InputError, InputErrors

GOLDEN = Path(__file__).resolve().parents[2] / "golden"


def tabulated(definition: FrameDefinition, capture: Path, out: Path, engine: Any = None) -> list[Path]:
    with Tables(definition, out) as tables, capture.open("rb") as stream:
        decode_capture(definition, stream, tables.write, engine)
    return list(tables.paths.values())


def test_counts_and_csv_of_a_capture_longer_than_a_block(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("bench.frame.capture._BLOCK_BYTES", 1000)
    monkeypatch.setattr("bench.frame.table._ROWS_AT_ONCE", 7)
    definition = frame("ngu_a")
    columns = {"counter": np.arange(100) * 2, "npp": 1, "ppp": 2, "af_clock": 3, "master_count": 4, "fg_count": 5}
    rows = definition.encode(columns | {"status": 1 << 12}, 100)
    rows[50, 30] ^= 1
    capture = tmp_path / "capture.bin"
    capture.write_bytes(b"noise" + rows.tobytes() + b"\xeb\x90")
    assert captured(definition, capture)[0].summary() == {
        "frame": "ngu_a", "frame_sha256": definition.sha256, "check": "crc-16/ibm-3740", "good": 99, "bytes": 5707,
        "bad": 1, "lost": 100, "duplicate": 0, "suspect": 0, "skipped_bytes": 64, "other": 0, "jumps": 0,
        "messages": {"frame": 99}, "cut_off": True, "mangled": [], "bad_because": [{
            "cause": "check", "number": 1, "offset": 5 + 50 * 57,
            "text": "fails its check: crc-16/ibm-3740 over bytes 2 to 54 is 0xd68a, the frame holds 0x933e"}],
    }  # fmt: skip
    assert tabulated(definition, capture, tmp_path / "out.csv") == [tmp_path / "out.csv"]
    with (tmp_path / "out.csv").open(newline="", encoding="utf-8") as stream:
        table = list(csv.DictReader(stream))
    assert len(table) == 99
    assert [int(row["counter"]) for row in table] == [2 * i for i in range(100) if i != 50]
    assert [int(row["offset"]) for row in table[:2]] == [5, 62]
    assert table[98]["npp_10 [pulse]"] == "1"
    assert (table[98]["status.mode"], table[98]["status.calibrating"]) == ("1", "0")


@pytest.mark.parametrize("name", ["ngu_a", "ngu_b", "vn100_binary"])
def test_parquet_has_the_columns_and_values_of_the_csv(
    name: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    parquet = pytest.importorskip("pyarrow.parquet")
    monkeypatch.setattr("bench.frame.capture._BLOCK_BYTES", 500)
    capture = tmp_path / "capture.bin"
    of_one = [path.read_text(encoding="ascii") for path in sorted(GOLDEN.glob(f"{name}*.hex"))]
    capture.write_bytes(b"".join(map(bytes.fromhex, of_one)) * 30)
    tables = (
        tabulated(frame(name), capture, tmp_path / "t.csv"),
        tabulated(frame(name), capture, tmp_path / "t.parquet"),
    )
    rows = 0
    for csv_path, parquet_path in zip(*tables, strict=True):
        found = parquet.read_table(parquet_path)
        with csv_path.open(newline="", encoding="utf-8") as stream:
            head, *lines = csv.reader(stream)
        assert found.column_names == head
        assert found.num_rows == len(lines)
        assert {str(kind) for kind in found.schema.types} <= {"int64", "uint64", "float", "double", "binary", "string"}
        for title, texts in zip(head, zip(*lines, strict=True), strict=True) if lines else ():
            values = found[title].to_pylist()
            assert [value.hex() if isinstance(value, bytes) else float(value) for value in values] == [
                text
                if isinstance(value, bytes)
                else float(np.float32(text))
                if found[title].type == "float"
                else float(text)
                for text, value in zip(texts, values, strict=True)
            ]
        rows += len(lines)
    assert rows >= 30
    assert not list(tmp_path.glob("*.part"))


def test_a_table_that_is_not_finished_leaves_nothing(tmp_path: Path) -> None:
    definition = frame("ngu_a")
    capture = tmp_path / "capture.bin"
    capture.write_bytes(golden_bytes("ngu_a") * 3)

    def broken(tables: Tables) -> None:
        with tables, capture.open("rb") as stream:
            decode_capture(definition, stream, tables.write)
            raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        broken(Tables(definition, tmp_path / "out.csv"))
    assert [path.name for path in tmp_path.iterdir()] == ["capture.bin"]


def test_a_device_stays_one_and_a_link_leads_to_the_table(tmp_path: Path) -> None:
    capture, device, link = tmp_path / "capture.bin", tmp_path / "device", tmp_path / "link.csv"
    capture.write_bytes(golden_bytes("ngu_a"))
    device.symlink_to("/dev/null")
    link.symlink_to(tmp_path / "table.csv")
    for out in (device, link):
        tabulated(frame("ngu_a"), capture, out)
        assert out.is_symlink()
    assert device.is_char_device()
    assert len((tmp_path / "table.csv").read_text(encoding="utf-8").splitlines()) == 2
    assert not list(tmp_path.glob("*.part"))


def test_a_table_that_cannot_be_written(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    definition = frame("ngu_a")
    capture = tmp_path / "capture.bin"
    capture.write_bytes(golden_bytes("ngu_a"))
    for name in ("out.csv", "out.parquet"):
        with pytest.raises(InputError, match="B-FRAME-032"):
            tabulated(definition, capture, tmp_path / "no_folder" / name)
    monkeypatch.setattr("bench.frame.table.find_spec", lambda name: None)
    with pytest.raises(InputError, match="B-FRAME-033"):
        Tables(definition, tmp_path / "out.parquet")


HOSTILE = """{frame: hostile, endian: big, sync: [0xA5], other: true, length: {field: size, plus: 0, max: 40},
  fields: [{name: size, type: u8}, {name: kind, type: u8}], type: {field: kind}, crc: {name: sum-16, over: [sync, end]},
  messages: {one: {value: 1, fields: [{name: n, type: u8, role: own_counter}, {name: b, type: bytes, count: rest}],
                   golden: "a5 06 01 07 00 b3", expect: {n: 7}}}}"""


def numbered(n: int, body: bytes = b"abc", kind: int = 1, size: int | None = None) -> bytes:
    frame = bytes([0xA5, len(body) + 6 if size is None else size, kind, n % 256]) + body
    return frame + sum(frame).to_bytes(2, "big")


def plainly(capture: bytes) -> tuple[int, int, int, int]:
    """Count good, bad and other frames of HOSTILE and the bytes in none, byte by byte."""
    good = bad = other = skipped = at = 0
    while at < len(capture):
        size, kind = [*capture[at + 1 : at + 3], 255, 255][:2]
        frame = capture[at : at + size]
        due = 6 <= size <= 40 or (kind != 1 and 5 <= size <= 40)
        right = due and len(frame) == size and sum(frame[:-2]).to_bytes(2, "big") == frame[-2:]
        if capture[at] == 0xA5 and right:
            good, other, at = good + (kind == 1), other + (kind != 1), at + size
            continue
        bad += capture[at] == 0xA5 and at + 3 <= len(capture) and (not due or len(frame) == size)
        begin, at = at, capture.find(b"\xa5", at + 1) % (len(capture) + 1)
        skipped += at - begin
    return good, bad, other, skipped


STREAM = [numbered(n, bytes(range(n, n + n % 20))) for n in range(200)]
WHOLE, NESTED = b"".join(STREAM), numbered(2, numbered(1, numbered(0)))
BITS = int.from_bytes(WHOLE, "big")
NOISE = np.random.default_rng(5).bytes(10_000_000)
CAPTURES = {
    "empty": b"", "a byte": b"\xa5", "all FF": b"\xff" * 9999, "all zero": bytes(9999), "all sync": b"\xa5" * 9999,
    "length 0": numbered(1, size=0) * 9, "length 4": numbered(1, size=4) * 9, "length max": numbered(1, size=40) * 9,
    "length over max": numbered(1, size=41) * 9, "length 255": numbered(1, size=255) * 9,
    "longer than the file": WHOLE + numbered(1, size=40), "one byte less": numbered(1)[:-1], "nested": NESTED * 9,
    "nested in a bad one": (NESTED[:-1] + b"\0") * 9, "heads": b"\xa5\x28\x01" * 20_000,
    "wrong id": numbered(1, kind=9) * 9, "wrong id between": (numbered(1, kind=9) + numbered(1)) * 9,
    "sync inside": numbered(1, b"\xa5" * 20) * 9, "a bit late": (BITS >> 1).to_bytes(len(WHOLE), "big"),
    "7 bits late": (BITS >> 7).to_bytes(len(WHOLE), "big"), "backwards": WHOLE[::-1], "text": b"Lorem ipsum\r\n" * 999,
    "hex": WHOLE.hex().encode(), "gzip": gzip.compress(WHOLE), "UTF-16": WHOLE.decode("latin-1").encode("utf-16"),
    "two at once": b"".join(map(bytes, zip(WHOLE, NOISE, strict=False))), "text between": b" ok\r\n".join(STREAM),
    "a byte lost": b"".join(one[: at % 7] + one[at % 7 + 1 :] for at, one in enumerate(STREAM)),
    "a byte twice": b"".join(one[: at % 7 + 1] + one[at % 7 :] for at, one in enumerate(STREAM)),
    "a bit turned": b"".join(one[: at % 6] + bytes([one[at % 6] ^ 1 << at % 8]) + one[at % 6 + 1 :]
                             for at, one in enumerate(STREAM)),
    "cut anywhere": b"".join(one[: at % len(one)] for at, one in enumerate(STREAM)), "10 MB": NOISE,
    "100,000 times": numbered(1) * 100_000,
}  # fmt: skip


@pytest.mark.parametrize("name", CAPTURES)
def test_hostile_captures(name: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """The counts of a plain parser, the status and one line if nothing is good, soon."""
    (tmp_path / "hostile.yaml").write_text(HOSTILE, encoding="utf-8")
    capture, started = CAPTURES[name], process_time()
    (tmp_path / "capture.bin").write_bytes(capture)
    status = decode(str(tmp_path / "hostile.yaml"), tmp_path / "capture.bin", None, None, True)
    assert process_time() - started < 5
    found, told = capsys.readouterr()
    good, bad, other, skipped = plainly(capture)
    summary = json.loads(found)
    assert tuple(summary[key] for key in ("good", "bad", "other", "skipped_bytes")) == (good, bad, other, skipped)
    said = f"{other} frames with a right check are of types" if other > bad else f"{bad} places look like the beginning"
    if not bad and not other:
        said = "the capture ends inside" if summary["cut_off"] else "the sync bytes a5 begin no frame of a possible"
    said = f"nothing good: {said if capture else 'the capture is empty'}"
    assert (status, told.count("\n"), told[: len(said)]) == ((0, 0, "") if good else (1, 1, said))


def test_a_table_never_replaces_what_is_read(tmp_path: Path) -> None:
    definition, capture = tmp_path / "hostile.yaml", tmp_path / "hostile.csv"
    definition.write_text(HOSTILE, encoding="utf-8")
    capture.write_bytes(WHOLE)
    for table in (definition, capture, tmp_path):
        with pytest.raises(InputError, match="B-FRAME-032"):
            decode(str(definition), capture, table, None, False)
    for unread in (tmp_path, tmp_path / "nothing.bin"):
        with pytest.raises(InputError, match="B-FRAME-030"):
            decode(str(definition), unread, None, None, False)
    with pytest.raises(InputError, match="B-FRAME-032"):
        decode(str(definition), capture, None, tmp_path / "out.csv", False)
    assert (definition.read_text(encoding="utf-8"), capture.read_bytes()) == (HOSTILE, WHOLE)


def test_standard_input_is_a_capture_too(monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]) -> None:
    stream = io.TextIOWrapper(io.BytesIO(golden_bytes("ngu_a") * 3 + golden_bytes("ngu_a")[:20]))
    monkeypatch.setattr("sys.stdin", stream)
    assert decode("ngu_a", Path("-"), None, None, False) == 0
    said = capsys.readouterr().out
    assert "standard input: ngu_a" in said
    assert "good           3" in said
    assert "cut off in its last frame" in said


UNIT_SPEC: dict[str, Any] = {
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
UNIT_SPEC["messages"]["sets"]["golden"], UNIT_SPEC["messages"]["items"]["golden"] = SETS.hex(), ITEMS.hex()
DEFINITION = json.dumps(UNIT_SPEC)


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


def test_no_more_than_a_thousand_are_looked_at() -> None:
    found = counted(DEFINITION, (SETS[:-1] + b"\0") * 1500)
    assert (found.counts.bad, [kind.number for kind in found.bad]) == (1500, [1000])


def sent(number: int) -> bytes:
    """Frames of one channel set, each with other counts."""
    counts = np.random.default_rng(5).integers(0, 1 << 16, (2, number, 10))
    columns = {"counter": np.arange(number), "npp": counts[0], "ppp": counts[1], "af_clock": 3, "master_count": 4}
    return frame("ngu_a").encode(columns | {"fg_count": 5, "status": 1 << 12}, number).tobytes()


LOST = "what they were is lost: take the capture again in binary"
CR = f"no byte of the first {{}} is 0D: CR became LF (0A stands there 218 times); {LOST}"
XON = f"no byte of the first {{}} is 11 or 13: XON and XOFF were taken out; {LOST}"
UNDONE = "undone, the first {} bytes hold 600 good frames, {} as"
CUT = f"the highest bit of every byte is cut: the sync bytes stand there 600 times as 6b 10; {LOST}"
AS_SENT = sent(600)


@pytest.mark.parametrize(
    ("capture", "said"),
    [
        (AS_SENT.replace(b"\n", b"\r\n"), f"every LF became CR LF; {UNDONE}"),
        (AS_SENT.decode("latin-1").encode(), f"every byte above 7F became UTF-8 of Latin-1; {UNDONE}"),
        (AS_SENT.hex(" ").upper().encode(), f"it is hex text; {UNDONE}"),
        (base64.encodebytes(AS_SENT), f"it is base64 text; {UNDONE}"),
        (gzip.compress(AS_SENT), f"it is compressed with gzip; {UNDONE}"),
        (gzip.compress(AS_SENT.hex().encode()), f"it is compressed with gzip; then it is hex text; {UNDONE}"),
        (AS_SENT.replace(b"\r", b"\n"), CR),
        (AS_SENT.translate(None, b"\x11\x13"), XON),
        (AS_SENT.decode(errors="replace").encode(), f" bytes that are no UTF-8 became EF BF BD; {LOST}"),
        (bytes(byte & 127 for byte in AS_SENT), CUT),
    ],
)
def test_what_mangled_a_capture_is_named(capture: bytes, said: str) -> None:
    found = decode_capture(frame("ngu_a"), io.BytesIO(capture))
    (text,) = found.mangled
    assert said.format(len(capture), found.counts.frames) in text
    assert found.counts.frames < 550
    assert decode_capture(frame("ngu_a"), io.BytesIO(b"log\r\n" + AS_SENT)).mangled == ()
    assert decode_capture(frame("ngu_a"), io.BytesIO(np.random.default_rng(1).bytes(50_000))).mangled == ()


def test_lines_and_packets() -> None:
    def nmea(body: bytes) -> bytes:
        return b"$%b*%02X\r\n" % (body, reduce(xor, body))

    good = nmea(b"GPVTG,77.52,T,,M,0.004,N,0.008,K,A")
    long = nmea(b"GPVTG,77.52,TT,,M,0.004,N,0.008,K,A")
    capture = good + long + nmea(b"GPVTG,1") + good.replace(b"*06", b"*07")
    found = decode_capture(frame("nmea_0183"), io.BytesIO(capture))
    assert [(kind.cause, kind.number) for kind in found.bad] == [("contents", 2), ("check", 1)]
    (without,) = decode_capture(frame("nmea_0183"), io.BytesIO(b"$GPVTG,1\r\n")).bad
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


def spec_of(golden: str, expect: dict[str, Any], *fields: dict[str, Any], **more: Any) -> dict[str, Any]:
    """Return a definition with one sync byte and no check, without what is None."""
    spec = {"frame": "unit", "endian": "big", "sync": [0xA5], "crc": {"name": "none"}, "fields": [*fields]}
    spec |= {"golden": golden, "expect": expect} | more
    return {name: value for name, value in spec.items() if value is not None}


def field(name: str, kind: str, **more: Any) -> dict[str, Any]:
    return {"name": name, "type": kind, **more}


NAME = field("t", "bytes", count=4, form="text")
TEXT = spec_of("a5 61 62 00 00", {"t": "ab"}, NAME)
DOT = spec_of("a5 01", {"u": 1}, field("u", "u8", bits={"low": 0}))


def test_values_that_nobody_could_read_back_are_not_written() -> None:
    assert counted(json.dumps(TEXT), bytes.fromhex("a561620000")).counts.frames == 1
    with pytest.raises(InputError, match="B-FRAME-022"):
        parse_frame(json.dumps(DOT), "unit.yaml").encode_one({"u.": 1})


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
def test_the_rest_of_a_bad_line_is_none(capture: bytes, numbers: list[tuple[float, float]], bad: int, cut: int) -> None:
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
    definition = parse_frame(json.dumps(TEXT), "text.yaml")
    with Tables(definition, tmp_path / "t.csv") as tables:
        decode_capture(definition, io.BytesIO(bytes.fromhex("a5610d6200 a561e90a00")), tables.write)
    assert (tmp_path / "t.csv").read_text().splitlines() == ["offset,t", r"0,a\x0db", r"5,a\xe9\x0a"]


def test_a_long_line_of_text_is_looked_at_at_once() -> None:
    assert line_guess((b"x" * 4000 + b"\xb0\n") * 262) is None
    guess = line_guess(b"".join(b"%d,%d\r\n" % (i, 3 * i) for i in range(60)))
    assert guess is not None
    assert (guess.covered, len(guess.lines)) == (1.0, 60)
