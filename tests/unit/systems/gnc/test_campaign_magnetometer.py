"""The magnetometer by both methods: a simulated unit, logs distorted by known iron, other people's recordings; the
compensation of an IMU: the document, the merge of two sessions, and the header in a real compiler."""

import json
import struct
import subprocess
from dataclasses import replace
from pathlib import Path
from typing import Any

import jsonschema
import numpy as np
import pytest
from c_program import compile_main
from gnc_rig import FRAME, exchange
from imported_logs import MAPPINGS, estimates_of, imported, of_mirror
from imu_material import Rig
from numpy.typing import NDArray
from one_estimate import every, one, value
from scipy.optimize import least_squares
from spoken import english_left

from bench.analysis import Analysis, Material, build_results, results_json
from bench.analysis.doubt import weigh
from bench.frame import load_frame
from bench.model.errors import FitError, InputError
from bench.model.systems import systems
from bench.plan import PlannedCommand, compile_sequence
from bench.session.coefficients import Coefficients, merged_coefficients, write_coefficients
from bench.systems.gnc.coefficients import (
    coefficients_of,
    coefficients_schema,
    header_text,
    magnetometer_section,
    merged,
    triad_section,
)
from bench.systems.gnc.estimators.magnetometer.ellipse import PlaneParameters
from bench.systems.gnc.estimators.triad import TriadFit
from bench.systems.gnc.logs import magnetometer
from bench.systems.gnc.magnetometer import analyse

Array = NDArray[np.float64]
SEED, FIELD_gauss = 608, 0.43
LAYOUTS = load_frame(FRAME).commands
LIMITS = {"roll_error": {"value": 2.0, "unit": "deg"}}
HARD = np.array([0.12, -0.05, 0.3])
SOFT = np.array([[1.05, 0.02, -0.01], [0.02, 0.97, 0.03], [-0.01, 0.03, 0.99]])


def rolls(deg: range = range(0, 360, 45)):
    """Answers of a module without compensation: LSB of its field and the roll angle that it makes of them."""
    found = [exchange("set_magnetometer", struct.pack("<5h", 0, 0, 0, 10_000, 0), b"", 0, item="")]
    alpha = np.deg2rad(1.5)
    for number, angle in enumerate(deg, 1):
        x, y = FIELD_gauss * np.cos(np.deg2rad(angle + 17.0)), -FIELD_gauss * np.sin(np.deg2rad(angle + 17.0))
        raw = np.rint(np.array([0.05 + x * np.cos(alpha) + y * np.sin(alpha), -0.03 + y / 1.04, 0.2]) / 120e-6)
        roll = np.rad2deg(np.arctan2(-raw[1], raw[0]))
        answer = struct.pack("<4h", round(100 * roll), *(int(one) for one in raw))
        found.append(exchange("roll", b"", answer, number, conditions={"roll_deg": float(angle)}))
    return found


def spun(seconds: float = 60.0, **more: Any) -> Rig:
    rig = Rig(SEED)
    rig.spin(seconds, 90.0, FIELD_gauss, **more)
    return rig


def analysed(method: str = "ellipse", **more: Any) -> Analysis:
    material = spun(**more).material("magnetometer", exchanges=rolls(), layouts=LAYOUTS, limits=LIMITS)
    return analyse(material, method)


@pytest.fixture(scope="module")
def found() -> Analysis:
    return analysed(table="non_magnetic")


def test_the_ellipse_finds_the_parameters_and_the_extremes_are_told_beside(found: Analysis) -> None:
    offset = [value(found, "mag_offset", method="ellipse", axis=axis) for axis in "xy"]
    assert offset == pytest.approx([0.05, -0.03], abs=2e-5)
    assert value(found, "mag_gain", method="ellipse") == pytest.approx(1.04, abs=2e-4)
    assert value(found, "mag_angle", method="ellipse") == pytest.approx(1.5, abs=0.02)
    stds = (one(found, "mag_angle", method=method).std_uncertainty for method in ("extremes", "ellipse"))
    assert next(stds) > 20.0 * next(stds)
    assert found.missing == []
    assert any("no gap between phases" in note for note in found.notes)
    assert english_left(found) == set()
    before, after = (np.hypot(series.x, series.y) for series in found.figures[0].series)  # mgauss
    assert (np.std(before) > 10.0, np.std(after) < 1.0) == (True, True)


