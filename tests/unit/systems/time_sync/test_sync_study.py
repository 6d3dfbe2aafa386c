"""The study of the time offset: tasks, tolerances; its document by formula, in which every tolerance can fail."""

import json
import math
import pickle
from collections.abc import Callable
from dataclasses import replace
from importlib import import_module
from typing import Any

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from bench.maths.geodesy import heading_matrices
from bench.model.errors import FitError, InputError
from bench.report.document import study_html
from bench.systems.time_sync.estimators.sar.image import Chip
from bench.systems.time_sync.estimators.sar.response import Cut, Response, SEARCH_m
from bench.systems.time_sync.study import study as published
from bench.systems.time_sync.study import tasks
from bench.systems.time_sync.study.document import study_chapters, study_document, study_json
from bench.systems.time_sync.study.study import (
    AUGMENTED,
    BASE,
    ERRORS,
    TIGHT,
    UNAUGMENTED,
    FlightResult,
    Group,
    Results,
    StudyOptions,
    Task,
)
from bench.systems.time_sync.study.tasks import _focused, image_result, predicted_shift_m, run_task, scene_of


@pytest.mark.parametrize(
    ("runs", "offsets", "said"),
    [
        (1, "0,10", "2 to 1000"),
        (1001, "0,10", "2 to 1000"),
        (50, "", "milliseconds with commas"),
        (50, "10,20", "0 must be among them"),
        (50, "0,150.5", "150 ms either way"),
        (50, "0,nan", "150 ms either way"),
    ],
)
def test_impossible_options(runs: int, offsets: str, said: str) -> None:
    with pytest.raises(InputError, match=f"B-STUDY-002.*{said}"):
        published.checked_options(runs, 1, offsets, quick=False)


def test_options() -> None:
    assert published.checked_options(None, 7, "30, 0,-2.5,0", quick=False) == StudyOptions(50, 7, (-2.5, 0.0, 30.0))
    quick = published.checked_options(None, 1, "0,10", quick=True)
    assert quick.runs < 50
    assert not quick.judged
    assert quick.long_s < StudyOptions().long_s == 500.0
    assert StudyOptions().judged
    assert not StudyOptions(runs=49).judged


def test_tasks_travel_and_cover_everything() -> None:
    options = StudyOptions(offsets_ms=(0.0, 10.0, 20.0))
    tasks = published.tasks_of(options)
    assert tasks == pickle.loads(pickle.dumps(tasks))
    assert len({task.name for task in tasks}) == len(tasks)
    flown = {(task.kind, task.manoeuvre, group.offset_ms, group.augmented) for task in tasks for group in task.groups}
    for manoeuvre in ("stationary", "linear", "acceleration", "turn"):
        assert {("flight", manoeuvre, one, False) for one in options.offsets_ms} <= flown
    for manoeuvre in ("linear", "acceleration", "turn"):
        assert {("flight", manoeuvre, one, True) for one in (-20.0, 0.0, 10.0, 13.7, 20.0, 30.0)} <= flown
    assert {("image", "sar", one, state) for one in options.offsets_ms for state in (True, False)} <= flown
    assert [len({group.offset_s for group in task.groups}) for task in published.image_tasks(options)] == [2, 1]
    assert all(task.position_sigma_m >= 10.0 for task in tasks if any(group.augmented for group in task.groups))


