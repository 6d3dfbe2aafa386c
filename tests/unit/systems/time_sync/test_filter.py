"""The filter of the time offset on short flights: tags off the grid, lost samples, nothing to see or to use."""

from dataclasses import replace

import numpy as np
import pytest
from numpy.typing import NDArray
from sync_rig import BASE, END_S, LEVEL_UNTIL_S, TURN_UNTIL_S, Flight, flight, setup

from bench.model.errors import FitError
from bench.systems.time_sync.estimators.kalman.filter import run_filter
from bench.systems.time_sync.estimators.kalman.innovation import filled_noise, nis_summary
from bench.systems.time_sync.estimators.kalman.setup import LOOSE, TIGHT, FilterRun, ImuSamples
from sim_instruments.worlds.time_sync.flight.egi import EgiRuns
from sim_instruments.worlds.time_sync.flight.imu import imu_runs
from sim_instruments.worlds.time_sync.flight.path import FlightPath

Array = NDArray[np.float64]

OFFSETS_S = (-0.020, 0.0137, 0.020)  # early, no whole number of samples, late
OFFSET_S = 0.0137  # of one unit on a bench
SETTLED_S = LEVEL_UNTIL_S + 0.5  # the offset is known, innovations are those of the EGI's errors


def at(run: FilterRun, t_s: float) -> int:
    return int(np.searchsorted(run.t_s, t_s))


def rms(x: Array) -> Array:
    return np.asarray(np.sqrt(np.mean(x**2, axis=-1)))


@pytest.fixture(scope="module")
def sound() -> FilterRun:
    return run_filter(flight(6).imu, flight(6).egi(OFFSETS_S), setup(3, BASE, keep_every=5))


def test_late_early_and_fractional_offsets_are_found_with_their_sign(sound: FilterRun) -> None:
    """EGI errors as an EGI has them, R = BASE."""
    true, level = np.array(OFFSETS_S)[:, None], at(sound, LEVEL_UNTIL_S - 0.1)
    errors = sound.offset_s - true
    assert np.all(rms(errors[level]) >= 0.9 * np.abs(true[:, 0]))  # level flight cannot tell the offset
    assert np.all(np.abs(errors[-1].mean(axis=-1)) < 0.5e-3)
    assert np.all(rms(errors[-1]) < 1e-3)
    assert np.all(nis_summary(sound, SETTLED_S).ratio[:, 0] < 0.03)  # EGI errors change slowly, innovations are small
    assert np.all(sound.sigma[-1, :, 15] < 0.3e-3)
    assert np.all(sound.sigma[level, :, 15] > 0.9 * 0.03)
    assert np.all(sound.offset_s[-1].std(axis=-1) > 1e-6)  # lanes are not copies of each other


def test_without_the_state_the_errors_lag_by_the_offset() -> None:
    trip = flight(6)
    run = run_filter(trip.imu, trip.egi((0.0, 0.020)), setup(2, BASE, augmented=False))
    assert np.all(run.offset_s == 0.0)
    assert np.all(run.sigma[..., 15] == 0.0)
    level, turn = at(run, LEVEL_UNTIL_S - 0.5), at(run, TURN_UNTIL_S - 0.1)
    lag_m = (run.p[level, 1] - run.p[level, 0])[:, 0].mean()
    assert lag_m == pytest.approx(-100.0 * 0.020, rel=0.01)  # equation (1): minus v T_d
    yaw = np.arctan2(run.C[turn, :, :, 1, 0], run.C[turn, :, :, 0, 0])
    lag_deg = np.rad2deg(yaw[1] - yaw[0]).mean()
    assert lag_deg == pytest.approx(-9.0 * 0.020, rel=0.25)  # equation (3): minus w T_d, not settled yet


def test_a_group_gives_the_same_bits_in_any_company() -> None:
    trip = flight(6, end_s=3.0)
    together = run_filter(trip.imu, trip.egi(OFFSETS_S), setup(3, LOOSE, keep_every=25, fine_from_s=2.5))
    assert together.fine is not None
    for place, offset_s in enumerate(OFFSETS_S):
        alone = run_filter(trip.imu, trip.egi((offset_s,)), setup(1, LOOSE, keep_every=25, fine_from_s=2.5))
        for name in ("p", "v", "C", "accel_bias", "gyro_bias", "offset_s", "covariance", "nis"):
            assert np.array_equal(getattr(together, name)[:, place], getattr(alone, name)[:, 0], equal_nan=True), name
        assert np.array_equal(together.fine.p[:, place], alone.fine.p[:, 0])


