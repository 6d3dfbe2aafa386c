"""Gyroscope triad from turns; attitude and earth rate against scipy and closed forms."""

from collections.abc import Callable
from dataclasses import replace
from functools import cache

import numpy as np
import pytest
from imu_fit_simulation import EARTH_DEG_S, Unit, body_to_local, draw, local_rate_deg_s, rotation, rotations
from scipy.spatial.transform import Rotation

from bench.maths.verdict import coverage_factor
from bench.model.errors import FitError
from bench.systems.gnc.estimators import earth_rate as er
from bench.systems.gnc.estimators.earth_rate import Pose, RotationRecord, Site
from bench.systems.gnc.estimators.rotation_inputs import Declared
from bench.systems.gnc.estimators.rotations import RotationFit, fit_rotations

Keep = Callable[[str, object], None]
SITE = Site(34.2, 90.0)
STEP = Declared(resolution_deg_s=0.005)


def unit_of(seed: int) -> Unit:
    return draw(np.random.default_rng([41, seed]), 0.01, 0.003, 0.1)


@cache
def fitted(seed: int, mount: str | None = "earth_axis", declared: Declared = STEP, **more: object) -> RotationFit:
    records = rotations(unit_of(seed), np.random.default_rng([42, seed]), mount, **more)
    return fit_rotations(records, SITE if mount else None, declared)


def errors(fit: RotationFit, unit: Unit) -> np.ndarray:
    """(12,) of K row by row and of the bias, deg/s."""
    matrix, bias = fit.triad.matrix - np.linalg.inv(unit.sensitivity), fit.triad.bias - unit.bias
    return np.concatenate([matrix.ravel(), bias])


@pytest.mark.parametrize("length_s", [15.3, 25.0])
@pytest.mark.parametrize("mount", ["earth_axis", "vertical", None])
def test_without_noise_the_truth_comes_back(length_s: float, mount: str | None) -> None:
    fit = fitted(3, mount, Declared(), length_s=length_s, walk_deg_sqrt_h=0.0, resolution=0.0)
    off = errors(fit, unit_of(3))
    assert np.abs(off[:9]).max() < 1e-9
    assert np.abs(off[9:]).max() * 3600.0 < 1e-4  # deg/h


@pytest.mark.validates(
    "GNC paper (3) and (4), corrected: gyroscope triad of 50 units, 1080 degrees forth and back",
    against="the simulated truth: scale 1 %, cross coupling 0.3 %, bias 0.1 deg/s, 0.3 deg/sqrt(h), steps 0.005 deg/s",
)
@pytest.mark.parametrize("length_s", [15.3, 25.0])
def test_fifty_units(record_property: Keep, length_s: float) -> None:
    fits = [fitted(seed, length_s=length_s) for seed in range(50)]
    off_ppm = 1e6 * np.array([f.triad.sensitivity - unit_of(k).sensitivity for k, f in enumerate(fits)])
    bias_deg_h = 3600.0 * np.array([f.triad.bias - unit_of(k).bias for k, f in enumerate(fits)])
    theory = 0.3 * 60.0 / np.sqrt(4.0 * length_s)  # angle random walk over the root of 4 T
    rms = float(np.sqrt(np.mean(bias_deg_h**2)))
    scale, cross = off_ppm[:, range(3), range(3)], off_ppm[:, ~np.eye(3, dtype=bool)]
    figure = (
        f"rms scale {np.std(scale):.1f}, cross {np.std(cross):.1f}, worst {np.abs(off_ppm).max():.1f} ppm (limit 50)"
    )
    worst = np.abs(bias_deg_h).max() / theory
    record_property(
        "obtained", f"T {length_s:g} s: {figure}, bias rms {rms:.2f} of {theory:.2f} deg/h, worst {worst:.1f} sigma"
    )
    assert np.abs(off_ppm).max() < 50.0
    assert rms == pytest.approx(theory, rel=0.17)
    assert worst < 4.5
    assert 3600.0 * np.median([f.triad.bias_std for f in fits]) == pytest.approx(theory, rel=0.02)
    assert sum(f.triad.inflated for f in fits) <= 1


