"""The whole way on the simulated bench: check, run, page, fit, report, replay, history and certificate."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import pytest
from bench.cli import app
from bench.model.errors import InputErrors
from bench.plan import compile_sequence
from bench.web.recorded.past import Past
from block import SEQUENCE, SETPOINTS_DEGC, by_place
from typer.testing import CliRunner

from resistance_thermometer.world.world import CHANNELS

NAME = "20000101T000000Z_resistance_thermometer_BATCH-1"


def command(*words: object, status: int = 0) -> str:
    done = CliRunner().invoke(app, [str(word) for word in words], catch_exceptions=False)
    assert done.exit_code == status, done.output
    return done.output


@pytest.fixture(scope="module")
def session(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("thermometers")
    out = command("run", SEQUENCE, "--clock", "virtual", "--seed", 3, "--out", folder, "--truth")
    assert "Tolerance classes" in out
    assert "32 pass" in out
    return folder / NAME


def results_of(folder: Path) -> dict[str, Any]:
    document: dict[str, Any] = json.loads((folder / "results.json").read_text())
    return document


def test_the_check_finds_no_mistake() -> None:
    assert "no mistake found" in command("check", SEQUENCE)


def test_the_results_hold_the_truth(session: Path) -> None:
    estimates = results_of(session)["estimates"]
    truth = json.loads((session.parent / f"{NAME}.truth.json").read_text())["estimates"]
    deviations, true = by_place(estimates, "deviation"), by_place(truth, "deviation")
    assert deviations.keys() == true.keys() == {(channel, t) for channel in CHANNELS for t in SETPOINTS_DEGC}
    for place, entry in deviations.items():
        assert abs(entry["value"] - true[place]["value"]) < entry["expanded_uncertainty"]
        assert entry["n"] == 20


def test_every_reader_of_a_session_takes_it(session: Path) -> None:
    assert "every number is identical" in command("replay", session)
    assert "8 records, 0 frames" in command("fit", session)
    assert "identical" in command("report", session, "--verify")
    history = f"sqlite:///{session.parent / 'history.sqlite'}"
    assert "P-101" in command("history", "list", "--history", history)
    assert "certificate.specimen.xml" in command("certificate", session, "--specimen")
    (session / "certificate.specimen.xml").unlink()


def test_the_report_shows_tables_figures_and_the_budget(session: Path) -> None:
    report = (session / "report.html").read_text()
    for words in ("Tolerance classes", "Coefficients", "Deviations", "Residuals of the fit", "reference probe"):
        assert words in report
    assert "calibration of the reference probe" in report
    assert "SIM-0104" in report


def test_the_page_shows_the_session(session: Path) -> None:
    state = Past().final(session)
    assert (state["records"]["done"], state["records"]["planned"]) == (8, 8)
    assert state["records"]["last"][0]["readings"] == 120


@pytest.mark.parametrize(
    ("option", "said"),
    [("two_wire=on", "connected with two wires"), ("reference_degC=-8", "beside the chamber's air")],
)
def test_what_is_wrong_on_the_bench_is_said(tmp_path: Path, option: str, said: str) -> None:
    command("run", SEQUENCE, "--seed", 3, "--out", tmp_path, "--set", f"world.{option}", status=1)
    assert any(said in sentence for sentence in results_of(tmp_path / NAME)["notes"])


@pytest.mark.parametrize(
    ("old", "new", "said"),
    [
        ("channel: 102, tol", "channel: 101, tol", "channel 101 is stated twice"),
        ("tolerance_class: B", "tolerance_class: D", "'A' or 'B'"),
        ("self_heating: 0.005 degC}\n    - {serial: P-102", "self_heating: 5}\n    - {serial: P-102", "has no unit"),
    ],
)
def test_a_mistake_in_the_sequence_is_found_by_the_check(tmp_path: Path, old: str, new: str, said: str) -> None:
    for kind in ("sequences", "stations"):
        (tmp_path / kind).mkdir()
        for path in (SEQUENCE.parents[1] / kind).iterdir():
            (tmp_path / kind / path.name).write_text(path.read_text().replace(old, new))
    with pytest.raises(InputErrors) as caught:
        compile_sequence(tmp_path / "sequences" / SEQUENCE.name)
    assert any(said in error.message for error in caught.value.errors)
