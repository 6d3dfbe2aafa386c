"""The simulated unit in time, and the commands it takes."""

from __future__ import annotations

import numpy as np
import pytest
from ngu_rig import BYTE_NS, decoded, gate_frames, powered_unit, send_command, steady, warm

from bench.frame import load_frame
from bench.model.clock import NS, VirtualClock, to_ns
from bench.model.shipped import find_shipped
from sim_instruments.worlds.af_converter.constants import KINDS
from sim_instruments.worlds.af_converter.ngu import Ngu

# --- what the counts say ---------------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    "clocks", [{}, {"master_error_ppm": "50", "af_clock_error_ppm": "-50"}, {"master_error_ppm": "-50"}]
)
def test_equation_1_holds_for_counts_of_100_s(clocks):
    clock, unit = powered_unit(seed=4, options=clocks | {"noise": "off"})
    inputs_A = [0.1, -0.1, 0.25, -3e-4, 1e-3, 0.0, 0.02, -0.02, 5e-4, -1e-3]
    for channel, current_A in enumerate(inputs_A, start=1):
        unit.set_input(channel, current_A, 0)
    clock.sleep(161)
    frames = gate_frames(unit.read("port_a", 10**9))
    window = slice(5000, 15_000)
    n_af = frames.raw("af_clock")[window].astype(np.int64).sum()
    rates = 256_000.0 / n_af  # (N / t_INT0) r with r = f_AF0 t_INT0 / n_AF
    for channel, current_A in enumerate(inputs_A, start=1):
        k0_C = KINDS[channel - 1].k0_C
        n, p = (frames.raw(name)[window, channel - 1].astype(np.int64).sum() for name in ("npp", "ppp"))
        dsf_n, dsf_p = (1e-6 * of(channel, 31.0) for of in (unit.truth.dsf_n_ppm, unit.truth.dsf_p_ppm))
        reading_A = k0_C * rates * ((1 + dsf_n) * n - (1 + dsf_p) * p)
        truth_A = current_A - unit.truth.bias_A(channel, 31.0, 0.0)
        assert reading_A == pytest.approx(truth_A, abs=2 * k0_C / 100 + 5e-8 * abs(current_A)), channel


def test_open_inputs_read_the_negative_bias():
    clock, unit = powered_unit(seed=2)
    clock.sleep(130)
    frames = gate_frames(unit.read("port_a", 10**9))
    for channel in range(1, 11):
        n, p = (frames.raw(name)[2000:12_000, channel - 1].astype(np.int64).sum() for name in ("npp", "ppp"))
        reading_A = KINDS[channel - 1].k0_C / 100 * (int(n) - int(p))
        assert reading_A == pytest.approx(
            -unit.truth.bias_A(channel, 31.0, 60.0), abs=1.1 * KINDS[channel - 1].k0_C / 100
        )


def test_master_clock_error_follows_from_the_function_generator_count():
    clock, unit = powered_unit(seed=3)
    unit.set_fg(1e7 * (1 + 2e-6), 0)
    clock.sleep(102)
    frames = gate_frames(unit.read("port_a", 10**9))
    counted = frames.raw("fg_count")[:10_000].astype(np.int64).sum()
    assert (1e9 * (1 + 2e-6) / counted - 1) * 1e6 == pytest.approx(unit.truth.master_error_ppm(31.0), abs=0.002)
    assert set(frames.raw("master_count").tolist()) == {100_000}


def test_without_a_function_generator_its_count_is_zero():
    clock, unit = powered_unit()
    unit.set_fg(0.0, 0)
    clock.sleep(3)
    assert not gate_frames(unit.read("port_a", 10**6)).raw("fg_count").any()


def test_status_tells_a_channel_over_range():
    clock, unit = powered_unit()
    unit.set_input(7, 0.0243, to_ns(2.0))
    clock.sleep(4)
    over = gate_frames(unit.read("port_a", 10**6)).raw("status.over_range")
    assert over[:100].max() == 0
    assert set(over[100:].tolist()) == {1 << 6}


# --- when the bytes are there ----------------------------------------------------------------------------------------


def test_a_frame_is_there_when_the_line_has_carried_it():
    clock, unit = powered_unit(
        options={"master_error_ppm": "0", "noise": "off"}, thermal=lambda t: np.full(len(t), 20.0)
    )
    first_end_ns = NS + to_ns(0.01)  # one second of boot, one gate
    clock.sleep_until_ns(first_end_ns)
    assert unit.waiting("port_a") == 0
    clock.sleep_until_ns(first_end_ns + int(10 * BYTE_NS) - 1)
    assert unit.waiting("port_a") == 9
    clock.sleep_until_ns(first_end_ns + int(57 * BYTE_NS) - 1)
    assert unit.waiting("port_a") == 56
    clock.sleep_until_ns(first_end_ns + int(57 * BYTE_NS) + 60)
    assert unit.waiting("port_a") == 57


def test_frame_times_drift_with_the_master_clock():
    clock, unit = powered_unit(options={"master_error_ppm": "100"}, thermal=lambda t: np.full(len(t), 20.0))
    clock.sleep(1 + 1000 / (1 + 100e-6) + 0.006)
    assert len(gate_frames(unit.read("port_a", 10**9))) == 100_000


def test_counters_count_without_gaps_and_wrap():
    clock, unit = powered_unit()
    clock.sleep(700)
    counter = gate_frames(unit.read("port_a", 10**9)).raw("counter").astype(np.int64)
    np.testing.assert_array_equal(counter, np.arange(len(counter)) % 65_536)
    housekeeping = decoded(unit.read("port_b", 10**9), "ngu_b")["housekeeping"].raw("counter")
    np.testing.assert_array_equal(housekeeping, np.arange(6989))


