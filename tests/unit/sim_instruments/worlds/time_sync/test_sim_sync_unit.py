"""Ports, supply and clocks of the simulated EGI, inertial unit and radar; clocks by what is seen of them."""

import numpy as np
import pytest
from sync_rig import BAUDS, LAYOUTS, QUIET, Rig, flying, frames, turning

from bench.model.clock import NS

RATES_HZ = {"egi": 50, "imu": 200, "radar": 1000}


def length(name):
    return 6 + LAYOUTS[name][1].size


def test_it_speaks_3_s_behind_its_supply_whatever_the_voltage():
    rig = Rig()
    rig.clock.sleep(5.0)
    assert not any(rig.bytes_of(name) for name in BAUDS)
    rig.power()
    rig.clock.sleep(3.0)
    assert not any(rig.bytes_of(name) for name in BAUDS)
    rig.clock.sleep(1.0)
    assert rig.rows("imu").shape[0] in (199, 200)
    assert rig.rows("egi").shape[0] in (49, 50)
    assert not rig.bytes_of("radar")
    for name in ("imu", "egi"):
        np.testing.assert_array_equal(rig.rows(name)[:, 0], np.arange(len(rig.rows(name))))
    calm, changed = Rig(), Rig()
    for rig in (calm, changed):
        rig.power()
        rig.clock.sleep(4.0)
        if rig is changed:
            rig.unit.set_power(True, rig.clock.now_ns(), 15.2)
        rig.clock.sleep(1.0)
    assert calm.bytes_of("imu") == changed.bytes_of("imu")


def test_a_supply_switched_off_is_silence_and_a_new_start_begins_anew():
    rig = flying()
    rig.clock.sleep(2.0)
    first = {name: rig.rows(name) for name in ("imu", "egi")}
    rig.power(on=False)
    rig.received = {name: [] for name in BAUDS}
    rig.clock.sleep(0.1)
    rig.read()
    rig.received = {name: [] for name in BAUDS}
    rig.clock.sleep(20.0)
    assert not any(rig.bytes_of(name) for name in BAUDS)
    rig.power()
    rig.clock.sleep(4.0)
    for name in ("imu", "egi"):
        rows = rig.rows(name)
        assert rows[0, 0] == 0
        elapsed_s = 1e-7 * (rows[0, 1] - first[name][0, 1])
        assert abs(elapsed_s - 26.1) > 1.0, "a clock that went on is none that was started"
    assert set(rig.rows("egi")[:, 12]) == {0.0}, "it is not aligned before a flight begins"


def test_who_comes_late_or_again_finds_the_counter_further_on_and_the_same_bytes():
    always, late = flying(), flying(listen=())
    for rig in (always, late):
        rig.clock.sleep(3.0)
        if rig is late:
            rig.listen("imu")
            rig.listen("egi")
        rig.clock.sleep(2.0)
    for name in ("imu", "egi"):
        whole, part = always.bytes_of(name), late.bytes_of(name)
        assert len(part) > 0.9 * 2 * RATES_HZ[name] * length(name)
        assert whole.endswith(part)
    rig = flying()
    rig.clock.sleep(1.0)
    rig.read()
    rig.unit.disconnect("imu")
    rig.clock.sleep(1.0)
    rig.listen("imu")
    rig.clock.sleep(1.0)
    counter = rig.rows("imu")[:, 0]
    gaps = np.diff(counter)
    assert (gaps > 1).sum() == 1
    assert gaps.max() in (200, 201, 202)


def test_nothing_depends_on_when_one_looks():
    """Poll each millisecond, look at the end, look at irregular times: the same bytes; radar and turn, too."""
    seen = []
    for way in range(3):
        rig = flying(seed=5, speed=250.0, jitter_s=0.004)
        if way == 0:
            rig.poll()
        draw = np.random.default_rng(way)

        def wait(duration_s, rig=rig, way=way, draw=draw):
            end_ns = rig.clock.now_ns() + round(duration_s * NS)
            while way == 2 and rig.clock.now_ns() < end_ns:
                rig.clock.sleep_until_ns(min(end_ns, rig.clock.now_ns() + int(draw.integers(1, 30_000_000))))
                rig.read()
            rig.clock.sleep_until_ns(end_ns)

        wait(1.2345)
        rig.turn(9.0)
        wait(0.0123)
        rig.turn(4.0)  # while the table still comes to speed
        wait(1.0)
        rig.world.operate("acceleration", 3.0)
        wait(0.7)
        rig.world.operate("radar", "on")
        wait(0.5)
        rig.world.operate("radar", "off")
        wait(0.01)
        seen.append({name: rig.bytes_of(name) for name in BAUDS})
    for name in BAUDS:
        assert len(seen[0][name]) > 400 * length("imu") or name == "egi"
        assert seen[0][name] == seen[1][name] == seen[2][name], name


# --- clocks, by what is seen ---------------------------------------------------------------------------------------


