"""Wrong worlds of a scale-factor campaign: what the model says is not so, in one respect and by a stated size.

A physics of its own (``fit_simulation``), which shares no line with the product's simulators.
"""

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import fit_simulation as sim
import numpy as np
from doubt_classes import PROVENANCE, Seen, Switch, changed
from trials import without_budgets

from bench.analysis import Material, build_results, estimates_of
from bench.systems.af_converter.scale_factor.analysis import analyse

SYSTEM = "scale_factor"
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


def instead(current_A: Callable[[Wrong, float, sim.Place], float]) -> type[Wrong]:
    """Another current reaches the integrator of the wrong channel."""
    return changed(Wrong, input_A=lambda w, right_A, at: current_A(w, right_A, at) if w.of_channel(at) else right_A)


def miscounted(name: str, where: Callable[[Wrong, sim.Place], bool]) -> type[Wrong]:
    """These counts are larger by a part where this holds."""
    return changed(Wrong, counted=lambda w, counts, at: counts | {name: counts[name] * (1.0 + w.size * where(w, at))})


def stuck_bits(w: Wrong, counts: dict[str, float], at: sim.Place) -> dict[str, float]:
    if not w.of_channel(at):
        return counts
    return counts | {name: float(counts[name] // w.size * w.size) for name in ("n", "p")}


BAD_RECORD = (20.0, 5e-3, 1)  # temperature, level, polarity


def is_bad(conditions: dict[str, Any]) -> bool:
    """Return whether a record is the bad one."""
    at = conditions["temperature_degC"], conditions["current_A"], conditions["polarity"]
    return conditions["channel"] == WRONG and at == BAD_RECORD


SOFT_SATURATION = instead(lambda w, current_A, at: current_A * (1.0 - w.size * (current_A / _FULL_A) ** 4))
CLIPPED = instead(lambda w, current_A, at: float(np.clip(current_A, -20e-3 * (1.0 - w.size), 20e-3 * (1.0 - w.size))))
EVEN_ORDER = instead(lambda w, current_A, at: current_A * (1.0 + w.size * current_A / _FULL_A))
CALIBRATOR_STEP = changed(Wrong, gain=lambda w, at: w.size * (at.share > 0.6))
CALIBRATOR_DRIFT = changed(Wrong, gain=lambda w, at: w.size * (at.share - 0.5))
ONE_BAD_RECORD = miscounted("n", lambda w, at: w.of_channel(at) and (at.nominal_degC, *at.step[1:3]) == BAD_RECORD)
STUCK_BITS = changed(Wrong, counted=stuck_bits)
SWITCHES = (
    Switch(
        "swapped_leads",
        instead(lambda w, current_A, at: -current_A if at.nominal_degC < -20.0 + 100.0 * w.size else current_A),
        (0.25, 0.5, 1.0),
    ),
    Switch("soft_saturation", SOFT_SATURATION, (1e-5, 1e-4, 1e-3), "converter_linearity"),
    Switch("clipped", CLIPPED, (1e-5, 1e-3, 1e-1)),
    Switch("calibrator_step", CALIBRATOR_STEP, (1e-6, 1e-5, 1e-3), "calibrator_drift"),
    Switch("calibrator_drift", CALIBRATOR_DRIFT, (3e-6, 3e-5, 3e-3), "calibrator_drift"),
    Switch("even_order", EVEN_ORDER, (1e-5, 1e-4, 1e-3)),
    Switch("one_bad_record", ONE_BAD_RECORD, (1e-5, 1e-4, 1e-2)),
    Switch("stuck_bits", STUCK_BITS, (8.0, 256.0, 4096.0)),
    # after a change of the range the first record lacks a part: the smallest level of each range
    Switch(
        "first_of_a_range",
        instead(
            lambda w, current_A, at: current_A * (1.0 - w.size * (at.step[2] == 1 and at.step[1] in (0.5e-3, 5e-3)))
        ),
        (1e-5, 1e-4, 1e-3),
    ),
    # the switch leaks to the other pole: a part of the current of negative polarity is lost
    Switch(
        "one_polarity_lost",
        instead(lambda w, current_A, at: current_A * (1.0 - w.size * abs(current_A) / _FULL_A * (at.step[2] < 0))),
        (1e-5, 1e-4, 1e-3),
    ),
    Switch(
        "sensor_gain",
        changed(Wrong, sensed_degC=lambda w, unit_degC: 20.0 + (unit_degC - 20.0) * (1.0 + w.size)),
        (1e-3, 1e-2, 1e-1),
        "temperature_sensor_gain",
    ),
    # the AF clock is read short by a part of a thousand in one visit
    Switch(
        "clock_misread",
        miscounted("af", lambda w, at: at.nominal_degC == 20.0 and at.step[1] >= 1e-3 and at.step[2] == 1),
        (1e-6, 1e-5, 1e-3),
        "clock_counts",
    ),
)


def seen(seed: int, switch: Switch | None, size: float, *, noise_free: bool = False) -> Seen:
    """Return what one campaign states and its truth; without a switch that of the same seed in a right world."""
    world = None if switch is None else switch.world(size)
    switches = _NOISE_FREE if noise_free else sim.Switches()
    campaign = sim.simulate(seed, switches, repeat_channel=1, world=world)
    with without_budgets():
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
