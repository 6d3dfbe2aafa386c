"""The simulated time-offset bench: streams against the direct simulation, flight, radar, echoes, truth, operations."""

import numpy as np
import pytest
from scipy.integrate import cumulative_simpson
from sync_rig import QUIET, Rig, flying, level_matrices, turning

from bench.maths.geodesy import TangentFrame, body_to_level
from bench.model.clock import NS
from bench.model.ports import RecordWindow
from bench.systems.time_sync.estimators.sar.pulses import Pulses
from bench.systems.time_sync.estimators.sar.response import impulse_response
from sim_instruments.worlds.simulation import kind_options
from sim_instruments.worlds.time_sync.flight.egi import egi_error_runs
from sim_instruments.worlds.time_sync.flight.imu import exact_increments, imu_runs
from sim_instruments.worlds.time_sync.flight.path import FlightPath
from sim_instruments.worlds.time_sync.world import Radar, echoes, scene

PLACE = (37.5, 127.0)  # origin of every flight
BOOT_S = 4.0  # of the rig, when its flight begins


def tangent(rows):
    """Positions (n, 3), velocities (n, 3) and attitudes (n, 3, 3) of frames of the EGI, by the analysis' conversion."""
    latitude, longitude, height = rows[:, 2:5].T
    frame = TangentFrame(*PLACE)
    axes = frame.from_level(latitude, longitude)
    velocity = np.einsum("nij,nj->ni", axes, rows[:, 5:8])
    return frame.positions_m(latitude, longitude, height), velocity, axes @ body_to_level(*rows[:, 8:11].T)


def flight_s(rig, name, rows):
    """Time of the flight of frames, by their ticks and the true clock."""
    clock = getattr(rig.world.units.powers[-1], name)
    return clock.since_on_s(1e-7 * rows[:, 1]) - BOOT_S


@pytest.fixture(scope="module")
def turned():
    """A vehicle that has flown the paper's turn, its tags without noise."""
    return turning(4.5, before_s=20.0, turn_s=20.0, after_s=20.0, tag_noise_s=0.0, seed=3, listen=("egi", "imu"))


def test_the_stream_of_the_imu_is_the_direct_simulation_on_the_same_path_with_the_same_draws(turned):
    rig = turned
    rows, path = rig.rows("imu"), rig.world.flight.path
    end_s = flight_s(rig, "imu", rows)
    rows, end_s = rows[end_s > 0.0], end_s[end_s > 0.0]
    assert rows.shape[0] > 11_900
    grid_s = np.append(end_s[0] - np.diff(end_s).mean(), end_s)
    dv, dtheta = exact_increments(path, grid_s)
    direct = imu_runs(path, 60.0, 1, 3)
    bare_dv, bare_dtheta = exact_increments(path, np.arange(12_001) / 200.0)
    dv = dv + (direct.dv[:, 0] - bare_dv)[: len(rows)]
    dtheta = dtheta + (direct.dtheta[:, 0] - bare_dtheta)[: len(rows)]
    np.testing.assert_allclose(1e-9 * rows[:, 2:5], dtheta, rtol=0.0, atol=0.51e-9)
    np.testing.assert_allclose(1e-8 * rows[:, 5:8], dv, rtol=0.0, atol=0.53e-8)


