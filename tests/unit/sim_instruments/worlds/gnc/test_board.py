"""The simulated test board: commands, answers, refusals and the stream of samples, bytes packed here by hand."""

import struct

import numpy as np
import pytest
from crccheck.crc import Crc16CcittFalse
from gnc_rig import ANSWER, BAUD, REFUSAL, STREAM, frames_in, open_host, packed

from bench.frame import load_frame
from bench.model.clock import NS
from bench.model.lab import find_shipped
from sim_instruments.worlds.gnc.module import CRYSTAL_PPM_DEGC2

BYTE_NS = 10 * NS / BAUD
ERASE = (2, 2, 1, 0, 4096)  # SPI FLASH, its first sector
DEFINITION = load_frame(find_shipped("frames", "gnc_422"))


def test_identify_byte_by_byte_with_the_check_of_the_catalogue():
    frame = packed(0x11, struct.pack("<IB", 5000, 20), sequence=7)
    assert frame == bytes.fromhex("eb 90 01 10 01 07 01 11 05 00 88 13 00 00 14 5c 84")
    assert Crc16CcittFalse.calc(frame[2:-2]) == int.from_bytes(frame[-2:], "little")
    with open_host(serial="GNC-07") as host:
        host.board.write("rs422", packed(0x01, sequence=9, source=3))
        host.clock.sleep(0.1)
        body = bytes.fromhex("01 03 10 09 81 01 1c 00 00 01") + b"GNC-TB-SIM  GNC-07      " + bytes.fromhex("02 01")
        assert host.read() == b"\xeb\x90" + body + Crc16CcittFalse.calc(body).to_bytes(2, "little")


def test_bytes_take_their_time_on_the_line_both_ways():
    with open_host() as host:
        sent = packed(0x01)
        host.board.write("rs422", sent)
        done_ns = host.clock.now_ns() + round(len(sent) * BYTE_NS) + 2_000_000
        host.clock.sleep_until_ns(done_ns)
        assert host.board.waiting("rs422") == 0
        host.clock.sleep_until_ns(done_ns + round(10.5 * BYTE_NS))
        assert host.board.waiting("rs422") == 10
        host.clock.sleep_until_ns(done_ns + round(39.5 * BYTE_NS))
        assert len(host.read()) == 39


def test_nothing_is_heard_before_the_module_has_booted_or_without_power():
    with open_host(on=False) as host:
        assert host.exchange(0x01) is None
        host.power()
        host.clock.sleep(1.19)
        host.board.write("rs422", packed(0x01, sequence=1))
        host.clock.sleep(0.5)
        assert host.read() == b""
        host.board.write("rs422", packed(0x12, struct.pack("<3B2I", *ERASE), sequence=5))
        host.clock.sleep(0.001)
        host.power(False)  # a command that is being done ends with it
        host.clock.sleep(0.1)
        host.power()
        host.clock.sleep(2)
        assert host.read() == b""
        assert host.board.module.memories.erases[2] == 0
        assert host.exchange(0x01) is not None
        host.power(False)
        assert host.exchange(0x01) is None


def test_a_repeated_number_is_answered_again_and_nothing_is_done_twice():
    with open_host() as host:
        payload = struct.pack("<3B2I", *ERASE)
        first, again = (host.exchange(0x12, payload, sequence=5) for _ in range(2))
        assert first == again
        assert struct.unpack("<6I", first.payload[1:])[5] == 1
        other = host.exchange(0x12, payload, sequence=6)
        assert struct.unpack("<6I", other.payload[1:])[5] == 2
        changed = host.exchange(0x12, struct.pack("<3B2I", 2, 2, 2, 0, 4096), sequence=6)
        assert struct.unpack("<6I", changed.payload[1:])[0] == 1024, "another command with this number is done"
        assert host.board.module.memories.erases[2] == 2
        for sequence in range(8):
            assert host.exchange(0x17, b"\x34\x12", sequence=sequence) is not None
        found = host.exchange(0x12, payload, sequence=6)  # the number has come round
        assert struct.unpack("<6I", found.payload[1:])[5] == 3


def test_while_a_command_is_being_done_nothing_is_heard():
    with open_host() as host:
        host.board.write("rs422", packed(0x10, bytes(4), sequence=1))
        host.clock.sleep(0.1)
        for sequence in (1, 2):
            host.board.write("rs422", packed(0x10, bytes(4), sequence=sequence))
        host.clock.sleep(1.0)
        assert [frame.sequence for frame in frames_in(host.read())] == [1]


