"""Wrong worlds of a campaign by the DMM method: what the model says of unit, switch or meter is not so.

Counts by ``fit_simulation``, readings by ``dmm_simulation``: neither shares a line with the product's simulators.
"""

from collections.abc import Callable
from dataclasses import replace
from typing import Any

import dmm_simulation as dmm
import fit_simulation as sim
import numpy as np
from doubt_classes import PROVENANCE, Seen, Switch, changed
from doubt_scale_factor import CLIPPED, EVEN_ORDER, SOFT_SATURATION, Wrong, instead, miscounted

from bench.analysis import Reading, build_results, estimates_of
from bench.systems.af_converter.dmm_method.analysis import analyse

SYSTEM = "dmm_method"
QUANTITIES = ("dsf_n", "dsf_p", "dsf_asymmetry")
_LEVELS_A = sim.KIND["accelerometer"]["levels_A"]
_LENGTH_s = 9000.0 + 45 * 120.0


def swapped_A(w: Wrong, current_A: float, at: sim.Place) -> float:
    """The leads are swapped up to a share of the levels."""
    return -current_A if at.step[1] <= _LEVELS_A[round(w.size * len(_LEVELS_A)) - 1] else current_A


def misread(where: Callable[[float, float, int], float]) -> type[Wrong]:
    """The meter shows more by a part, where: range, time and number of the reading."""
    return changed(Wrong, read_A=lambda w, value_A, *at: value_A * (1.0 + w.size * where(*at)))


def stuck_A(w: Wrong, value_A: float, range_A: float, at_s: float, number: int) -> float:
    """For a share of the campaign the meter repeats the reading that it had before, whatever flows."""
    return 1e-3 if 60 <= number < 60 + w.size else value_A


SWITCHES = (
    Switch("swapped_leads", instead(swapped_A), (0.34, 0.67, 1.0)),
    Switch("soft_saturation", SOFT_SATURATION, (1e-5, 1e-4, 1e-3), "linear_at_full_scale"),
    Switch("clipped", CLIPPED, (1e-5, 1e-3, 1e-1), "linear_at_full_scale"),
    Switch("even_order", EVEN_ORDER, (1e-5, 1e-4, 1e-3), "linear_at_full_scale"),
    Switch(
        "one_bad_record",
        miscounted("n", lambda w, at: w.of_channel(at) and at.step[1:3] == (5e-3, 1)),
        (1e-5, 1e-4, 1e-2),
    ),
    Switch(
        "clock_misread",
        miscounted("af", lambda w, at: w.of_channel(at) and at.step[1] >= 1e-3 and at.step[2] == 1),
        (1e-6, 1e-5, 1e-3),
        "clock_of_polarity",
    ),
    # a part of the current of both polarities goes past the unit
    Switch(
        "switch_leaks",
        changed(Wrong, input_A=lambda w, current_A, at: current_A * (1.0 - w.size)),
        (1e-5, 1e-4, 1e-1),
        "all_current_through_the_unit",
    ),
    # one range of the meter is off by more than its specification, or all by the same
    Switch("meter_range", misread(lambda range_A, at_s, number: range_A == 1e-2), (1e-5, 1e-4, 1e-3), "meter_gain"),
    Switch("meter_gain", misread(lambda range_A, at_s, number: 1.0), (1e-5, 1e-4, 1e-1), "meter_gain"),
    Switch("meter_drifts", misread(lambda range_A, at_s, number: at_s / _LENGTH_s), (1e-6, 1e-5, 1e-3), "steady_meter"),
    Switch("one_bad_reading", misread(lambda range_A, at_s, number: number == 100), (1e-5, 1e-3, 1e-1)),
    Switch("stuck_meter", changed(Wrong, read_A=stuck_A), (1.0, 6.0, 30.0)),
)


def seen(seed: int, switch: Switch | None, size: float, *, noise_free: bool = False) -> Seen:
    """Return what one campaign states and its truth; without a switch that of the same seed in a right world."""
    world = Wrong() if switch is None else switch.world(size)
    analysis, campaign = analysed(seed, world, noise_free=noise_free)
    document = build_results("doubt", analysis, {"records": len(campaign.rows)}, PROVENANCE)
    wanted = [entry for entry in estimates_of(document) if entry.quantity in QUANTITIES]
    chi2 = sum(group["reduced_chi2"] * group["dof"] for group in analysis.groups)
    for entry in analysis.estimates:
        if entry.quantity == "repeat_shift":
            chi2 += (entry.value / entry.std_uncertainty) ** 2
    return Seen(wanted, [campaign.truth(entry) for entry in wanted], chi2, 3 * len(campaign.units))


def analysed(seed: int, world: Wrong, *, noise_free: bool = False) -> tuple[Any, sim.SimulatedCampaign]:
    """Return the analysis of one campaign and its truth."""
    switches = sim.Switches(calibrator_errors=False, offset_A=dmm.OFFSET_A, lag=False)
    if noise_free:
        switches = replace(switches, gain=False, noise=False, quantised=False)
    campaign = sim.simulate(seed, switches, temperatures=(20.0,), repeat_channel=1, world=world)
    meter = dmm.Drawn(np.random.default_rng([seed, 3458]))
    readings = dmm.readings_of(campaign, meter)
    if noise_free:
        meter.gain, meter.zero_A = dict.fromkeys(meter.gain, 0.0), dict.fromkeys(meter.zero_A, 0.0)
        meter.linearity_A = dict.fromkeys(meter.linearity_A, 0.0)
        readings = dmm.readings_of(campaign, meter)
    material = dmm.material(campaign, _read(readings, world), both=False)
    return analyse(material), campaign


def _read(readings: list[Reading], world: Wrong) -> list[Reading]:
    """Return readings as the meter of a world shows them."""
    shown, range_A = [], 0.0
    for number, reading in enumerate(readings):
        value_A = float(reading.value)
        if reading.name == "configure_current":
            range_A = value_A
        elif "zero_range_A" not in reading.conditions:
            value_A = world.read_A(value_A, range_A, reading.t_s, number)
        shown.append(replace(reading, value=value_A))
    return shown