@pytest.mark.validates(
    "a vertical turntable gives the bias of the mount along the Earth's axis",
    against="the simulated truth of 20 units, each in both mounts with the same noise; site 34.2 N",
)
def test_vertical_table_after_compensation(record_property: Keep) -> None:
    apart, left = [], []
    for seed in range(20):
        records = rotations(unit_of(seed), np.random.default_rng([42, seed]), "vertical")
        one, two = fitted(seed, length_s=15.3), fit_rotations(records, SITE, STEP)
        plain = fit_rotations(records, None, STEP).triad.bias
        apart.append(3600.0 * (two.triad.bias - one.triad.bias))
        left.append(3600.0 * (plain - unit_of(seed).bias))
        assert np.all(np.abs(two.triad.bias - one.triad.bias) < 0.1 * one.triad.bias_std)
    rms = float(np.sqrt(np.mean(np.square(left))))
    record_property(
        "obtained", f"apart at most {np.abs(apart).max():.3f} deg/h; without compensation {rms:.1f} deg/h rms off"
    )
    assert np.abs(apart).max() < 0.2
    assert rms > 4.0


@pytest.mark.validates(
    "gyroscope triad: 95 % intervals of the twelve parameters, 500 units",
    against="the simulated truth, without tilt on a vertical table, and with 1 arcmin of tilt of each axis of turn",
)
@pytest.mark.parametrize("tilt_deg", [0.0, 1.0 / 60.0])
@pytest.mark.parametrize("units", [60, pytest.param(500, marks=pytest.mark.sweep)])
def test_intervals_cover(record_property: Keep, tilt_deg: float, units: int) -> None:
    """Of 60 units 95 +- 4 % of all 720 intervals."""
    declared = replace(STEP, tilt_std_deg=tilt_deg)
    inside, off_ppm, mount = [], [], None if tilt_deg else "vertical"
    for seed in range(units):
        more = {"tilt_deg": tilt_deg} if tilt_deg else {}
        fit = fitted(seed, mount, declared, rate_Hz=100.0, **more)
        std = np.sqrt(fit.triad.covariance.diagonal())
        inside.append(np.abs(errors(fit, unit_of(seed))) <= coverage_factor(fit.triad.dof) * std)
        off_ppm.append(1e6 * (fit.triad.sensitivity - unit_of(seed).sensitivity)[~np.eye(3, dtype=bool)])
    share, cross_ppm = 100.0 * np.mean(inside, axis=0), float(np.std(off_ppm))
    record_property(
        "obtained", f"tilt {60 * tilt_deg:g}': {share.min():.1f} to {share.max():.1f} %, all {share.mean():.1f} %"
    )
    if tilt_deg:
        record_property("obtained", f"cross coupling then off by {cross_ppm:.0f} ppm rms")
        assert 200.0 < cross_ppm < 400.0
    assert units == 60 or np.all(np.abs(share - 95.0) <= 4.0)
    assert abs(share.mean() - 95.0) <= (4.0 if units == 60 else 1.5)


def test_bias_that_wanders_unsaid_is_noticed() -> None:
    rng = np.random.default_rng(78)
    for seed in range(8):
        records = [replace(r, rate=r.rate + rng.normal(size=3) * 0.02) for r in rotations(unit_of(seed), rng)]
        found = fit_rotations(records, None, STEP)
        assert 0.01 < found.drift_deg_s < 0.03
        assert found.triad.bias_std.min() > 0.005
        assert found.triad.dof == 15.0
        stated = fit_rotations(records, None, replace(STEP, drift_deg_s=0.02)).triad
        assert not stated.inflated
        assert stated.bias_std.min() > 0.005


def test_outputs_that_are_off_in_the_turns_alone_are_noticed() -> None:
    rng, found = np.random.default_rng(79), []
    for seed in range(8):
        records = [
            replace(r, rate=r.rate + rng.normal(size=3) * 0.02 * (np.abs(r.rate).max(axis=1) > 10.0)[:, None])
            for r in rotations(unit_of(seed), rng)
        ]
        found.append(fit_rotations(records, None, STEP).triad)
    assert sum(triad.inflated for triad in found) >= 7
    assert {triad.dof for triad in found if triad.inflated} <= {15.0, 24.0}  # 36 integrals less 12 parameters


def test_correlated_noise_at_rest_is_taken_in_full() -> None:
    """A two-point mean halves what single samples scatter, but not what their integral does."""
    rng = np.random.default_rng(3)
    smooth = []
    for r in rotations(unit_of(2), rng, walk_deg_sqrt_h=0.6):
        rate = r.rate.copy()
        rate[1:] = 0.5 * (r.rate[1:] + r.rate[:-1])
        smooth.append(replace(r, rate=rate))
    noise = [er.noise_density(er.good_samples(r), r.axis, r.name)[0].diagonal() for r in smooth]
    assert 60.0 * np.sqrt(np.mean(noise, axis=0)) == pytest.approx(0.6, rel=0.15)


