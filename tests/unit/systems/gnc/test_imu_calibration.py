"""Accelerometer triad from poses, and the calibration of a simulated unit found again: intervals, what is missing."""

from collections.abc import Callable
from dataclasses import replace
from fractions import Fraction

import numpy as np
import pytest
from imu_fit_simulation import ARROWS, draw, positions
from imu_material import POSES, SITE, Rig, Unit, calibration, values
from one_estimate import every
from scipy import signal, stats
from spoken import english_left

from bench.analysis import Analysis
from bench.maths.verdict import coverage_factor
from bench.model.errors import FitError
from bench.systems.gnc.calibration.analysis import analyse
from bench.systems.gnc.estimators.earth_rate import quantisation_variance, static_means
from bench.systems.gnc.estimators.triad import TriadFit, fit_six_position

SEED = 606


def short(seed: int = SEED) -> Rig:
    """One set of a unit, its positions of 10 s."""
    return calibration(Rig(seed), rest_s=10.0)


def analysed(rig: Rig, **more: object) -> Analysis:
    return analyse(rig.material("imu_calibration", **more))


def test_coupling_is_judged_after_compensation_by_the_second_set() -> None:
    twice = analyse(calibration(Rig(SEED), sets=2).material("imu_calibration"))
    assert english_left(twice) == set()
    assert twice.missing == []
    rows = {row[0]: row[-1] for row in twice.tables[2].rows}
    for kind, name in (("accel", "accelerometer"), ("gyro", "gyro")):
        raw, left = every(twice, f"{kind}_cross_coupling"), every(twice, f"{kind}_coupling_compensated")
        assert {entry.verdict for entry in raw} == {"none"}
        assert max(abs(entry.value) for entry in raw) > 1e-3
        assert [entry.verdict for entry in left] == ["pass"] * 6
        assert max(abs(entry.value) for entry in left) < 1e-4
        again = every(twice, f"{kind}_scale_repeatability")
        assert len(again) == 3
        assert all(abs(entry.value) < 2.0 * entry.expanded_uncertainty < 1e-3 for entry in again)
        for what in ("coupling after compensation", "scale-factor repeatability, 1 sigma"):
            assert rows[f"{name}: {what}"] == "PASS"
    assert list(rows.values()).count("PASS") == 4
    once = analysed(short())  # without a second set
    assert {row[-1] for row in once.tables[2].rows} == {"not tested"}
    assert sum("no second set" in text for text in once.missing) == 2


def test_what_changes_between_the_sets_is_told_by_its_size_and_place() -> None:
    """The scale factor of x by 0.2 %, and how x answers to a rate about y by 0.3 %."""
    rig = short()
    change = np.array([[0.002, 0.0, 0.0], [0.0, 0.0, 0.0], [0.0, 0.0, 0.0]])
    rig.unit = replace(rig.unit, gyro_S=rig.unit.gyro_S * (1.0 + change))
    changed = every(analysed(calibration(rig, rest_s=10.0)), "gyro_scale_repeatability")
    assert changed[0].value == pytest.approx(-2e-3 / 2.0**0.5, rel=0.05)
    assert [entry.verdict for entry in changed] == ["fail", "pass", "pass"]
    rig = short()
    rig.unit = replace(rig.unit, gyro_S=rig.unit.gyro_S + 1.5 * np.roll(change, 1, axis=1))
    left = every(analysed(calibration(rig, rest_s=10.0)), "gyro_coupling_compensated")
    verdicts = {(entry.conditions["row"], entry.conditions["column"]): entry.verdict for entry in left}
    assert verdicts == dict.fromkeys(verdicts, "pass") | {("x", "y"): "fail"}


def test_a_fast_crystal_of_the_unit_makes_no_scale_error() -> None:
    """100 ppm: the unit counts too many seconds, the angle of the table does not depend on them."""
    rig = short(SEED + 2)
    for row in rig.rows:
        tick = row.samples.columns["tick"].astype(np.int64)
        row.samples.columns["tick"] = np.rint(tick * (1.0 + 100e-6)).astype(np.uint32)
    analysis = analysed(rig)
    off_ppm = values(analysis.estimates, "gyro_scale_error") - 1e6 * (np.diag(Unit().gyro_S) - 1.0)
    assert abs(np.mean(off_ppm)) < 25.0
    assert any("by +100.0 ±" in note for note in analysis.notes)