def test_the_stream_of_the_egi_is_the_direct_simulation_on_the_same_path_with_the_same_draws(turned):
    rig = turned
    rows = rig.rows("egi")
    valid_s = flight_s(rig, "egi", rows)
    rows, valid_s = rows[valid_s > 0.0], valid_s[valid_s > 0.0]
    assert set(rows[:, 12]) == {3.0}
    true = rig.world.flight.path.state(valid_s)
    direct = egi_error_runs(rig.world.flight.path, 60.0, 1, 3)
    p, v, turn = tangent(rows)
    count = len(rows)
    # the direct one starts at 0 s, the stream up to 20 ms later: errors of 1 m and 0.01 m/s, in turns 1 deg apart
    np.testing.assert_allclose(p - true.p, direct.dp[:count, 0], rtol=0.0, atol=1e-3)
    np.testing.assert_allclose(v - true.v, direct.dv[:count, 0], rtol=0.0, atol=1.5e-4)
    tilt = turn @ np.swapaxes(level_matrices(true.yaw), 1, 2)
    skew = 0.5 * (tilt - np.swapaxes(tilt, 1, 2))
    dphi = np.stack([skew[:, 2, 1], skew[:, 0, 2], skew[:, 1, 0]], axis=1)
    np.testing.assert_allclose(dphi, direct.dphi[:count, 0], rtol=0.0, atol=5e-7)
    assert np.abs(direct.dp).max() > 0.1
    sigma_m = rows[:, 11]
    assert (np.diff(sigma_m[:50]) > 0.0).sum() >= 45, "between two fixes it grows"
    assert 0.05 < sigma_m.min() < sigma_m.max() < 1.0


def test_the_path_is_that_of_a_vehicle_with_the_tables_heading():
    """Position by integration of speed along the heading of the table, ramps of 22 ms included; no path class."""
    rig = turning(9.0, before_s=2.0, turn_s=10.0, after_s=3.0, speed=250.0, **QUIET)
    rows = rig.rows("egi")
    valid_s = flight_s(rig, "egi", rows)
    rows, valid_s = rows[valid_s > 0.0], valid_s[valid_s > 0.0]
    grid_s = np.arange(0.0, 15.0, 1e-4)
    angle_deg = rig.world.motion[0].angle_deg(np.rint((BOOT_S + grid_s) * NS).astype(np.int64))
    heading = -np.radians(angle_deg)
    north = cumulative_simpson(250.0 * np.cos(heading), x=grid_s, initial=0.0)
    east = cumulative_simpson(250.0 * np.sin(heading), x=grid_s, initial=0.0)
    p, v, turn = tangent(rows)
    np.testing.assert_allclose(p[:, 0], np.interp(valid_s, grid_s, north), rtol=0.0, atol=2e-5)
    np.testing.assert_allclose(p[:, 1], np.interp(valid_s, grid_s, east), rtol=0.0, atol=2e-5)
    np.testing.assert_allclose(p[:, 2], -3000.0, rtol=0.0, atol=1e-6)
    yaw = np.unwrap(np.arctan2(turn[:, 1, 0], turn[:, 0, 0]))
    np.testing.assert_allclose(yaw, np.interp(valid_s, grid_s, heading), rtol=0.0, atol=2e-6)
    np.testing.assert_allclose(np.hypot(v[:, 0], v[:, 1]), 250.0, rtol=0.0, atol=1e-7)
    assert v[-1, 1] > 240.0, "a right turn from north goes east"


def test_acceleration_holds_from_its_command_until_the_next():
    rig = flying(100.0, **QUIET)
    rig.clock.sleep(2.0)
    rig.world.operate("acceleration", "15 m/s2")
    rig.clock.sleep(10.0)
    rig.world.operate("acceleration", 0.0)
    rig.clock.sleep(2.0)
    rows = rig.rows("egi")
    valid_s = flight_s(rig, "egi", rows)
    rows, valid_s = rows[valid_s > 0.0], valid_s[valid_s > 0.0]
    gone_s = np.clip(valid_s - 2.0, 0.0, 10.0)
    p, v, _ = tangent(rows)
    np.testing.assert_allclose(v[:, 0], 100.0 + 15.0 * gone_s, rtol=0.0, atol=1e-5)
    expected = 100.0 * valid_s + 7.5 * gone_s**2 + 150.0 * np.clip(valid_s - 12.0, 0.0, None)
    np.testing.assert_allclose(p[:, 0], expected, rtol=0.0, atol=3e-5)
    imu = rig.rows("imu")
    forward_m_s2 = 1e-8 * imu[:, 5] / 0.005
    end_s = flight_s(rig, "imu", imu)
    assert forward_m_s2[(end_s > 2.01) & (end_s < 12.0)].mean() == pytest.approx(15.0, abs=5e-3)
    assert forward_m_s2[(end_s > 0.0) & (end_s < 2.0)].mean() == pytest.approx(0.0, abs=5e-3)


