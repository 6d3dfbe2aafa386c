"""Supply, AD channels and satellite receiver of the simulated GNC module.

Paper 001, section 3 (2) 4: three AD channels see the magnetometer's outputs; five are led out, on the test board to
5 V, 3.3 V, 1.2 V, GND and to nothing, each through a DIP switch; with its switch off a channel is pulled down.
"""

from __future__ import annotations

from collections.abc import Set
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from sim_instruments.worlds.gnc.draws import ModuleDraws

Float = NDArray[np.float64]

CHANNELS = 8
VOLT_PER_GAUSS, MAGNETOMETER_ZERO_V = 0.2, 2.5
LSB_V, HIGHEST_V, NOISE_V = 5.5 / 4096, 5.5, 1e-3
NOMINAL_CURRENT_A, CURRENT_SIGMA_A = 0.49, 0.005  # 5 % are 0.0245 A
SHORT_CURRENT_A = 20.0
CONTACT_OHM = 0.9
METRE_DEG = 1.0 / 111_195.0  # of latitude
GIVE_UP_S = 1.8  # the processor waits no longer for a fix


class Power:
    """What the module draws from 5 V and what its regulators make of it."""

    def __init__(self, draws: ModuleDraws, faults: Set[str]) -> None:
        self._faults = faults
        rng = draws.generator("supply")
        self._current_A = NOMINAL_CURRENT_A + float(np.clip(rng.normal(0.0, CURRENT_SIGMA_A), -0.015, 0.015))
        self._rails_V = (float(rng.normal(3.3, 0.01)), float(rng.normal(1.2, 0.004)))

    @property
    def current_A(self) -> float:
        """Current while the module runs, ampere."""
        if "supply_short" in self._faults:
            return SHORT_CURRENT_A
        more_A = 0.05 if "current_high" in self._faults else 0.0
        return self._current_A + more_A - (0.05 if "current_low" in self._faults else 0.0)

    def board_V(self, supply_V: float) -> float:
        """Voltage at the test board, where it is measured, behind the contacts of the supply."""
        return supply_V - (CONTACT_OHM * self.current_A if "contact_resistance" in self._faults else 0.0)

    @property
    def rails_V(self) -> tuple[float, float]:
        """The 3.3 V and the 1.2 V of the module, volt."""
        high_V = 2.9 if "rail_3v3_low" in self._faults else self._rails_V[0]
        return high_V, 1.4 if "rail_1v2_high" in self._faults else self._rails_V[1]


class Converter:
    """The AD converter: gain and offset drawn once, twelve bits of 5.5 V, noise of each reading."""

    def __init__(self, draws: ModuleDraws, faults: Set[str]) -> None:
        self._draws, self._faults = draws, faults
        rng = draws.generator("AD errors")
        self._gain, self._offset_V = float(rng.normal(1.0, 1e-3)), float(rng.normal(0.0, 2e-3))
        self._readings = 0

    def read_V(self, sources_V: Float, switch: int, field_gauss: Float) -> Float:
        """Return the eight channels, (8,), volt.

        Args: sources_V: what channels 4 to 7 are connected to, (4,).   switch: DIP switch that is on, 0 for none.
            field_gauss: what the magnetometer gives, (3,).
        """
        self._readings += 1
        rng = self._draws.generator("AD noise", self._readings)
        true_V = np.zeros(CHANNELS)
        true_V[:3] = MAGNETOMETER_ZERO_V + VOLT_PER_GAUSS * field_gauss
        if "magnetometer_output_dead" in self._faults:
            true_V[1] = 0.0
        leads_V = [*sources_V, rng.uniform(0.2, 2.6)]  # a floating input is anywhere
        if "ad_ground_lifted" in self._faults:
            leads_V[3] += 0.6
        if switch:
            true_V[2 + switch] = leads_V[switch - 1]
        if "ad_channel_open" in self._faults:
            true_V[3] = 0.0
        gain = self._gain * (1.0 / 0.88 if "ad_reference" in self._faults else 1.0)
        offset_V = self._offset_V + (0.25 if "ad_offset" in self._faults else 0.0)
        seen_V = np.clip(true_V * gain + offset_V + rng.normal(0.0, NOISE_V, CHANNELS), 0.0, HIGHEST_V)
        return np.asarray(np.rint(seen_V / LSB_V) * LSB_V)


@dataclass(frozen=True)
class Fix:
    """What the satellite receiver says; ``fix`` 0 none, 2 without height, 3 with it."""

    fix: int
    satellites: int
    latitude_deg: float
    longitude_deg: float
    height_m: float
    time_to_fix_s: float


class Receiver:
    """The satellite receiver in a hot start: almanac, ephemeris, time and place are known."""

    def __init__(self, draws: ModuleDraws, faults: Set[str], place: tuple[float, float, float]) -> None:
        self._draws, self._faults = draws, faults
        self._place = place  # latitude and longitude in degrees, height in metres
        self._starts = 0

    @property
    def alive(self) -> bool:
        """Whether it answers the processor."""
        return "gps_silent" not in self._faults

    def hot_start(self) -> Fix:
        """Return the fix of the next start; 1.3 to 1.7 s from the command, 1.5 m of noise across and 2.5 m upwards."""
        self._starts += 1
        rng = self._draws.generator("hot start", self._starts)
        north_m, east_m = rng.normal(0.0, 1.5, 2)
        height_m, time_s, satellites = rng.normal(0.0, 2.5), rng.uniform(1.3, 1.7), int(rng.integers(8, 13))
        if not self.alive or "gps_no_satellites" in self._faults:
            return Fix(0, 0, 0.0, 0.0, 0.0, GIVE_UP_S)
        latitude_deg = self._place[0] + north_m * METRE_DEG
        longitude_deg = self._place[1] + east_m * METRE_DEG / float(np.cos(np.deg2rad(self._place[0])))
        if "gps_far" in self._faults:
            latitude_deg += 1.0
        if "gps_few_satellites" in self._faults:
            return Fix(2, 3, latitude_deg, longitude_deg, 0.0, time_s)
        return Fix(3, satellites, latitude_deg, longitude_deg, self._place[2] + height_m, time_s)
