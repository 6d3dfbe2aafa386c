"""Samples of the simulated module on its line: counted, stamped, in time, whoever looks how often."""

import struct

import numpy as np
import pytest
from gnc_rig import STREAM, frames_in, open_host

from bench.frame import load_frame
from bench.model.shipped import find_shipped
from sim_instruments.worlds.gnc.module import CRYSTAL_PPM_DEGC2

DEFINITION = load_frame(find_shipped("frames", "gnc_422"))


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
    assert 998 <= len(rows) <= 1000
    assert (rows[:, 0] == np.arange(len(rows))).all()
    assert (np.diff(rows[:, 1]) == 5000).all()
    assert (rows[:, 2] == 1).all()
    force_g = rows[:, 6:9].mean(axis=0) / 1000
    assert np.linalg.norm(force_g) == pytest.approx(1.0, abs=0.05)


def test_the_bytes_are_those_of_the_frame_file():
    with open_host() as host:
        rows = streamed(host, seconds=1.0)
        host.clock.sleep(0.5)
        batch = DEFINITION.decoder().feed(host.read()).messages["stream"]
    assert len(batch) >= 99
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


@pytest.mark.parametrize("look_s", [0.02, 0.7, 20.0])
def test_it_does_not_matter_how_often_somebody_looks(look_s):
    with open_host() as host:
        rows = streamed(host, seconds=20.0 if look_s != 0.7 else 19.6, look_s=look_s)
    with open_host() as host:
        other = streamed(host, seconds=20.0, look_s=0.25)
    n = min(len(rows), len(other))
    assert n >= 3918
    assert (rows[:n] == other[:n]).all()


def test_lost_frames_are_seen_by_the_counter():
    with open_host() as host:
        host.world.faults.link("rs422").drop_rate = 0.02
        while host.ask(0x20, "BHI", 7, 200, 0)[0] != 0:
            pass
        host.clock.sleep(10)
        counters = [int.from_bytes(f.payload[:4], "little") for f in frames_in(host.read()) if f.kind == STREAM]
    missing = counters[-1] - counters[0] + 1 - len(counters)
    assert 10 <= missing <= 90
    assert len(set(counters)) == len(counters)


def test_commands_are_answered_between_samples():
    with open_host() as host:
        streamed(host, seconds=0.5)
        assert host.ask(0x17, "H", 0x1234) == (0, bytes.fromhex("34 12 34 12"))
        rows = [f for f in frames_in(host.read()) if f.kind == STREAM]
    assert len(rows) <= 2
