"""Shipped frame files against golden bytes, and public wire formats against bytes that other people published."""

import os
import struct
import zlib
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
import yaml
from crccheck.crc import Crc16Ibm3740, Crc16Xmodem, Crc24LteA, Crc32Jamcrc, Crc32Mpeg2
from record_sample import ROOT, captured, golden_bytes
from record_sample import frame as frame_of

from bench.frame import LinkDecoder, MessageBatch, load_frame, parse_frame

GOLDEN = ROOT / "tests" / "golden"
LINES = {"nmea_0183"}  # tests/unit/frame/test_parts.py
NAMES = sorted({path.stem for path in (ROOT / "frames").glob("*.yaml")} - LINES)
NPP = [1291, 1280, 0, 2560, 640, 1279, 1300, 7, 1281, 65535]
PPP = [1269, 1280, 2560, 0, 1920, 1281, 1260, 2553, 1279, 0]
NPP_100S = [12910000, 12800000, 0, 25600000, 6400000, 12790000, 13000000, 70000, 12810000, 4294967295]
PPP_100S = [12690000, 12800000, 25600000, 0, 19200000, 12810000, 12600000, 25530000, 12790000, 1]
CLOCKS_100S = (25600512, 1000001500, 999999999)
IMU = (-1234567, 1500000000, 7, -48983123, 250, 980000000)
RANGES = (44919.25, 2.5, 0.03122838104166667)
STATUS = 1 | 1 << 3 | 2 << 12
FLOATS = [0.25 + 0.125 * index * (-1) ** index for index in range(29)]


def u24(value: int) -> bytes:
    return struct.pack(">I", value)[1:]


def with_crc(sync: bytes, body: bytes, crc: type = Crc16Ibm3740) -> bytes:
    return sync + body + struct.pack(">H", crc.calc(body))


def ngu_a() -> bytes:
    body = struct.pack(">H10H10H", 17, *NPP, *PPP) + u24(2560) + u24(100001) + u24(99999) + struct.pack(">H", STATUS)
    return with_crc(b"\xeb\x90", body)


def with_crc16(sync: bytes, kind: str, *values: float, more: bytes = b"") -> bytes:
    """A frame of little-endian values behind which CRC-16/IBM-3740 stands low byte first."""
    body = struct.pack(f"<{kind}", *values) + more
    return sync + body + struct.pack("<H", Crc16Ibm3740.calc(body))


def with_crc32(sync: bytes, kind: str, *values: float, more: bytes = b"") -> bytes:
    body = struct.pack(f"<{kind}", *values) + more
    return sync + body + struct.pack("<I", zlib.crc32(body))


def gnc(kind: int, command: int, sequence: int, payload: bytes, to_unit: bool = False) -> bytes:
    ends = (0x10, 0x01) if to_unit else (0x01, 0x10)
    return with_crc16(b"\xeb\x90", "6BH", 1, *ends, sequence, kind, command, len(payload), more=payload)


def ngu_b(kind: int, payload: bytes) -> bytes:
    return with_crc(b"\xeb\x9b", struct.pack(">BB", len(payload) + 6, kind) + payload)


def kvh_1750() -> bytes:
    """The example message with which open drivers of the unit test their check (4BFA34D8)."""
    angles = (2.019593e-05, 5.159911e-05, -1.3111248e-05)
    forces = (-1.0019064, -0.00349504687, 0.0021090312)
    body = struct.pack(">6fBBh", *angles, *forces, 0x77, 61, 40)
    return b"\xfe\x81\xff\x55" + body + struct.pack(">I", Crc32Mpeg2.calc(b"\xfe\x81\xff\x55" + body))


def novatel_inspvas() -> bytes:
    """A log of a receiver on the road, as an open driver keeps it for its tests; no initial value, no final one."""
    body = struct.pack("<BHHI", 88, 508, 2088, 197594600) + struct.pack(
        "<I10dI", 2088, 197594.6, *VALUES["SOLUTION"], 3
    )
    crc = Crc32Jamcrc.calc(b"\xaa\x44\x13" + body, initvalue=0)
    return b"\xaa\x44\x13" + body + struct.pack("<I", crc)