def test_before_a_flight_the_egi_aligns_and_a_flight_begins_at_the_origin_heading_north():
    rig = Rig()
    rig.world.motion[0].go_to(70.0, 100.0, 400.0, 0)
    rig.power()
    rig.clock.sleep(BOOT_S)
    rig.world.operate("speed", "100 m/s")
    rig.clock.sleep(2.0)
    rig.world.operate("speed", 50.0)
    rig.clock.sleep(1.0)
    rows = rig.rows("egi")
    valid_s = flight_s(rig, "egi", rows)
    assert set(rows[valid_s < 0.0, 12]) == {0.0}
    assert set(rows[valid_s >= 0.0, 12]) == {3.0}
    p, v, _ = tangent(rows)
    for begin_s, speed in ((0.0, 100.0), (2.0, 50.0)):
        first = np.flatnonzero(valid_s >= begin_s)[0]
        assert np.abs(p[first] - [speed * (valid_s[first] - begin_s), 0.0, -3000.0]).max() < 3.0
        assert np.abs(v[first] - [speed, 0.0, 0.0]).max() < 0.3
        heading_deg = (rows[first, 10] + 180.0) % 360.0 - 180.0
        assert abs(heading_deg) < 0.1
    assert np.diff(rows[:, 0]).tolist() == [1.0] * (len(rows) - 1)


def test_echoes_are_those_of_three_reflectors_broadside_five_seconds_ahead():
    """Range and phase of the middle reflector, by a path written here: straight north at 250 m/s from 0 s."""
    rig = flying(250.0, **QUIET, imu_clock_ppm=20.0)
    rig.clock.sleep(1.0)
    rig.world.operate("radar", "on")
    rig.clock.sleep(10.0)
    rig.world.operate("radar", "off")
    rig.clock.sleep(1.0)
    rows = rig.rows("radar")
    assert rows.shape[0] in (10_000, 10_001)
    pulse_s = flight_s(rig, "imu", rows)
    np.testing.assert_allclose(np.diff(pulse_s), 1e-3 / (1.0 + 20e-6), atol=1e-7)
    assert 1.0 <= pulse_s[0] < 1.001
    ground_m = np.sqrt(45_000.0**2 - 3000.0**2)
    targets = rig.world.units.pulses[-1].targets_m
    np.testing.assert_allclose(targets[0], [250.0 * 6.0, ground_m, 0.0], rtol=0.0, atol=1e-6)
    assert targets.shape == (3, 3)
    assert not targets[:, 2].any()
    near_m, spacing_m, wavelength_m = rows[0, 2], rows[0, 3], rows[0, 4]
    assert wavelength_m == pytest.approx(299_792_458.0 / 9.6e9)
    gates = rows[:, 5:133].reshape(-1, 64, 2) @ [1.0, 1j]
    range_m = np.sqrt((250.0 * pulse_s - targets[:, :1]) ** 2 + targets[:, 1:2] ** 2 + 3000.0**2)
    gate_m = near_m + spacing_m * np.arange(64)
    expected = np.zeros_like(gates)
    for one in range_m:
        shape = np.sinc((gate_m - one[:, None]) * 2.0 * 50e6 / 299_792_458.0)
        expected += shape * np.exp(-4j * np.pi * one / wavelength_m)[:, None]
    scale = np.vdot(expected, gates) / np.vdot(expected, expected)
    assert scale.real == pytest.approx(6000.0, rel=1e-3)
    assert abs(scale.imag) < 3.0
    assert np.abs(gates - scale * expected).max() < 10.0


