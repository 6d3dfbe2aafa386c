"""imu_coefficients.h, compiled and applied to simulated sessions; whole calibrations, and the shortest that the command
``bench plan`` finds, against the simulated truth."""

import json
import math
import shutil
import subprocess
from collections.abc import Callable, Sequence
from dataclasses import replace
from functools import cache
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from gnc_campaigns import GIVEN, SHORTEST, given, rewritten
from gnc_rig import Session, TURN_s, calibration_settings, recorded_unit, run_session, share_covered
from imu_fit_simulation import EARTH_DEG_S, body_to_local, local_rate_deg_s
from scipy import stats
from scipy.spatial.transform import Rotation
from typer.testing import CliRunner

from bench.analysis import FALSE_DOUBT, joined
from bench.cli import app
from bench.design import reached
from bench.design.shortest import misses
from bench.model.errors import InputError
from bench.plan import check_plan, compile_sequence
from bench.record import RecordRow
from bench.session.designed import Asked, Proposal, problem_of, proposed
from bench.session.predicted import predicted
from bench.session.service import read_view
from bench.systems.gnc.calibration.design import Calibrations
from bench.systems.gnc.estimators.earth_rate import Pose

Keep = Callable[[str, object], None]
LATITUDE_deg, AZIMUTH_deg, GRAVITY_g = 34.2, 90.0, 9.7969 / 9.80665  # of the simulated bench
DECLINATION_deg = -4.0
PROGRAM = """
#include <stdio.h>
#include "imu_coefficients.h"
int main(void)
{
    double g[3], a[3], m[3], w[3], f[3], h[2];
    while (scanf("%lf %lf %lf %lf %lf %lf %lf %lf", &g[0], &g[1], &g[2], &a[0], &a[1], &a[2], &m[0], &m[1]) == 8) {
        imu_compensate_gyro(g, w);
        imu_compensate_accelerometer(a, f);
        imu_compensate_magnetometer(m, h);
        printf("%.12g %.12g %.12g %.12g %.12g %.12g %.12g %.12g\\n", w[0], w[1], w[2], f[0], f[1], f[2], h[0], h[1]);
    }
    return 0;
}
"""


def to_local(row: RecordRow) -> Rotation:
    """Body to East, North, Up at the begin of a record."""
    at = row.window.conditions
    angles = (float(at[f"{axis}_deg"]) for axis in ("outer", "middle", "inner"))
    return body_to_local(Pose(*angles, str(at["mounting"])), AZIMUTH_deg)


@pytest.fixture(scope="module")
def sessions(tmp_path_factory: pytest.TempPathFactory) -> tuple[dict[str, list[RecordRow]], Path, dict[str, dict]]:
    """Records by item, the compiled program, the sections of the coefficients."""
    compiler = shutil.which("gcc") or shutil.which("cc") or shutil.which("clang")
    if compiler is None:
        pytest.skip("no C compiler on this machine: the header is not compiled")
    out = tmp_path_factory.mktemp("header")
    calibration, _ = recorded_unit(tmp_path_factory, "gnc_imu_calibration")
    magnetometer, _ = recorded_unit(tmp_path_factory, "gnc_magnetometer")
    merged = CliRunner().invoke(app, ["coefficients", str(calibration), str(magnetometer), "--out", str(out)])
    assert merged.exit_code == 0, merged.output
    (out / "main.c").write_text(PROGRAM)
    flags = ["-std=c99", "-Wall", "-Wextra", "-pedantic", "-Werror", "-O1"]
    built = subprocess.run(
        [compiler, *flags, "main.c", "-o", "main"], cwd=out, capture_output=True, text=True, check=False
    )
    assert (built.returncode, built.stderr) == (0, "")
    rows: dict[str, list[RecordRow]] = {}
    for folder in (calibration, magnetometer):
        for row in joined(read_view(folder).rows):
            rows.setdefault(str(row.window.conditions.get("item")), []).append(row)
    document = json.loads((out / "imu_coefficients.json").read_text())
    return rows, out / "main", {one["section"]: one for one in document["sections"]}


def compensated(program: Path, row: RecordRow) -> np.ndarray:
    """(n, 8): rates, forces, field across z, from the counts of a record and the steps of the specification."""
    columns = row.samples.columns
    values = [columns["gyro"] * 0.005, columns["accel"] * 1e-3, columns["mag"][:, :2] * 120e-6]
    lines = "\n".join(" ".join(map(repr, one)) for one in np.column_stack(values).tolist())
    ran = subprocess.run([str(program)], input=lines, capture_output=True, text=True, check=True)
    found = np.array(ran.stdout.split(), float).reshape(-1, 8)
    assert len(found) == len(row.samples)
    return found