def ubx(message: int, body: bytes) -> bytes:
    """A frame with the check as the receiver description writes it: two bytes that overflow."""
    covered = struct.pack(">H", message) + struct.pack("<H", len(body)) + body
    first = second = 0
    for byte in covered:
        first = (first + byte) & 0xFF
        second = (second + first) & 0xFF
    return b"\xb5\x62" + covered + bytes((first, second))


def ubx_pvt() -> bytes:
    """The values that pyubx2 packed into the golden frame of the definition."""
    when = struct.pack("<IH6BIi", 197594600, 2026, 11, 23, 6, 53, 14, 7, 25, -187654)
    place = struct.pack("<4B4i2I", 3, 3, 0, 17, 1165045583, 400408371, 27403, 35812, 14, 21)
    motion = struct.pack("<5i2I", 69, 9647, -6, 9647, 9093423, 83, 32114)
    return ubx(0x0107, when + place + motion + struct.pack("<2HIihH", 116, 0, 0, 9100001, -671, 50))


def ubx_sensors() -> dict[str, bytes]:
    """Measurements with a sign in 24 of 32 bits, an attitude, two satellites."""
    words = [value & 0xFFFFFF | kind << 24 for value, kind in ((-123, 16), (10240, 18))]
    sensors = struct.pack("<IHH2II", 123456, 2 << 11 | 8, 0, *words, 120000)
    attitude = struct.pack("<IB3x3i3I", 197594600, 0, 150000, -225000, 35999999, 1200, 1300, 25000)
    two = (0, 5, 44, 41, 271, -12, 0x1F), (1, 133, 0, -3, 0, 0, 0x10)
    heard = struct.pack("<IBBH", 197594600, 1, 2, 0) + b"".join(struct.pack("<BBBbhhI", *one) for one in two)
    return {
        "ublox_sensors.measurements": ubx(0x1002, sensors),
        "ublox_sensors.attitude": ubx(0x0105, attitude),
        "ublox_sensors.satellites": ubx(0x0135, heard),
    }


def sbf(block: int, body: bytes) -> bytes:
    """A block of a Septentrio receiver: the check stands in front of what it covers."""
    covered = struct.pack("<HH", block, len(body) + 8) + body
    return b"$@" + struct.pack("<H", Crc16Xmodem.calc(covered)) + covered


def sbf_attitude() -> bytes:
    """Of a receiver with one antenna, which does not know its attitude."""
    return sbf(5938, struct.pack("<IH2BHH6f", 483013000, 2367, 255, 128, 0, 0, *[-2e10] * 6))


def sirf(message: int, body: bytes) -> bytes:
    covered = struct.pack(">B", message) + body
    size, check = struct.pack(">H", len(covered)), struct.pack(">H", sum(covered) & 0x7FFF)
    return b"\xa0\xa2" + size + covered + check + b"\xb0\xb3"


def rtcm(number: int) -> bytes:
    """A message of a reference station, kept by an open library; length, number and check made again."""
    kept = golden_bytes(f"rtcm3.{RTCM[number]}")
    body = struct.pack(">H", number << 4 | kept[4] & 0x0F) + kept[5:-3]
    frame = b"\xd3" + struct.pack(">H", len(body)) + body
    return frame + u24(Crc24LteA.calc(frame))


def xbus(message: int, body: bytes) -> bytes:
    covered = struct.pack("3B", 0xFF, message, len(body)) + body
    return b"\xfa" + covered + bytes([-sum(covered) % 256])


