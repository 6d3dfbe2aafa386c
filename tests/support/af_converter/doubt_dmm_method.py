"""Wrong worlds of a campaign by the DMM method: what the model says of unit, switch or meter is not so.

Counts by ``fit_simulation``, readings by ``dmm_simulation``: neither shares a line with the product's simulators.
"""

from dataclasses import replace
from typing import Any

import dmm_simulation as dmm
import fit_simulation as sim
import numpy as np
from doubt_classes import Seen, Switch
from doubt_scale_factor import Clipped, EvenOrder, SoftSaturation, Wrong

from bench.analysis import Reading, build_results, estimates_of
from bench.systems.af_converter.dmm_method.analysis import analyse

SYSTEM = "dmm_method"
PROVENANCE = {"simulated": True, "plan_sha256": "", "frame_sha256": "", "session_sha256": "", "software": "doubt"}
QUANTITIES = ("dsf_n", "dsf_p", "dsf_asymmetry")
_LEVELS_A = sim.KIND["accelerometer"]["levels_A"]
_LENGTH_s = 9000.0 + 45 * 120.0


class SwappedLeads(Wrong):
    """The leads are swapped up to a share of the levels."""

    def input_A(self, current_A: float, at: sim.Place) -> float:
        swapped = at.step[1] <= _LEVELS_A[round(self.size * len(_LEVELS_A)) - 1]
        return -current_A if self.of_channel(at) and swapped else current_A


class OneBadRecord(Wrong):
    def counted(self, counts: dict[str, float], at: sim.Place) -> dict[str, float]:
        hit = self.of_channel(at) and (at.step[1], at.step[2]) == (5e-3, 1)
        return counts | {"n": counts["n"] * (1.0 + self.size)} if hit else counts


class ClockMisread(Wrong):
    def counted(self, counts: dict[str, float], at: sim.Place) -> dict[str, float]:
        hit = self.of_channel(at) and at.step[1] >= 1e-3 and at.step[2] == 1
        return counts | {"af": counts["af"] * (1.0 + self.size)} if hit else counts


class SwitchLeaks(Wrong):
    """A part of the current of both polarities goes past the unit."""

    def input_A(self, current_A: float, at: sim.Place) -> float:
        return current_A * (1.0 - self.size)


class MeterRange(Wrong):
    """One range of the meter is off by more than its specification."""

    def read_A(self, value_A: float, range_A: float, at_s: float, number: int) -> float:
        return value_A * (1.0 + self.size) if range_A == 1e-2 else value_A


class MeterGain(Wrong):
    """All ranges of the meter are off by the same."""

    def read_A(self, value_A: float, range_A: float, at_s: float, number: int) -> float:
        return value_A * (1.0 + self.size)


class MeterDrifts(Wrong):
    def read_A(self, value_A: float, range_A: float, at_s: float, number: int) -> float:
        return value_A * (1.0 + self.size * at_s / _LENGTH_s)


class OneBadReading(Wrong):
    def read_A(self, value_A: float, range_A: float, at_s: float, number: int) -> float:
        return value_A * (1.0 + self.size) if number == 100 else value_A


class StuckMeter(Wrong):
    """For a share of the campaign the meter repeats the reading that it had before, whatever flows."""

    def read_A(self, value_A: float, range_A: float, at_s: float, number: int) -> float:
        return 1e-3 if 60 <= number < 60 + self.size else value_A


SWITCHES = (
    Switch("swapped_leads", SwappedLeads, (0.34, 0.67, 1.0)),
    Switch("soft_saturation", SoftSaturation, (1e-5, 1e-4, 1e-3), "linear_at_full_scale"),
    Switch("clipped", Clipped, (1e-5, 1e-3, 1e-1), "linear_at_full_scale"),
    Switch("even_order", EvenOrder, (1e-5, 1e-4, 1e-3), "linear_at_full_scale"),
    Switch("one_bad_record", OneBadRecord, (1e-5, 1e-4, 1e-2)),
    Switch("clock_misread", ClockMisread, (1e-6, 1e-5, 1e-3), "clock_of_polarity"),
    Switch("switch_leaks", SwitchLeaks, (1e-5, 1e-4, 1e-1), "all_current_through_the_unit"),
    Switch("meter_range", MeterRange, (1e-5, 1e-4, 1e-3), "meter_gain"),
    Switch("meter_gain", MeterGain, (1e-5, 1e-4, 1e-1), "meter_gain"),
    Switch("meter_drifts", MeterDrifts, (1e-6, 1e-5, 1e-3), "steady_meter"),
    Switch("one_bad_reading", OneBadReading, (1e-5, 1e-3, 1e-1)),
    Switch("stuck_meter", StuckMeter, (1.0, 6.0, 30.0)),
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