def checks(rows: Sequence[RecordRow]) -> Sequence[RecordRow]:
    """The second half of the records: they took no part in the calibration."""
    return rows[len(rows) // 2 :]


@pytest.mark.slow
@pytest.mark.validates(
    "imu_coefficients.h applied to the counts of records that took no part in the calibration",
    against="angles of the table by scipy's rotations, the sidereal day, gravity of the simulated site",
)
def test_forces_and_rates_at_rest(sessions, record_property: Keep) -> None:
    rows, program, sections = sessions
    worst_g, worst_deg_s = 0.0, 0.0
    assert len(rows["position"]) == 12
    for row in checks(rows["position"]):
        seconds = len(row.samples) / 200.0
        mean = compensated(program, row).mean(axis=0)
        body = to_local(row).inv()
        force_g, rate_deg_s = body.apply([0.0, 0.0, GRAVITY_g]), body.apply(local_rate_deg_s(LATITUDE_deg))
        accelerometer, gyro = sections["accelerometer"], sections["gyro"]
        own_g = np.hypot(np.linalg.norm(accelerometer["matrix_std"], axis=1), accelerometer["bias_std"])
        off_g = (mean[3:6] - force_g) / np.hypot(own_g, 1.2e-4 / seconds**0.5)
        off_deg_s = (mean[:3] - rate_deg_s) / np.hypot(gyro["bias_std"], 0.3 / 60.0 / seconds**0.5)
        worst_g, worst_deg_s = max(worst_g, np.abs(off_g).max()), max(worst_deg_s, np.abs(off_deg_s).max())
    record_property("obtained", f"worst of 18 forces {worst_g:.1f}, of 18 rates {worst_deg_s:.1f} standard deviations")
    assert worst_g < 4.0
    assert worst_deg_s < 4.0


@pytest.mark.slow
def test_the_whole_turn_comes_out_about_the_axis_it_was_made(sessions) -> None:
    """+-1080 degrees about x, y and z, and the Earth's rate about the same axis, which points to the pole."""
    rows, program, sections = sessions
    gyro = sections["gyro"]
    assert len(rows["rotation"]) == 12
    for row in (one for pair in range(0, 12, 4) for one in rows["rotation"][pair + 2 : pair + 4]):
        seconds = len(row.samples) / 200.0
        turned = compensated(program, row)[:, :3].sum(axis=0) / 200.0
        axis = np.eye(3)["xyz".index(str(row.window.conditions["axis"]))]
        along = to_local(row).apply(axis)
        assert along == pytest.approx(local_rate_deg_s(LATITUDE_deg) / EARTH_DEG_S, abs=1e-9)
        due = axis * (float(row.window.conditions["turn_deg"]) + EARTH_DEG_S * seconds)
        noise_deg = 0.3 / 60.0 * seconds**0.5
        own_deg = np.hypot(np.asarray(gyro["matrix_std"]) @ np.abs(due), np.asarray(gyro["bias_std"]) * seconds)
        assert np.all(np.abs(turned - due) < 4.0 * np.hypot(own_deg, noise_deg)), row.window.conditions


@pytest.mark.slow
def test_the_roll_angle_is_that_of_the_table(sessions) -> None:
    """z points north: roll turns with the inner axis; the field's direction across z is that of its declination."""
    rows, program, _ = sessions
    (row,) = rows["magnetometer"]
    field = compensated(program, row)[:, 6:]
    rate_deg_s = np.degrees(
        np.polyfit(np.arange(len(field)) / 200.0, np.unwrap(np.arctan2(-field[:, 1], field[:, 0])), 1)[0]
    )
    assert rate_deg_s == pytest.approx(15.0, abs=0.01)
    size = np.hypot(*field.T)
    assert size.std() < 1.5 * 0.5e-3
    across = 0.43 * np.hypot(np.sin(np.radians(55.0)), np.cos(np.radians(55.0)) * np.sin(np.radians(DECLINATION_deg)))
    assert size.mean() == pytest.approx(across, rel=0.09)  # sensitivity of x: 3 %, at most 2.5 standard deviations


MATRICES = tuple(f"{kind}_{what}" for kind in ("accel", "gyro") for what in ("scale_error", "cross_coupling"))
COVERED = (*MATRICES, "accel_bias", "gyro_bias", "accel_matrix", "gyro_matrix")
CROSS = ~np.eye(3, dtype=bool)


def off_ppm(session: Session, kind: str) -> np.ndarray:
    """Error of S, (3, 3), ppm."""
    true, found = (np.linalg.inv(session.matrix(f"{kind}_matrix", true=which)) for which in (True, False))
    return 1e6 * (found - true)


def bias_over_theory(found: list[Session], length_s: float) -> np.ndarray:
    """Errors of the gyro biases in units of ARW / sqrt(4 T)."""
    parts = []
    for one in found:
        walk_deg_rt_h = one.by_axis("angle_random_walk", "gyro", true=True)
        theory_deg_h = walk_deg_rt_h / math.sqrt(4.0 * length_s / 3600.0)
        parts.append((one.by_axis("gyro_bias", "gyro") - one.by_axis("gyro_bias", "gyro", true=True)) / theory_deg_h)
    return np.concatenate(parts)


@pytest.mark.parametrize(
    ("units", "length_s"),
    [
        pytest.param(1, TURN_s, marks=pytest.mark.slow),
        pytest.param(50, TURN_s, marks=pytest.mark.sweep),
        pytest.param(50, 25.0, marks=pytest.mark.sweep),
    ],
)
def test_units_against_the_truth(tmp_path_factory: pytest.TempPathFactory, units: int, length_s: float) -> None:
    _, first = recorded_unit(tmp_path_factory, "gnc_imu_calibration")
    out, settings = tmp_path_factory.mktemp("units"), calibration_settings(length_s)
    found = [first] if units == 1 else [run_session(out, "gnc_imu_calibration", n, *settings) for n in range(units)]
    assert all(one.missing == [] for one in found)
    for kind in ("accel", "gyro"):
        ppm = np.array([off_ppm(one, kind) for one in found])
        rms = [float(np.sqrt(np.mean(part**2))) for part in (ppm[:, ~CROSS], ppm[:, CROSS])]
        print(f"{kind}: scale {rms[0]:.1f}, cross {rms[1]:.1f} ppm rms, worst {np.abs(ppm).max():.1f} ppm")
        assert np.abs(ppm).max() < 50.0
    bias = bias_over_theory(found, length_s)
    print(f"gyro bias: {np.sqrt(np.mean(bias**2)):.3f} of ARW / sqrt(4 T) rms, worst {np.abs(bias).max():.2f}")
    assert np.sqrt(np.mean(bias**2)) == pytest.approx(1.0, abs=0.17 if units == 50 else 0.7)
    assert np.abs(bias).max() < 4.5
    for quantity in COVERED:
        print(f"{quantity}: {share_covered(found, quantity):.1f} % covered")
    assert share_covered(found, *COVERED) == pytest.approx(95.0, abs=4.0 if units == 50 else 7.0)
    assert_check_covers(found)


def assert_check_covers(found: list[Session]) -> None:
    """Coupling after compensation against what these coefficients do leave of the true sensors: K S."""
    inside = []
    for one in found:
        for kind in ("accel", "gyro"):
            left = one.matrix(f"{kind}_matrix") @ np.linalg.inv(one.matrix(f"{kind}_matrix", true=True))
            seen = one.matrix(f"{kind}_coupling_compensated")
            wide = np.zeros((3, 3))
            for key, estimate in one.found.items():
                if key[0] == f"{kind}_coupling_compensated":
                    place = dict(key[1:])
                    wide["xyz".index(place["row"]), "xyz".index(place["column"])] = estimate["expanded_uncertainty"]
            inside += list(np.abs(seen - left)[CROSS] <= wide[CROSS])
    print(f"coupling after compensation: {100 * np.mean(inside):.1f} % covered")
    assert 100.0 * np.mean(inside) > (91.0 if len(found) > 10 else 80.0)


@cache
def found() -> Proposal:
    return proposed(given(), Asked([], None, None))


def problem() -> Calibrations:
    return found().problem


@pytest.mark.validates(
    "calibration of a GNC module in less time: both triads no worse",
    against="the prediction of the fit for both compiled sequences",
)
def test_the_written_plan_is_what_was_found_and_reaches_the_targets(tmp_path: Path, record_property: Any) -> None:
    path = tmp_path / "shorter.yaml"
    path.write_text(found().text("shorter"), encoding="utf-8")
    plan = compile_sequence(path, None, {})
    assert check_plan(plan) == []
    design, before = found().design, given()
    assert (design.candidate, design.length_s) == SHORTEST
    record_property("obtained", f"{plan.duration_s:.0f} s in place of {before.duration_s:.0f} s")
    assert plan.duration_s == pytest.approx(design.duration_s, abs=1e-6)
    assert plan.duration_s < 0.95 * before.duration_s
    known, after = (reached(predicted(each).estimates) for each in (before, plan))
    assert len(found().targets) == 6
    assert all(pytest.approx(known[target.key], rel=1.1e-3) == target.U for target in found().targets)
    assert misses(found().targets, after) == []
    for key in after:
        assert found().found[key] == pytest.approx(after[key], rel=1e-6), key


def test_bounds_are_bounds() -> None:
    for candidate, length_s in (problem().today, (found().design.candidate, 60.0)):
        known = reached(problem().estimates(candidate, length_s))
        for key, U in problem().at_least(candidate, length_s).items():
            assert 0.95 * known[key] < U <= known[key], key


def test_broken_rules_are_named() -> None:
    candidate, length_s = found().design.candidate, found().design.length_s
    assert problem().broken(candidate, length_s) == []
    blind = {
        "6 turns take 9 s": (replace(candidate, turns=6, turn_s=30.0), length_s),
        "5 turns hide": (replace(candidate, turns=5), length_s),
        "less than 7 s of rest": (replace(candidate, turn_s=11.5), length_s),
        "the call of a turn may take 14 s": (replace(candidate, turns=1, turn_s=13.0), length_s),
        "a position of 5 s": (candidate, 5.0),
        "a repeated position of 1 s": (replace(candidate, check_s=1.0), length_s),
    }
    for words, each in blind.items():
        assert any(words in sentence for sentence in problem().broken(*each)), words


def test_more_turns_hide_by_how_much_one_ends_off_its_angle() -> None:
    """It moves a scale factor by half of its share, since the turn back is right; the sets differ by that."""
    leasts_deg = []
    for turns in (1, 2, 3, 5):
        parts = problem().nominal(replace(found().design.candidate, turns=turns, turn_s=20.5), 300.0)[1]
        assert len(parts.fits["gyro"]) == 2
        stds = (each.matrix_std[0, 0] for each in parts.fits["gyro"])
        leasts_deg.append(2.0 * 360.0 * turns * float(np.hypot(*stds)))
    print(f"one standard deviation of an error of one turn of 1, 2, 3 and 5, degree: {np.round(leasts_deg, 4)}")
    assert leasts_deg == sorted(leasts_deg)
    assert leasts_deg[-1] > 1.2 * leasts_deg[-2]


def test_a_repeat_that_cannot_be_judged_is_named(tmp_path: Path) -> None:
    """A limit of 100 ppm on the coupling leaves 10 ppm for the second set."""
    plan = rewritten(tmp_path, GIVEN, ("accel_cross_coupling: 1000 ppm", "accel_cross_coupling: 100 ppm"))
    strict = problem_of(plan, None)
    assert any("accel_coupling_compensated" in sentence for sentence in strict.broken(*strict.today))


def test_the_power_against_a_square_of_the_acceleration_is_that_of_its_formula(tmp_path: Path) -> None:
    """k f^2 moves each bias by k / 3 and leaves residuals of 4 / 3 k^2 per sensor and set; noise is white and alike.

    The bias has the variance s^2 / 6 of the 300 s of the first set, the residuals s^2 each, and 5 s^2 in the 60 s of
    the second, so that 1 U of the bias has the noncentrality 3 * 4 / 3 * 9 * (1 + 1 / 5) * U^2 / s^2. Its threshold is
    shared by some hundred columns, of which the number matters little.
    """
    slow = "accelerometer_wandering: [{size: 6 ug, over: 10 s}, {size: 6 ug, over: 100 s}, {size: 6 ug, over: 1000 s}],"
    white = problem_of(rewritten(tmp_path, GIVEN, (slow, "")), None)
    powers = {(each.rival, each.quantity): each.power for each in white.powers(*white.today)}
    limits = stats.f.isf(FALSE_DOUBT / 4.0 / np.array([1000, 100]), 1, 6 * 19)  # 20 means of each position
    least, most = stats.ncx2.sf(limits, 1, 7.2 * 1.96**2)
    obtained = powers["square of the acceleration", "accel_bias"]
    print(f"power {obtained:.3f}, by the formula {least:.3f} to {most:.3f}")
    assert least < obtained < most


def test_what_rates_of_one_size_cannot_show_is_not_said_to_be_seen() -> None:
    for campaign in (problem().today, (found().design.candidate, found().design.length_s)):
        powers = {(each.rival, each.quantity): each.power for each in problem().powers(*campaign)}
        assert powers["scale factors of gyros that change with the rate", "gyro_scale_error"] < 0.01
        assert powers["gyro biases that drift steadily", "gyro_scale_error"] > 0.9
        assert powers["accelerometer biases that drift steadily", "accel_scale_error"] > 0.9


def test_a_calibration_without_a_second_set_is_refused(tmp_path: Path) -> None:
    second = '  - positions: {time: "{check_position}"}  # the second set checks what the first one gave\n'
    plan = rewritten(tmp_path, GIVEN, (second, ""))
    with pytest.raises(InputError, match=r"B-DES-004.*\+x 1 times"):
        problem_of(plan, None)