def xbus_data() -> bytes:
    """A measurement of an MTi-630 in the example of an open driver."""
    heads = [bytes.fromhex(head) for head in ("106004", "201010", "80200c", "40200c", "c0200c", "e02004")]
    sizes, values, at = (1, 4, 3, 3, 3, 1), (39007691, *VALUES["MTI"], 3), 0
    body = b""
    for head, size in zip(heads, sizes, strict=True):
        kind = "I" if size == 1 else "f"
        body += head + struct.pack(f">{size}{kind}", *values[at : at + size])
        at += size
    return xbus(0x36, body)


def jpss_packet() -> bytes:
    """The first packet of a day of the satellite, with the values that an open decoder prints."""
    body = struct.pack(">HIHBHIH6f", 23109, 7, 137, 159, 23109, 30, 941, *VALUES["ORBIT"]) + struct.pack(
        ">HIH4f", 23108, 86399930, 941, *VALUES["TURNED"]
    )
    return struct.pack(">HHH", 1 << 11 | 11, 3 << 14 | 2606, len(body) - 1) + body


VALUES = yaml.safe_load((GOLDEN / "values.yaml").read_text(encoding="utf-8"))
RTCM = {1005: "station", 1077: "gps", 1087: "glonass"}
PLACE, VELOCITY, ATTITUDE = (37.5000012345, 126.9512345678, 3001.25), (99.875, -0.015625, 0.25), (0.5, -1.25, 359.96875)
ECHO = [(37 * gate - 1184) * (-1) ** gate for gate in range(128)]
EVENTS = struct.pack("<3I", 1234 << 3 | 0b011, 5678 << 3, 999999 << 3 | 0b101)
SAMPLE = struct.pack("<2IB9ih", 70000, 4294967290, 1, 43200, -3, 7, -12, 1003, 5, 1200, -3584, 2500, 2512)
HOUSEKEEPING = struct.pack(">H4hHH3HH", 513, -1023, -998, 2004, 5001, 28012, 1850, 5003, 15010, 14990, 3)
INDEPENDENT = {
    "fog_1k": with_crc16(b"\xf0\x6e", "IiIhH", 70000, -707107, 0xC00001, 2512, 3),
    "rlg_housekeeping": with_crc16(b"\x52\x4c", "IhHHH", 4711, 2475, 12345, 10012, 0),
    "time_tags": with_crc32(b"\xa5\x5a\xc3\x3c", "HIQIIH", 44, 4, 4000123, 100000000, 7, 3, more=EVENTS),
    "gnc_422.command": gnc(0x01, 0x11, 7, struct.pack("<IB", 5000, 20), to_unit=True),
    "gnc_422.answer": gnc(0x81, 0x21, 8, struct.pack("<BI", 0, 48000)),
    "gnc_422.stream": gnc(0x02, 0x22, 9, SAMPLE),
    "gnc_422.refusal": gnc(0x7F, 0x44, 255, b"\x03"),
    "ngu_a": ngu_a(),
    "ngu_a_100s": with_crc(b"\xeb\xa0", struct.pack(">H10I10I3IH", 3, *NPP_100S, *PPP_100S, *CLOCKS_100S, STATUS)),
    "ngu_b.housekeeping": ngu_b(1, HOUSEKEEPING),
    "ngu_b.answer": ngu_b(2, b"\x01\x00NGU SIM-1 1.0"),
    "ngu_b.command": ngu_b(3, b"\x02\x64"),
    "vn100_binary": with_crc(b"\xfa", bytes.fromhex("143e003a00") + struct.pack("<29f", *FLOATS), Crc16Xmodem),
    "imu_200": with_crc32(b"IM", "IQ6ihH", 70000, 3500012345, *IMU, 2512, 3),
    "egi_50": with_crc32(b"EG", "IQ9dfHH", 17500, 3500098765, *PLACE, *VELOCITY, *ATTITUDE, 1.5, 3, 0),
    "sar_pulse": with_crc32(b"SR", "IQdfd128hH", 9999, 4999990000, *RANGES, *ECHO, 1),
    "kvh_1750": kvh_1750(),
    "novatel_inspvas": novatel_inspvas(),
    "ublox_ubx.pvt": ubx_pvt(),
    "ublox_ubx.velned": ubx(0x0112, struct.pack("<I3i2Ii2I", 197594600, 7, 965, -1, 965, 965, 9093423, 8, 32114)),
    "septentrio_sbf.pvt_geodetic": sbf(4007 | 2 << 13, golden_bytes("septentrio_sbf.pvt_geodetic")[8:]),
    "septentrio_sbf.pvt_cartesian": sbf(4006 | 2 << 13, golden_bytes("septentrio_sbf.pvt_cartesian")[8:]),
    "septentrio_sbf.attitude": sbf_attitude(),
    "sirf_binary.navigation": sirf(2, struct.pack(">3i3h3BHI13B", *VALUES["NAVIGATION"])),
    "sirf_binary.pulse_time": sirf(52, struct.pack(">5BHhIBI", 20, 42, 27, 9, 12, 2021, 0, 0, 1, 0)),
    "sirf_binary.geodetic": sirf(41, struct.pack(">HHHIHBBBBHIiiiiBHHhhhIIIHiIiIIHHBBB", *VALUES["GEODETIC"])),
    **{f"rtcm3.{name}": rtcm(number) for number, name in RTCM.items()},
    "xsens_mtdata2.data": xbus_data(),
    "xsens_mtdata2.wake_up": xbus(0x3E, b""),
    "xsens_mtdata2.outputs": xbus(0xC1, bytes.fromhex("10a00001")),
    "ccsds_jpss1.ephemeris": jpss_packet(),
    "ccsds_jpss1.fill": struct.pack(">HHH", 2047, 3 << 14, 3) + b"\x55" * 4,
    **ubx_sensors(),
    "ublox_ubx.timegps": ubx(0x0120, struct.pack("<IihbBI", 197594600, -187654, 2446, 18, 7, 25)),
}


