"""What is flown in the study, how it is cut into tasks, how a value is held against its tolerance."""

from __future__ import annotations

import math
import pickle
from dataclasses import replace
from importlib import import_module

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from bench.model.errors import FitError, InputError
from bench.systems.time_sync.estimators.sar.response import SEARCH_m
from bench.systems.time_sync.study.flight import fly, headings, setup_of
from bench.systems.time_sync.study.study import (
    BASE,
    ERRORS,
    TIGHT,
    FlightResult,
    Group,
    StudyOptions,
    Task,
    checked_options,
    image_tasks,
    measured,
    rms_std,
    tasks_of,
)
from bench.systems.time_sync.study.tasks import _focused, image_result, predicted_shift_m, run_task, scene_of


@pytest.mark.parametrize(
    ("runs", "offsets", "said"),
    [
        (1, "0,10", "2 to 1000"),
        (1001, "0,10", "2 to 1000"),
        (50, "0,ten", "milliseconds with commas"),
        (50, "", "milliseconds with commas"),
        (50, "10,20", "0 must be among them"),
        (50, "0,150.5", "150 ms either way"),
        (50, "0,nan", "150 ms either way"),
    ],
)
def test_impossible_options(runs: int, offsets: str, said: str) -> None:
    with pytest.raises(InputError) as caught:
        checked_options(runs, 1, offsets, quick=False)
    assert caught.value.code == "B-STUDY-002"
    assert said in caught.value.message


def test_options() -> None:
    assert checked_options(None, 7, "30, 0,-2.5,0", quick=False) == StudyOptions(50, 7, (-2.5, 0.0, 30.0))
    quick = checked_options(None, 1, "0,10", quick=True)
    assert quick.runs < 50
    assert not quick.judged
    assert quick.long_s < StudyOptions().long_s == 500.0
    assert StudyOptions().judged
    assert not StudyOptions(runs=49).judged


def test_tasks_travel_and_cover_everything() -> None:
    options = StudyOptions(offsets_ms=(0.0, 10.0, 20.0))
    tasks = tasks_of(options)
    assert tasks == pickle.loads(pickle.dumps(tasks))
    assert len({task.name for task in tasks}) == len(tasks)
    flown = {(task.kind, task.manoeuvre, group.offset_ms, group.augmented) for task in tasks for group in task.groups}
    for manoeuvre in ("stationary", "linear", "acceleration", "turn"):
        assert {("flight", manoeuvre, one, False) for one in options.offsets_ms} <= flown
    for manoeuvre in ("linear", "acceleration", "turn"):
        assert {("flight", manoeuvre, one, True) for one in (-20.0, 0.0, 10.0, 13.7, 20.0, 30.0)} <= flown
    assert {("image", "sar", one, state) for one in options.offsets_ms for state in (True, False)} <= flown
    assert [len({group.offset_s for group in task.groups}) for task in image_tasks(options)] == [2, 1]
    assert all(task.position_sigma_m >= 10.0 for task in tasks if any(group.augmented for group in task.groups))


@pytest.mark.parametrize(
    ("value", "ends", "verdict", "limit"),
    [
        (0.3, {"at_least": 0.2, "at_most": 0.45}, "pass", 0.45),
        (0.45, {"at_least": 0.2, "at_most": 0.45}, "pass", 0.45),
        (0.19, {"at_least": 0.2, "at_most": 0.45}, "fail", 0.45),
        (0.46, {"at_least": 0.2, "at_most": 0.45}, "fail", 0.45),
        (-0.6, {"at_least": -0.5, "at_most": 0.5}, "fail", 0.5),
        (1.02, {"at_least": 1.01}, "pass", 1.01),
        (1.0, {"at_least": 1.01}, "fail", 1.01),
        (math.nan, {"at_most": 1.0}, "fail", 1.0),
        (5.0, {}, "none", None),
    ],
)
def test_tolerance(value: float, ends: dict[str, float], verdict: str, limit: float | None) -> None:
    found = measured("shift", "m", value, 0.01, {"offset_ms": 10.0}, n=50, **ends)
    assert (found["verdict"], found["limit"]) == (verdict, limit)
    assert found["conditions"] == {"offset_ms": 10.0, **ends}