def test_housekeeping_tells_temperature_and_supply():
    clock, unit = powered_unit(thermal=warm)
    unit.set_power(True, to_ns(100.0), voltage_V=24.0)
    clock.sleep(201)
    frames = decoded(unit.read("port_b", 10**6), "ngu_b")["housekeeping"]
    t_s = 1.1 + 0.1 * np.arange(len(frames))
    error_degC = frames.scaled("unit_temperature") - (15.0 + 0.01 * t_s)[:, None]
    assert error_degC.std() == pytest.approx(np.hypot(0.01, 0.01 / np.sqrt(12)), rel=0.05)
    assert abs(error_degC.mean()) < 4 * 0.01 / np.sqrt(error_degC.size)
    assert frames.scaled("supply_voltage")[:980].mean() == pytest.approx(28.0, abs=0.001)
    assert frames.scaled("supply_voltage")[990:].mean() == pytest.approx(24.0, abs=0.001)


def test_nothing_is_sent_without_supply_and_a_new_period_starts_from_zero():
    clock = VirtualClock()
    unit = Ngu(clock, 1, steady)
    unit.connect("port_a", 115_200)
    clock.sleep(5)
    assert unit.waiting("port_a") == 0
    unit.set_power(True, clock.now_ns())
    clock.sleep(11)
    before = gate_frames(unit.read("port_a", 10**6))
    unit.set_power(False, clock.now_ns())
    clock.sleep(1)
    unit.read("port_a", 57)
    clock.sleep(60)
    assert unit.waiting("port_a") == 0
    unit.set_power(True, clock.now_ns())
    clock.sleep(11)
    again = gate_frames(unit.read("port_a", 10**6))
    assert again.raw("counter")[0] == 0
    assert len(again) == len(before) == 999
    assert (again.raw("npp") != before.raw("npp")).any()


def test_what_is_sent_while_nobody_listens_is_lost():
    clock = VirtualClock()
    unit = Ngu(clock, 1, steady)
    unit.set_power(True, 0)
    clock.sleep(100)
    unit.connect("port_a", 115_200)
    clock.sleep(2)
    assert 190 * 57 <= unit.waiting("port_a") <= 201 * 57
    unit.discard("port_a")
    assert unit.waiting("port_a") == 0


def _answers(unit):
    batch = decoded(unit.read("port_b", 10**7), "ngu_b").get("answer")
    if batch is None:
        return []
    return [
        (int(c), int(s), p) for c, s, p in zip(*(batch.raw(n) for n in ("command", "status", "payload")), strict=True)
    ]


def test_the_unit_identifies_itself():
    clock, unit = powered_unit()
    clock.sleep(2)
    send_command(unit, 1)
    assert _answers(unit) == []
    clock.sleep(0.01)
    assert _answers(unit) == [(1, 0, b"NGU SIM-1 1.0")]


def test_the_stream_stops_and_starts():
    clock, unit = powered_unit()
    clock.sleep(2)
    send_command(unit, 3)
    clock.sleep(1)
    unit.discard("port_a")
    clock.sleep(5)
    assert unit.waiting("port_a") == 0
    send_command(unit, 2, b"\x64")
    clock.sleep(5)
    assert unit.waiting("port_a") > 490 * 57
    assert [answer[:2] for answer in _answers(unit)] == [(3, 0), (2, 0)]
    assert int(gate_frames(unit.read("port_a", 10**6)).raw("counter")[0]) == 700


def test_counters_start_again_at_zero():
    clock, unit = powered_unit()
    clock.sleep(5.5)
    send_command(unit, 4)
    clock.sleep(3)
    counter = gate_frames(unit.read("port_a", 10**6)).raw("counter").astype(np.int64)
    assert np.flatnonzero(np.diff(counter) != 1).tolist() == [449]
    assert counter[450] == 0


def test_integrated_frames_hold_the_sums_of_10000_gates():
    clock, unit = powered_unit(7)
    unit.set_input(2, 0.123, 0)
    send_command(unit, 2, b"\x00")
    clock.sleep(1 + 2 * 100 + 0.1)
    twin_clock, twin = powered_unit(7)
    twin.set_input(2, 0.123, 0)
    twin_clock.sleep(1 + 2 * 100 + 0.1)
    integrated = decoded(unit.read("port_a", 10**6), "ngu_a_100s")["frame"]
    gates = gate_frames(twin.read("port_a", 10**8))
    assert integrated.raw("counter").tolist() == [0, 1]
    for name in ("npp", "ppp", "af_clock", "master_count", "fg_count"):
        sums = gates.raw(name)[:20_000].astype(np.int64).reshape(2, 10_000, -1).sum(axis=1)
        np.testing.assert_array_equal(integrated.raw(name).reshape(2, -1), sums)
    assert integrated.raw("status.mode").tolist() == [1, 1]


@pytest.mark.parametrize(("command", "payload", "status"), [(77, b"", 1), (2, b"\x07", 2), (1, b"x", 2)])
def test_what_the_unit_cannot_do_is_answered_with_a_status(command, payload, status):
    clock, unit = powered_unit()
    clock.sleep(2)
    send_command(unit, command, payload)
    clock.sleep(0.1)
    assert _answers(unit) == [(command, status, b"")]


def test_damaged_commands_are_not_answered():
    clock, unit = powered_unit()
    clock.sleep(2)
    definition = load_frame(find_shipped("frames", "ngu_b"))
    damaged = bytearray(definition.encode_one({"command": 3, "payload": b""}, "command"))
    damaged[4] ^= 1
    unit.write("port_b", bytes(damaged))
    unit.write("port_a", definition.encode_one({"command": 3, "payload": b""}, "command"))
    clock.sleep(1)
    assert _answers(unit) == []