def test_roll_is_right_after_compensation_and_only_then(found: Analysis) -> None:
    returned = [entry.value for entry in every(found, "mag_roll_error", method="returned")]
    assert len(returned) == 8
    assert max(map(abs, returned)) > 4.0
    compensated = every(found, "mag_roll_error", method="ellipse")
    assert max(abs(entry.value) for entry in compensated) < 0.05
    assert {entry.verdict for entry in compensated} == {"pass"}
    assert {entry.verdict for entry in every(found, "mag_roll_error", method="extremes")} == {"none"}
    single_deg = np.rad2deg(5e-4 / FIELD_gauss)  # noise of one reading; a step of the output makes a tenth of it
    less_mean_deg = single_deg * np.sqrt(7.0 / 8.0)
    assert [entry.std_uncertainty for entry in compensated] == pytest.approx([less_mean_deg] * 8, rel=0.05)
    unlimited = analyse(spun(table="non_magnetic").material("magnetometer", exchanges=rolls(), layouts=LAYOUTS))
    assert {entry.verdict for entry in unlimited.estimates} == {"none"}  # no specification states a limit of it


def test_the_correction_in_force_is_undone() -> None:
    """The same module with a correction of its own: its answers change, the errors after ours do not."""
    plain, offset, errors = rolls(), (250, -100), []
    moved = [replace(plain[0], sent=struct.pack("<5h", *offset, 0, 10_000, 0))]
    for answer in plain[1:]:
        roll, x, y, z = struct.unpack("<4h", answer.received)
        moved.append(replace(answer, received=struct.pack("<4h", roll, x - offset[0], y - offset[1], z)))
    for exchanges in (plain, moved):
        analysis = analyse(spun().material("magnetometer", exchanges=exchanges, layouts=LAYOUTS))
        errors.append([entry.value for entry in every(analysis, "mag_roll_error", method="ellipse")])
    np.testing.assert_allclose(errors[0], errors[1], atol=1e-9)


def test_the_table_must_be_declared_non_magnetic(found: Analysis) -> None:
    assert not any("non-magnetic" in note for note in found.notes)
    assert any("does not say which table" in note for note in analysed().notes)
    assert any("names the table 'turntable'" in note for note in analysed(table="turntable").notes)


def test_less_than_a_turn_is_refused_and_the_other_record_is_used() -> None:
    rig = spun(2.0)
    with pytest.raises(FitError, match=r"B-FIT-09[01]"):
        analyse(rig.material("magnetometer"))
    rig.spin(60.0, 90.0, FIELD_gauss)
    analysis = analyse(rig.material("magnetometer"))
    assert len(analysis.missing) == 1
    assert value(analysis, "mag_angle", method="ellipse") == pytest.approx(1.5, abs=0.02)


def test_the_method_chosen_is_the_one_that_compensates() -> None:
    assert analysed("extremes").compensation[0]["method"] == "extremes"


def attitudes(rig: Rig, hard_gauss: tuple[float, float, float], cap: bool = False) -> None:
    """A minute of readings all over the sphere, or on a cap of it, about a hard iron, without soft iron."""
    field = rig.rng.normal(size=(12_000, 3))
    field[:, 2] = 2.0 * np.hypot(*field[:, :2].T) if cap else field[:, 2]
    field = FIELD_gauss * field / np.linalg.norm(field, axis=1)[:, None] + hard_gauss
    seen = np.rint((field + rig.rng.normal(0.0, 5e-4, field.shape)) / 120e-6)
    rig._add(0.0 * field, 0.0 * field, (90.0, 0.0, 0.0), "z", {"item": "attitudes"}, mag=seen)


