"""Partial fits of a session that is not finished."""

from __future__ import annotations

import json
import os
import shutil
from pathlib import Path

import pytest
from trend_sample import run_short, short_plan

from bench.analysis import analyse
from bench.model.systems import analyses
from bench.session import partial as command
from bench.session.predicted import predicted
from bench.session.service import read_view
from bench.session.view import material_of

MAIN = analyses()["scale_factor"][0].main


@pytest.fixture(scope="module")
def session(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return run_short(tmp_path_factory.mktemp("partial"))[0].folder


def test_a_finished_session_gives_its_main_estimates(session: Path) -> None:
    found = command.partial(session)
    full = {
        (one["quantity"], one["conditions"]["channel"], one["conditions"]["temperature_degC"]): one["value"]
        for one in analyse(material_of(read_view(session))).estimates
        if one["quantity"] in MAIN
    }
    assert found["records"] > 0
    assert {row["quantity"] for row in found["rows"]} >= {"dsf_n", "dsf_p"}
    assert next(row["titles"]["en"] for row in found["rows"] if row["quantity"] == "dsf_n") == "Scale-factor error N"
    for row in found["rows"]:
        assert set(row) == {*command.KEYS, "titles", "predicted_uncertainty", "expected_uncertainty"}
        assert row["expected_uncertainty"] == pytest.approx(row["expanded_uncertainty"], rel=1e-12), "nothing comes"
        assert "unit_temperature_degC" not in row["conditions"], "what is measured does not name an estimate"
        key = (row["quantity"], row["conditions"]["channel"], row["conditions"]["temperature_degC"])
        assert row["value"] == full.pop(key)
    assert full == {}


def test_a_session_that_has_just_begun_says_what_is_expected_and_why_nothing_is_determined(
    session: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(os, "nice", lambda step: 0)
    shutil.copy(session / "session.0001.mcap", tmp_path)
    content = (tmp_path / "session.0001.mcap").read_bytes()
    (tmp_path / "session.0001.mcap").write_bytes(content[: len(content) // 4])
    assert command.main([str(tmp_path)]) == 0
    said = json.loads(capsys.readouterr().out)
    assert said["why"] != ""
    whole = predicted(short_plan()).estimates
    assert len(said["rows"]) == len([entry for entry in whole if entry["quantity"] in MAIN])
    for row in said["rows"]:
        assert (row["value"], row["expanded_uncertainty"], row["quality"]) == (None, None, None)
        assert row["expected_uncertainty"] == row["predicted_uncertainty"] > 0.0


def test_what_is_no_session_is_refused(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(os, "nice", lambda step: 0)
    assert command.main([str(tmp_path)]) == 2
    assert "B-REC-010" in capsys.readouterr().err