def test_uncertainty_of_an_rms_against_draws() -> None:
    """Scatter of the RMS of 50 normal errors over 20,000 trials, seed 5."""
    draws = np.random.default_rng(5).standard_normal((20_000, 50))
    assert np.sqrt(np.mean(draws**2, axis=1)).std() == pytest.approx(rms_std(1.0, 50), rel=0.02)


def test_headings_against_scipy() -> None:
    yaw = np.random.default_rng(3).uniform(-3.0, 3.0, 7)
    assert headings(yaw) == pytest.approx(Rotation.from_euler("z", yaw[:, None]).as_matrix(), abs=1e-15)


def test_predicted_shift_has_both_terms_with_their_signs() -> None:
    """Eastward at 250 m/s, target 45 km to the south: ahead by 2.5 m, then 0.01 m/s towards the target."""
    pulse_s = np.arange(10_000) / 1000.0
    true_m = np.stack((np.zeros(10_000), 250.0 * (pulse_s - 4.9995), np.full(10_000, -3000.0)), axis=1)
    target_m = np.array([-math.sqrt(45e3**2 - 3e3**2), 0.0, 0.0])
    sight = (target_m - [0.0, 0.0, -3000.0]) / 45e3
    ahead_m = true_m + np.array([0.0, 2.5, 0.0])
    towards_m = true_m + 0.01 * (pulse_s - 4.9995)[:, None] * sight
    assert predicted_shift_m(pulse_s, ahead_m, true_m, target_m) == pytest.approx(2.5, abs=1e-6)
    assert predicted_shift_m(pulse_s, towards_m, true_m, target_m) == pytest.approx(-45e3 / 250.0 * 0.01, abs=1e-4)


def test_a_short_flight_end_to_end() -> None:
    """Two runs of three seconds, seed 2: the position lags, runs differ, the same task gives the same bytes."""
    late = (Group(0.02, augmented=False, noise=TIGHT), Group(0.02, augmented=True, noise=TIGHT))
    groups = (Group(0.0, augmented=False, noise=BASE), *late)
    task = Task("flight", "linear", 3.0, groups, runs=2, seed=2)
    found = run_task(task)
    assert isinstance(found, FlightResult)
    assert set(found.mean) == set(ERRORS)
    lag_m = (found.mean["position_m"][:, 1] - found.mean["position_m"][:, 0])[-1]
    assert lag_m == pytest.approx([-2.0, 0.0, 0.0], abs=0.05)
    assert np.all(found.rms["position_m"] > np.abs(found.mean["position_m"]))
    assert np.abs(found.mean["attitude_deg"]).max() < 0.1
    assert np.abs(found.mean["position_m"][:, 0]).max() < 3.0
    assert np.abs(found.mean["velocity_m_s"][:, 0]).max() < 0.3
    assert found.offset_mean_s[0] == pytest.approx([0.0, -0.02, -0.02], abs=2e-3)  # a straight flight does not tell it
    assert np.isnan(found.offset_nees[:, :2]).all()
    assert found.offset_nees[0, 2] == pytest.approx((found.offset_rms_s[0, 2] / found.offset_sigma_s[0, 2]) ** 2)
    assert pickle.dumps(found) == pickle.dumps(run_task(task))
    assert pickle.dumps(found) != pickle.dumps(run_task(Task("flight", "linear", 3.0, groups, runs=2, seed=3)))