@pytest.mark.validates(
    "radar stream of the simulated bench, noise and steps of the wire included",
    against="theory of an unweighted aperture of 10 s and 50 MHz: 0.2490 m, 2.656 m, -13.26 dB, no shift",
)
def test_the_image_of_the_stream_at_true_positions_is_ideal(record_property):
    """Noise, steps of the wire and clock included: what theory says of 50 MHz and 10 s of aperture, no shift."""
    rig = flying(250.0, seed=3, listen=("radar",))
    rig.world.operate("radar", "on")
    rig.clock.sleep(10.0)
    rows = rig.rows("radar")
    gates = (rows[:, 5:133].reshape(-1, 64, 2) @ [1.0, 1j]).astype(np.complex64)
    positions_m = rig.world.flight.path.state(flight_s(rig, "imu", rows)).p
    pulses = Pulses(gates, float(rows[0, 2]), float(rows[0, 3]), float(rows[0, 4]))
    found = impulse_response(pulses, positions_m, rig.world.units.pulses[-1].targets_m[0])
    size = f"{found.azimuth.resolution_m:.4f} m, {found.range.resolution_m:.3f} m, {found.azimuth.pslr_dB:.2f} dB"
    record_property("obtained", f"{size}, shift {1e3 * found.azimuth.shift_m:.1f} mm")
    assert found.azimuth.shift_m == pytest.approx(0.0, abs=2e-3)
    assert found.range.shift_m == pytest.approx(0.0, abs=0.02)
    assert found.azimuth.resolution_m == pytest.approx(0.2490, rel=0.01)
    assert found.range.resolution_m == pytest.approx(2.656, rel=0.01)
    assert found.azimuth.pslr_dB == pytest.approx(-13.26, abs=0.15)


def test_receiver_noise_is_20_dB_below_the_peak_of_one_pulse():
    noisy, quiet = (flying(250.0, seed=6, noise=noise) for noise in ("on", "off"))
    for rig in (noisy, quiet):
        rig.world.operate("radar", "on")
        rig.clock.sleep(1.0)
    difference = noisy.rows("radar")[:, 5:133] - quiet.rows("radar")[:, 5:133]
    power = (difference**2).sum(axis=1).mean() / 64.0
    assert 10.0 * np.log10(power / 6000.0**2) == pytest.approx(-20.0, abs=0.1)


def test_the_radar_is_silent_on_the_ground_and_counts_on_from_one_time_to_the_next():
    rig = flying(0.0)
    rig.world.operate("radar", "on")
    rig.clock.sleep(1.0)
    assert not rig.bytes_of("radar")
    rig.world.operate("speed", 200.0)
    rig.clock.sleep(0.5)
    assert not rig.bytes_of("radar"), "a new flight begins with the radar off"
    for _ in range(2):
        rig.world.operate("radar", "on")
        rig.world.operate("radar", "on")
        rig.clock.sleep(0.5)
        rig.world.operate("radar", "off")
        rig.clock.sleep(0.25)
    rows = rig.rows("radar")
    np.testing.assert_array_equal(rows[:, 0], np.arange(len(rows)))
    assert len(rows) in (1000, 1001, 1002)
    assert (np.diff(rows[:, 1]) > 2e6).sum() == 1
    rig.world.operate("radar", "on")
    rig.world.operate("speed", 200.0)
    before = len(rig.bytes_of("radar"))
    rig.clock.sleep(0.5)
    assert len(rig.bytes_of("radar")) - before <= 2 * 296


def windows(*spans_s, **conditions):
    return [
        RecordWindow(number, "imu", 0, 1, round(begin * NS), round(end * NS), conditions)
        for number, (begin, end) in enumerate(spans_s)
    ]