@pytest.mark.parametrize(
    ("command", "payload", "status"),
    [
        (0x44, "", 3),
        (0x02, "00", 3),
        (0x01, "00", 4),
        (0x10, "000000", 4),
        (0x11, "63 00 00 00 14", 4),  # 99 us
        (0x11, "88 13 00 00 15", 4),  # 21 ticks
        (0x12, "04 00 00 00000000 04000000", 4),  # no such memory
        (0x12, "00 00 01 00000000 04000000", 4),  # RAM is not erased
        (0x12, "02 00 00 00000000 04000000", 4),  # FLASH is not written without erasing
        (0x12, "00 00 00 02000000 04000000", 4),  # not a word
        (0x12, "00 00 00 00000000 04000100", 4),  # beyond its end
        (0x12, "00 00 00 00000000 00000000", 4),
        (0x13, "00", 4),
        (0x15, "06", 4),
        (0x16, "01 01 00", 4),
        (0x16, "01 05 00", 4),
        (0x16, "01 02 02", 4),
        (0x19, "00 00 00 20", 4),  # 30 bits
        (0x20, "00 c8 00 00000000", 4),
        (0x20, "07 c9 00 00000000", 4),  # 201 Hz
        (0x31, "0000 0000 0000 0000 0000", 4),
        (0x7E, "ff", 4),
    ],
)
def test_what_cannot_be_done_is_refused(command, payload, status):
    with open_host() as host:
        frame = host.exchange(command, bytes.fromhex(payload))
        assert (frame.kind, frame.payload) == (REFUSAL, bytes([status]))


def test_frames_for_others_damaged_and_false_ones_are_not_answered():
    with open_host() as host:
        damaged = bytearray(packed(0x01, sequence=2))
        damaged[-1] ^= 0x10
        for sent in (packed(0x01, destination=0x11), bytes(damaged), b"\xeb\x90\xeb"):
            host.board.write("rs422", sent)
        host.board.write("rs422", packed(0x01, sequence=3))
        host.clock.sleep(0.02)
        assert [frame.sequence for frame in frames_in(host.read())] == [3]
        false = bytearray(packed(0x01, sequence=1))
        false[8:10] = b"\x00\x04"
        host.board.write("rs422", bytes(false) + packed(0x01, sequence=2))
        host.clock.sleep(0.045)
        assert host.read() == b""
        host.clock.sleep(0.010)
        assert [frame.sequence for frame in frames_in(host.read())] == [2]


ASKED = {  # what is asked for, and some of what must come back; everything else only has to be read
    "identify": ({}, {"protocol": 1, "board_serial": b"GNC-TB-SIM  ".hex(), "unit_serial": b"GNC-01      ".hex()}),
    "cpu": ({"seed": 1}, {"operations": [256] * 4, "wrong": [0] * 4, "memory_wrong": 0}),
    "timer": ({"setting_us": 500, "ticks": 20}, {"interrupts": 20}),
    "memory": ({"region": 3, "pattern": 0, "operation": 1, "start": 0, "length": 4096}, {"checked": 1024, "erases": 1}),
    "imu": ({"samples": 20}, {"samples": 20}),
    "gps": ({}, {"fix": 3, "latitude": pytest.approx(34.2, abs=1e-3), "longitude": pytest.approx(108.9, abs=1e-3),
                 "height": pytest.approx(400.0, abs=30.0)}),
    "ad": ({"dip": 0}, {}),
    "io": ({"output": 1, "input": 3, "level": 1}, {"read": 1, "others": 0}),
    "spi": ({"word": 0x1234}, {"received": 0x1234, "observed": 0x1234}),
    "sci": ({"pattern": b"\x55\xaa"}, {"echo": "55aa"}),
    "can": ({"identifier": 0x123, "pattern": b"\x01"}, {"identifier": 0x123, "echo": "01"}),
    "set_magnetometer": ({"offset": [0.12, 0.0, -0.12], "gain": 1.05, "sin_alpha": 0.02}, {}),
    "roll": ({}, {}),
    "stream_start": ({"sensors": 7, "rate": 200, "samples": 5}, {}),
    "stream_stop": ({}, {"sent": 0}),
    "inject": ({"code": 21}, {}),
}  # fmt: skip


def test_the_frame_file_and_the_board_mean_the_same():
    commands = load_frame(find_shipped("frames", "gnc_422")).commands
    assert set(commands) == set(ASKED)
    with open_host() as host:
        for name, (asked, due) in ASKED.items():
            frame = host.exchange(commands[name].code, commands[name].encode(asked))
            assert (frame.kind, frame.payload[0]) == (ANSWER, 0), name
            found = commands[name].decode(frame.payload[1:])
            assert {field: found[field] for field in due} == due
        assert host.board.correction.gain == pytest.approx(1.05)
        assert host.board.correction.offset == (1000, 0, -1000)
        assert host.board.correction.sin_alpha == pytest.approx(0.02)


