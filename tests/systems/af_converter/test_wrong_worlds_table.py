"""Worlds that were once stated with small intervals around wrong values: each is doubted, refused or right now."""

from __future__ import annotations

from dataclasses import dataclass

import doubt_scale_factor as worlds
import fit_simulation as sim
import pytest
from doubt_classes import WRONG, class_of

from bench.analysis import Material, build_results, is_sound
from bench.systems.af_converter.scale_factor.analysis import analyse

FRAMES = 10_000.0  # of a record
STUCK = 7.0  # pulses a frame, whatever the input is


@dataclass(frozen=True)
class StuckCounter(sim.World):
    def counted(self, counts: dict[str, float], at: sim.Place) -> dict[str, float]:
        return counts | {"n": STUCK * FRAMES} if at.channel == worlds.WRONG else counts


def classes(campaign: sim.SimulatedCampaign) -> list[tuple[dict[str, object], str]]:
    analysis = analyse(Material(campaign.rows, campaign.campaign, campaign.standards))
    document = build_results("doubt", analysis, {"records": len(campaign.rows)}, worlds.PROVENANCE)
    entries = [entry for entry in document["estimates"] if entry["quantity"] in worlds.QUANTITIES]
    return [(entry, class_of(entry, campaign.truth(entry), None, 0.0)) for entry in entries]


@pytest.mark.parametrize("seed", range(2))
def test_a_counter_that_stands_at_seven_pulses_a_frame_is_refused(seed: int) -> None:
    found = classes(sim.simulate(seed, world=StuckCounter()))
    assert not [entry for entry, kind in found if kind == WRONG]
    of_it = [entry for entry, _ in found if entry["conditions"]["channel"] == worlds.WRONG]
    assert all(entry["quality"] == "refused" for entry in of_it)
    others = [entry for entry, _ in found if entry["conditions"]["channel"] != worlds.WRONG]
    assert others
    assert all(is_sound(entry) for entry in others)


@pytest.mark.parametrize("repeat", [None, 1])
def test_a_calibrator_that_drifts_by_three_per_mille_leaves_no_small_interval(repeat: int | None) -> None:
    found = classes(sim.simulate(4, repeat_channel=repeat, world=worlds.CalibratorDrift(3e-3)))
    assert found
    assert not [entry for entry, kind in found if kind == WRONG]