def test_a_saturated_record_is_not_used() -> None:
    """The range of 6 gauss is 50,000 steps, a 16-bit word of the frame ends at 32,767: 3.93 gauss."""
    rig = spun()
    rig.rows[0].samples.columns["mag"][2000:2003, 1] = 32_767
    rig.spin(60.0, 90.0, FIELD_gauss)
    analysis = analyse(rig.material("magnetometer"))
    assert any("magnetometer y is at its limit in " in text and "in 3 samples" in text for text in analysis.missing)
    assert len(every(analysis, "mag_gain", method="ellipse")) == 1
    rig, hard_gauss = spun(table="non_magnetic"), (0.11, -0.07, 0.05)
    attitudes(rig, hard_gauss)
    attitudes(rig, hard_gauss)
    rig.rows[2].samples.columns["mag"][:400, 2] = 32_767
    analysis = analyse(rig.material("magnetometer"))
    assert any("magnetometer z is at its limit in " in text and "(record 3)" in text for text in analysis.missing)
    iron = every(analysis, "mag_hard_iron")
    np.testing.assert_allclose([entry.value for entry in iron], hard_gauss, atol=5e-5)
    assert {entry.n for entry in iron} == {12_000}
    rig = spun(table="non_magnetic")
    attitudes(rig, hard_gauss, cap=True)  # which leaves a direction open
    analysis = analyse(rig.material("magnetometer"))
    assert every(analysis, "mag_hard_iron") == []
    assert any("hard and soft iron" in text and "B-FIT-091" in text for text in (*analysis.notes, *analysis.missing))


@pytest.mark.parametrize(
    ("settings", "sent"),
    [
        ({}, (0, 0, 0, 10_000, 0)),
        ({"sin_alpha": "-0.0262"}, (0, 0, 0, 10_000, -2620)),
        ({"offset": "0.012 gauss,-0.024 gauss,0.0024 gauss", "gain": "0.98"}, (100, -200, 20, 9800, 0)),
    ],
)
def test_gain_offset_and_angle_need_not_be_whole_numbers(settings: dict[str, str], sent: tuple[int, ...]) -> None:
    plan = compile_sequence("gnc_magnetometer", None, settings)
    (command,) = [step for step in plan.steps if isinstance(step, PlannedCommand) and step.name == "set_magnetometer"]
    assert struct.unpack("<5h", bytes(command.payload)) == sent


def material(field: Array, unit: str = "gauss") -> Material:
    columns = [{"name": n, "header": n, "role": "magnetometer", "axis": n, "unit": unit} for n in "xyz"]
    series = {"t_s": np.arange(len(field)) / 10.0} | {axis: field[:, k] for k, axis in enumerate("xyz")}
    return Material((), {"uut": {"model": "m", "serial": "1"}, "columns": columns}, {}, series=series)


def sphere(count: int = 1500, flat: bool = False) -> Array:
    """Field of 0.5 gauss from all sides, on a spiral over the sphere, or in a turn about z."""
    step = np.arange(count) + 0.5
    height = np.zeros(count) if flat else 1.0 - 2.0 * step / count
    turn = step * np.pi * (3.0 - np.sqrt(5.0))
    unit = np.column_stack((np.cos(turn), np.sin(turn), height / np.maximum(np.sqrt(1.0 - height**2), 1e-9)))
    unit *= np.sqrt(1.0 - height**2)[:, None]
    noise = np.random.default_rng(3).normal(0.0, 5e-4, (count, 3))
    return np.asarray(0.5 * unit @ np.linalg.inv(SOFT).T + HARD + noise)


def test_the_iron_that_readings_were_distorted_by_is_found() -> None:
    shape = SOFT / np.linalg.det(SOFT) ** (1.0 / 3.0)  # the correction keeps volumes
    for factor, unit in ((1.0, "gauss"), (400.0, "1")):
        analysis = magnetometer.analyse(material(factor * sphere(), unit))
        assert english_left(analysis) == set()
        for entry, true in zip(every(analysis, "mag_hard_iron"), HARD, strict=True):
            assert entry.value == pytest.approx(factor * true, abs=1.5 * entry.expanded_uncertainty)
        soft = every(analysis, "mag_soft_iron")
        for entry in soft:
            true = shape["xyz".index(entry.conditions["row"]), "xyz".index(entry.conditions["column"])]
            assert entry.value == pytest.approx(true, abs=1.5 * entry.expanded_uncertainty)
        assert len(soft) == 6
        assert weigh(analysis.evidence).against == []
        assert {entry.unit for entry in analysis.estimates} == {unit, "1"}
    doubts = weigh(magnetometer.analyse(material(10.0 * sphere())).evidence).against
    assert "implausible_field" in {check.code for check in doubts}  # of gauss, not of counts


