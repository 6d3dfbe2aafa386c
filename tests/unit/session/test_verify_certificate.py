"""A certificate is held against the results it was made from, in whatever order these name their conditions."""

from __future__ import annotations

import json
from pathlib import Path

import pytest
from dcc_sample import calibration, estimate

from bench.analysis import results_json
from bench.commands.verify import check_certificates
from bench.report.dcc import certificate_text
from bench.session.verification import Verification

NAME = "certificate.specimen.xml"


@pytest.mark.parametrize("value", [3.5, 3.6])
def test_conditions_of_an_analysis_in_an_order_that_is_not_that_of_the_file(tmp_path: Path, value: float) -> None:
    conditions = {"temperature_degC": 50.0, "channel": 1, "repeat": 1, "kind": "gyro"}
    made = calibration(estimates=[estimate("dsf_n_drift", "ppm", 3.5, 0.9, conditions=conditions)], specimen=True)
    stored = json.loads(results_json(made.results))
    made = calibration(estimates=stored["estimates"], specimen=True)
    (tmp_path / NAME).write_text(certificate_text(made))
    today = calibration(estimates=[estimate("dsf_n_drift", "ppm", value, 0.9, conditions=conditions)], specimen=True)
    results = {**today.results, "provenance": {**today.results["provenance"], "session_sha256": "5" * 64}}
    found = Verification()
    check_certificates(found, tmp_path, today.manifest, results)
    assert found.compared == [NAME]
    assert bool(found.changes) == (value != 3.5)