def switched_off(rig: Rig) -> None:
    """Behind the records so far: the unit's clock begins again, its bias is another one."""
    rig.unit = replace(
        rig.unit, accel_bias_g=rig.unit.accel_bias_g + 3e-4, gyro_bias_deg_s=rig.unit.gyro_bias_deg_s + 0.02
    )


def test_a_unit_that_was_switched_off_between_the_records_is_noticed() -> None:
    """A resumed run: behind the third position, and between the two turns about y."""
    rig, off = Rig(SEED), []
    for number, (up, pose) in enumerate(POSES.items()):
        if number == 3:
            switched_off(rig)
            off.append(len(rig.rows))
        rig.rest(10.0, pose, item="position", up=up)
    for axis, sign in [(axis, sign) for axis in "xyz" for sign in (1, -1)]:
        if (axis, sign) == ("y", -1):
            switched_off(rig)
            off.append(len(rig.rows))
        rig.turn(axis, sign * 1080.0, 16.3, -37.5, -20.0)
    for first in off:
        for row in rig.rows[first:]:
            tick = row.samples.columns["tick"].astype(np.int64) - 60_000_000
            row.samples.columns["tick"] = (tick % (1 << 32)).astype(np.uint32)
    analysis = analysed(rig)
    for name in ("positions", "rotations"):
        assert any(f"switched off between the {name}" in note for note in analysis.notes)
    for kind, S in (("accel", Unit().accel_S), ("gyro", Unit().gyro_S)):
        for entry in every(analysis, f"{kind}_matrix"):
            row, column = ("xyz".index(entry.conditions[name]) for name in ("row", "column"))
            assert abs(entry.value - np.linalg.inv(S)[row, column]) < 1.5 * entry.expanded_uncertainty, entry
    assert (
        min(entry.expanded_uncertainty for entry in every(analysis, "gyro_bias")) > 0.25 * 3600 * 0.02
    )  # it is that of neither power-on


def test_a_unit_that_is_not_warm_is_told() -> None:
    rig = short()
    assert not any("let it warm up" in note for note in analysed(rig).notes)
    for number, row in enumerate(rig.rows[:6]):
        row.samples.columns["temperature"][:] = 2500 + 20 * number
    notes = analysed(rig).notes
    assert any("moved from 25.00 to 26.00 degC over the positions" in note for note in notes)


def test_a_stated_tilt_is_in_the_couplings_and_hardly_in_the_scale_factors() -> None:
    rig = short()
    tilted = analysed(rig, site=SITE | {"tilt_std_deg": 1.0 / 60.0})
    plain = analysed(rig)
    assert any(note.startswith("A tilt of 1 arcmin") for note in tilted.notes)
    for kind in ("accel", "gyro"):
        for quantity, least, most in (("cross_coupling", 150e-6, 350e-6), ("scale_error", 0.0, 20.0)):
            pairs = zip(*(every(each, f"{kind}_{quantity}") for each in (tilted, plain)), strict=True)
            extra = [(one.std_uncertainty**2 - other.std_uncertainty**2) ** 0.5 for one, other in pairs]
            assert all(least <= abs(each) <= most for each in extra)


def test_a_longer_record_is_trimmed_and_told() -> None:
    rig = Rig(SEED)
    for axis in "xyz":
        rig.turn(axis, 1080.0, 17.3, -37.5, -20.0)
        rig.turn(axis, -1080.0, 16.3, -37.5, -20.0)
    analysis = analysed(rig)
    assert set(analysis.attachments) == {
        f"GNC-07/gyro/{axis}{turn}.csv" for axis in "XYZ" for turn in ("+1080", "-1080")
    }
    lengths = {len(text.splitlines()) for text in analysis.attachments.values()}
    assert lengths == {1 + round(16.3 * 200)}
    first = analysis.attachments["GNC-07/gyro/X+1080.csv"].splitlines()
    assert first[0] == "counter,time_s,gyro_x_deg_s,gyro_y_deg_s,gyro_z_deg_s"
    assert any(note.startswith("X+1080: 1.000 s were cut off") for note in analysis.notes)
    assert "position +x up: no record" in analysis.missing