def test_truth_is_the_offset_at_the_middle_its_drift_and_the_biases_of_its_records():
    rig = flying(100.0, seed=9, offset_s=0.02, drift_ppm=5.0, imu_clock_ppm=10.0)
    rig.clock.sleep(60.0)
    found = rig.world.truth(windows((10.0, 30.0), (30.0, 60.0), item="time_sync", manoeuvre="turn"))
    offsets = {one["conditions"]["at"]: one for one in found if one["quantity"] == "time_offset"}
    for at, t_s in (("begin", 10.0), ("middle", 35.0), ("end", 60.0)):
        assert offsets[at]["value"] == pytest.approx(0.02 + 5e-6 * (1.0 + 10e-6) * t_s, abs=1e-12)
        assert offsets[at]["unit"] == "s"
        assert offsets[at]["conditions"]["manoeuvre"] == "turn"
    drift = next(one for one in found if one["quantity"] == "time_offset_drift")
    assert drift["value"] == pytest.approx(5.0, abs=1e-8)
    direct = imu_runs(FlightPath([(0.0, 0.0, 0.0)], 100.0), 1.0, 1, 9)
    accel = [one["value"] for one in found if one["quantity"] == "accel_bias"]
    gyro = [one["value"] for one in found if one["quantity"] == "gyro_bias"]
    np.testing.assert_allclose(np.array(accel) * 9.80665e-6, direct.accel_bias[0], rtol=1e-9)
    np.testing.assert_allclose(np.radians(gyro) / 3600.0, direct.gyro_bias[0], rtol=1e-9)
    rig = flying()
    assert rig.world.truth([]) == []
    assert rig.world.truth(windows((1.0, 2.0), item="warm_up")) == []
    assert Rig().world.truth(windows((1.0, 2.0), item="time_sync")) == []


def test_options_have_names_and_what_is_not_given_is_drawn_within_its_limits():
    assert {"noise", "offset_s", "drift_ppm", "imu_clock_ppm", "egi_latency_s"} <= set(kind_options("time_sync"))
    drawn = []
    for seed in range(30):
        rig = Rig(seed)
        rig.power()
        clocks = rig.world.units.powers[0]
        drawn.append((clocks.offset_s(0), clocks.drift_ppm, 1e6 * (clocks.imu.rate - 1.0)))
        rig.world.close()
    spread = np.array(drawn)
    assert (np.abs(spread) <= [0.03, 5.0, 20.0]).all()
    assert (np.ptp(spread, axis=0) > [0.03, 5.0, 20.0]).all()


RADAR = Radar()


def test_pulses_one_by_one_are_those_of_the_whole_aperture() -> None:
    track = np.stack([np.arange(2500) * 0.25, np.zeros(2500), np.full(2500, -3000.0)], axis=1)
    targets = scene(Radar(aperture_s=2.5), track[0], np.array([250.0, 0.0, 0.0]))
    whole = echoes(RADAR, track, targets, np.ones(3))
    some = [echoes(RADAR, track[index : index + 1], targets, np.ones(3)) for index in (0, 1999, 2000, 2499)]
    for index, one in zip((0, 1999, 2000, 2499), some, strict=True):
        assert np.array_equal(whole[index], one[0])


@pytest.mark.parametrize(("heading_deg", "right"), [(0.0, [0.0, 1.0]), (90.0, [-1.0, 0.0]), (200.0, [0.3420, -0.9397])])
def test_the_scene_is_broadside_to_the_right_on_the_ground(heading_deg: float, right: list[float]) -> None:
    heading = np.radians(heading_deg)
    velocity = 250.0 * np.array([np.cos(heading), np.sin(heading), 0.0])
    start = np.array([1000.0, -2000.0, -3000.0])
    targets = scene(RADAR, start, velocity)
    middle = start + 5.0 * velocity
    sight = targets - middle
    assert np.linalg.norm(sight[0]) == pytest.approx(45_000.0, abs=1e-6)
    assert sight[0] @ velocity == pytest.approx(0.0, abs=1e-6)
    assert sight[0, :2] / np.linalg.norm(sight[0, :2]) == pytest.approx(right, abs=1e-4)
    assert targets[:, 2] == pytest.approx([0.0, 0.0, 0.0], abs=1e-9)
    assert sight @ velocity / 250.0 == pytest.approx([0.0, 100.0, -100.0], abs=1e-6)