def test_while_the_position_is_held_only_the_attitude_is_used() -> None:
    trip = flight(6)
    held = TURN_UNTIL_S + 0.5
    free = setup(1, TIGHT, fine_from_s=held)
    biggest_m = []
    for changes in (free, replace(free, hold_position_from_s=held)):
        run = run_filter(trip.imu, EgiRuns(trip.path, trip.errors, np.array([0.0])), changes)
        assert run.fine.t_s[0] >= held
        assert run.fine.t_s[-1] == pytest.approx(END_S)
        steps = np.diff(run.fine.p, axis=0) - 0.0025 * (run.fine.v[1:] + run.fine.v[:-1])
        biggest_m.append(np.abs(steps).max())
        late = run.nis_count[run.t_s >= held]
        assert np.all(late[..., 3] > 0)  # the attitude goes on
        assert np.all((late[..., 1:3] > 0) == (changes is free))
    assert biggest_m[0] > 3e-4
    assert biggest_m[1] < 0.5 * biggest_m[0]


def test_an_offset_of_a_tenth_is_found_and_half_a_second_from_a_rough_value() -> None:
    trip = flight(6)

    def found(offset_s: float, **begin: float) -> float:
        return float(run_filter(trip.imu, trip.egi((offset_s,)), setup(1, LOOSE, **begin)).offset_s[-1].mean())

    rough_s = found(0.1)
    assert rough_s == pytest.approx(0.1, abs=3.4e-3)
    assert found(0.1, offset0_s=rough_s) == pytest.approx(0.1, abs=0.5e-3)
    for offset_s in (0.5, -0.5):
        begin = {"offset0_s": offset_s - 0.02, "look_ahead_s": 0.6, "reach_s": 1.3}
        assert found(offset_s, **begin) == pytest.approx(offset_s, abs=1e-3)


class Samples:
    """An EGI of stored samples."""

    def __init__(self, t_s: Array, p: Array, v: Array, C: Array) -> None:
        self.t_s, self.p, self.v, self.C = t_s, p, v, C

    def block(self, k0: int, k1: int) -> tuple[Array, Array, Array]:
        return self.p[k0:k1], self.v[k0:k1], self.C[k0:k1]


def stored(trip: Flight, offsets_s: tuple[float, ...] = (OFFSET_S,)) -> Samples:
    """All samples of a flight, in arrays of their own."""
    egi = trip.egi(offsets_s)
    return Samples(egi.t_s.copy(), *(x.copy() for x in egi.block(0, egi.t_s.size)))


def test_tags_between_the_samples_of_the_imu() -> None:
    """The same motion tagged by a clock whose samples fall between those of the IMU and drift by 400 ppm."""
    trip = flight(1)
    t_s = trip.errors.t_s * 1.0004 + 0.0031
    true = trip.path.state(t_s - OFFSET_S)
    p, v = true.p[:, None, None] + trip.errors.dp[:, None], true.v[:, None, None] + trip.errors.dv[:, None]
    C = np.broadcast_to(trip.matrices(t_s - OFFSET_S)[:, None, None], (*p.shape, 3))
    offset_s, _ = ends(run_filter(trip.imu, Samples(t_s, p, v, C), setup(1, BASE)))
    assert offset_s == pytest.approx(OFFSET_S, abs=0.5e-3)


def ends(run: FilterRun) -> tuple[float, float]:
    return float(run.offset_s[-1, 0, 0]), float(run.sigma[-1, 0, 15])


@pytest.fixture(scope="module")
def whole() -> tuple[float, float]:
    trip = flight(1)
    offset_s, sigma_s = ends(run_filter(trip.imu, stored(trip), setup(1, BASE)))
    assert offset_s == pytest.approx(OFFSET_S, abs=0.5e-3)
    return offset_s, sigma_s