def test_what_is_missing_is_named_and_costs_only_its_part() -> None:
    rig = short()
    rig.rows[6].samples.columns["gyro"][1000:1010, 0] = 80_000  # a saturated record is not used either
    rig.rows = [row for row in rig.rows if row.window.number != 8 and row.window.conditions.get("up") != "-y"]
    analysis = analysed(rig)
    assert {f"{text}: no record" for text in ("position -y up", "rotation X-")} <= set(analysis.missing)
    assert "rotation X+: no record" not in analysis.missing
    (at_limit,) = (text for text in analysis.missing if "at its limit" in text)
    assert "gyro x is at its limit in rotation x +1080 (record 7): +400 deg/s of 400 deg/s in 10 samples" in at_limit
    assert "the first at sample 1000" in at_limit
    assert any(text.startswith("gyros: ") and "B-FIT-081" in text for text in analysis.missing)
    assert every(analysis, "accel_matrix") != []
    assert every(analysis, "gyro_matrix") == []


@pytest.mark.parametrize(
    ("change", "said"),
    [
        ({"up": "+q"}, r"'up' is '\+q'"),
        ({"up": "-x"}, "in its pose up is"),
        ({"outer_deg": None}, "do not give its pose"),
        ({"item": "rotation", "axis": "x"}, "'turn_deg' None"),
    ],
)
def test_conditions_that_do_not_say_what_a_record_shows(change: dict[str, str | None], said: str) -> None:
    rig = Rig(SEED)
    rig.rest(2.0, POSES["+x"], **({"item": "position", "up": "+x"} | change))
    if "outer_deg" in change:
        rig.rows[0].window.conditions.pop("outer_deg")
    with pytest.raises(FitError, match=f"B-GNC-004.*{said}"):
        analysed(rig)


def test_no_samples_and_no_site() -> None:
    with pytest.raises(FitError, match="B-GNC-003"):
        analysed(Rig(SEED))
    with pytest.raises(FitError, match=r"B-GNC-005.*gravity"):
        analysed(short(), site={"latitude_deg": 1.0, "azimuth_deg": 0.0})


Keep = Callable[[str, object], None]
Found = tuple[TriadFit, np.ndarray, np.ndarray]
FORCES = np.array(list(ARROWS.values()), float)


def fitted(seed: int, declared_deg: float = 0.0, known: bool = True, **more: float) -> Found:
    """Fit of one drawn unit; errors of K row by row and of the bias of a = K N + bias; errors of S, (3, 3)."""
    rng = np.random.default_rng([31, seed])
    unit = draw(rng, 0.01, 0.003, 0.010)
    poses, forces = positions(unit, rng, **more)
    mean, covariance, _ = static_means(poses, 200.0, resolution=1e-3)
    fit = fit_six_position(mean, forces, covariance if known else None, tilt_std_deg=declared_deg)
    truth = np.concatenate([np.linalg.inv(unit.sensitivity).ravel(), -unit.bias])
    return fit, np.concatenate([fit.matrix.ravel(), fit.bias]) - truth, fit.sensitivity - unit.sensitivity


def covered(found: list[Found]) -> np.ndarray:
    """Per cent of 95 % intervals that hold the truth, for each of the twelve."""
    inside = [np.abs(e) <= coverage_factor(f.dof) * np.sqrt(f.covariance.diagonal()) for f, e, _ in found]
    return 100.0 * np.mean(inside, axis=0)


@pytest.mark.validates(
    "accelerometer triad of 50 units, 60 s in each of six poses: scale and cross terms within 50 ppm",
    against="the simulated truth: scale 1 %, cross coupling 0.3 %, bias 10 mg, noise 0.1 mg/sqrt(Hz), steps of 1 mg",
)
def test_fifty_units_within_50_ppm(record_property: Keep) -> None:
    found = [fitted(seed) for seed in range(50)]
    off_ppm = 1e6 * np.array([sensitivity for _, _, sensitivity in found])
    scale, cross = off_ppm[:, range(3), range(3)], off_ppm[:, ~np.eye(3, dtype=bool)]
    bias_mg = 1e3 * np.array([errors[9:] for _, errors, _ in found])
    figure = f"rms scale {np.std(scale):.1f}, cross {np.std(cross):.1f}, worst {np.abs(off_ppm).max():.1f} ppm"
    record_property("obtained", f"{figure}; bias rms {np.sqrt(np.mean(bias_mg**2)):.4f} mg")
    assert np.abs(off_ppm).max() < 50.0
    assert np.sqrt(np.mean(bias_mg**2)) < 0.01
    assert sum(fit.inflated for fit, _, _ in found) == 0


