"""A check standard is a unit of its own: charted by the history, and in nothing that is said of the unit under test."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import plan_sample
import pytest

from bench.analysis import Analysis, compensation_of_unit, of_check_standard, without_check_standard
from bench.store.contents import contents_of

CAMPAIGN = {"analysis": "scale_factor", "check_standard": {"model": "CS-1", "serial": "0042", "channel": 8}}
ROOT = Path(__file__).resolve().parents[3]


def entry(channel: int) -> dict[str, Any]:
    return {
        "quantity": "dsf_n", "unit": "ppm", "conditions": {"channel": channel}, "value": 1.0 * channel,
        "std_uncertainty": 0.1, "coverage_factor": 2.0, "expanded_uncertainty": 0.2, "n": 3, "dropped": 0,
        "limit": None, "verdict": "none", "quality": "sound", "reasons": [],
    }  # fmt: skip


def document() -> dict[str, Any]:
    provenance = {
        "simulated": True, "plan_sha256": "p", "frame_sha256": "f", "session_sha256": "5ea1", "software": "s",
    }  # fmt: skip
    return {
        "session": "20260401T080000Z_short_SIM-1", "campaign": "scale_factor", "method": "gls", "notes": [],
        "uut": {"model": "NGU", "serial": "SIM-1"}, "estimates": [entry(1), entry(8), entry(2)], "quality": {},
        "provenance": provenance,
    }  # fmt: skip


def test_the_history_keeps_it_as_a_unit_of_its_own() -> None:
    unit, check = contents_of(document(), {"campaign": CAMPAIGN}, None)
    named = [(one.calibration["uut_model"], one.calibration["uut_serial"]) for one in (unit, check)]
    assert named == [("NGU", "SIM-1"), ("CS-1", "0042")]
    assert [len(one.estimates) for one in (unit, check)] == [2, 1]
    assert check.estimates[0]["value"] == 8.0
    assert check.calibration["session"] == "20260401T080000Z_short_SIM-1:0042"
    assert check.calibration["session_sha256"] != unit.calibration["session_sha256"]


def test_what_is_said_of_the_unit_leaves_it_out() -> None:
    parts = [{"channel": 1}, {"channel": 8}, {"channel": None}]
    analysis = Analysis("scale_factor", "gls", {}, [], compensation=parts)
    of_unit, campaign = compensation_of_unit(analysis, {**CAMPAIGN, "channels": [{"number": 1}, {"number": 8}]})
    assert of_unit.compensation == [{"channel": 1}, {"channel": None}]
    assert campaign["channels"] == [{"number": 1}]
    kept = without_check_standard(document(), CAMPAIGN)["estimates"]
    assert [one["conditions"]["channel"] for one in kept] == [1, 2]


def test_a_campaign_without_one_is_left_as_it_is() -> None:
    plain = document()
    analysis = Analysis("scale_factor", "gls", {}, [], compensation=[{"channel": 8}])
    assert compensation_of_unit(analysis, {})[0] is analysis
    assert without_check_standard(plain, {}) is plain
    assert of_check_standard(plain, {}) is None


@pytest.mark.parametrize(("channel", "found"), [(2, []), (9, ["B-PLAN-099"])])
def test_it_stands_on_a_channel_that_is_measured_b_plan_099(tmp_path: Path, channel: int, found: list[str]) -> None:
    text = (ROOT / "sequences" / "scale_factor_short.yaml").read_text()
    path = tmp_path / "scale_factor_short.yaml"
    path.write_text(f"check_standard: {{model: CS-1, serial: '0042', channel: {channel}}}\n{text}")
    assert [one.code for one in plan_sample.mistakes(path)] == found
