"""Captures of public formats: the shipped definitions beside the libraries of others, by counts and values.

The captures are not part of this project: BENCH_CAPTURES names a folder with files of the repositories pysbf2 and
pyrtcm, pyubx2 (their tests), space_packet_parser (the file of JPSS-1) and gpsd (test/daemon, SiRF and NMEA); those of
xsens-go (testdata/N/output.bin and output.golden) stand there as xsens_go_N.bin and .golden.
"""

import os
import re
import struct
from collections import Counter
from collections.abc import Mapping
from pathlib import Path

import numpy as np
import pytest
from record_sample import captured
from record_sample import frame as frame_of

from bench.frame import Counted, MessageBatch, parse_frame

CAPTURES = Path(os.environ.get("BENCH_CAPTURES", "/nonexistent"))
SBF = ("sbfdata.log", "pygpsdata_x5pvt.log", "pygpsdata_x5_pvtgeod.log", "pygpsdata_x5_attitude.log")
RTCM = ("pygpsdata-RTCM3.log", "pygpsdata-NTRIP-1300-1302.log", "pygpsdata-1240-1264.log", "rtcm3.2.log")
UNPARSED = {"pygpsdata-NTRIP-1300-1302.log": 6}  # frames of type 1302, which pyrtcm 1.2.1 does not give
JPSS = "J01_G011_LZ_2021-04-09T00-00-00Z_V01.DAT1"
SIRF = ("sirf2.log", "sirfstarv.log")
NMEA = ("nmea-rtk.log", "quectel-l76k-nmea.log", "ublox-8.log", "sirfstarv-nmea.log", "nmea-fuzzy-cases.log")
KNOT = 1852 / 3600
UBX = ("pygpsdata-ESF.log", "pygpsdata-MIXED.log", "pygpsdata-SF-calibration.log", "ucenter-ZEDF9P-configdebug.log")
EMPTY = "fa ff 36 00 cb"  # a measurement without any output


def decoded(name: str, capture: str) -> tuple[Counted, Mapping[str, MessageBatch]]:
    path = CAPTURES / capture
    if not path.exists():
        pytest.skip(f"no capture {path}: set BENCH_CAPTURES")
    return captured(frame_of(name), path)


@pytest.mark.parametrize("capture", SBF)
def test_septentrio_as_pysbf2(capture: str) -> None:
    reader = pytest.importorskip("pysbf2", reason="pysbf2 is not installed: pip install .[peers]").SBFReader
    found, messages = decoded("septentrio_sbf", capture)
    with (CAPTURES / capture).open("rb") as stream:
        theirs = [message for _, message in reader(stream, quitonerror=0)]
    names = {"pvt_geodetic": "PVTGeodetic", "pvt_cartesian": "PVTCartesian", "attitude": "AttEuler"}
    counts = Counter(message.identity for message in theirs)
    assert found.messages == {ours: counts[name] for ours, name in names.items()}
    assert (found.counts.other, found.counts.bad) == (len(theirs) - found.counts.frames, 0)
    values = {"pvt_geodetic": {"latitude": "Latitude", "longitude": "Longitude", "height": "Height"},
              "pvt_cartesian": {"undulation": "Undulation", "satellites": "NrSV", "clock_bias": "RxClkBias"},
              "attitude": {"satellites": "NrSV", "error": "Error"}}  # fmt: skip
    for ours, name in names.items():
        of_kind = [message for message in theirs if message.identity == name]
        for field, attribute in values[ours].items():
            mine = messages[ours].raw(field)
            assert mine.tolist() == [getattr(message, attribute) for message in of_kind], (ours, field)


@pytest.mark.parametrize("capture", RTCM)
def test_reference_stations_as_pyrtcm(capture: str) -> None:
    reader = pytest.importorskip("pyrtcm", reason="pyrtcm is not installed: pip install .[peers]").RTCMReader
    found, messages = decoded("rtcm3", capture)
    with (CAPTURES / capture).open("rb") as stream:
        raws = [raw for raw, _ in reader(stream, quitonerror=0)]
    theirs = [(raw, struct.unpack_from(">H", raw, 3)[0] >> 4) for raw in raws]
    counts = Counter(number for _, number in theirs)
    assert found.messages == {"station": counts[1005], "gps": counts[1077], "glonass": counts[1087]}
    assert found.counts.other == len(theirs) - found.counts.frames + UNPARSED.get(capture, 0)
    kept = [raw[13:-3] for raw, number in theirs if number == 1077]
    assert messages["gps"].raw("body").tolist() == kept
    with (CAPTURES / capture).open("rb") as stream:
        parsed = [message for _, message in reader(stream, quitonerror=0) if message is not None]
    values = {"station": {"x": "DF025", "y": "DF026", "z": "DF027", "station": "DF003", "gps": "DF022"},
              "gps": {"tick": "DF004", "more_follow": "DF393", "issue": "DF409", "station": "DF003"},
              "glonass": {"tick": "DF034", "day": "DF416", "clock_steering": "DF411"}}  # fmt: skip
    for name, number in (("station", "1005"), ("gps", "1077"), ("glonass", "1087")):
        for field, attribute in values[name].items():
            due = [getattr(message, attribute) for message in parsed if message.identity == number]
            mine = messages[name].scaled(field) / (0.001 if field == "tick" else 1)
            np.testing.assert_allclose(mine, np.array(due, float), rtol=1e-12, err_msg=field)