def decode(name: str, frame: bytes, message: str = "frame") -> MessageBatch:
    batch = frame_of(name).decoder().feed(frame).messages[message]
    assert len(batch) == 1
    return batch


@pytest.mark.validates(
    "shipped frame definitions: their golden bytes", against="struct of the standard library and the package crccheck"
)
@pytest.mark.parametrize("name", INDEPENDENT)
def test_golden_files_are_what_struct_and_crccheck_make(name: str) -> None:
    assert golden_bytes(name) == INDEPENDENT[name]


def test_every_shipped_frame_has_its_golden_bytes_in_a_file_and_in_its_definition() -> None:
    assert {name.partition(".")[0] for name in INDEPENDENT} == set(NAMES)
    assert {path.stem for path in GOLDEN.glob("*.hex")} >= set(INDEPENDENT)
    for name, frame in INDEPENDENT.items():
        text = " ".join(frame_of(name.partition(".")[0]).text.split())
        assert frame.hex(" ") in text


FIELDS: dict[str, dict[str, object]] = {
    "ngu_a": {"npp": NPP, "ppp": PPP, "counter": 17, "af_clock": 2560, "master_count": 100001, "fg_count": 99999,
              "status": STATUS, "status.calibrating": 1, "status.over_range": 4, "status.mode": 2},
    "ngu_b.housekeeping": {"unit_temperature": [-10.23, -9.98, 20.04, 50.01], "supply_voltage": 28.012},
    "ngu_b.answer": {"command": 1, "payload": b"NGU SIM-1 1.0"},
    "ngu_b.command": {"command": 2, "payload": b"\x64"},
    "time_tags": {"events": EVENTS, "counter": 4, "tick": 4000123, "clock": 100000000, "dropped": 7, "edges": 3},
    "fog_1k": {"output": -0.707107, "encoder": 270.0 + 360.0 / 2**24},
    "imu_200": {"tick": 350.0012345, "delta_angle": [-1.234567e-3, 1.5, 7e-9],
                "delta_velocity": [-0.48983123, 2.5e-6, 9.8]},
    "gnc_422.stream": {"counter": 70000, "gyro": [216.0, -0.015, 0.035], "accel": [-0.012, 1.003, 0.005],
                       "mag": [0.144, -0.43008, 0.3], "temperature": 25.12},
}  # fmt: skip


