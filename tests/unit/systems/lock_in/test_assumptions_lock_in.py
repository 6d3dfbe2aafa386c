"""What no record of a ring laser can show is said, with sizes."""

from __future__ import annotations

import doubt_lock_in as worlds

from bench.model.assumptions import assumptions_of


def test_every_hidden_switch_is_named() -> None:
    named = {taken.code for taken in assumptions_of({"analysis": "rlg_lock_in", "site": {"latitude_deg": 37.0}})}
    assert {switch.assumption for switch in worlds.SWITCHES if switch.assumption} <= named
    assert len(named) == 6


def test_latitude_is_stated_with_its_size() -> None:
    """d(1 / cos^2) / (1 / cos^2) = 2 tan(latitude) d(latitude): 2.6 % at 37 deg, by hand."""
    (latitude,) = [
        taken
        for taken in assumptions_of({"analysis": "rlg_lock_in", "site": {"latitude_deg": 37.0}})
        if taken.code == "latitude"
    ]
    assert latitude.effect.endswith("at 37 deg, 1 deg is 2.6 % of it.")
    assert latitude.quantities == ("alignment_time",)


def test_a_campaign_without_a_site_has_its_assumptions() -> None:
    assert len(assumptions_of({"analysis": "rlg_lock_in"})) == 6
