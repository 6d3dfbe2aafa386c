"""Errors of the simulated EGI: their model against whole navigators, what its filter believes, their colour;
ports, supply and clocks of EGI, inertial unit and radar by what is seen of them."""

from itertools import pairwise

import numpy as np
import pytest
from scipy import stats
from scipy.integrate import solve_ivp
from scipy.spatial.transform import Rotation
from sync_rig import BAUDS, LAYOUTS, QUIET, Rig, flying, frames, turning

from bench.model.clock import NS
from sim_instruments.seeds import generator
from sim_instruments.worlds.time_sync.flight.egi import (
    EgiClass,
    EgiErrorFilter,
    EgiErrors,
    EgiRuns,
    _ErrorModel,
    clock_noise,
    egi_error_runs,
    lane,
)
from sim_instruments.worlds.time_sync.flight.path import FlightPath, manoeuvre

Array = np.ndarray
_LATITUDE = np.radians(37.5)
_EARTH = 7.292115e-5 * np.array([np.cos(_LATITUDE), 0.0, -np.sin(_LATITUDE)])
_GRAVITY = 9.7994905
_PULL = _GRAVITY / 6.371e6 * np.array([-1.0, -1.0, 2.0])
_OFFSETS_S = np.array([-0.02, 0.0, 0.0137, 0.1])
_PATH = manoeuvre("turn")
_ERRORS = egi_error_runs(_PATH, 26.0, 3, 5)


def _navigator_errors(path: FlightPath, first_s: float, last_s: float, start: Array) -> Array:
    """Errors at the end of a navigator with errors at its start and constant biases (all 15, as the filter's).

    It integrates the mechanisation from the specific force and rate along the path; the truth is the path itself.
    """

    def rates(t_s: float, y: Array) -> Array:
        true = path.state(np.array([t_s]))
        turn = Rotation.from_euler("z", true.yaw[0])
        pull = np.array([0.0, 0.0, _GRAVITY])
        force = turn.inv().apply(true.a[0] - pull - _PULL * true.p[0] + 2.0 * np.cross(_EARTH, true.v[0]))
        rate = turn.inv().apply(_EARTH) + np.array([0.0, 0.0, true.yaw_rate[0]])
        c = y[6:].reshape(3, 3)
        x, u, z = rate - start[12:]
        body = np.array([[0.0, -z, u], [z, 0.0, -x], [-u, x, 0.0]])
        earth = np.array([[0.0, -_EARTH[2], 0.0], [_EARTH[2], 0.0, -_EARTH[0]], [0.0, _EARTH[0], 0.0]])
        dv = c @ (force - start[9:12]) + pull + _PULL * y[:3] - 2.0 * np.cross(_EARTH, y[3:6])
        return np.concatenate((y[3:6], dv, (c @ body - earth @ c).ravel()))

    true = path.state(np.array([first_s, last_s]))
    turns = [Rotation.from_euler("z", yaw) for yaw in true.yaw]
    attitude = (Rotation.from_rotvec(start[6:9]) * turns[0]).as_matrix().ravel()
    y = np.concatenate((true.p[0] + start[:3], true.v[0] + start[3:6], attitude))
    for begin, end in pairwise([first_s, *path.borders_s(first_s, last_s), last_s]):
        y = solve_ivp(rates, (begin, np.nextafter(end, 0.0)), y, "DOP853", rtol=1e-10, atol=1e-10).y[:, -1]
    dphi = (Rotation.from_matrix(y[6:].reshape(3, 3)) * turns[1].inv()).as_rotvec()
    return np.concatenate((y[:3] - true.p[1], y[3:6] - true.v[1], dphi, start[9:]))