@pytest.mark.validates(
    "accelerometer triad: 95 % intervals of the twelve parameters, 500 units",
    against="the simulated truth, table without and with 1 arcmin of tilt per pose and axis",
)
@pytest.mark.parametrize("tilt_deg", [0.0, 1.0 / 60.0])
def test_intervals_cover(record_property: Keep, tilt_deg: float) -> None:
    found = [fitted(seed, tilt_deg, seconds=2.0, tilt_deg=tilt_deg) for seed in range(500)]
    share = covered(found)
    cross_ppm = 1e6 * np.array([s for _, _, s in found])[:, ~np.eye(3, dtype=bool)]
    record_property(
        "obtained", f"tilt {60 * tilt_deg:g}': {share.min():.1f} to {share.max():.1f} %, all {share.mean():.1f} %"
    )
    if tilt_deg:
        record_property("obtained", f"cross coupling then off by {np.std(cross_ppm):.0f} ppm rms")
        assert 150.0 < np.std(cross_ppm) < 300.0
    assert np.all(np.abs(share - 95.0) <= 4.0)
    assert abs(share.mean() - 95.0) <= 1.5


def test_intervals_from_residuals_alone_cover() -> None:
    """Six degrees of freedom: Student's t; noise alike on all axes is what residuals stand for."""
    share = covered([fitted(seed, known=False, seconds=1.0) for seed in range(1000, 1400)])
    assert np.all(np.abs(share - 95.0) <= 4.5)


def test_tilt_that_was_not_declared_is_noticed_and_enlarges_the_intervals() -> None:
    found = [fitted(seed, tilt_deg=1.0 / 60.0) for seed in range(40)]
    assert all(fit.inflated for fit, _, _ in found)
    assert {fit.dof for fit, _, _ in found} == {6.0}  # as many as the residuals that say how much larger it was
    assert covered(found).mean() > 91.0


@pytest.mark.validates(
    "GNC paper (2): six-position least squares with the column of ones",
    against="the formula K = (N^T N)^-1 N^T F in fractions of whole numbers, and numpy.linalg.lstsq",
)
def test_the_papers_formula(record_property: Keep) -> None:
    """Gauss and Jordan in exact fractions."""
    rng, exact = np.random.default_rng(5), np.vectorize(Fraction)
    mean = np.round((FORCES + rng.normal(size=(6, 3)) * 0.01) * 4096) / 4096
    N, F = exact(np.column_stack([mean, np.ones(6)])), exact(FORCES)
    rows = np.hstack([N.T @ N, N.T @ F])
    for i in range(4):
        rows[i] = rows[i] / rows[i, i]
        for k in set(range(4)) - {i}:
            rows[k] = rows[k] - rows[k, i] * rows[i]
    solution = rows[:, 4:].astype(float)
    fit = fit_six_position(mean, FORCES)
    apart = max(np.abs(fit.matrix - solution[:3].T).max(), np.abs(fit.bias - solution[3]).max())
    other = np.linalg.lstsq(np.column_stack([mean, np.ones(6)]), FORCES, rcond=None)[0]
    record_property("obtained", f"apart {apart:.0e} and {np.abs(fit.matrix - other[:3].T).max():.0e}")
    assert apart < 1e-13
    assert np.abs(fit.bias - other[3]).max() < 1e-13
    mean = FORCES + np.array([0.010, -0.010, 0.010])
    printed = np.linalg.lstsq(mean, FORCES, rcond=None)[0]  # without the ones, as the text has it, the bias stays
    assert np.abs(mean @ printed - FORCES).max() > 0.009
    assert np.abs(fit_six_position(mean, FORCES).apply(mean, bias_sign=1) - FORCES).max() < 1e-12


