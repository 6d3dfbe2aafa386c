"""Wrong worlds of a scale-factor campaign: what the model says is not so, in one respect and by a stated size.

A physics of its own (``fit_simulation``), which shares no line with the product's simulators.
"""

from dataclasses import dataclass
from typing import Any

import fit_simulation as sim
import numpy as np
from doubt_classes import Seen, Switch

from bench.analysis import Material, build_results, estimates_of
from bench.systems.af_converter.scale_factor.analysis import analyse

SYSTEM = "scale_factor"
PROVENANCE = {"simulated": True, "plan_sha256": "", "frame_sha256": "", "session_sha256": "", "software": "doubt"}
WRONG = 2  # the channel that is wrong, where one is
QUANTITIES = ("dsf_n", "dsf_p", "dsf_asymmetry", "dsf_n_tc0", "dsf_n_tc1", "dsf_n_tc2", "dsf_p_tc0", "dsf_p_tc1",
              "dsf_p_tc2")  # fmt: skip
_FULL_A = sim.KIND["accelerometer"]["full_scale_A"]
_NOISE_FREE = sim.Switches(gain=False, calibrator_errors=False, noise=False, quantised=False)


@dataclass(frozen=True)
class Wrong(sim.World):
    """A right world; a wrong one departs from it in one method. ``size``: by how much."""

    size: float = 0.0

    def of_channel(self, at: sim.Place) -> bool:
        return at.channel == WRONG

    def read_A(self, value_A: float, range_A: float, at_s: float, number: int) -> float:
        """Return what a meter beside the unit shows; ``number``: of the reading among all."""
        return value_A


class SwappedLeads(Wrong):
    def input_A(self, current_A: float, at: sim.Place) -> float:
        return -current_A if self.of_channel(at) and at.nominal_degC < -20.0 + 100.0 * self.size else current_A


class SoftSaturation(Wrong):
    def input_A(self, current_A: float, at: sim.Place) -> float:
        return current_A * (1.0 - self.size * (current_A / _FULL_A) ** 4) if self.of_channel(at) else current_A


class Clipped(Wrong):
    def input_A(self, current_A: float, at: sim.Place) -> float:
        most_A = 20e-3 * (1.0 - self.size)
        return float(np.clip(current_A, -most_A, most_A)) if self.of_channel(at) else current_A


class CalibratorStep(Wrong):
    def gain(self, at: sim.Place) -> float:
        return self.size if at.share > 0.6 else 0.0


class CalibratorDrift(Wrong):
    def gain(self, at: sim.Place) -> float:
        return self.size * (at.share - 0.5)


class EvenOrder(Wrong):
    def input_A(self, current_A: float, at: sim.Place) -> float:
        return current_A * (1.0 + self.size * current_A / _FULL_A) if self.of_channel(at) else current_A


class OneBadRecord(Wrong):
    AT = (20.0, 5e-3, 1)  # temperature, level, polarity

    def counted(self, counts: dict[str, float], at: sim.Place) -> dict[str, float]:
        hit = self.of_channel(at) and (at.nominal_degC, at.step[1], at.step[2]) == self.AT
        return counts | {"n": counts["n"] * (1.0 + self.size)} if hit else counts

    def hits(self, conditions: dict[str, Any]) -> bool:
        """Return whether a record is the bad one."""
        at = conditions["temperature_degC"], conditions["current_A"], conditions["polarity"]
        return conditions["channel"] == WRONG and at == self.AT


class StuckBits(Wrong):
    def counted(self, counts: dict[str, float], at: sim.Place) -> dict[str, float]:
        if not self.of_channel(at):
            return counts
        return counts | {name: float(counts[name] // self.size * self.size) for name in ("n", "p")}


class DielectricTail(Wrong):
    """After a change of the range the first record lacks a part: the smallest level of each range."""

    def input_A(self, current_A: float, at: sim.Place) -> float:
        first = at.step[2] == 1 and at.step[1] in (0.5e-3, 5e-3)
        return current_A * (1.0 - self.size) if self.of_channel(at) and first else current_A


class OnePolarityRelay(Wrong):
    """The switch leaks to the other pole: a part of the current of negative polarity is lost."""

    def input_A(self, current_A: float, at: sim.Place) -> float:
        return (
            current_A * (1.0 - self.size * abs(current_A) / _FULL_A)
            if self.of_channel(at) and at.step[2] < 0
            else current_A
        )


class SensorGain(Wrong):
    def sensed_degC(self, unit_degC: float) -> float:
        return 20.0 + (unit_degC - 20.0) * (1.0 + self.size)


class ClockSteps(Wrong):
    """The AF clock of the wrong channel's records is read short by a part of a thousand in one visit."""

    def counted(self, counts: dict[str, float], at: sim.Place) -> dict[str, float]:
        hit = at.nominal_degC == 20.0 and at.step[1] >= 1e-3 and at.step[2] == 1
        return counts | {"af": counts["af"] * (1.0 + self.size)} if hit else counts


SWITCHES = (
    Switch("swapped_leads", SwappedLeads, (0.25, 0.5, 1.0)),
    Switch("soft_saturation", SoftSaturation, (1e-5, 1e-4, 1e-3), "converter_linearity"),
    Switch("clipped", Clipped, (1e-5, 1e-3, 1e-1)),
    Switch("calibrator_step", CalibratorStep, (1e-6, 1e-5, 1e-3), "calibrator_drift"),
    Switch("calibrator_drift", CalibratorDrift, (3e-6, 3e-5, 3e-3), "calibrator_drift"),
    Switch("even_order", EvenOrder, (1e-5, 1e-4, 1e-3)),
    Switch("one_bad_record", OneBadRecord, (1e-5, 1e-4, 1e-2)),
    Switch("stuck_bits", StuckBits, (8.0, 256.0, 4096.0)),
    Switch("first_of_a_range", DielectricTail, (1e-5, 1e-4, 1e-3)),
    Switch("one_polarity_lost", OnePolarityRelay, (1e-5, 1e-4, 1e-3)),
    Switch("sensor_gain", SensorGain, (1e-3, 1e-2, 1e-1), "temperature_sensor_gain"),
    Switch("clock_misread", ClockSteps, (1e-6, 1e-5, 1e-3), "clock_counts"),
)


def seen(seed: int, switch: Switch | None, size: float, *, noise_free: bool = False) -> Seen:
    """Return what one campaign states and its truth; without a switch that of the same seed in a right world."""
    world = None if switch is None else switch.world(size)
    switches = _NOISE_FREE if noise_free else sim.Switches()
    campaign = sim.simulate(seed, switches, repeat_channel=1, world=world)
    analysis = analyse(Material(campaign.rows, campaign.campaign, campaign.standards))
    document = build_results("doubt", analysis, {"records": len(campaign.rows)}, PROVENANCE)
    wanted = [
        entry for entry in estimates_of(document) if entry.quantity in QUANTITIES and "repeat" not in entry.conditions
    ]
    chi2 = sum(group["reduced_chi2"] * group["dof"] for group in analysis.groups)
    drifts = [entry for entry in analysis.estimates if entry.quantity in ("dsf_n_drift", "dsf_p_drift")]
    chi2 += sum((entry.value / entry.std_uncertainty) ** 2 for entry in drifts)
    return Seen(wanted, [campaign.truth(entry) for entry in wanted], chi2, _promised(campaign))


def _promised(campaign: Any) -> int:
    visits = len(
        {(row.window.conditions["channel"], row.window.conditions["temperature_degC"]) for row in campaign.rows}
    )
    return 3 * visits + 6 * len(campaign.units)
