"""Campaigns by the DMM method for the tests: what the meter says is made from its specification, without bench.fit."""

import dataclasses
from typing import Any

import fit_simulation as sim
import numpy as np

from bench.analysis import Analysis, Material, Reading
from bench.systems.af_converter.dmm_method import analysis as dmm_method

SPECIFICATION = {
    1e-4: (20e-6, 8e-6),
    1e-3: (20e-6, 5e-6),
    1e-2: (20e-6, 5e-6),
    1e-1: (35e-6, 5e-6),
    1.0: (110e-6, 10e-6),
}
OFFSET_A = 3e-9  # of the calibrator, in every range: nothing the method may notice
QUANTITIES = ("dsf_n", "dsf_p")


@dataclasses.dataclass
class Drawn:
    """Errors of a meter: relative gain, zero and linearity of each range."""

    rng: np.random.Generator
    one_gain: bool = False  # every range off by the same number of standard deviations
    noise: float = 1e-9  # of a reading, of its range

    def __post_init__(self) -> None:
        shared = self.rng.normal()
        draws = {full: shared if self.one_gain else self.rng.normal() for full in SPECIFICATION}
        self.gain = {full: draws[full] * relative / 2 for full, (relative, _) in SPECIFICATION.items()}
        self.zero_A = {full: self.rng.normal(0, floor / 2) * full for full, (_, floor) in SPECIFICATION.items()}
        self.linearity_A: dict[tuple[float, float], float] = {}

    def says_A(self, true_A: float, level_A: float, full: float) -> float:
        key = full, level_A
        if level_A and key not in self.linearity_A:
            self.linearity_A[key] = self.rng.normal(0, SPECIFICATION[full][1] / 2) * full
        noise_A = self.rng.normal(0, self.noise) * full
        return true_A * (1 + self.gain[full]) + self.zero_A[full] + self.linearity_A.get(key, 0.0) + noise_A


def meter_range(level_A: float) -> float:
    return next(full for full in SPECIFICATION if max(level_A, 3e-5) <= 1.2 * full)


def readings_of(campaign: sim.SimulatedCampaign, meter: Drawn, zeros: bool = True) -> list[Reading]:
    """Three readings before every closed record, and before all records the zero of each range."""
    found: list[Reading] = []

    def add(t_s: float, name: str, value: float, **conditions: float) -> None:
        found.append(Reading(t_s, len(found), "dmm", name, value, conditions))

    for index, full in enumerate(SPECIFICATION if zeros else ()):
        add(10.0 * index - 60.0, "configure_current", full, zero_range_A=full)
        for second in (1, 2, 3):
            add(10.0 * index - 60.0 + second, "measure_current", meter.says_A(0.0, 0.0, full), zero_range_A=full)
    for row in campaign.rows:
        conditions = row.window.conditions
        if conditions["route"] == "closed":
            begin_s, full = 1e-9 * row.window.t_start_ns - 10.0, meter_range(conditions["current_A"])
            true_A = conditions["current_A"] * (1 + campaign.gain) + OFFSET_A
            add(begin_s, "configure_current", full)
            for second in (1, 2, 3):
                add(begin_s + second, "measure_current", meter.says_A(true_A, conditions["current_A"], full))
    return found


def standards() -> dict[str, Any]:
    lines = [{"range_A": full, "relative": r, "floor_A": f * full} for full, (r, f) in SPECIFICATION.items()]
    return {"dmm": {"driver": "hp_3458a", "serial": "1", "uncertainty": lines, "corrections": []}}


def simulate(seed: int, **meter: Any) -> tuple[sim.SimulatedCampaign, Drawn]:
    switches = sim.Switches(calibrator_errors=False, offset_A=OFFSET_A, lag=False)
    campaign = sim.simulate(seed, switches, temperatures=(20.0,), repeat_channel=1)
    return campaign, Drawn(np.random.default_rng([seed, 3458]), **meter)


def material(campaign: sim.SimulatedCampaign, readings: list[Reading], both: bool = True) -> Material:
    register = standards() | (campaign.standards if both else {})
    return Material(campaign.rows, campaign.campaign | {"analysis": "dmm_method"}, register, readings=readings)


def analysed(
    seed: int, method: str = "joint", both: bool = True, **meter: bool
) -> tuple[Analysis, sim.SimulatedCampaign]:
    campaign, drawn = simulate(seed, **meter)
    return dmm_method.analyse(material(campaign, readings_of(campaign, drawn), both), method), campaign