def streamed(host, rate=200, seconds=5.0, sensors=7, samples=0, look_s=0.25):
    """Samples as rows of (counter, tick, count, gyro, accel, mag, temperature)."""
    assert host.ask(0x20, "BHI", sensors, rate, samples) == (0, b"")
    received = b""
    for _ in range(round(seconds / look_s)):
        host.clock.sleep(look_s)
        received += host.read()
    frames = [frame for frame in frames_in(received) if frame.kind == STREAM]
    assert all((f.command, f.destination, f.source) == (0x22, 1, 0x10) for f in frames)
    return np.array([struct.unpack("<2IB9ih", frame.payload) for frame in frames])


def test_samples_are_counted_and_stamped():
    with open_host() as host:
        rows = streamed(host)
        host.clock.sleep(0.5)
        batch = DEFINITION.decoder().feed(host.read()).messages["stream"]
    assert 998 <= len(rows) <= 1000
    assert (rows[:, 0] == np.arange(len(rows))).all()
    assert (np.diff(rows[:, 1]) == 5000).all()
    assert (rows[:, 2] == 1).all()
    force_g = rows[:, 6:9].mean(axis=0) / 1000
    assert np.linalg.norm(force_g) == pytest.approx(1.0, abs=0.05)
    assert len(batch) >= 99  # the bytes are those of the frame file
    assert int(batch.raw("counter")[0]) == len(rows)
    assert batch.raw("gyro").shape[1] == 3


@pytest.mark.parametrize("rate", [1, 7, 50, 150])
def test_the_rate_is_the_one_asked_for(rate):
    with open_host() as host:
        rows = streamed(host, rate, seconds=4.0)
    assert abs(len(rows) - 4 * rate) <= 1
    assert np.abs(np.diff(rows[:, 1]) - 1e6 / rate).max() <= 1


@pytest.mark.parametrize(("sensors", "there"), [(1, [1, 0, 0]), (2, [0, 1, 0]), (4, [0, 0, 1]), (5, [1, 0, 1])])
def test_sensors_that_were_not_asked_for_read_zero(sensors, there):
    with open_host() as host:
        rows = streamed(host, sensors=sensors, seconds=0.5)
    assert [bool(rows[:, at : at + 3].any()) for at in (3, 6, 9)] == [bool(v) for v in there]


def test_a_number_of_samples_and_the_counter_over_several_streams():
    with open_host() as host:
        first = streamed(host, samples=30, seconds=1.0)
        assert host.ask(0x21) == (0, struct.pack("<I", 30))
        second = streamed(host, seconds=1.0)
        status, sent = host.ask(0x21)
        assert status == 0
        assert host.read() == b""
        host.power(False)
        host.power()
        host.clock.sleep(1.6)
        third = streamed(host, samples=3, seconds=1.0)
    assert list(first[:, 0]) == list(range(30))
    assert second[0, 0] == 30
    assert struct.unpack("<I", sent)[0] >= len(second)
    assert list(third[:, 0]) == [0, 1, 2], "the counter begins anew with the power"


def test_the_clock_of_the_module_is_wrong_by_some_ppm_and_by_temperature():
    errors = []
    for seed in range(12):
        with open_host(seed) as host:
            rows = streamed(host, 1, seconds=600.0, look_s=100.0)
            errors.append(host.board.module.crystal_error(host.clock.now_ns()) * 1e6)
            stream = host.board.stream
            took_s = (stream._times_ns(np.array([100_000]))[0] - stream.start_ns) / 1e9
            assert (100_000 / took_s - 1) * 1e6 == pytest.approx(stream.error * 1e6, abs=1e-3)
        assert len(rows) >= 599
    assert 4.0 < np.std(errors) < 20.0
    assert CRYSTAL_PPM_DEGC2 < 0


def test_the_tick_wraps():
    with open_host() as host:
        host.clock.sleep(4290.0)
        rows = streamed(host, seconds=5.0)
    wrapped = np.flatnonzero(np.diff(rows[:, 1]) < 0)
    assert len(wrapped) == 1
    assert (np.diff(rows[:, 1]) % 2**32 == 5000).all()


@pytest.mark.parametrize("look_s", [0.02, 0.7, 5.6])
def test_it_does_not_matter_how_often_somebody_looks(look_s):
    with open_host() as host:
        rows = streamed(host, seconds=5.6, look_s=look_s)
    with open_host() as host:
        other = streamed(host, seconds=5.6, look_s=0.28)
    n = min(len(rows), len(other))
    assert n >= 1118
    assert (rows[:n] == other[:n]).all()