@pytest.mark.parametrize("name", FIELDS)
def test_fields_are_what_was_packed(name: str) -> None:
    frame, _, message = name.partition(".")
    batch = decode(frame, INDEPENDENT[name], message or "frame")
    for field, due in FIELDS[name].items():
        if isinstance(due, bytes):
            assert batch.raw(field).tolist() == [due]
        else:
            np.testing.assert_allclose(batch.scaled(field)[0], due, rtol=1e-14, err_msg=field)


def test_encoder_fills_in_length_kind_constants_and_defaults() -> None:
    definition = frame_of("gnc_422")
    command = definition.encode_one({"sequence": 7, "command": 0x11, "payload": b"\x88\x13\0\0\x14"}, "command")
    assert command == INDEPENDENT["gnc_422.command"]
    from_unit = {"destination": 1, "source": 16}
    answer = {"sequence": 8, "command": 0x21, "status": 0, "payload": b"\x80\xbb\0\0", **from_unit}
    assert definition.encode_one(answer, "answer") == INDEPENDENT["gnc_422.answer"]
    sample = {"counter": 70000, "tick": 4294967290, "gyro": [43200, -3, 7], "accel": [-12, 1003, 5],
              "mag": [1200, -3584, 2500], "temperature": 2512, "sequence": 9, "command": 0x22, **from_unit}  # fmt: skip
    rows = definition.encode(sample, 3, "stream")
    assert {row.tobytes() for row in rows} == {INDEPENDENT["gnc_422.stream"]}


# OEM7 documentation, "ASCII to binary log conversion example", and GPStation-6 manual, page 44: the same check covers
# every binary log, so the vendor's two BESTPOS logs hold the one of INSPVAS
BESTPOS = """
aa44121c2a000020480000005eb40b0780ada301000000004561832500000000200000001011865b5868404009a4cc35038141408f53742497ef33
406666a2413d0000004faf143d645d5c3defc9c33d30000000000040400000000012090900000000 01c3ef64d2
""", """
aa44121c2a0002204800000090b49305b0abb912000000004561bc0a00000000100000001b0450b3f28e494016fa6bbe7c825cc00060769f449f90
40a62a82c13d000000125acb3fcd9e983fdb664040003030300000000000000000 0b0b00000006000342dc4c48
"""  # fmt: skip


@pytest.mark.validates(
    "frame novatel_inspvas: check and fields",
    against="two logs of the vendor's manuals, and a log of a receiver in the tests of an open driver, with its values",
)
def test_logs_of_novatel(record_property: Callable[[str, object], None]) -> None:
    text = frame_of("novatel_inspvas").text
    check = next(line for line in text.splitlines() if line.startswith("crc:"))
    for published in BESTPOS:
        log = bytes.fromhex("".join(published.split()))
        assert len(log) == 104
        body = f"{{name: body, type: bytes, count: {len(log) - 7}}}"
        other = f"frame: any\nendian: little\nsync: [0xAA, 0x44, 0x12]\nfields: [{body}]\n{check}\n"
        parse_frame(f'{other}golden: "{log.hex()}"\nexpect: {{body: "{log[3:-4].hex()}"}}\n', "any.yaml")
    batch = frame_of("novatel_inspvas").decoder().feed(golden_bytes("novatel_inspvas")).messages["frame"]
    # as the other driver prints them, seven to eight digits
    theirs = {"latitude": 40.040837, "longitude": 116.504558, "height": 27.403953, "velocity_north": 0.069381334,
              "velocity_east": 9.647163, "velocity_up": -0.0059339763}  # fmt: skip
    for name, value in theirs.items():
        assert batch.scaled(name)[0] == pytest.approx(value, rel=6e-8), name
    np.testing.assert_allclose(batch.scaled("attitude")[0], [0.59717965, 0.053063083, 90.934232], rtol=6e-8)
    assert batch.scaled("header_time")[0] == batch.scaled("tick")[0] == 197594.6
    record_property("obtained", "checks of 3 published logs right; 9 values equal to all printed digits")


