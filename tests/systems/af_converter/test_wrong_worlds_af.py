"""Scale-factor campaigns of wrong worlds: no number that looks sound, and none lost in a right one.

Counts are made from the physics alone (support/systems); nothing of the product or its simulators makes them.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from typing import Any

import fit_simulation as sim
import pytest

from bench.analysis import Material, build_results, is_sound
from bench.session.coefficients import coefficients_of_session
from bench.systems.af_converter.scale_factor.analysis import analyse

PROVENANCE = {"simulated": True, "plan_sha256": "", "frame_sha256": "", "session_sha256": "", "software": "test"}
Counts = Callable[[Any, dict[str, Any]], dict[str, Any]]


def results_of(seed: int, change: Counts | None = None, channel: int = 0) -> tuple[dict[str, Any], Any, Any]:
    campaign = sim.simulate(seed, sim.Switches())
    rows = campaign.rows if change is None else [_changed(row, change, channel) for row in campaign.rows]
    analysis = analyse(Material(rows, campaign.campaign, campaign.standards))
    return build_results("session", analysis, {"records": len(rows)}, PROVENANCE), analysis, campaign


def _changed(row: Any, change: Counts, channel: int) -> Any:
    if row.window.conditions.get("channel") != channel:
        return row
    return replace(row, sums=change(row, dict(row.sums)))


def swapped(row: Any, sums: dict[str, Any]) -> dict[str, Any]:
    return sums | {"npp": sums["ppp"], "ppp": sums["npp"]}


def saturating(row: Any, sums: dict[str, Any]) -> dict[str, Any]:
    """Lose pulses softly towards full scale: one in a thousand at it, by the fourth power below."""
    share = abs(row.window.conditions.get("current_A", 0.0)) / sim.KIND["accelerometer"]["full_scale_A"]
    kept = 1.0 - 1e-3 * share**4
    return sums | {name: [int(count * kept) for count in sums[name]] for name in ("npp", "ppp")}


def stuck(row: Any, sums: dict[str, Any]) -> dict[str, Any]:
    return sums | {"npp": [7 * 10_000 for _ in sums["npp"]]}


@pytest.mark.parametrize(
    ("change", "channel", "quality", "code"),
    [
        (swapped, 2, "refused", "swapped_leads"),
        (saturating, 2, "doubtful", "lack_of_fit"),
        (stuck, 1, "refused", "stimulus_not_followed"),
    ],
)
def test_a_wrong_channel_is_not_sound_and_the_other_is(change: Counts, channel: int, quality: str, code: str) -> None:
    results, analysis, campaign = results_of(7, change, channel)
    of_wrong = [one for one in results["estimates"] if one["conditions"].get("channel") == channel]
    scale_factors = [one for one in of_wrong if one["quantity"].startswith("dsf_")]
    assert scale_factors
    assert {one["quality"] for one in scale_factors} == {quality}
    assert code in {reason["code"] for one in scale_factors for reason in one["reasons"]}
    others = [one for one in results["estimates"] if one["conditions"].get("channel") == 3 - channel]
    assert all(is_sound(one) for one in others)
    written = coefficients_of_session(analysis, results, campaign.campaign)
    assert written is not None
    assert {part["channel"] for part in written.document["parameters"]} == {3 - channel}


@pytest.mark.parametrize("seed", range(20))
def test_a_right_world_is_not_doubted(seed: int) -> None:
    results, _, _ = results_of(seed)
    assert [one["reasons"] for one in results["estimates"] if not is_sound(one)] == []


@pytest.mark.parametrize(("drift", "least"), [(3e-3, 0), (-3e-3, 0), (3e-5, 30), (-3e-5, 30)])
def test_a_drift_that_the_repeat_found_is_in_every_number_it_bears_on(drift: float, least: int) -> None:
    """Each value that looks sound holds its truth; 0.3 % bends the levels of a visit, 30 ppm do not."""
    campaign = sim.simulate(3, sim.Switches(), repeat_channel=1, drift=drift)
    analysis = analyse(Material(campaign.rows, campaign.campaign, campaign.standards))
    results = build_results("session", analysis, {"records": len(campaign.rows)}, PROVENANCE)
    quantities = ("dsf_n", "dsf_p", "dsf_asymmetry", "dsf_n_tc1", "dsf_p_tc1", "dsf_n_tc2", "dsf_p_tc2")
    stated = [one for one in results["estimates"] if one["quantity"] in quantities and is_sound(one)]
    off = [abs(one["value"] - campaign.truth(one)) / one["expanded_uncertainty"] for one in stated]
    assert len(stated) >= least
    assert max(off, default=0.0) <= 1.5