def test_a_satellite_as_space_packet_parser() -> None:
    parser = pytest.importorskip("space_packet_parser.generators", reason="space_packet_parser is not installed")
    found, messages = decoded("ccsds_jpss1", JPSS)
    with (CAPTURES / JPSS).open("rb") as stream:
        packets = [bytes(packet) for packet in parser.ccsds_generator(stream)]
    batch = messages["ephemeris"]
    assert (len(batch), found.counts.bad, found.counts.lost) == (len(packets), 0, 0)
    theirs = np.array([struct.unpack_from(">3f", packet, 23) for packet in packets], np.float32)
    np.testing.assert_array_equal(batch.raw("position"), theirs)
    assert np.all(np.abs(np.linalg.norm(batch.raw("quaternion").astype(np.float64), axis=1) - 1) < 1e-6)
    assert np.all(np.abs(np.linalg.norm(batch.raw("position").astype(np.float64), axis=1) - 7.2e6) < 5e4)  # its orbit


@pytest.mark.parametrize("capture", UBX)
def test_receivers_as_pyubx2(capture: str) -> None:
    reader = pytest.importorskip("pyubx2", reason="pyubx2 is not installed: pip install .[peers]").UBXReader
    found, _ = decoded("ublox_ubx", capture)
    sensed, messages = decoded("ublox_sensors", capture)
    with (CAPTURES / capture).open("rb") as stream:
        theirs = [message for _, message in reader(stream, quitonerror=0, protfilter=2) if message is not None]
    assert found.counts.frames + found.counts.other == sensed.counts.frames + sensed.counts.other == len(theirs)
    counts = Counter(message.identity for message in theirs)
    assert found.messages == {name: counts[f"NAV-{name.upper()}"] for name in ("pvt", "velned", "timegps")}
    groups = {"measurements": ("ESF-MEAS", "flags.number", {"value": "dataField", "kind": "dataType"}),
              "satellites": ("NAV-SAT", "number", {"satellite": "svId", "elevation": "elev", "azimuth": "azim",
                                                   "signal": "cno", "state.used": "svUsed"})}  # fmt: skip
    for name, (identity, number, fields) in groups.items():
        of_kind = [message for message in theirs if message.identity == identity]
        batch = messages[name]
        assert len(batch) == len(of_kind)
        for index, message in enumerate(of_kind):
            there = int(batch.raw(number)[index])
            for field, attribute in fields.items():
                due = [getattr(message, f"{attribute}_{one + 1:02}") for one in range(there)]
                mine = (batch.raw(field) & 0xFFFFFF if field == "value" else batch.scaled(field))[index]
                np.testing.assert_allclose(mine[:there], due, atol=1e-9, err_msg=field)


@pytest.mark.parametrize("number", [1, 2, 4, 5])
def test_an_imu_as_its_open_driver(number: int) -> None:
    """Captures of an MTi-G-710 in 32-bit floats, 12.20 fixed point and 64-bit floats, with what the driver prints."""
    text = frame_of("xsens_mtdata2").text
    if number in (2, 4):
        step, kind = (1, "i32, scale: 9.5367431640625e-07") if number == 2 else (3, "f64")
        lines = [re.sub(r"id: 0x([0-9A-F]{4})", lambda match: f"id: 0x{int(match[1], 16) + step:04X}", line)
                 if "f32" in line else line for line in text.splitlines()]  # fmt: skip
        text = re.sub(r"(?s)    golden: >-.*?delta_v: 0\n", f"    golden: {EMPTY}\n    expect: {{length: 0}}\n",
                      "\n".join(lines).replace("f32", kind))  # fmt: skip
    path = CAPTURES / f"xsens_go_{number}.bin"
    if not path.exists():
        pytest.skip(f"no capture {path}: set BENCH_CAPTURES")
    found, messages = captured(parse_frame(text, "xsens.yaml"), path)
    batch = messages["data"]
    blocks = path.with_suffix(".golden").read_text(encoding="ascii").split("\n\n")
    theirs = [printed(block) for block in blocks if block]
    assert (len(batch), found.counts.bad, found.counts.skipped_bytes) == (len(theirs), 0, 0)
    fields = {"PacketCounter": "packet", "Acceleration": "accel", "DeltaV": "delta_velocity", "RateOfTurn": "rate",
              "DeltaQ": "delta_quaternion", "EulerAngles": "attitude", "AltitudeEllipsoid": "height",
              "VelocityXYZ": "velocity", "Quaternion": "quaternion", "MagneticField": "magnetic_field",
              "Temperature": "temperature", "FreeAcceleration": "accel_earth", "BaroPressure": "pressure"}  # fmt: skip
    compared = 0
    for index, values in enumerate(theirs):
        for title, field in fields.items():
            mine = np.atleast_1d(batch.scaled(field)[index])
            due = values.get(title)
            compared += due is not None
            due = np.full(len(mine), np.nan) if due is None else due
            np.testing.assert_allclose(mine, due, rtol=1e-7, err_msg=title)
    assert compared > 400


