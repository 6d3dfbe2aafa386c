"""The filter of the time offset on short flights: what it finds, and that what would break it is found."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace

import numpy as np
import pytest
from numpy.typing import NDArray
from sync_flights import BASE, END_S, LEVEL_UNTIL_S, TURN_UNTIL_S, Flight, flight, setup

from bench.systems.time_sync.estimators.kalman import filter as sync_filter
from bench.systems.time_sync.estimators.kalman import innovation as sync_innovation
from bench.systems.time_sync.estimators.kalman.filter import run_filter
from bench.systems.time_sync.estimators.kalman.innovation import nis_summary
from bench.systems.time_sync.estimators.kalman.setup import LOOSE, TIGHT, FilterRun, FilterSetup
from sim_instruments.worlds.time_sync.flight.egi import EgiRuns

Array = NDArray[np.float64]

OFFSETS_S = (-0.020, 0.0137, 0.020)  # early, no whole number of samples, late
SETTLED_S = LEVEL_UNTIL_S + 0.5  # the offset is known, innovations are those of the EGI's errors


def at(run: FilterRun, t_s: float) -> int:
    return int(np.searchsorted(run.t_s, t_s))


def rms(x: Array) -> Array:
    return np.asarray(np.sqrt(np.mean(x**2, axis=-1)))


def judge(run: FilterRun, offsets_s: tuple[float, ...] = OFFSETS_S) -> None:
    """What holds for a sound filter on EGI errors as an EGI has them, with R = BASE."""
    true = np.array(offsets_s)[:, None]
    errors = run.offset_s - true
    level = errors[at(run, LEVEL_UNTIL_S - 0.1)]
    assert np.all(rms(level) >= 0.9 * np.abs(true[:, 0])), f"level flight cannot tell the offset: {level}"
    end = errors[-1]
    assert np.all(np.abs(end.mean(axis=-1)) < 0.5e-3), f"mean offset off by {1e3 * end.mean(axis=-1)} ms"
    assert np.all(rms(end) < 1e-3), f"offset scatters by {1e3 * rms(end)} ms"
    assert np.all(nis_summary(run, SETTLED_S).ratio[:, 0] < 0.03), "EGI errors change slowly, innovations are small"


def run_sound(trip: Flight, changes: FilterSetup | None = None) -> FilterRun:
    return run_filter(trip.imu, trip.egi(OFFSETS_S), changes or setup(3, BASE, keep_every=5))


@pytest.fixture(scope="module")
def sound() -> FilterRun:
    return run_sound(flight(6))


def test_late_early_and_fractional_offsets_are_found_with_their_sign(sound: FilterRun) -> None:
    judge(sound)
    assert np.all(sound.sigma[-1, :, 15] < 0.3e-3)
    assert np.all(sound.sigma[at(sound, LEVEL_UNTIL_S - 0.1), :, 15] > 0.9 * 0.03)


def test_lanes_are_not_copies_of_each_other(sound: FilterRun) -> None:
    assert np.all(sound.offset_s[-1].std(axis=-1) > 1e-6)


# Mutations ------------------------------------------------------------------------------------------------------------


def flipped_column(patch: pytest.MonkeyPatch) -> None:
    """The offset's column of H with the other sign."""
    rows = sync_filter.measurement_rows
    patch.setattr(sync_filter, "measurement_rows", lambda F, age_s, motion: rows(F, age_s, -motion))


def not_shifted(patch: pytest.MonkeyPatch) -> None:
    """The estimate is not used in the prediction."""
    patch.setattr(sync_innovation, "predicted_at", lambda t_s, offset_s: t_s - 0.0 * offset_s)


def both_flipped(patch: pytest.MonkeyPatch) -> None:
    """Column and shift: a filter in itself sound of which only the sign of the offset is wrong."""
    flipped_column(patch)
    patch.setattr(sync_innovation, "predicted_at", lambda t_s, offset_s: t_s + offset_s)


def attitude_row_flipped(patch: pytest.MonkeyPatch) -> None:
    rows = sync_filter.measurement_rows
    signs = np.repeat([1.0, 1.0, -1.0], 3)
    patch.setattr(sync_filter, "measurement_rows", lambda F, age_s, motion: rows(F, age_s, signs * motion))


def rounded_to_samples(patch: pytest.MonkeyPatch) -> None:
    """Only whole intervals of the IMU."""
    patch.setattr(sync_innovation, "predicted_at", lambda t_s, offset_s: t_s - np.round(offset_s / 0.005) * 0.005)


