"""Compensation of an IMU out: the document, the merge of two sessions, and the header in a real compiler."""

import json
import subprocess
from pathlib import Path
from typing import Any

import jsonschema
import numpy as np
import pytest
from c_program import compile_main

from bench.analysis import Analysis, build_results, results_json
from bench.model.errors import InputError
from bench.model.systems import systems
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

PROVENANCE = {"simulated": True, "plan_sha256": "a", "frame_sha256": "b", "session_sha256": "c0ffee", "software": "x 1"}
SEED = 609
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
    given = np.random.default_rng(SEED).normal(0.0, 1.0, (20, 3))
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