def printed(block: str) -> dict[str, list[float]]:
    """Numbers of a measurement as the driver prints them, by what they are."""
    values: dict[str, list[float]] = {}
    name = ""
    for line in block.splitlines():
        if not line.startswith(" "):
            name = line.partition("(")[0].rstrip(":")
            values[name] = []
        elif re.fullmatch(r"[-+.0-9e]+", text := line.rpartition(":")[2].strip()):
            values[name].append(float(text))
    return values


def test_sirf_frames_are_those_that_a_plain_search_finds() -> None:
    for capture in SIRF:
        found, messages = decoded("sirf_binary", capture)
        data, at, kinds = (CAPTURES / capture).read_bytes(), 0, Counter[int]()
        while (at := data.find(b"\xa0\xa2", at)) >= 0 and at + 4 <= len(data):
            (size,) = struct.unpack_from(">H", data, at + 2)
            frame = data[at : at + size + 8]
            good = len(frame) == size + 8 and frame.endswith(b"\xb0\xb3")
            if good and sum(frame[4:-4]) & 0x7FFF == struct.unpack(">H", frame[-4:-2])[0]:
                kinds[frame[4]] += 1
                at += len(frame)
            else:
                at += 1
        assert found.messages == {"navigation": kinds[2], "pulse_time": kinds[52], "geodetic": kinds[41]}
        assert found.counts.other == sum(kinds.values()) - found.counts.frames
        if capture == SIRF[0]:  # a receiver that stands still: its two messages of one second agree within a metre
            known = messages["navigation"].raw("satellites") > 3
            x, y, z = messages["navigation"].scaled("position")[known].T
            longitude = np.degrees(np.arctan2(y, x))
            np.testing.assert_allclose(longitude, messages["geodetic"].scaled("longitude")[known], atol=1e-5)
            assert np.all(np.abs(np.hypot(np.hypot(x, y), z) - 6.37e6) < 1e4)


@pytest.mark.parametrize("capture", NMEA)
def test_sentences_as_pynmeagps(capture: str) -> None:
    reader = pytest.importorskip("pynmeagps", reason="pynmeagps is not installed: pip install .[peers]").NMEAReader
    found, messages = decoded("nmea_0183", capture)
    with (CAPTURES / capture).open("rb") as stream:
        theirs = [message for _, message in reader(stream, nmeaonly=False, quitonerror=0) if message is not None]
    counts = Counter(message.msgID for message in theirs)
    assert found.messages == {name: counts[name.upper()] for name in messages}
    assert found.counts.frames + found.counts.other == len(theirs)
    values = {"gga": {"latitude": "lat", "longitude": "lon", "height_sea_level": "alt", "geoid": "sep",
                      "fix": "quality", "satellites": "numSV", "dilution": "HDOP"},
              "rmc": {"latitude": "lat", "longitude": "lon", "speed": "spd", "course": "cog"},
              "vtg": {"course": "cogt", "speed": "sogn", "speed_km": "sogk"}}  # fmt: skip
    for name, fields in values.items():
        of_kind = [message for message in theirs if message.msgID == name.upper()]
        for field, attribute in fields.items():
            texts = [getattr(message, attribute) for message in of_kind]
            due = np.array([np.nan if text == "" else float(text) for text in texts])
            due = due * KNOT if field == "speed" else due
            np.testing.assert_allclose(messages[name].scaled(field), due, rtol=1e-7, atol=1e-8, err_msg=field)
    stamps = [message.time for message in theirs if message.msgID == "RMC"]
    seconds = [
        np.nan if at == "" else at.hour * 3600 + at.minute * 60 + at.second + at.microsecond / 1e6 for at in stamps
    ]
    np.testing.assert_allclose(messages["rmc"].raw("tick"), seconds, atol=1e-6)