def test_the_counter_of_kvh_goes_on_behind_127() -> None:
    columns = {"delta_angle": 0.0, "accel": 0.0, "status": 0x77, "temperature": 25, "counter": np.arange(300) % 128}
    gone, link = [126, 127, 128, 200], LinkDecoder(frame_of("kvh_1750"))
    link.push(0, np.delete(frame_of("kvh_1750").encode(columns, 300), gone, axis=0).tobytes())
    batch = link.flush().messages["frame"]
    assert (link.counts.frames, link.counts.lost, link.counts.suspect) == (296, 4, 0)
    assert batch.counter is not None
    assert batch.counter.tolist() == [place for place in range(300) if place not in gone]


@pytest.mark.parametrize(
    "path", sorted((ROOT / "tests" / "golden" / "public").glob("*.yaml")), ids=lambda path: path.stem
)
def test_frames_that_others_published_are_decoded_and_written_again(path: Path) -> None:
    definition = load_frame(path)
    stream = b"\0" + b"".join(definition.golden) * 3
    for engine in ("numpy", "reference"):
        decoder = definition.decoder(engine)  # type: ignore[arg-type]
        batch = decoder.feed(stream)
        assert {name: len(batch.messages[name]) for name in definition.messages} == dict.fromkeys(
            definition.messages, 3
        )
    if definition.name != "mip":  # its other items are not listed
        for name, frame in zip(definition.messages, definition.golden, strict=True):
            message = batch.messages[name]
            values = {field.name: message.raw(field.name)[0] for field in message.message.fields}
            assert definition.encode_one(values, name) == frame


RECORDINGS = Path(os.environ.get("BENCH_REAL_DATA", ROOT.parent / "shared" / "data")) / "vn100"

IS_THERE = pytest.mark.skipif(not (RECORDINGS / "F00379").exists(), reason=f"no recording {RECORDINGS / 'F00379'}")


@pytest.mark.real
@IS_THERE
@pytest.mark.parametrize("engine", ["numpy", "reference"])
def test_counts_of_the_capture(engine: str) -> None:
    decoded, _ = captured(frame_of("vn100_binary"), RECORDINGS / "F00379", engine)  # type: ignore[arg-type]
    assert (decoded.counts.frames, decoded.counts.bad) == (8895, 2)
    assert decoded.counts.bytes == 1_437_495


@pytest.mark.real
@IS_THERE
@pytest.mark.validates(
    "frame decoder on a real capture of 8,895 frames", against="a decode of the same capture by other people's software"
)
def test_all_columns_equal_the_independent_decode_within_its_print_rounding(
    record_property: Callable[[str, object], None],
) -> None:
    _, messages = captured(frame_of("vn100_binary"), RECORDINGS / "F00379")
    batch = messages["frame"]
    names = [item.name for item in batch.message.fields if item.name != "header"]
    ours = np.column_stack([batch.scaled(name) for name in names])
    lines = (RECORDINGS / "F00379_B").read_text(encoding="ascii").splitlines()[1:]
    theirs = np.array([[float(text) for text in line.split(",")[:-1]] for line in lines if line.count(",") == 29])
    assert ours.shape == theirs.shape == (8895, 29)
    # printed as 1.234567e+02: only half a unit of the last printed digit may differ, 5e-5 for values from 100 on
    last_digit = 10.0 ** (np.floor(np.log10(np.maximum(np.abs(theirs), 1e-30))) - 6)
    worst = float(np.max(np.abs(ours - theirs) / last_digit))
    record_property("obtained", f"29 columns, worst {worst:.3f} of the last printed digit, limit 0.5")
    assert (np.abs(ours - theirs) <= 0.5 * last_digit * (1 + 1e-6)).all()