@pytest.mark.validates(
    "error model of the simulated EGI, each of 15 states over a turn of 4 g",
    against="a navigator with these errors, integrated by scipy's DOP853, minus the true path",
)
@pytest.mark.parametrize("column", range(15))
def test_error_model_is_the_difference_of_two_navigators(column: int) -> None:
    """Each state by itself, over acceleration and a turn of 4 g."""
    path = FlightPath(((0.0, 0.0, 0.0), (5.0, 15.0, 0.0), (10.0, 0.0, 9.0), (18.0, 0.0, 0.0)), 175.0, 20.0)
    start = np.zeros(15)
    start[column] = [1.0, 0.01, 1e-5, 1e-4, 1e-6][column // 3]
    errors = start.copy()
    for transition in _ErrorModel(EgiClass()).transitions(path.state(np.arange(1001) / 50.0)):
        errors = transition @ errors
    found = _navigator_errors(path, 0.0, 20.0, start)
    for part, absolute in ((slice(0, 3), 2e-6), (slice(3, 6), 3e-7), (slice(6, 9), 1e-9)):
        scale = np.abs(found[part]).max()
        assert errors[part] == pytest.approx(found[part], abs=absolute + 1e-3 * scale)


_NOISY = EgiClass(velocity_walk_ug=200.0, angle_walk_deg_rt_h=0.1)


@pytest.mark.validates(
    "covariance of the simulated EGI's filter", against="NEES of 200 units, chi-square bounds of 99.98 %, at five times"
)
@pytest.mark.parametrize(("name", "sensor"), [("linear", EgiClass()), ("sar", EgiClass()), ("sar", _NOISY)])
def test_the_filter_believes_what_is_true(name: str, sensor: EgiClass) -> None:
    """NEES of all 15 states over 200 units within its 99.98 % bounds, before, in and after the manoeuvres."""
    lanes = [generator(17, "nees", lane) for lane in range(200)]
    inner = EgiErrorFilter(manoeuvre(name), 0.0, lanes, sensor)
    low, high = stats.chi2.ppf([1e-4, 1.0 - 1e-4], 15 * 200) / 200
    for until_s in (0.0, 10.5, 25.98, 55.0, 62.0):
        inner.advance(round(until_s * 50) - inner.sample)
        scale = np.sqrt(np.diag(inner.covariance))
        errors = inner.errors / scale
        nees = np.einsum("ri,ri->r", errors, np.linalg.solve(inner.covariance / np.outer(scale, scale), errors.T).T)
        assert low < nees.mean() < high
        assert errors.std(0) == pytest.approx(np.ones(15), abs=0.25)
    assert np.all((scale[:3] > 0.1) & (scale[:3] < (0.4 if sensor is not _NOISY else 1.0)))


def test_errors_are_coloured_and_walk_with_the_stated_density() -> None:
    """White noise at 50 Hz would have a correlation of 0 from sample to sample."""
    errors = egi_error_runs(manoeuvre("linear"), 60.0, 50, 2)
    for kind in (errors.dp, errors.dv, errors.dphi):
        now, later = kind[10:-25:50].reshape(-1), kind[35::50].reshape(-1)
        assert now.size == later.size
        assert np.corrcoef(now, later)[0, 1] > 0.95
        assert np.corrcoef(kind[:-1].reshape(-1), kind[1:].reshape(-1))[0, 1] > 0.99
    jump = np.abs(np.diff(errors.dp, axis=0)).max((1, 2))
    assert jump[49::50].min() > 10 * np.delete(jump, np.s_[49::50]).max()  # GPS corrects at whole seconds
    # over 0.98 s without GPS vertical velocity and attitude spread by walk times square root of time
    errors = egi_error_runs(manoeuvre("linear"), 60.0, 20, 3, _NOISY)
    for kind, walk in ((errors.dv[..., 2:], 200e-6 * 9.80665), (errors.dphi, np.radians(0.1) / 60.0)):
        spread = (kind[49::50] - kind[:-1:50]).std((0, 1))
        assert spread == pytest.approx(np.full(spread.size, walk * np.sqrt(0.98)), rel=0.08)


def test_size_of_the_errors() -> None:
    """Of 50 units: position between 0.2 and 0.45 m, yaw 0.0144 deg where nothing but the gyrocompass gives it."""
    rms = {}
    for seed in range(3):
        errors = egi_error_runs(manoeuvre("linear"), 60.0, 50, seed)
        rms[seed] = [np.sqrt(np.mean(kind[250:] ** 2, (0, 1))) for kind in (errors.dp, errors.dv, errors.dphi)]
        assert np.all((rms[seed][0] > 0.2) & (rms[seed][0] < 0.45))
        assert np.all(rms[seed][1] < 0.02)
        assert np.degrees(rms[seed][2][2]) == pytest.approx(0.0144, abs=4.5 * 0.0144 / np.sqrt(100))
        assert np.degrees(rms[seed][2][:2]) == pytest.approx(np.full(2, 0.0014), abs=0.0006)
        assert np.all(np.abs(errors.dp[250:].mean((0, 1))) < 4.0 * rms[seed][0] / np.sqrt(50))
    assert rms[0][0][0] != rms[1][0][0]


def test_manoeuvres_show_the_yaw() -> None:
    """Acceleration across a yaw error is an error of velocity, which GPS sees: yaw is known better after them."""
    errors = egi_error_runs(manoeuvre("sar"), 100.0, 50, 4)
    before, after = (np.sqrt(np.mean(errors.dphi[k, :, 2] ** 2)) for k in (950, 5000))
    assert after < 0.4 * before


def test_runs_differ_and_are_the_same_in_any_company() -> None:
    path = manoeuvre("turn")
    many, few = egi_error_runs(path, 3.0, 70, 8), egi_error_runs(path, 2.5, 3, 8)
    assert few.t_s[0] == 0.0
    assert few.t_s[-1] == 2.5
    for kind in ("dp", "dv", "dphi"):
        assert np.array_equal(getattr(many, kind)[: few.t_s.size, :3], getattr(few, kind))
        assert np.all(getattr(many, kind).std(1) > 0.0)
        assert np.unique(getattr(many, kind)[0]).size == 210
    assert not np.array_equal(egi_error_runs(path, 2.5, 3, 9).dp, few.dp)


def test_stepper_gives_the_same_numbers_while_the_path_grows_from_anywhere() -> None:
    pieces = [(0.0, 0.0, 0.0), (1.234, 5.0, 0.0), (2.0, 0.0, 4.0), (2.001, 0.0, 9.0), (2.5, 0.0, 0.0)]
    whole = egi_error_runs(FlightPath(pieces, 100.0), 4.0, 2, 6)
    path = FlightPath(pieces[:1], 100.0)
    stepper, known = EgiErrorFilter(path, 0.0, [lane(6, 1)], EgiClass()), 1
    sigmas = []
    for k, t_s in enumerate(whole.t_s):
        while known < len(pieces) and pieces[known][0] <= t_s:
            path.add(*pieces[known])
            known += 1
        assert np.array_equal(stepper.advance(1)[0, 0], np.concatenate([whole.dp, whole.dv, whole.dphi], -1)[k, 1])
        sigmas.append(stepper.position_sigma_m)
    assert known == len(pieces)
    assert 0.1 < min(sigmas) < max(sigmas) < 0.4
    moved = FlightPath([(1.25, 0.0, 0.0), (2.25, 0.0, 9.0)], 100.0)
    there, here = (
        EgiErrorFilter(moved, 1.25, [lane(3, 0)], EgiClass()),
        egi_error_runs(FlightPath([(0.0, 0.0, 0.0), (1.0, 0.0, 9.0)], 100.0), 2.0, 1, 3),
    )
    for k in range(100):
        assert there.advance(1)[0, 0, 3:6] == pytest.approx(here.dv[k, 0], rel=1e-9)


def _quiet(runs: int) -> EgiErrors:
    m = _ERRORS.t_s.size
    return EgiErrors(_ERRORS.t_s, *np.zeros((3, m, runs, 3)))


def test_samples_are_old_by_the_offset_and_each_by_its_clock_noise() -> None:
    """100 m/s to the north: 1.37 m behind at 13.7 ms, which no whole number of samples gives; and ahead at -20 ms."""
    p, v, c = EgiRuns(_PATH, _quiet(1), _OFFSETS_S).block(500, 501)
    assert p[0, :, 0, 0] == pytest.approx(1000.0 - 100.0 * _OFFSETS_S, abs=1e-9)
    assert v[0, :, 0] == pytest.approx(np.tile([100.0, 0.0, 0.0], (4, 1)), abs=1e-12)
    p, v, c = EgiRuns(_PATH, _quiet(1), _OFFSETS_S).block(1250, 1251)
    heading_deg = 22.5 - 4.5 * _OFFSETS_S
    assert np.degrees(np.arctan2(c[0, :, 0, 1, 0], c[0, :, 0, 0, 0])) == pytest.approx(heading_deg, abs=1e-10)
    assert np.degrees(np.arctan2(v[0, :, 0, 1], v[0, :, 0, 0])) == pytest.approx(heading_deg, abs=1e-10)
    noise = clock_noise(4, _ERRORS.t_s.size, 3)
    assert noise.std() == pytest.approx(1e-5, rel=0.05)
    assert np.array_equal(clock_noise(4, _ERRORS.t_s.size, 1)[:, 0], noise[:, 0])
    p, v, c = EgiRuns(_PATH, _quiet(3), [0.0137], noise).block(1250, 1251)
    for run in range(3):
        true = _PATH.state(np.array([25.0 - 0.0137 - noise[1250, run]]))
        assert p[0, 0, run] == pytest.approx(true.p[0], abs=1e-8)
        assert v[0, 0, run] == pytest.approx(true.v[0], abs=1e-9)
        assert np.arctan2(c[0, 0, run, 1, 0], c[0, 0, run, 0, 0]) == pytest.approx(true.yaw[0], abs=1e-14)


def test_errors_are_the_same_for_every_offset() -> None:
    noisy, quiet = (EgiRuns(_PATH, errors, _OFFSETS_S).block(1100, 1300) for errors in (_ERRORS, _quiet(3)))
    for part, errors in ((0, _ERRORS.dp), (1, _ERRORS.dv)):
        for group in range(4):
            difference = noisy[part][:, group] - quiet[part][:, group]
            assert difference == pytest.approx(errors[1100:1300], abs=1e-9)
    for group in range(4):
        turns = Rotation.from_matrix(noisy[2][:, group].reshape(-1, 3, 3))
        yaw = _PATH.state(_ERRORS.t_s[1100:1300] - _OFFSETS_S[group]).yaw
        true = Rotation.from_euler("z", np.repeat(yaw, 3)[:, None])
        assert quiet[2][:, group].reshape(-1, 3, 3) == pytest.approx(true.as_matrix(), abs=1e-14)
        assert (turns * true.inv()).as_rotvec() == pytest.approx(_ERRORS.dphi[1100:1300].reshape(-1, 3), abs=1e-14)


def test_blocks_do_not_depend_on_where_they_are_cut() -> None:
    runs = EgiRuns(_PATH, _ERRORS, _OFFSETS_S, clock_noise(1, _ERRORS.t_s.size, 3))
    whole = runs.block(990, 1020)
    for part in range(3):
        pieces = [runs.block(k, k + 1)[part] for k in range(990, 1020)]
        assert np.array_equal(np.concatenate(pieces), whole[part])
    assert [part.shape for part in whole] == [(30, 4, 3, 3), (30, 4, 3, 3), (30, 4, 3, 3, 3)]


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