@pytest.mark.parametrize("absent", [True, False], ids=["absent", "nan"])
def test_lost_egi_samples_cost_little(whole: tuple[float, float], absent: bool) -> None:
    trip = flight(1)
    egi = stored(trip)
    lost = np.random.default_rng(3).random(egi.t_s.size) < 0.05
    lost[:4] = True  # the first ones among them
    lost[60:85] = True  # half a second before the turn
    if absent:
        egi = Samples(egi.t_s[~lost], egi.p[~lost], egi.v[~lost], egi.C[~lost])
    else:
        egi.p[lost] = np.nan
        egi.v[np.flatnonzero(lost)[::2]] = np.nan
    run = run_filter(trip.imu, egi, setup(1, BASE))
    offset_s, sigma_s = ends(run)
    assert np.isfinite(run.p).all()
    assert abs(offset_s - whole[0]) < 0.5 * whole[1]
    assert sigma_s == pytest.approx(whole[1], rel=0.1)


def with_filled(imu: ImuSamples, share: float) -> ImuSamples:
    """Some samples lost and filled with the mean of their neighbours."""
    filled = np.random.default_rng(5).random(imu.t_s.size) < share
    filled[[0, -1]] = False
    good = np.flatnonzero(~filled)
    dv, dtheta = imu.dv.copy(), imu.dtheta.copy()
    for x in (dv, dtheta):
        for axis in range(3):
            x[filled, 0, axis] = np.interp(np.flatnonzero(filled), good, x[good, 0, axis])
    return ImuSamples(imu.t_s, dv, dtheta, filled)


def test_filled_imu_samples_cost_little(whole: tuple[float, float]) -> None:
    trip = flight(1)
    offset_s, sigma_s = ends(run_filter(with_filled(trip.imu, 0.02), stored(trip), setup(1, BASE)))
    assert abs(offset_s - whole[0]) < whole[1]
    assert sigma_s > whole[1]  # wider process noise


def test_a_filled_sample_is_trusted_by_what_changed_across_it() -> None:
    dv = np.zeros((6, 1, 3))
    dv[4:, 0, 1] = 0.04
    filled = np.array([False, True, False, True, False, False])
    sums = filled_noise(ImuSamples(np.arange(6) * 0.005, dv, np.zeros((6, 1, 3)), filled))
    assert sums[2, :3] == pytest.approx(0.0)  # nothing changed across the first
    assert sums[-1, :3] == pytest.approx(0.02**2)
    assert sums[-1, 3:] == pytest.approx(0.0)
    filled[2] = True  # three in a row: what they are off by they are off by together
    sums = filled_noise(ImuSamples(np.arange(6) * 0.005, np.zeros((6, 1, 3)), dv, filled))
    assert sums[-1, 3:] == pytest.approx((3 * 0.02) ** 2)


def test_one_lane_without_its_sample_takes_it_from_its_group_only() -> None:
    trip = flight(3, end_s=3.0)
    egi, other = stored(trip, (0.0, 0.02)), stored(trip, (0.0, 0.02))
    egi.p[80:100, 0, 1, 2] = np.nan
    run, whole_run = (run_filter(trip.imu, x, setup(2, BASE, keep_every=10)) for x in (egi, other))
    assert np.array_equal(run.p[:, 1], whole_run.p[:, 1])
    assert not np.array_equal(run.p[:, 0], whole_run.p[:, 0])
    assert whole_run.nis_count[:, 0].sum() - run.nis_count[:, 0].sum() == 20 * 3 * 4  # samples, lanes, blocks


def test_what_does_not_move_tells_nothing() -> None:
    """One lane at rest with a tight attitude: noise of the gyros must not pass for motion."""
    path = FlightPath(((0.0, 0.0, 0.0),), speed_m_s=0.0)
    still = replace(flight(1), path=path, unit=imu_runs(path, END_S, 1, 7))
    run = run_filter(still.imu, still.egi((0.02,)), setup(1, TIGHT))
    assert run.sigma[-1, 0, 15] > 0.97 * 0.03
    assert abs(run.offset_s[-1, 0, 0] - 0.02) > 0.9 * 0.02


@pytest.mark.parametrize("what", ["apart", "nan", "at the end"])
def test_an_egi_that_cannot_be_held_against_the_imu_is_refused(what: str) -> None:
    trip = flight(1)
    egi = stored(trip)
    if what == "apart":
        egi.t_s += 1000.0
    elif what == "nan":
        egi.p[:] = np.nan
    else:
        egi.t_s += trip.imu.t_s[-1] - 0.04  # one sample, and none behind it that could be used
    with pytest.raises(FitError, match="B-FIT-116"):
        run_filter(trip.imu, egi, setup(1, LOOSE))
