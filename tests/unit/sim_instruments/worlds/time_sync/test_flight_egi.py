"""Errors of the simulated EGI: their model against whole navigators, what its filter believes, their colour."""

from itertools import pairwise

import numpy as np
import pytest
from scipy import stats
from scipy.integrate import solve_ivp
from scipy.spatial.transform import Rotation

from sim_instruments.seeds import generator
from sim_instruments.worlds.time_sync.flight.egi import (
    EgiClass,
    EgiErrorFilter,
    EgiErrors,
    EgiErrorStepper,
    EgiRuns,
    _ErrorModel,
    clock_noise,
    egi_error_runs,
)
from sim_instruments.worlds.time_sync.flight.path import MANOEUVRES, FlightPath

Array = np.ndarray
_LATITUDE = np.radians(37.5)
_EARTH = 7.292115e-5 * np.array([np.cos(_LATITUDE), 0.0, -np.sin(_LATITUDE)])
_GRAVITY = 9.7994905
_PULL = _GRAVITY / 6.371e6 * np.array([-1.0, -1.0, 2.0])
_OFFSETS_S = np.array([-0.02, 0.0, 0.0137, 0.1])
_PATH = MANOEUVRES["turn"]
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
    inner = EgiErrorFilter(MANOEUVRES[name], 0.0, lanes, sensor)
    low, high = stats.chi2.ppf([1e-4, 1.0 - 1e-4], 15 * 200) / 200
    for until_s in (0.0, 10.5, 25.98, 55.0, 62.0):
        inner.advance(round(until_s * 50) - inner.sample)
        scale = np.sqrt(np.diag(inner.covariance))
        errors = inner.errors / scale
        nees = np.einsum("ri,ri->r", errors, np.linalg.solve(inner.covariance / np.outer(scale, scale), errors.T).T)
        print(name, until_s, nees.mean())
        assert low < nees.mean() < high
        assert errors.std(0) == pytest.approx(np.ones(15), abs=0.25)
    assert np.all((scale[:3] > 0.1) & (scale[:3] < (0.4 if sensor is not _NOISY else 1.0)))


def test_errors_are_coloured_and_walk_with_the_stated_density() -> None:
    """White noise at 50 Hz would have a correlation of 0 from sample to sample."""
    errors = egi_error_runs(MANOEUVRES["linear"], 60.0, 50, 2)
    for kind in (errors.dp, errors.dv, errors.dphi):
        now, later = kind[10:-25:50].reshape(-1), kind[35::50].reshape(-1)
        assert now.size == later.size
        assert np.corrcoef(now, later)[0, 1] > 0.95
        assert np.corrcoef(kind[:-1].reshape(-1), kind[1:].reshape(-1))[0, 1] > 0.99
    jump = np.abs(np.diff(errors.dp, axis=0)).max((1, 2))
    assert jump[49::50].min() > 10 * np.delete(jump, np.s_[49::50]).max()  # GPS corrects at whole seconds
    # over 0.98 s without GPS vertical velocity and attitude spread by walk times square root of time
    errors = egi_error_runs(MANOEUVRES["linear"], 60.0, 20, 3, _NOISY)
    for kind, walk in ((errors.dv[..., 2:], 200e-6 * 9.80665), (errors.dphi, np.radians(0.1) / 60.0)):
        spread = (kind[49::50] - kind[:-1:50]).std((0, 1))
        assert spread == pytest.approx(np.full(spread.size, walk * np.sqrt(0.98)), rel=0.08)


def test_size_of_the_errors() -> None:
    """Of 50 units: position between 0.2 and 0.45 m, yaw 0.0144 deg where nothing but the gyrocompass gives it."""
    rms = {}
    for seed in range(3):
        errors = egi_error_runs(MANOEUVRES["linear"], 60.0, 50, seed)
        rms[seed] = [np.sqrt(np.mean(kind[250:] ** 2, (0, 1))) for kind in (errors.dp, errors.dv, errors.dphi)]
        print(seed, rms[seed])
        assert np.all((rms[seed][0] > 0.2) & (rms[seed][0] < 0.45))
        assert np.all(rms[seed][1] < 0.02)
        assert np.degrees(rms[seed][2][2]) == pytest.approx(0.0144, abs=4.5 * 0.0144 / np.sqrt(100))
        assert np.degrees(rms[seed][2][:2]) == pytest.approx(np.full(2, 0.0014), abs=0.0006)
        assert np.all(np.abs(errors.dp[250:].mean((0, 1))) < 4.0 * rms[seed][0] / np.sqrt(50))
    assert rms[0][0][0] != rms[1][0][0]


def test_manoeuvres_show_the_yaw() -> None:
    """Acceleration across a yaw error is an error of velocity, which GPS sees: yaw is known better after them."""
    errors = egi_error_runs(MANOEUVRES["sar"], 100.0, 50, 4)
    before, after = (np.sqrt(np.mean(errors.dphi[k, :, 2] ** 2)) for k in (950, 5000))
    assert after < 0.4 * before


def test_runs_differ_and_are_the_same_in_any_company() -> None:
    path = MANOEUVRES["turn"]
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
    stepper, known = EgiErrorStepper(path, 6, 1), 1
    sigmas = []
    for k, t_s in enumerate(whole.t_s):
        while known < len(pieces) and pieces[known][0] <= t_s:
            path.add(*pieces[known])
            known += 1
        for one, of in zip(stepper.step(), (whole.dp, whole.dv, whole.dphi), strict=True):
            assert np.array_equal(one, of[k, 1])
        sigmas.append(stepper.position_sigma_m)
    assert known == len(pieces)
    assert 0.1 < min(sigmas) < max(sigmas) < 0.4
    moved = FlightPath([(1.25, 0.0, 0.0), (2.25, 0.0, 9.0)], 100.0)
    there, here = (
        EgiErrorStepper(moved, 3, begin_s=1.25),
        egi_error_runs(FlightPath([(0.0, 0.0, 0.0), (1.0, 0.0, 9.0)], 100.0), 2.0, 1, 3),
    )
    for k in range(100):
        assert there.step()[1] == pytest.approx(here.dv[k, 0], rel=1e-9)


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