def test_a_turn_about_z_gives_its_ellipse() -> None:
    analysis = magnetometer.analyse(material(sphere(flat=True)))
    assert english_left(analysis) == set()
    assert analysis.method == "turn_about_z"
    for entry, true in zip(every(analysis, "mag_offset"), HARD[:2], strict=True):
        assert entry.value == pytest.approx(true, abs=1.5 * entry.expanded_uncertainty)
    assert any("no hard and soft iron" in note for note in analysis.notes)


def test_half_a_sphere_and_a_missing_axis_are_refused() -> None:
    half = sphere()
    with pytest.raises(FitError, match=r"B-FIT-091: .*hard and soft iron"):
        magnetometer.analyse(material(half[half[:, 0] > HARD[0] + 0.3]))
    lacking = material(half)
    lacking.campaign["columns"].pop()
    with pytest.raises(FitError, match="B-GNC-006"):
        magnetometer.analyse(lacking)


def test_rows_off_the_surface_are_left_out_if_few_and_told() -> None:
    field = sphere()
    clean = magnetometer.analyse(material(field))
    field[[100, 101, 700]] = -40.96, 3.2767, 0.0
    analysis = magnetometer.analyse(material(field))
    told = "Rows 101 to 102, 701 of 1500 lie off the surface of all others and were left out."
    assert (analysis.notes[0], analysis.seen, english_left(analysis)) == (told, [told], set())
    for quantity in ("mag_hard_iron", "mag_soft_iron"):
        for entry, other in zip(every(analysis, quantity), every(clean, quantity), strict=True):
            assert entry.value == pytest.approx(other.value, abs=0.1 * other.expanded_uncertainty)


@pytest.mark.parametrize(
    ("spoil", "seen", "next_step"),
    [
        (lambda field: np.minimum(field, 0.4, out=field, where=[True, False, False]),
         "x reads 400 mgauss, its largest value, in 309 of 1500 rows: it clips", "take it in a larger range"),
        (lambda field: np.add(field[750:], 0.04, out=field[750:]),
         "from row 751 of 1500 on the readings lie on another ellipsoid: the iron has changed",
         "import the rows before it and those from it on as two logs"),
        (lambda field: np.add(field[200:230], 0.9, out=field[200:230]),
         "30 of 1500 rows leave the surface of all others: 201 to 230",
         "look what was near then, and leave them out of the log"),
    ],
)  # fmt: skip
def test_what_keeps_readings_from_one_surface_is_named(spoil: Any, seen: str, next_step: str) -> None:
    field = sphere()
    field = field[np.random.default_rng(4).permutation(len(field))]
    spoil(field)
    with pytest.raises(FitError) as caught:
        magnetometer.analyse(material(field))
    told = f"error B-GNC-009: no hard and soft iron of the magnetometer: {seen}. Next: {next_step}"
    assert str(caught.value) == told


@pytest.mark.real
def test_a_real_sphere_against_a_fit_by_scipy(tmp_path: Path) -> None:
    """github.com/aleksandrbazhin/ellipsoid_fit_python: 347 readings in counts, of a field of 174."""
    log = of_mirror("aleksandrbazhin+ellipsoid_fit_python", "mag_out.txt")
    field = np.array([line.replace(",", " ").split() for line in log.decode().splitlines() if line], float)
    found = estimates_of(imported(tmp_path, MAPPINGS / "magnetometer_sphere.yaml", log, None))

    def off(parameters: Array) -> Array:
        shape = np.zeros((3, 3))
        shape[np.triu_indices(3)] = parameters[3:]
        return np.linalg.norm((field - parameters[:3]) @ shape.T, axis=1) - 1.0

    start = np.concatenate((field.mean(axis=0), np.eye(3)[np.triu_indices(3)] / 170.0))
    centre = least_squares(off, start, x_scale="jac").x[:3]
    hard = [entry.value for entry in every(found, "mag_hard_iron")]
    assert hard == pytest.approx(centre.tolist(), abs=1.0)


