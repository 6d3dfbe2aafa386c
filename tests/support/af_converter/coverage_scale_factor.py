"""Scale-factor campaigns whose intervals are held against the truth, and one whose calibrator drifts.

A physics of its own (``fit_simulation``), which shares no line with the product's simulators.
"""

from collections.abc import Mapping
from typing import Any

import fit_simulation as sim
import numpy as np
from trials import without_budgets

from bench.analysis import Estimate, Material, build_results, estimates, is_sound
from bench.systems.af_converter.scale_factor.analysis import analyse

SYSTEM = "scale_factor"
_PROVENANCE = {"simulated": True, "plan_sha256": "", "frame_sha256": "", "session_sha256": "", "software": "coverage"}
_STEADY = (
    "dsf_n", "dsf_p", "dsf_asymmetry", "dsf_n_tc1", "dsf_n_tc2", "dsf_p_tc1", "dsf_p_tc2", "bias_tc1", "bias_tc2",
)  # fmt: skip
_DRIFT_ppm = 5.0  # standard, over the campaign


class Drifting(sim.World):
    """The calibrator drifts steadily; about the middle of the campaign its gain is right."""

    def __init__(self, drift_ppm: float) -> None:
        self.drift_ppm = drift_ppm
        self.share: dict[int, list[float]] = {0: [], 1: []}

    def gain(self, at: sim.Place) -> float:
        if (at.channel, at.nominal_degC) == (1, sim.TEMPERATURES_degC[-1]) and at.step[0] == "closed":
            self.share[at.repeat].append(at.share)
        return 1e-6 * self.drift_ppm * (at.share - 0.5)

    @property
    def change_ppm(self) -> float:
        """From the first visit of the closing repeat's place to the repeat."""
        return self.drift_ppm * float(np.mean(self.share[1]) - np.mean(self.share[0]))


def inside(seed: int) -> dict[str, bool | None]:
    """Return of each quantity whether the interval of one estimate holds the truth; None if it is not sound.

    Of the places of a quantity each campaign gives the next one.
    """
    steady = sim.simulate(seed)
    found = estimates_of(steady, steady.standards)
    seen = {}
    for quantity in _STEADY:
        places = [entry for entry in found if entry.quantity == quantity]
        seen[quantity] = _holds(places[seed % len(places)], steady.truth(places[seed % len(places)]))
    world = Drifting(float(np.random.default_rng([seed, 1]).normal(0.0, _DRIFT_ppm)))
    drifting = sim.simulate(seed, repeat_channel=1, world=world)
    entries = estimates_of(drifting, drifting.standards)
    (drift,) = (entry for entry in entries if entry.quantity == "calibrator_drift")
    return seen | {"calibrator_drift": _holds(drift, world.change_ppm)}


def estimates_of(campaign: sim.SimulatedCampaign, standards: Mapping[str, Any]) -> list[Estimate]:
    """Return the estimates as results.json states them, by a register of standards."""
    with without_budgets():
        analysis = analyse(Material(campaign.rows, campaign.campaign, standards))
    return estimates.estimates_of(build_results("coverage", analysis, {}, _PROVENANCE))


def _holds(entry: Any, truth: float) -> bool | None:
    return bool(abs(entry.value - truth) <= entry.expanded_uncertainty) if is_sound(entry) else None