def test_quiet_sensor_keeps_its_quantisation() -> None:
    """Without noise a resting output may be half a step off for good, and the bias with it."""
    fits = [fitted(seed, None, walk_deg_sqrt_h=0.0, resolution=0.005) for seed in range(20)]
    off = np.array([errors(fit, unit_of(seed))[9:] for seed, fit in enumerate(fits)])
    stated = float(np.mean([fit.triad.bias_std for fit in fits]))
    assert stated == pytest.approx(0.005 / np.sqrt(12.0) * 10.5 / 15.3, rel=0.05)  # 10.5 s of 15.3 s are rest
    assert 0.7 < np.sqrt(np.mean(off**2)) / stated < 1.3


def good() -> list[RotationRecord]:
    return rotations(unit_of(5), np.random.default_rng(5))


def picked(record: RotationRecord, places: np.ndarray) -> RotationRecord:
    """The same record with some of its samples, once or twice."""
    return replace(record, counter=record.counter[places], time_s=record.time_s[places], rate=record.rate[places])


def test_a_longer_record_is_cut_at_its_end_and_duplicates_are_dropped() -> None:
    records = good()
    longer = rotation(unit_of(5), "y", 1080.0, np.random.default_rng(9), length_s=19.0)
    fit = fit_rotations([*records[:2], longer, *records[3:]], None, STEP)
    assert fit.trimmed_s["Y+1080"] == pytest.approx(3.7)
    assert fit.used["Y+1080"] == fit.used["Y-1080"] == 3060
    assert fit.trimmed_s["X+1080"] == 0.0
    again = picked(records[4], np.sort(np.concatenate([np.arange(3060), [100, 700, 701]])))
    fit = fit_rotations([*records[:4], again, records[5]], None, STEP)
    assert fit.duplicates == dict.fromkeys(fit.duplicates, 0) | {"Z+1080": 3}
    assert np.array_equal(fit.triad.matrix, fit_rotations(records, None, STEP).triad.matrix)


def test_irregular_time_stamps_are_integrated_as_they_are() -> None:
    """Samples are means over intervals of any length: a clock that hurries by turns does not matter."""
    unit, rng = unit_of(6), np.random.default_rng(6)
    records = []
    for r in rotations(unit, rng, walk_deg_sqrt_h=0.0, resolution=0.0, rate_Hz=800.0):
        ends = np.cumsum(np.tile([3, 5, 4, 4], 765))
        ends = ends[ends <= len(r.rate)]
        total = np.concatenate([[[0.0] * 3], np.cumsum(r.rate, axis=0)])
        rate = np.diff(total[np.concatenate([[0], ends])], axis=0) / np.diff(ends, prepend=0)[:, None]
        records.append(replace(r, counter=np.arange(len(ends)), time_s=r.time_s[ends - 1], rate=rate))
    assert np.abs(errors(fit_rotations(records, None), unit)).max() < 2e-5


def lost(count: int) -> RotationRecord:
    return picked(good()[1], np.delete(np.arange(3060), np.arange(500, 500 + count)))


def crooked() -> list[RotationRecord]:
    first, *others = rotations(unit_of(5), np.random.default_rng(5), "earth_axis")
    assert first.pose is not None
    return [replace(first, pose=replace(first.pose, mounting="y")), *others]


def half() -> RotationRecord:
    return replace(rotation(unit_of(5), "x", 540.0, np.random.default_rng(5)), turn_deg=1080.0)


def restless() -> list[RotationRecord]:
    return [rotation(unit_of(5), r.axis, r.turn_deg, np.random.default_rng(5), length_s=6.5) for r in good()]


@pytest.mark.parametrize(
    ("records", "said"),
    [
        (lambda: [good()[0], lost(1), *good()[2:]], r"B-FIT-080.*X-1080.*counter 499: the next one is 501"),
        (lambda: [good()[0], lost(40), *good()[2:]], r"B-FIT-080.*X-1080.*counter 499: the next one is 540"),
        (lambda: good()[:5], "B-FIT-081.*1 is due"),
        (lambda: [*good(), good()[0]], "B-FIT-081.*1 is due"),
        (crooked, "B-FIT-081.*does not turn about body axis x"),
        (lambda: [half(), *good()[1:]], r"B-FIT-082.*add up to .* deg, the turn is \+1080 deg"),
        (lambda: [replace(good()[1], turn_deg=1080.0), *good()[1:]], "B-FIT-082"),
        (restless, "B-FIT-083.*too few to tell the noise"),
        (lambda: [picked(good()[0], np.array([0])), *good()[1:]], "B-FIT-083"),
    ],
)
def test_records_that_do_not_serve_are_refused(records: Callable[[], list[RotationRecord]], said: str) -> None:
    with pytest.raises(FitError, match=said):
        fit_rotations(records(), SITE if records is crooked else None)