@pytest.mark.real
def test_a_real_turn_against_the_figures_of_its_author(tmp_path: Path) -> None:
    """github.com/nliaudat/magnetometer_calibration: hard iron of x and y 41.46 and -87.80 in its README.

    Its z, 569.4, rests on readings that hardly leave a plane; it is not given here. Its fit is algebraic, which moves a
    centre by 1 % of the field of 190 where readings lie unevenly.
    """
    log = of_mirror("nliaudat+magnetometer_calibration", "mag_out_sample.txt")
    found = estimates_of(imported(tmp_path, MAPPINGS / "hmc5883l_turn.yaml", log, None))
    assert [value(found, "mag_offset", axis=axis) for axis in "xy"] == pytest.approx([41.46, -87.80], abs=2.0)


PROVENANCE = {"simulated": True, "plan_sha256": "a", "frame_sha256": "b", "session_sha256": "c0ffee", "software": "x 1"}
UNIT_SEED = 609
MATRIX = np.array([[1.0101, -2.1e-3, 0.3e-3], [4.5e-3, 0.9899, -1.7e-3], [0.1, 3.3e-4, 1.0033]])


def triad(scale: float = 1.0) -> TriadFit:
    return TriadFit(
        matrix=MATRIX * scale, bias=np.array([0.1, -0.07, 1e-5 / 3]), covariance=np.eye(12) * 1e-12,
        residual=np.zeros((6, 3)), chi2=0.0, residual_dof=6, dof=6.0,
    )  # fmt: skip


PLANE = PlaneParameters(np.array([0.05, -0.03]), 1.04, 1.5, 0.43, np.eye(5) * 1e-12, np.zeros(5))
SPAN = (24.1, 31.7)


def analysis(*sections: dict[str, Any], serial: str = "GNC-07") -> Analysis:
    uut = {"model": "GNC", "serial": serial}
    return Analysis("imu_calibration", "least_squares", uut, [], compensation=list(sections))


def document(name: str, *sections: dict[str, Any], serial: str = "GNC-07", **provenance: Any) -> dict[str, Any]:
    one = analysis(*sections, serial=serial)
    return coefficients_of(one, build_results(name, one, {}, PROVENANCE | provenance), {})


@pytest.fixture
def calibration() -> dict[str, Any]:
    return document("cal", triad_section("accelerometer", triad(), SPAN), triad_section("gyro", triad(1.01), SPAN))


@pytest.fixture
def both(calibration: dict[str, Any]) -> dict[str, Any]:
    return merged([document("mag", magnetometer_section("ellipse", PLANE, SPAN)), calibration])


def test_document_is_valid_by_the_shipped_schema_and_filed(both: dict[str, Any], tmp_path: Path) -> None:
    shipped = Path(__file__).parents[4] / "bench/systems/gnc/imu_coefficients.schema.json"
    schema = json.loads(shipped.read_text(encoding="utf-8"))
    assert schema == coefficients_schema()
    jsonschema.Draft202012Validator.check_schema(schema)
    jsonschema.validate(json.loads(results_json(both)), schema)
    assert [one["section"] for one in both["sections"]] == ["accelerometer", "gyro", "magnetometer"]
    assert [one["session"] for one in both["sections"]] == ["cal", "cal", "mag"]
    assert both["simulated"] is True
    one = analysis(triad_section("gyro", triad(), SPAN))
    paths = write_coefficients(tmp_path, one, build_results("cal", one, {}, PROVENANCE), {})
    assert [path.name for path in paths] == ["imu_coefficients.json", "imu_coefficients.h"]
    text = paths[1].read_text()
    assert ("SIMULATED" in text, "imu_compensate_accelerometer" in text, text.isascii()) == (True, False, True)


