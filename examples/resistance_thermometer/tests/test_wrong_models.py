"""What the data look like if something is not as stated, and what the analysis says then."""

from __future__ import annotations

from typing import Any

import pytest
from bench.analysis import Analysis
from block import SETPOINTS_DEGC, SLOT_S, by_place, material

from resistance_thermometer.system.analysis import analyse


def wrong(**options: Any) -> Analysis:
    return analyse(material(3, **options)[0])


def note(found: Analysis, words: str) -> str:
    return next((sentence for sentence in found.notes if words in sentence), "")


def test_nothing_is_doubted_where_all_is_as_stated() -> None:
    for seed in range(10):
        found = analyse(material(seed)[0])
        assert [sentence for sentence in found.notes if "cvd_c is not determined" not in sentence] == []
        assert found.missing == []


def test_leads_that_are_joined_are_seen_as_a_resistance_in_series() -> None:
    """The equation fits them as well as ever: only the course of the departure tells leads from another R0."""
    found = wrong(two_wire=True)
    assert "+3.0" in note(found, "P-104 is outside of class B, most likely as if")
    assert "two wires" in note(found, "P-104 is outside")
    assert not note(found, "P-101 is outside")
    deviations = by_place(found.estimates, "deviation")
    assert {deviations[104, t]["verdict"] for t in SETPOINTS_DEGC} == {"fail"}


def test_another_platinum_is_seen_in_its_coefficient() -> None:
    found = wrong(alloy_ppm=17_000.0)
    assert "platinum of another alloy" in note(found, "P-104 is outside")
    value = by_place(found.estimates, "cvd_a")[104, None]["value"]
    assert value == pytest.approx(3908.3 * 1.017, abs=5.0)


def test_thermometers_that_change_places_break_the_equation() -> None:
    """From the fifth set-point on; where they are as far apart as their class allows."""
    seeds = []
    for seed in range(20):
        found = analyse(material(seed, exchanged_s=4 * SLOT_S)[0])
        seeds += [seed] if any("was it moved, exchanged" in sentence for sentence in found.missing) else []
    assert len(seeds) >= 5
    found = analyse(material(seeds[0], exchanged_s=4 * SLOT_S)[0])
    refused = {sentence.split(" ")[0] for sentence in found.missing}
    assert refused <= {"P-101", "P-102"}
    assert not {(101, None)} & by_place(found.estimates, "r0").keys() or "P-101" not in refused
    assert len(by_place(found.estimates, "deviation")) == 4 * len(SETPOINTS_DEGC)


def test_a_wrong_reference_is_doubted_before_four_thermometers_are() -> None:
    found = wrong(reference_degC=0.6)
    assert "look for the cause in what they have in common" in note(found, "All 4 thermometers deviate by about -0.")


def test_a_reference_that_lies_outside_of_the_chamber_is_seen_by_the_air() -> None:
    found = wrong(reference_degC=-8.0)
    assert "-8" in note(found, "beside the chamber's air")