def truth_in_the_prediction(patch: pytest.MonkeyPatch) -> None:
    """The true offset is given to the measurement model."""
    patch.setattr(
        sync_innovation, "predicted_at", lambda t_s, offset_s: t_s - np.array(OFFSETS_S)[:, None] + 0.0 * offset_s
    )


def truth_at_the_begin(patch: pytest.MonkeyPatch) -> None:
    """The state begins at the true position and the filter knows it to a metre."""
    begin = sync_filter._Filter.begin

    def leaking(work: sync_filter._Filter, sample: sync_innovation.EgiSample) -> None:
        late_s = np.array(OFFSETS_S)[:, None]
        begin(work, sample._replace(p=sample.p + late_s * sample.v))

    patch.setattr(sync_filter._Filter, "begin", leaking)


MUTATIONS = [
    flipped_column,
    not_shifted,
    attitude_row_flipped,
    rounded_to_samples,
    truth_in_the_prediction,
]


@pytest.mark.parametrize("mutation", MUTATIONS, ids=lambda of: of.__name__)
def test_a_broken_filter_is_found(
    mutation: Callable[[pytest.MonkeyPatch], None], monkeypatch: pytest.MonkeyPatch
) -> None:
    mutation(monkeypatch)
    with pytest.raises(AssertionError):
        judge(run_sound(flight(6)))


def test_both_signs_wrong_shows_in_the_sign_of_the_offset_alone(monkeypatch: pytest.MonkeyPatch) -> None:
    both_flipped(monkeypatch)
    run = run_sound(flight(6))
    with pytest.raises(AssertionError, match="mean offset off"):
        judge(run)
    assert run.offset_s[-1].mean(axis=-1) == pytest.approx(-np.array(OFFSETS_S), abs=0.5e-3)
    assert np.all(nis_summary(run, SETTLED_S).ratio[:, 0] < 0.03)  # nothing else looks wrong


def test_truth_leaking_into_the_begin_is_found(monkeypatch: pytest.MonkeyPatch) -> None:
    certain = replace(setup(3, BASE, keep_every=5), position_sigma_m=1.0)
    truth_at_the_begin(monkeypatch)
    with pytest.raises(AssertionError, match="level flight cannot tell"):
        judge(run_sound(flight(6), certain))


def test_white_egi_errors_are_found() -> None:
    with pytest.raises(AssertionError, match="change slowly"):
        judge(run_sound(flight(6).white()))


# ----------------------------------------------------------------------------------------------------------------------


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
        assert alone.fine is not None
        assert np.array_equal(together.fine.p[:, place], alone.fine.p[:, 0])


def test_while_the_position_is_held_only_the_attitude_is_used() -> None:
    trip = flight(6)
    held = TURN_UNTIL_S + 0.5
    free = setup(1, TIGHT, fine_from_s=held)
    biggest_m = []
    for changes in (free, replace(free, hold_position_from_s=held)):
        run = run_filter(trip.imu, EgiRuns(trip.path, trip.errors, np.array([0.0])), changes)
        assert run.fine is not None
        assert run.fine.t_s[0] >= held
        assert run.fine.t_s[-1] == pytest.approx(END_S)
        steps = np.diff(run.fine.p, axis=0) - 0.0025 * (run.fine.v[1:] + run.fine.v[:-1])
        biggest_m.append(np.abs(steps).max())
        late = run.nis_count[run.t_s >= held]
        assert np.all(late[..., 3] > 0)  # the attitude goes on
        assert np.all((late[..., 1:3] > 0) == (changes is free))
    assert biggest_m[0] > 3e-4
    assert biggest_m[1] < 0.5 * biggest_m[0]


def test_an_offset_of_a_tenth_of_a_second_is_found() -> None:
    trip = flight(6)
    run = run_filter(trip.imu, trip.egi((0.1,)), setup(1, LOOSE))
    assert run.offset_s[-1].mean() == pytest.approx(0.1, abs=3.4e-3)
    again = run_filter(trip.imu, trip.egi((0.1,)), setup(1, LOOSE, offset0_s=float(run.offset_s[-1].mean())))
    assert again.offset_s[-1].mean() == pytest.approx(0.1, abs=0.5e-3)


@pytest.mark.parametrize("offset_s", [0.5, -0.5])
def test_half_a_second_is_found_from_a_rough_value(offset_s: float) -> None:
    trip = flight(2)
    begin = setup(1, LOOSE, offset0_s=offset_s - 0.02, look_ahead_s=0.6, reach_s=1.3)
    run = run_filter(trip.imu, trip.egi((offset_s,)), begin)
    assert run.offset_s[-1].mean() == pytest.approx(offset_s, abs=1e-3)