@pytest.mark.parametrize(
    ("value", "ends", "verdict", "limit"),
    [
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
    within = ends.get("at_least", -math.inf), ends.get("at_most", math.inf)
    found = published.measured("shift", "m", value, 0.01, {"offset_ms": 10.0}, n=50, within=within)
    assert (found.verdict, found.limit) == (verdict, limit)
    assert found.conditions == {"offset_ms": 10.0, **ends}


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


def test_headings_against_scipy_and_the_uncertainty_of_an_rms_against_draws() -> None:
    yaw = np.random.default_rng(3).uniform(-3.0, 3.0, 7)
    assert heading_matrices(yaw) == pytest.approx(Rotation.from_euler("z", yaw[:, None]).as_matrix(), abs=1e-15)
    draws = np.random.default_rng(5).standard_normal((20_000, 50))
    assert np.sqrt(np.mean(draws**2, axis=1)).std() == pytest.approx(published.rms_std(1.0, 50), rel=0.02)


def test_a_short_flight_end_to_end() -> None:
    """Two runs of three seconds, seed 2: the position lags, runs differ, the same task gives the same bytes."""
    late = (Group(20.0, augmented=False, noise=TIGHT), Group(20.0, augmented=True, noise=TIGHT))
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
    imaged = Group(20.0, augmented=False, noise=TIGHT)
    task = Task("image", "linear", 11.0, (Group(20.0, augmented=False, noise=BASE), imaged), runs=1, seed=2)
    flown = tasks.fly(task)
    fine = flown.run.fine
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
    (response,) = found.responses
    for cut, shift_m in ((response.azimuth, due_m), (response.range, found.range_shift_m.item())):
        assert cut.shift_m + cut.offset_m[np.abs(cut.value).argmax()] == pytest.approx(shift_m, abs=0.02)
    (chip,) = found.chips
    assert chip.azimuth_m[np.abs(chip.value).max(axis=1).argmax()] == pytest.approx(due_m, abs=0.2)


def test_an_image_far_behind_is_found_and_not_its_neighbour() -> None:
    """24 m behind the target, as at 150 ms and 160 m/s; the next target is 100 m away."""
    scene = scene_of(import_module("sim_instruments.worlds.time_sync.flight.path").manoeuvre("linear"), 1.0)
    behind_m, search_m = scene.true_m - [24.0, 0.0, 0.0], scene.search_m(0.15)
    assert scene.search_m(0.03) == SEARCH_m
    with pytest.raises(FitError):
        _focused(scene, behind_m, scene.search_m(0.03))
    for told_m, due_m in ((0.0, -24.0), (5.0, -29.0)):
        told = replace(scene, true_m=scene.true_m + np.array([told_m, 0.0, 0.0]))
        response, predicted_m = _focused(told, behind_m, search_m)
        assert response.azimuth.shift_m == pytest.approx(-24.0, abs=0.01)
        assert predicted_m == pytest.approx(due_m, abs=0.01)


def test_position_is_held_while_the_radar_is_on_and_only_then() -> None:
    options = StudyOptions()
    for task in published.tasks_of(options)[:-1]:
        opens_s = 490.0 if task.kind == "image" else math.inf
        setup = tasks.setup_of(task)
        assert setup.hold_position_from_s == opens_s
        assert setup.fine_from_s <= opens_s
        assert setup.offset0_s == 0.0  # whatever the true one


def test_a_group_flies_the_same_errors_in_any_task() -> None:
    """Pairs are compared across tasks: 20 ms with 0 ms beside it and alone, two runs of a second, seed 2."""
    groups = (Group(0.0, augmented=False, noise=BASE), Group(20.0, augmented=False, noise=BASE))
    both, alone = (run_task(Task("flight", "linear", 1.0, some, runs=2, seed=2)) for some in (groups, groups[1:]))
    assert isinstance(both, FlightResult)
    assert isinstance(alone, FlightResult)
    for name in ERRORS:
        assert np.array_equal(both.mean[name][:, 1:], alone.mean[name])


_EDGES_s = (20.0, 40.0)


def made_results(options: StudyOptions) -> Results:
    """Results that keep every tolerance."""
    ideal = published.IdealResult(2e-5, 3e-7, _response(0.0))
    made = {"ideal": lambda _: ideal, "image": _image, "flight": _flight}
    return Results(tuple((task, made[task.kind](task)) for task in published.tasks_of(options)))


def _flight(task: Task) -> FlightResult:
    t_s = np.arange(0.1, task.duration_s, 0.1)
    groups, shape = task.groups, (len(t_s), len(task.groups), 3)
    mean = {name: np.zeros(shape) for name in ERRORS}
    rms = {name: np.full(shape, 0.5) for name in ERRORS}
    inside = (t_s >= _EDGES_s[0]) & (t_s <= _EDGES_s[1])
    offset_s = np.array([group.offset_s for group in groups])
    if task.manoeuvre == "linear":
        mean["position_m"][:, :, 0] = -100.0 * offset_s
        rms["position_m"][:, :, 0] = np.hypot(0.3, 100.0 * offset_s)
    for at, group in enumerate(groups):
        if task.manoeuvre == "acceleration":
            rms["velocity_m_s"][:, at, 0] = published.VELOCITY_m_s.get(group.offset_ms, 0.05)
            mean["velocity_m_s"][inside, at, 0] = -5.0 * group.offset_s
        rms["attitude_deg"][:, at, 2] = published.YAW_deg.get(group.offset_ms, 0.01)
    found = task.manoeuvre != "linear"
    left_s = np.where((t_s[:, None] > 21.0) & found, 3e-4, np.abs(offset_s))
    one = np.ones((len(t_s), len(groups)))
    return FlightResult(
        groups, task.runs, t_s, mean, rms, -0.3 * left_s, left_s, 3e-4 * one, 0.8 * one,
        0.9 * one[0], 0.05 * one[0], np.where(t_s[:, None] > 21.0, 1e-3, 0.9) * one, 2e-3 * one,
    )  # fmt: skip


def _image(task: Task) -> published.ImageResult:
    groups = tuple(group for group in task.groups if group.noise == "tight")
    run_m = np.linspace(-0.8, 0.8, task.runs)
    moved = np.array([0.0 if group.augmented else group.offset_s / 0.030 for group in groups])[:, None]
    shift_m = run_m - 8.1 * moved
    flat = np.ones_like(shift_m)
    return published.ImageResult(
        flight=_flight(task),
        groups=groups,
        predicted_m=shift_m + 1e-3,
        several_m=shift_m[:, :3],
        azimuth_shift_m=shift_m,
        range_shift_m=0.0 * flat,
        azimuth_resolution_m=0.25 * (1.0 + 0.04 * moved) * flat,
        range_resolution_m=2.65 * flat,
        pslr_dB=-11.5 + 1.7 * moved * flat,
        islr_dB=-9.3 + 1.7 * moved * flat,
        peak=0.98 * flat,
        responses=tuple(map(_response, shift_m[:, 0])),
        chips=tuple(map(_chip, shift_m[:, 0])),
    )


def _response(shift_m: float) -> Response:
    at_m = np.arange(-3.0, 3.0, 0.02)
    along, across = (Cut(shift_m, at_m, np.sinc(at_m / 0.28) + 0j, wide_m, -13.26, -10.12) for wide_m in (0.249, 2.65))
    return Response(along, across, peak=1.0)


def _chip(shift_m: float) -> Chip:
    along_m, range_m = np.arange(-12.0, 12.0, 0.2), np.arange(-20.0, 20.0, 1.0)
    return Chip(along_m, range_m, np.outer(np.sinc((along_m - shift_m) / 0.28), np.sinc(range_m / 3.0)) + 0j)


def changed(found: Results, kind: str, manoeuvre: str, **new: Any) -> Results:
    """The same with some fields of some results, by their paths, changed by functions of the field and the groups."""

    def other(task: Task, result: Any) -> Any:
        if (task.kind, task.manoeuvre) != (kind, manoeuvre):
            return result
        for path, change in new.items():
            result = _changed(result, path, change, result)
        return result

    return Results(tuple((task, other(task, result)) for task, result in found.pairs))


def _changed(whole: Any, path: str, change: Callable[[Any, Any], Any], result: Any) -> Any:
    name, _, rest = path.partition(".")
    part = getattr(whole, name)
    return replace(whole, **{name: _changed(part, rest, change, result) if rest else change(part, result)})


OPTIONS = StudyOptions()
SOUND = made_results(OPTIONS)


def failed(found: Results, options: StudyOptions = OPTIONS) -> set[str]:
    document = study_document(options, found, "test")
    return {one["quantity"] for one in document["estimates"] if one["verdict"] == "fail"}


def scaled(name: str, factor: float, axis: int = 0) -> Callable[[Any, Any], Any]:
    def change(arrays: Any, result: Any) -> Any:
        values = arrays[name].copy()
        values[..., axis] *= factor
        return {**arrays, name: values}

    return change


def growing(name: str, axis: int, sign: float) -> Callable[[Any, Any], Any]:
    """What the offset must not reach grows with it."""

    def change(arrays: Any, result: Any) -> Any:
        values = arrays[name].copy()
        values[..., axis] *= 1.0 + sign * np.array([one.offset_s for one in result.groups])
        return {**arrays, name: values}

    return change


def times(factor: float) -> Callable[[Any, Any], Any]:
    return lambda values, _: values * factor


def by_offset(slope: float, augmented: bool) -> Callable[[Any, Any], Any]:
    """Add something that grows with the offset, to the groups with or without the state."""

    def change(values: Any, result: Any) -> Any:
        return values + np.array([[slope * one.offset_s * (one.augmented == augmented)] for one in result.groups])

    return change


def test_what_is_due_passes_and_every_estimate_says_of_what_it_is() -> None:
    document = study_document(OPTIONS, SOUND, "test")
    assert failed(SOUND) == set()
    assert [one["verdict"] for one in document["estimates"]].count("pass") > 100
    said = [(one["quantity"], json.dumps(one["conditions"], sort_keys=True)) for one in document["estimates"]]
    assert [one for one in said if said.count(one) > 1] == []
    offsets_ms = {*OPTIONS.offsets_ms, *published.RECOVERED_ms}
    for one in document["estimates"]:
        where = one["conditions"]
        assert type(where.get("offset_ms", 0.0)) is float
        assert where.get("offset_ms", 0.0) in offsets_ms
        assert where.get("filter", AUGMENTED) in {AUGMENTED, UNAUGMENTED, published.ERRORLESS}
        assert where.get("noise", BASE) in set(published.SIGMA_R)
    paired = [one["conditions"] for one in document["estimates"] if one["quantity"] == "shift_unexplained_rms"]
    assert {(one["filter"], one["offset_ms"]) for one in paired} == {
        (name, offset_ms) for name in (AUGMENTED, UNAUGMENTED) for offset_ms in OPTIONS.offsets_ms
    }


SPOILT = {
    "Table 5, 0 ms": ("flight", "linear", {"rms": scaled("position_m", 2.0)}, {"position_rms"}),
    "sign of the lag": ("flight", "linear", {"mean": scaled("position_m", -1.0)}, {"position_mean"}),
    "Table 6": ("flight", "acceleration", {"rms": scaled("velocity_m_s", 1.2)}, {"velocity_rms_max"}),
    "Table 7": ("flight", "turn", {"rms": scaled("attitude_deg", 1.2, axis=2)}, {"yaw_rms_max"}),
    "linear motion converges": ("flight", "linear", {"offset_rms_s": times(0.5)}, {"offset_error_rms"}),
    "linear motion is believed": (
        "flight", "linear", {"offset_nees": times(5.0)}, {"offset_nees", "offset_nees_over_offsets"},
    ),
    "linear motion has seen the truth": ("flight", "linear", {"offset_nees": times(0.1)}, {"offset_nees_over_offsets"}),
    "turn does not find it": ("flight", "turn", {"offset_rms_s": times(4.0)}, {"offset_error_rms"}),
    "sign of the estimate": ("flight", "turn", {"offset_mean_s": times(10.0)}, {"offset_error_mean"}),
    "over-confident": ("image", "sar", {"flight.offset_nees": times(8.0)}, {"offset_nees"}),
    "shift of another sign": (
        "image", "sar", {"azimuth_shift_m": times(-1.0), "predicted_m": times(-1.0)}, {"shift_over_lag"},
    ),
    "shift said, not seen": ("image", "sar", {"azimuth_shift_m": by_offset(20.0, False)}, {"shift_unexplained_rms"}),
    "compensation fails": (
        "image", "sar",
        {"azimuth_shift_m": by_offset(-250.0, True), "predicted_m": by_offset(-250.0, True)}, {"shift_against_none"},
    ),
    "resolution": ("image", "sar", {"azimuth_resolution_m": by_offset(-0.3, False)}, {"resolution_ratio"}),
    "compensated resolution": ("image", "sar", {"azimuth_resolution_m": by_offset(0.1, True)}, {"resolution_ratio"}),
    "side lobes": ("image", "sar", {"islr_dB": by_offset(-50.0, False)}, {"islr_against_none"}),
    "compensated side lobes": ("image", "sar", {"islr_dB": by_offset(5.0, True)}, {"islr_against_none"}),
    "strapdown": ("ideal", "turn", {"position_m": lambda *_: 1.1e-3}, {"navigation_error"}),
    "ideal resolution": ("ideal", "turn", {"response.azimuth.resolution_m": times(1.02)}, {"ideal_resolution"}),
    "ideal range": ("ideal", "turn", {"response.range.resolution_m": times(1.02)}, {"ideal_range_resolution"}),
    "ideal side lobe": ("ideal", "turn", {"response.azimuth.pslr_dB": times(1.02)}, {"ideal_pslr"}),
    "ideal side lobes": ("ideal", "turn", {"response.azimuth.islr_dB": times(0.9)}, {"ideal_islr"}),
    **{f"{name} {sign:+g}": ("flight", manoeuvre, {"rms": growing(name, axis, sign)}, {due}) for sign in (1.0, -1.0)
       for manoeuvre, name, axis, due in (("stationary", "position_m", 1, "position_rms_ratio"),
                                          ("acceleration", "gyro_bias_deg_h", 1, "gyro_bias_rms_ratio"),
                                          ("turn", "accel_bias_ug", 2, "accel_bias_rms_ratio"))},
}  # fmt: skip


@pytest.mark.parametrize("name", SPOILT)
def test_every_tolerance_can_fail(name: str) -> None:
    kind, manoeuvre, new, due = SPOILT[name]
    assert failed(changed(SOUND, kind, manoeuvre, **new)) == due


def test_few_runs_or_a_short_flight_are_not_judged() -> None:
    for options in (StudyOptions(runs=49), StudyOptions(quick=True)):
        document = study_document(options, made_results(options), "test")
        judged = {one["quantity"] for one in document["estimates"] if one["verdict"] != "none"}
        assert all(name.startswith(("ideal", "navigation")) for name in judged)
        assert "nothing but the case without errors is judged" in document["notes"][0]


def test_the_document_is_canonical_and_keeps_the_raw_cuts() -> None:
    text = study_json(study_document(OPTIONS, SOUND, "test"))
    document = json.loads(text)
    assert text == study_json(study_document(OPTIONS, made_results(OPTIONS), "test"))
    assert {one["filter"] for one in document["cuts"]} == {"none", "unaugmented", "augmented"}
    assert all(len(one["at_m"]) == len(one["real"]) == len(one["imaginary"]) for one in document["cuts"])
    limits = [one["limit"] for one in document["estimates"] if one["verdict"] != "none"]
    assert all(isinstance(limit, float) for limit in limits)


def rows_of(title: str, found: Results = SOUND, options: StudyOptions = OPTIONS) -> list[list[str]]:
    """Rows of a table of the page."""
    chapters = study_chapters(options, study_document(options, found, "test"), found)
    (rows,) = (table.rows for chapter in chapters for table in chapter.tables if table.title == title)
    return list(map(list, rows))


def test_the_paper_stands_beside_ours_and_what_failed_comes_first() -> None:
    paper = [["0", "0.01347"], ["10", "0.04958"], ["20", "0.09429"], ["30", "0.1396"]]
    assert [row[:2] for row in rows_of("Table 7")] == paper
    own = StudyOptions(offsets_ms=(-7.5, 0.0))  # offsets of one's own have no value of the paper
    found = made_results(own)
    assert failed(found, own) == set()
    assert [row[1] for row in rows_of("Table 5", found, own)] == ["–", "0.3219"]
    rows = rows_of("Tolerances", changed(SOUND, *SPOILT["ideal side lobe"][:2], **SPOILT["ideal side lobe"][2]))
    assert [row[0] for row in rows if row[-1] == "fail"] == ["ideal pslr"] == [rows[0][0]]
    document = study_document(OPTIONS, SOUND, "test")
    assert "SIMULATED" in study_html(document, study_chapters(OPTIONS, document, SOUND), "test")