def test_the_image_shows_what_navigation_is_off_by() -> None:
    """One run of 11 seconds: a solution 1.5 m ahead on average that drifts by 5 mm/s towards the target, by hand."""
    imaged = Group(0.02, augmented=False, noise=TIGHT)
    task = Task("image", "linear", 11.0, (Group(0.02, augmented=False, noise=BASE), imaged), runs=1, seed=2)
    flown = fly(task)
    fine = flown.run.fine
    assert fine is not None
    assert fine.t_s[0] == pytest.approx(0.9, abs=0.006)
    true = flown.path.state(fine.t_s)
    middle_s, sight = 1.0 + 0.5 * 9.999, np.array([0.0, math.sqrt(1.0 - (3.0 / 45.0) ** 2), 3.0 / 45.0])
    p, v = fine.p.copy(), fine.v.copy()  # of the group that is not imaged: as the filter has left them
    p[:, 1, 0] = true.p + [1.5, 0.0, 0.0] + 0.005 * (fine.t_s - middle_s)[:, None] * sight
    v[:, 1, 0] = true.v + 0.005 * sight
    found = image_result(task, replace(flown, run=replace(flown.run, fine=replace(fine, p=p, v=v))))
    due_m = 1.5 - 45e3 / 100.0 * 0.005
    assert scene_of(flown.path, 1.0).target_m[0] == pytest.approx(600.0)  # broadside in the middle of the aperture
    assert found.groups == (imaged,)
    assert found.flight.groups == task.groups
    assert found.azimuth_shift_m.item() == pytest.approx(due_m, abs=0.02)
    assert found.predicted_m.item() == pytest.approx(due_m, abs=0.02)
    assert found.several_m[0] == pytest.approx(due_m, abs=0.05)  # the picture moves as a whole
    assert found.azimuth_resolution_m.item() == pytest.approx(0.6225, rel=0.02)  # 0.886 wavelength R0 / 2 L, L = 1 km
    along, across = found.cuts
    assert along.at_m[np.abs(along.amplitude).argmax()] == pytest.approx(due_m, abs=0.02)
    assert across.at_m[np.abs(across.amplitude).argmax()] == pytest.approx(found.range_shift_m.item(), abs=0.02)
    (chip,) = found.chips
    assert chip.azimuth_m[chip.size.max(axis=1).argmax()] == pytest.approx(due_m, abs=0.2)


def test_an_image_far_behind_is_found_and_not_its_neighbour() -> None:
    """24 m behind the target, as at 150 ms and 160 m/s; the next target is 100 m away."""
    scene = scene_of(import_module("sim_instruments.worlds.time_sync.flight.path").MANOEUVRES["linear"], 1.0)
    behind_m = scene.true_m - [24.0, 0.0, 0.0]
    assert scene.search_m(0.03) == SEARCH_m
    with pytest.raises(FitError):
        _focused(scene, behind_m, scene.search_m(0.03))
    response, predicted_m = _focused(scene, behind_m, scene.search_m(0.15))
    assert response.azimuth_shift_m == pytest.approx(-24.0, abs=0.01)
    assert predicted_m == pytest.approx(-24.0, abs=0.01)
    told = replace(scene, true_m=scene.true_m + np.array([5.0, 0.0, 0.0]))
    response, predicted_m = _focused(told, behind_m, scene.search_m(0.15))
    assert response.azimuth_shift_m == pytest.approx(-24.0, abs=0.01)
    assert predicted_m == pytest.approx(-29.0, abs=0.01)


def test_position_is_held_while_the_radar_is_on_and_only_then() -> None:
    options = StudyOptions()
    for task in tasks_of(options)[:-1]:
        opens_s = 490.0 if task.kind == "image" else math.inf
        setup = setup_of(task)
        assert setup.hold_position_from_s == opens_s
        assert setup.fine_from_s <= opens_s
        assert setup.offset0_s == 0.0  # whatever the true one


def test_a_group_flies_the_same_errors_in_any_task() -> None:
    """Pairs are compared across tasks: 20 ms with 0 ms beside it and alone, two runs of a second, seed 2."""
    groups = (Group(0.0, augmented=False, noise=BASE), Group(0.02, augmented=False, noise=BASE))
    both, alone = (run_task(Task("flight", "linear", 1.0, some, runs=2, seed=2)) for some in (groups, groups[1:]))
    assert isinstance(both, FlightResult)
    assert isinstance(alone, FlightResult)
    for name in ERRORS:
        assert np.array_equal(both.mean[name][:, 1:], alone.mean[name])
