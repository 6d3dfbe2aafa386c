"""The analysis on simulated campaigns: intervals that hold, what enters them, and what cannot be used."""

from __future__ import annotations

from copy import deepcopy
from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from bench.analysis import Material, build_results
from bench.model.errors import FitError
from block import SETPOINTS_DEGC, by_place, material, standards

from resistance_thermometer.system.analysis import analyse
from resistance_thermometer.world.world import CHANNELS

PROVENANCE = {"simulated": True, "plan_sha256": "", "frame_sha256": "", "session_sha256": "", "software": "x"}
CAMPAIGNS = 40


def test_a_campaign_gives_every_estimate() -> None:
    found = analyse(material(1)[0])
    assert not found.missing
    deviations = by_place(found.estimates, "deviation")
    assert set(deviations) == {(channel, t) for channel in CHANNELS for t in SETPOINTS_DEGC}
    limits = {place: entry["limit"] for place, entry in deviations.items()}
    assert limits[101, 100.0] == pytest.approx(0.35, abs=1e-3)
    assert limits[104, 100.0] == pytest.approx(0.80, abs=2e-3)
    assert {entry["verdict"] for entry in deviations.values()} == {"pass"}
    for quantity, unit in (("r0", "ohm"), ("cvd_a", "ppm/degC"), ("cvd_b", "ppm/degC2")):
        entries = by_place(found.estimates, quantity)
        assert [entry["unit"] for entry in entries.values()] == [unit] * len(CHANNELS)
    assert {entry["conditions"]["unit"] for entry in found.estimates} == {"P-101", "P-102", "P-103", "P-104"}
    build_results("name", found, {}, PROVENANCE)


def test_intervals_hold_the_truth() -> None:
    """One campaign shares the errors of its standards, so it counts once: is the worst of a campaign inside?"""
    inside: dict[str, list[bool]] = {"r0": [], "deviation": []}
    for seed in range(CAMPAIGNS):
        campaign, truth = material(seed)
        estimates = analyse(campaign).estimates
        for quantity, hits in inside.items():
            true = by_place(truth, quantity)
            for place, entry in by_place(estimates, quantity).items():
                hits.append(abs(entry["value"] - true[place]["value"]) < entry["expanded_uncertainty"])
    shares = {quantity: float(np.mean(hits)) for quantity, hits in inside.items()}
    assert all(0.90 < share <= 1.0 for share in shares.values()), shares


def with_stated(role: str, name: str, factor: float) -> dict[str, dict[str, Any]]:
    changed = deepcopy(standards())
    changed[role]["stated"][name]["value"] *= factor
    return changed


@pytest.mark.parametrize(
    ("role", "name"),
    [
        ("reference_probe", "uncertainty"), ("meter", "resistance_relative"), ("meter", "resistance_floor"),
        ("scanner", "resistance_relative"), ("scanner", "resistance_floor"), ("chamber", "uniformity"),
        ("chamber", "stability"),
    ],
)  # fmt: skip
def test_every_stated_uncertainty_is_in_the_result(role: str, name: str) -> None:
    campaign, _ = material(1)
    place = (101, 100.0)
    before = by_place(analyse(campaign).estimates, "deviation")[place]["std_uncertainty"]
    worse = replace(campaign, standards=with_stated(role, name, 20.0))
    after = by_place(analyse(worse).estimates, "deviation")[place]["std_uncertainty"]
    assert after > 2.0 * before


def test_the_calibration_of_the_reference_is_in_r0_and_is_not_averaged_away() -> None:
    campaign, _ = material(1)
    worse = replace(campaign, standards=with_stated("reference_probe", "uncertainty", 50.0))  # 0.5 degC standard
    entry = by_place(analyse(worse).estimates, "r0")[101, None]
    assert entry["std_uncertainty"] == pytest.approx(0.5 * 0.39, rel=0.05)


def without(campaign: Material, role: str, channel: int = 0, degC: float | None = None) -> Material:
    """The readings of one instrument or channel gave no value, at one set-point or at all."""
    return replace(campaign, readings=[
        replace(reading, value=None)
        if (reading.role, reading.arguments.get("channel", 0)) == (role, channel)
        and degC in (None, reading.conditions["temperature_degC"])
        else reading
        for reading in campaign.readings
    ])  # fmt: skip


def test_a_thermometer_that_was_not_read_is_missing_and_the_others_are_not() -> None:
    found = analyse(without(material(1)[0], "scanner", 102))
    assert len(found.missing) == len(SETPOINTS_DEGC) + 1
    assert any("P-102 (channel 102): coefficients" in sentence for sentence in found.missing)
    assert {entry["conditions"]["channel"] for entry in found.estimates} == set(CHANNELS) - {102}
    build_results("name", found, {}, PROVENANCE)


def test_one_point_less_is_named_and_the_rest_is_used() -> None:
    found = analyse(without(material(1)[0], "meter", degC=40.0))
    assert found.missing == [f"P-{n} (channel {n}): deviation at 40 degC, nothing to compare there" for n in CHANNELS]
    assert len(by_place(found.estimates, "r0")) == len(CHANNELS)


def test_what_the_manifest_lacks_is_named() -> None:
    campaign, _ = material(1)
    lacking = deepcopy(standards())
    del lacking["reference_probe"]["stated"]["r0"]
    cases = [
        (replace(campaign, campaign={**campaign.campaign, "thermometers": []}), "RT-SET-001", "no thermometers"),
        (replace(campaign, standards=lacking), "RT-SET-002", "does not state 'r0' of reference_probe, in ohm"),
        (replace(campaign, rows=[]), "RT-SET-003", "no record can be used"),
    ]
    for changed, code, said in cases:
        with pytest.raises(FitError, match=said) as caught:
            analyse(changed)
        assert caught.value.code == code
    with pytest.raises(FitError) as caught:
        analyse(campaign, "by eye")
    assert caught.value.code == "B-FIT-004"
