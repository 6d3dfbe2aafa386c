"""What a campaign promises and has no result for is never silent: analysis, notes and the terminal table."""

import dataclasses
import io
from collections.abc import Callable
from typing import Any

import fit_simulation as sim
import pytest
from rich.console import Console

from bench.analysis import Analysis, Material, analyse, build_results
from bench.commands.tables import WIDTH, print_results
from bench.model.quality import Quality

PROVENANCE = {"simulated": True, "plan_sha256": "a", "frame_sha256": "b", "session_sha256": "c", "software": "1"}


@pytest.fixture(scope="module")
def campaign() -> sim.SimulatedCampaign:
    return sim.simulate(30, sim.Switches(), repeat_channel=1)


def run(campaign: sim.SimulatedCampaign, keep: Callable[[dict[str, Any]], bool]) -> Analysis:
    rows = [row for row in campaign.rows if keep(row.window.conditions)]
    return analyse(Material(rows, campaign.campaign, campaign.standards))


def printed(analysis: Analysis, width: int = WIDTH) -> str:
    out = Console(file=io.StringIO(), width=width)
    results = build_results("session", analysis, {"records": 1}, PROVENANCE)
    print_results(out, results, analysis)
    assert isinstance(out.file, io.StringIO)
    return out.file.getvalue()


def test_a_complete_campaign_misses_nothing(campaign: sim.SimulatedCampaign) -> None:
    analysis = run(campaign, lambda _: True)
    assert analysis.missing == []
    assert "MISSING" not in printed(analysis)


def test_a_channel_without_a_record_is_missing(campaign: sim.SimulatedCampaign) -> None:
    analysis = run(campaign, lambda conditions: conditions["channel"] == 1)
    assert analysis.missing == ["channel 2: no record"]
    assert "No result: channel 2: no record" in analysis.notes
    assert "MISSING: 1 promised without a result\n  channel 2: no record\n" in printed(analysis)


def test_a_declared_channel_is_promised_at_every_temperature(campaign: sim.SimulatedCampaign) -> None:
    analysis = run(campaign, lambda one: one["channel"] == 1 or one["temperature_degC"] < 30)
    assert analysis.missing == ["channel 2 at 35 degC: no record", "channel 2 at 50 degC: no record"]


def test_a_repeat_whose_records_are_flagged_is_missing(campaign: sim.SimulatedCampaign) -> None:
    rows = [
        dataclasses.replace(row, quality=Quality.TRIPPED) if row.window.conditions["repeat"] else row
        for row in campaign.rows
    ]
    analysis = analyse(Material(rows, campaign.campaign, campaign.standards))
    (one,) = analysis.missing
    assert one.startswith("channel 1 at 50 degC, repeat 1: ")
    assert "left out: 15 tripped" in one
    assert "B-FIT-012" in one


def test_what_is_left_of_a_group_that_is_not_determined_is_told(campaign: sim.SimulatedCampaign) -> None:
    rows = [
        dataclasses.replace(row, quality=Quality.NOT_SETTLED)
        if row.window.conditions["polarity"] < 0 and row.window.number <= 15
        else row
        for row in campaign.rows
    ]
    analysis = analyse(Material(rows, campaign.campaign, campaign.standards))
    (one,) = analysis.missing
    assert one.startswith("channel 1 at -10 degC: K_P is not determined")
    assert one.endswith("(B-FIT-005); left out: 7 not settled")
    assert one in " ".join(printed(analysis).split())


def test_a_missing_bias_is_noted(campaign: sim.SimulatedCampaign) -> None:
    rows = [dataclasses.replace(campaign.rows[0], quality=Quality.TRIPPED), *campaign.rows[1:]]
    analysis = analyse(Material(rows, campaign.campaign, campaign.standards))
    assert analysis.missing == []
    assert any(note == "No bias of channel 1 at -10 degC: its open record is not usable." for note in analysis.notes)


def test_table_shows_set_and_measured_temperature_in_110_columns(campaign: sim.SimulatedCampaign) -> None:
    text = printed(run(campaign, lambda _: True), width=200)
    assert max(len(line.rstrip()) for line in text.splitlines()) <= WIDTH
    analysis = run(campaign, lambda _: True)
    first = next(one for one in analysis.estimates if one["quantity"] == "dsf_n")
    (line,) = [line for line in text.splitlines() if line.split()[:3] == ["1", "gyro", "-10"]]
    assert line.split()[3] == f"{first['conditions']['unit_temperature_degC']:.2f}" != "-10.00"
    assert line.split()[-1] == "pass"
