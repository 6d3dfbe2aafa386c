"""Two units measured with one calibrator whose every error is drawn, its own calibration's from N(0, U / k).

The errors are drawn here and enter the physics of ``fit_simulation``; the analysis knows the register alone.
"""

import math
from collections.abc import Sequence
from typing import Any

import fit_simulation as sim
import numpy as np
from coverage_scale_factor import estimates_of

from bench.analysis import covariance_by_standards, is_sound
from bench.maths.verdict import coverage_factor

SYSTEM = "standards"
U, K = 24e-6, 2.4  # of the certificate, larger than of any real one: what leaves it out is seen at once
GAIN = 10e-6  # standard, of the specification


class Calibrator(sim.World):
    """One calibrator: gain, calibration, offset of each range and linearity of each level, the same for every unit."""

    def __init__(self, seed: int) -> None:
        rng = np.random.default_rng([seed, 3])
        self.relative = rng.normal(0.0, GAIN) + rng.normal(0.0, U / K)
        self.offset_A = {full: rng.normal(0.0, floor / 2.0) for full, floor in sim.FLOOR_A.items()}
        levels_A = {level for kind in sim.KIND.values() for level in kind["levels_A"]}
        self.linearity_A = {
            level: rng.normal(0.0, sim.FLOOR_A[sim.smallest_range(level)] / 2.0) for level in sorted(levels_A)
        }

    def gain(self, at: sim.Place) -> float:
        return self.relative

    def input_A(self, current_A: float, at: sim.Place) -> float:
        route, level_A, polarity, full_A = at.step
        if route == "open":
            return current_A
        return current_A + polarity * (self.offset_A[full_A] + self.linearity_A.get(level_A, 0.0))


def register() -> dict[str, Any]:
    """Return the register of a calibrator with relative specifications, all ranges calibrated with one standard."""
    _, standards = sim.manifest({})
    traced = {"specification": "relative", "certificate_U": U, "k": K, "common_with": "resistor 7"}
    lines = [line | traced for line in standards["calibrator"]["uncertainty"]]
    return {"calibrator": standards["calibrator"] | {"model": "5720A", "certificate": "C-1", "uncertainty": lines}}


def inside(seed: int) -> dict[str, bool | None]:
    """Return of each quantity whether the interval of one estimate holds the truth; None if it is not sound.

    Of the differences, too: of two channels of one certificate, and of one channel in two certificates.
    """
    world, own = Calibrator(seed), sim.Switches(gain=False, calibrator_errors=False)
    units = [sim.simulate(2 * seed + number, own, world=world) for number in (0, 1)]
    first, second = (estimates_of(unit, register()) for unit in units)
    seen: dict[str, bool | None] = {}
    for quantity in ("dsf_n", "dsf_p", "dsf_asymmetry"):
        places = [number for number, entry in enumerate(first) if entry.quantity == quantity]
        at = places[seed % len(places)]
        truth = units[0].truth(first[at])
        seen[quantity] = _holds(first[at].value - truth, first[at].expanded_uncertainty, first[at : at + 1])
    places = [number for number, entry in enumerate(first) if entry.quantity == "dsf_n"]
    gyro, accelerometer = places[2 * (seed % 5)], places[2 * (seed % 5) + 1]
    seen["dsf_n between channels"] = _difference(units[:1] * 2, (first[gyro], first[accelerometer]))
    seen["dsf_n between certificates"] = _difference(units, (first[gyro], second[gyro]))
    return seen


def _difference(units: Sequence[sim.SimulatedCampaign], pair: Sequence[Any]) -> bool | None:
    errors = [entry.value - unit.truth(entry) for unit, entry in zip(units, pair, strict=True)]
    shared = covariance_by_standards(*(entry.common for entry in pair))
    variance = math.fsum(entry.std_uncertainty**2 for entry in pair) - 2.0 * shared
    return _holds(errors[1] - errors[0], coverage_factor() * math.sqrt(variance), pair)


def _holds(error: float, expanded: float, entries: Sequence[Any]) -> bool | None:
    return bool(abs(error) <= expanded) if all(is_sound(entry) for entry in entries) else None