def test_an_uncertain_clock_is_in_every_scale_factor_and_in_no_ratio_of_two() -> None:
    plain, with_clock = fitted(3), fitted(3, declared=replace(STEP, time_std=40e-6))
    extra = with_clock.triad.covariance - plain.triad.covariance
    matrix = plain.triad.matrix
    np.testing.assert_allclose(np.sqrt(extra[:9, :9].diagonal()).reshape(3, 3), 40e-6 * np.abs(matrix), rtol=1e-3)
    assert extra[0, 4] == pytest.approx(1.6e-9 * matrix[0, 0] * matrix[1, 1], rel=1e-3)


def test_attitude_against_scipy() -> None:
    rng = np.random.default_rng(3)
    for mounting in "xyz":
        for _ in range(20):
            pose = Pose(*rng.uniform(-180.0, 180.0, 3), mounting)
            azimuth = rng.uniform(0.0, 360.0)
            assert er.attitude(pose, Site(0.0, azimuth)) == pytest.approx(body_to_local(pose, azimuth).as_matrix())


@pytest.mark.validates(
    "Earth's rate in the body: level, pole, along the Earth's axis",
    against="closed forms with one turn in a sidereal day of 86164.1 s",
)
def test_closed_forms() -> None:
    assert er.earth_rate_local_deg_s(34.2) == pytest.approx(local_rate_deg_s(34.2), rel=1e-6)
    level = er.earth_rate_body_deg_s(Pose(), Site(34.2, 30.0))  # x has azimuth 30, y is 90 degrees to its left
    cosine = 360.0 / 86164.1 * np.cos(np.radians(34.2))
    assert level[0] == pytest.approx(cosine * np.cos(np.radians(30.0)), rel=1e-6)
    assert level[1] == pytest.approx(cosine * np.cos(np.radians(300.0)), rel=1e-6)
    for mounting, place in (("x", 0), ("y", 1), ("z", 2)):
        along = er.earth_rate_body_deg_s(Pose(90.0, -34.2, 77.0, mounting), Site(34.2, 90.0))
        assert along == pytest.approx(EARTH_DEG_S * np.eye(3)[place], rel=1e-6, abs=1e-12)
    pole = er.earth_rate_body_deg_s(Pose(inner_deg=90.0), Site(90.0, 0.0))
    assert pole == pytest.approx([0, EARTH_DEG_S, 0], abs=1e-9)
    most = er.earth_rate_body_deg_s(Pose(), Site(34.2, 0.0))[0]  # more than the 10 deg/h of the paper's table 3
    assert 3600.0 * most == pytest.approx(12.44, abs=0.01)


def test_covariance_by_trials() -> None:
    """Three small angles drawn; rotation of the unit by scipy."""
    site, pose = Site(34.2, 50.0, 0.2), Pose(10.0, 20.0, 30.0, "z")
    rng = np.random.default_rng(4)
    seen = []
    for _ in range(4000):
        tilt = Rotation.from_rotvec(rng.normal(size=3) * 0.2, degrees=True)
        body = body_to_local(pose, 50.0) * tilt
        seen.append(body.inv().apply(local_rate_deg_s(34.2)))
    spread, stated = np.cov(np.transpose(seen)), er.earth_rate_covariance(pose, site)
    size = np.sqrt(np.outer(stated.diagonal(), stated.diagonal()))
    assert np.abs((spread - stated) / size).max() < 0.07
    assert np.all(er.earth_rate_covariance(pose, Site(34.2, 50.0)) == 0.0)


def test_specific_force_and_axis_of_turn() -> None:
    assert er.up_in_body(Pose()) == pytest.approx([0, 0, 1])
    assert er.up_in_body(Pose(middle_deg=-90.0, mounting="y")) == pytest.approx([0, 1, 0])
    assert er.turn_axis_in_body(Pose(5.0, 6.0, 7.0, "z"), "inner") == pytest.approx([0, 0, 1])
    assert er.turn_axis_in_body(Pose(5.0, 90.0, 7.0, "x"), "outer") == pytest.approx([-1, 0, 0])
    with pytest.raises(ValueError, match="none of inner, outer"):
        er.turn_axis_in_body(Pose(), "middle")