def test_sensitivity_and_its_covariance_by_trials() -> None:
    """The delta method against inverses of 40,000 drawn matrices."""
    fit, _, _ = fitted(3, 1.0 / 60.0, seconds=2.0)
    rng = np.random.default_rng(8)
    drawn = rng.multivariate_normal(fit.matrix.ravel(), fit.covariance[:9, :9], size=40_000)
    inverse = np.linalg.inv(drawn.reshape(-1, 3, 3)).reshape(-1, 9)
    spread = np.cov(inverse.T)
    size = np.sqrt(np.outer(spread.diagonal(), spread.diagonal()))
    assert np.abs((spread - fit.sensitivity_covariance) / size).max() < 0.03
    assert fit.scale_error_std_ppm == pytest.approx(1e6 * np.std(inverse[:, [0, 4, 8]], axis=0), rel=0.02)
    assert fit.cross_coupling_std[0, 1] == pytest.approx(np.std(inverse[:, 1]), rel=0.02)
    assert fit.scale_error_ppm == pytest.approx(1e6 * (np.diag(np.linalg.inv(fit.matrix)) - 1.0))


def test_more_poses_than_six_and_another_unit_of_the_output() -> None:
    rng = np.random.default_rng(12)
    force = rng.normal(size=(24, 3))
    matrix, bias = np.eye(3) + rng.normal(size=(3, 3)) * 0.02, np.array([0.1, -0.2, 0.3])
    mean = (force - bias) @ np.linalg.inv(matrix).T * 1000.0
    fit = fit_six_position(mean, force)
    assert fit.matrix * 1000.0 == pytest.approx(matrix)
    assert fit.bias == pytest.approx(bias)
    assert fit.residual_dof == 60


def test_poses_that_do_not_determine_all_twelve_are_refused() -> None:
    for poses in ([0, 2, 4], [0, 1, 2, 3], [0, 0, 2, 2, 4, 4]):
        with pytest.raises(FitError, match=r"B-FIT-001.*rank"):
            fit_six_position(FORCES[poses] * 1.01, FORCES[poses])
    fit = fit_six_position(FORCES[[0, 2, 4, 5]], FORCES[[0, 2, 4, 5]])  # four: values without an uncertainty
    assert fit.matrix == pytest.approx(np.eye(3))
    assert np.isnan(fit.bias_std).all()
    with pytest.raises(FitError, match="B-FIT-083"):  # a record at rest shorter than its means
        static_means([np.zeros((10, 3))], 200.0)


def test_quantisation_left_in_a_mean() -> None:
    """Against means of rounded normal noise over all places within a step, by numerical integration."""
    places, steps = (np.arange(400) + 0.5) / 400 - 0.5, np.arange(-30, 31)
    for std in (0.02, 0.3, 0.5):
        upper = stats.norm.cdf((steps + 0.5 - places[:, None]) / std)
        lower = stats.norm.cdf((steps - 0.5 - places[:, None]) / std)
        left = (upper - lower) @ steps - places
        stated = quantisation_variance(np.array(std * 0.005), 0.005) / 0.005**2
        assert stated == pytest.approx(np.mean(left**2), rel=1e-2)
    assert quantisation_variance(np.array([0.1]), 0.0) == 0.0


def test_noise_slower_than_the_blocks_is_part_of_the_means() -> None:
    """White noise and a slow part as large in the mean (correlated over a third of a record): intervals hold both."""
    rng = np.random.default_rng(4242)
    z = []
    for _ in range(150):
        poses = []
        for _ in range(6):
            slow, kept = rng.normal(size=3), np.exp(-1.0 / 100.0)
            kicks = rng.normal(size=(300, 3)) * np.sqrt(1.0 - kept**2)
            walk, _ = signal.lfilter([1.0], [1.0, -kept], kicks, axis=0, zi=kept * slow[None])
            poses.append(walk + rng.normal(0.0, 12.0, (300, 3)))
        means, covariance, _ = static_means(poses, 1.0)
        z.append(means / np.sqrt(np.diagonal(covariance, axis1=1, axis2=2)))
    assert np.sqrt(np.mean(np.square(z))) < 1.15