def test_sessions_that_do_not_belong_together_are_refused(calibration: dict[str, Any]) -> None:
    gyro = triad_section("gyro", triad(), SPAN)
    for second, code in (
        (document("other", gyro, serial="GNC-08"), "B-COEF-001"),
        (document("again", gyro), "B-COEF-002"),
        (document("real", simulated=False), "B-COEF-003"),
    ):
        with pytest.raises(InputError, match=code):
            merged([calibration, second])
    af, imu = (system.coefficients for system in systems() if system.coefficients is not None)
    converters = {"parameters": [], "sources": [{"session": "af"}]}
    with pytest.raises(InputError, match=r"B-COEF-007.*converters, others of an IMU"):
        merged_coefficients([Coefficients(imu, calibration), Coefficients(af, converters)])


@pytest.mark.parametrize(
    ("change", "says"),
    [
        ({"matrix": [[1.0, 0.0, 0.0]]}, r"sections\.0.*matrix"),
        ({"bias": [0.0, 0.0, float("nan")]}, "bias"),
        ({"unit": "m"}, "unit"),
    ],
)
def test_a_section_that_is_not_in_the_form_is_refused(change: dict[str, Any], says: str) -> None:
    with pytest.raises(InputError, match=f"B-COEF-006.*{says}"):
        document("cal", triad_section("gyro", triad(), SPAN) | change)


PROGRAM = """
#include <stdio.h>
#include "imu_coefficients.h"
#include "imu_coefficients.h"
int main(void)
{
    double in[3], out[3];
    while (scanf("%lf %lf %lf", &in[0], &in[1], &in[2]) == 3) {
        imu_compensate_accelerometer(in, out);
        printf("%.17g %.17g %.17g ", out[0], out[1], out[2]);
        imu_compensate_gyro(in, out);
        printf("%.17g %.17g %.17g ", out[0], out[1], out[2]);
        imu_compensate_magnetometer(in, out);
        printf("%.17g %.17g\\n", out[0], out[1]);
    }
    printf("%.17g\\n", IMU_ACCELEROMETER_VALID_DEGC[0] + IMU_GYRO_VALID_DEGC[1] + IMU_MAGNETOMETER_VALID_DEGC[0]);
    return IMU_SIMULATED + IMU_HAS_ACCELEROMETER + IMU_HAS_GYRO + IMU_HAS_MAGNETOMETER;
}
"""


@pytest.mark.validates(
    "imu_coefficients.h compiled as C99 without warnings, its numbers",
    against="numpy with the matrices of imu_coefficients.json",
)
def test_header_compiles_and_gives_the_same_numbers(tmp_path: Path, both: dict[str, Any]) -> None:
    (tmp_path / "imu_coefficients.h").write_text(header_text(both))
    (tmp_path / "main.c").write_text(PROGRAM)
    compile_main(tmp_path)
    given = np.random.default_rng(UNIT_SEED).normal(0.0, 1.0, (20, 3))
    lines = "\n".join(" ".join(repr(float(value)) for value in row) for row in given)
    ran = subprocess.run([str(tmp_path / "main")], input=lines, capture_output=True, text=True, check=False)
    assert ran.returncode == 4
    *rows, last = ran.stdout.splitlines()
    found = np.array([[float(text) for text in row.split()] for row in rows])
    bias = np.array([0.1, -0.07, 1e-5 / 3])
    np.testing.assert_allclose(found[:, :3], given @ MATRIX.T + bias, rtol=1e-13, atol=1e-15)
    np.testing.assert_allclose(found[:, 3:6], given @ (1.01 * MATRIX).T - bias, rtol=1e-13, atol=1e-15)
    x, y = PLANE.corrected(given[:, 0], given[:, 1])
    np.testing.assert_allclose(found[:, 6:], np.column_stack([x, y]), rtol=1e-13, atol=1e-15)
    assert float(last) == pytest.approx(24.1 + 31.7 + 24.1)
    (tmp_path / "imu_coefficients.h").write_text(header_text(both | {"sections": []}))
    (tmp_path / "main.c").write_text('#include "imu_coefficients.h"\nint main(void) { return IMU_HAS_GYRO; }\n')
    compile_main(tmp_path, "-fsyntax-only")  # of no section
