"""What the EGIs of a study send: truth when it is valid, the same errors for every offset, attitude as stated."""

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from sim_instruments.worlds.time_sync.flight.egi import EgiErrors, egi_error_runs
from sim_instruments.worlds.time_sync.flight.path import MANOEUVRES
from sim_instruments.worlds.time_sync.flight.runs import EgiRuns, clock_noise

_OFFSETS_S = np.array([-0.02, 0.0, 0.0137, 0.1])
_PATH = MANOEUVRES["turn"]
_ERRORS = egi_error_runs(_PATH, 26.0, 3, 5)


def _quiet(runs: int) -> EgiErrors:
    m = _ERRORS.t_s.size
    return EgiErrors(_ERRORS.t_s, *np.zeros((3, m, runs, 3)))


def test_samples_are_old_by_the_offset() -> None:
    """100 m/s to the north: 1.37 m behind at 13.7 ms, which no whole number of samples gives; and ahead at -20 ms."""
    p, v, c = EgiRuns(_PATH, _quiet(1), _OFFSETS_S).block(500, 501)
    assert p[0, :, 0, 0] == pytest.approx(1000.0 - 100.0 * _OFFSETS_S, abs=1e-9)
    assert v[0, :, 0] == pytest.approx(np.tile([100.0, 0.0, 0.0], (4, 1)), abs=1e-12)
    p, v, c = EgiRuns(_PATH, _quiet(1), _OFFSETS_S).block(1250, 1251)
    heading_deg = 22.5 - 4.5 * _OFFSETS_S
    assert np.degrees(np.arctan2(c[0, :, 0, 1, 0], c[0, :, 0, 0, 0])) == pytest.approx(heading_deg, abs=1e-10)
    assert np.degrees(np.arctan2(v[0, :, 0, 1], v[0, :, 0, 0])) == pytest.approx(heading_deg, abs=1e-10)


def test_before_the_flight_the_vehicle_was_on_its_way() -> None:
    p, _, _ = EgiRuns(_PATH, _quiet(1), _OFFSETS_S).block(0, 1)
    assert p[0, :, 0, 0] == pytest.approx(-100.0 * _OFFSETS_S, abs=1e-12)


def test_errors_are_the_same_for_every_offset() -> None:
    noisy, quiet = (EgiRuns(_PATH, errors, _OFFSETS_S).block(1100, 1300) for errors in (_ERRORS, _quiet(3)))
    for part, errors in ((0, _ERRORS.dp), (1, _ERRORS.dv)):
        for group in range(4):
            difference = noisy[part][:, group] - quiet[part][:, group]
            assert difference == pytest.approx(errors[1100:1300], abs=1e-9)
    for group in range(4):
        turns = Rotation.from_matrix(noisy[2][:, group].reshape(-1, 3, 3))
        true = Rotation.from_matrix(quiet[2][:, group].reshape(-1, 3, 3))
        assert (turns * true.inv()).as_rotvec() == pytest.approx(_ERRORS.dphi[1100:1300].reshape(-1, 3), abs=1e-14)


def test_attitude_is_a_rotation_by_the_error_on_the_left() -> None:
    """Also by large angles: C = exp([dphi x]) C_true."""
    drawn = np.random.default_rng(1).uniform(-1.5, 1.5, (_ERRORS.t_s.size, 3, 3))
    large = EgiErrors(_ERRORS.t_s, _ERRORS.dp, _ERRORS.dv, drawn)
    c = EgiRuns(_PATH, large, [0.0]).block(1200, 1210)[2][:, 0]
    for k in range(10):
        yaw = Rotation.from_euler("z", _PATH.state(large.t_s[1200 + k : 1201 + k]).yaw[0])
        for run in range(3):
            expected = (Rotation.from_rotvec(drawn[1200 + k, run]) * yaw).as_matrix()
            assert c[k, run] == pytest.approx(expected, abs=1e-14)


def test_blocks_do_not_depend_on_where_they_are_cut() -> None:
    runs = EgiRuns(_PATH, _ERRORS, _OFFSETS_S, clock_noise(1, _ERRORS.t_s.size, 3))
    whole = runs.block(990, 1020)
    for part in range(3):
        pieces = [runs.block(k, k + 1)[part] for k in range(990, 1020)]
        assert np.array_equal(np.concatenate(pieces), whole[part])
    assert [part.shape for part in whole] == [(30, 4, 3, 3), (30, 4, 3, 3), (30, 4, 3, 3, 3)]


def test_clock_noise_makes_samples_older_each_by_itself() -> None:
    noise = clock_noise(4, _ERRORS.t_s.size, 3)
    assert noise.std() == pytest.approx(1e-5, rel=0.05)
    assert np.array_equal(clock_noise(4, _ERRORS.t_s.size, 1)[:, 0], noise[:, 0])
    p, v, c = EgiRuns(_PATH, _quiet(3), [0.0137], noise).block(1250, 1251)
    for run in range(3):
        true = _PATH.state(np.array([25.0 - 0.0137 - noise[1250, run]]))
        assert p[0, 0, run] == pytest.approx(true.p[0], abs=1e-8)
        assert v[0, 0, run] == pytest.approx(true.v[0], abs=1e-9)
        assert np.arctan2(c[0, 0, run, 1, 0], c[0, 0, run, 0, 0]) == pytest.approx(true.yaw[0], abs=1e-14)
