"""One unit on a bench: tags off the grid, lost samples of both links, nothing to see, nothing to use."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from numpy.typing import NDArray
from sync_flights import BASE, END_S, Flight, flight, setup

from bench.model.errors import FitError
from bench.systems.time_sync.estimators.kalman import innovation as sync_innovation
from bench.systems.time_sync.estimators.kalman.filter import run_filter
from bench.systems.time_sync.estimators.kalman.setup import LOOSE, TIGHT, FilterRun, ImuSamples
from bench.systems.time_sync.estimators.kalman.stream import filled_noise
from sim_instruments.worlds.time_sync.flight.imu import imu_runs
from sim_instruments.worlds.time_sync.flight.path import FlightPath

Array = NDArray[np.float64]

OFFSET_S = 0.0137


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


def off_the_grid(trip: Flight) -> Samples:
    """The same motion tagged by a clock whose samples fall between those of the IMU and drift by 400 ppm."""
    errors = trip.errors
    t_s = errors.t_s * 1.0004 + 0.0031
    true = trip.path.state(t_s - OFFSET_S)
    p = true.p[:, None, None] + errors.dp[:, None]
    v = true.v[:, None, None] + errors.dv[:, None]
    return Samples(t_s, p, v, np.broadcast_to(trip.matrices(t_s - OFFSET_S)[:, None, None], (*p.shape, 3)))


def ends(run: FilterRun) -> tuple[float, float]:
    return float(run.offset_s[-1, 0, 0]), float(run.sigma[-1, 0, 15])


@pytest.fixture(scope="module")
def whole() -> tuple[float, float]:
    trip = flight(1)
    offset_s, sigma_s = ends(run_filter(trip.imu, stored(trip), setup(1, BASE)))
    assert offset_s == pytest.approx(OFFSET_S, abs=0.5e-3)
    return offset_s, sigma_s


def test_tags_between_the_samples_of_the_imu(whole: tuple[float, float]) -> None:
    trip = flight(1)
    offset_s, _ = ends(run_filter(trip.imu, off_the_grid(trip), setup(1, BASE)))
    assert offset_s == pytest.approx(OFFSET_S, abs=0.5e-3)


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


def test_what_does_not_move_tells_nothing(monkeypatch: pytest.MonkeyPatch) -> None:
    """One lane at rest with a tight attitude: noise of the gyros must not pass for motion."""
    path = FlightPath(((0.0, 0.0, 0.0),), speed_m_s=0.0)
    still = replace(flight(1), path=path, unit=imu_runs(path, END_S, 1, 7))
    run = run_filter(still.imu, still.egi((0.02,)), setup(1, TIGHT))
    assert run.sigma[-1, 0, 15] > 0.97 * 0.03
    assert abs(run.offset_s[-1, 0, 0] - 0.02) > 0.9 * 0.02
    monkeypatch.setattr(sync_innovation, "_seen", lambda motions, noise: 1.0)
    assert run_filter(still.imu, still.egi((0.02,)), setup(1, TIGHT)).sigma[-1, 0, 15] < 0.95 * 0.03


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
    with pytest.raises(FitError) as caught:
        run_filter(trip.imu, egi, setup(1, LOOSE))
    assert caught.value.code == "B-FIT-116"