def arrivals_ns(rig, name, frames_due, step_ns=8_000):
    """Bench times at which the first bytes of the next frames are there, and the frames' ticks in seconds."""
    got, begun, byte_ns = b"", [], 10 * NS // BAUDS[name]
    while len(begun) < frames_due or len(got) % length(name):
        rig.clock.sleep_until_ns(rig.clock.now_ns() + step_ns)
        if chunk := rig.unit.read(name, 10**6):
            if len(got) % length(name) == 0:
                begun.append(rig.clock.now_ns() - byte_ns - step_ns // 2)
            got += chunk
    return np.array(begun), 1e-7 * frames(name, got)[:, 1]


def test_first_bytes_come_a_latency_behind_validity_by_both_clocks():
    """Without jitter the difference of both lines, tick against arrival, is the true offset and drift."""
    options = {**QUIET, "offset_s": 0.0137, "drift_ppm": 5.0, "imu_clock_ppm": -12.0}
    rig = flying(0.0, **options, egi_latency_s=0.004, imu_latency_s=0.002)
    latency_s = {"imu": 0.002, "egi": 0.004}
    seen = {name: [] for name in latency_s}
    for _ in range(2):
        for name in latency_s:
            until_quiet(rig, name)
            seen[name].append(arrivals_ns(rig, name, 3))
        rig.clock.sleep(60.0)
    lines = {}
    for name, visits in seen.items():
        t_ns, tick_s = (np.concatenate(parts) for parts in zip(*visits, strict=True))
        rate, at_first_s = np.polyfit((t_ns - t_ns[0]) / NS, tick_s - tick_s[0], 1)
        lines[name] = (t_ns[0], tick_s[0] + at_first_s + latency_s[name] * rate, rate)
    t_ns = 100 * NS
    reading = {name: at_s + rate * (t_ns - first_ns) / NS for name, (first_ns, at_s, rate) in lines.items()}
    expected = 0.0137 + 5e-6 * 100.0 * (1.0 - 12e-6)
    assert reading["egi"] - reading["imu"] == pytest.approx(expected, abs=1e-5)
    assert lines["imu"][2] - 1.0 == pytest.approx(-12e-6, abs=0.15e-6)
    assert lines["egi"][2] / lines["imu"][2] - 1.0 == pytest.approx(5e-6, abs=0.15e-6)
    assert rig.world.units.powers[0].offset_s(t_ns) == pytest.approx(expected, abs=1e-12)


def until_quiet(rig, name):
    rig.unit.discard(name)
    rig.clock.sleep(1e-4)
    while rig.unit.read(name, 10**6):
        rig.clock.sleep(1e-4)


@pytest.mark.validates(
    "clocks of the simulated EGI and IMU, offset and drift",
    against="the moment a turn begins, by straight lines through EGI headings and IMU integrals over their tags",
)
@pytest.mark.parametrize(("offset_s", "drift_ppm"), [(0.0137, 5.0), (-0.02, -4.0), (0.3, 0.0), (0.0, 0.0)])
def test_a_turn_is_seen_at_ticks_that_differ_by_the_offset(offset_s, drift_ppm, record_property):
    """The heading of the EGI and the integral of the IMU begin to turn at the same moment: no clock is asked."""
    rig = turning(5.0, **QUIET, speed=0.0, offset_s=offset_s, drift_ppm=drift_ppm)  # no meridians converge at rest
    egi, imu = rig.rows("egi"), rig.rows("imu")
    egi_s, heading_deg = 1e-7 * egi[:, 1], egi[:, 10]
    heading_deg = np.degrees(np.unwrap(np.radians(heading_deg)))
    imu_s, yaw_deg = 1e-7 * imu[:, 1], np.degrees(1e-9 * np.cumsum(imu[:, 4]))
    still = imu_s < imu_s[0] + 5.0
    yaw_deg -= np.polyval(np.polyfit(imu_s[still] - imu_s[0], yaw_deg[still], 1), imu_s - imu_s[0])  # Earth's rate
    begun_s = []
    for t_s, deg in ((egi_s, heading_deg), (imu_s, yaw_deg)):
        ramp = (deg > 5.0) & (deg < 45.0)
        slope, at_s = np.polyfit(t_s[ramp] - t_s[0], deg[ramp], 1)
        begun_s.append(t_s[0] - at_s / slope)
    begun_at_s = 14.0 + 0.5 * 5.0 / 400.0
    expected = offset_s + 1e-6 * drift_ppm * begun_at_s
    off_s = begun_s[0] - begun_s[1] - expected
    record_property("obtained", f"{1e3 * offset_s:g} ms, {drift_ppm:g} ppm: {1e6 * off_s:.2f} us, limit 1")
    assert abs(off_s) < 1e-6
    assert rig.world.units.powers[0].offset_s(round(begun_at_s * NS)) == pytest.approx(expected, abs=1e-9)


def test_samples_lie_on_their_own_clocks_and_jitter_never_turns_their_order():
    rig = flying(tag_noise_s=1e-5)
    rig.clock.sleep(60.0)
    for name, period_s in (("imu", 0.005), ("egi", 0.02)):
        tick_s = rig.tick_s(name)
        off_s = tick_s - period_s * np.rint(tick_s / period_s)
        assert off_s.std() == pytest.approx(1e-5, rel=0.06)
        assert abs(off_s.mean()) < 4e-5 / np.sqrt(tick_s.size)
        assert abs(np.corrcoef(off_s[1:], off_s[:-1])[0, 1]) < 4.0 / np.sqrt(tick_s.size)
    rig = flying(jitter_s=0.01, imu_latency_s=0.001)
    rig.poll()
    rig.clock.sleep(5.0)
    assert np.diff(rig.rows("imu")[:, 0]).tolist() == [1.0] * (len(rig.rows("imu")) - 1)
    at_ns = np.array([t_ns for t_ns, _ in rig.received["imu"]])
    assert np.diff(at_ns).max() > 15_000_000
