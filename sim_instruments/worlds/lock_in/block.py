"""What one mounted laser block is: its path, what was drawn for it, and how it runs from one switching-on."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from sim_instruments.seeds import generator
from sim_instruments.worlds.common.thermal import LAB_DEGC
from sim_instruments.worlds.lock_in.core import (
    DITHER_DEG_S,
    DITHER_HZ,
    LOCK_IN_DEG_S,
    LOCK_IN_PATH_M,
    S_PER_H,
    RingLaser,
    quantum_deg_rt_h,
)

Float = NDArray[np.float64]

PPM = 1e-6
MM = 1000.0
BEAT_VOLT = 1.2
SELF_HEATING_DEGC, SELF_HEATING_S = 8.0, 900.0
_VOLT_PER_DEGC = -2e-4  # relative, of the intensity


@dataclass(frozen=True)
class LaserBlock:
    """One laser block; blocks of one path are one and the same.

    ``laser``: without its backscatter phase, which mirror transducers set.   ``phase_offset_deg``: what is added to the
    setting.   ``drift_deg_h``: of that phase while the laser is on.   ``dither_gain``: of the amplitude's sensor.
    ``warmth_degC``: of its thermometer against others.   ``beat_V``: amplitude of the beat at the laboratory's
    temperature.   ``current_A``: from its supply.
    """

    number: int
    laser: RingLaser
    phase_offset_deg: float
    drift_deg_h: float
    dither_gain: float
    warmth_degC: float
    beat_V: float
    current_A: float

    @classmethod
    def drawn(cls, seed: int, path_m: float, options: Mapping[str, Any]) -> LaserBlock:
        """Return the block of a path length, with completed options of the world."""
        number = round(path_m * MM)
        draws = generator(seed, "ring laser block", number).standard_normal(7)
        second_rad = float(generator(seed, "ring laser second harmonic", number).uniform(-math.pi, math.pi))
        laser = RingLaser(
            path_m=path_m,
            lock_in_deg_s=LOCK_IN_DEG_S * (LOCK_IN_PATH_M / path_m) ** 2 * (1.0 + 0.01 * draws[0]),
            rate_deg_h=float(options["rate_deg_h"]),
            dither_deg_s=DITHER_DEG_S * (1.0 + 0.005 * draws[1]),
            dither_Hz=DITHER_HZ + 0.3 * draws[2],
            dither_noise=float(options["dither_noise_ppm"]) * PPM,
            quantum_deg_rt_h=quantum_deg_rt_h(path_m) if options["quantum_noise"] else 0.0,
            beat_noise=float(options["beat_noise_ppm"]) * PPM,
            second_harmonic=float(options["second_harmonic_ppm"]) * PPM,
            second_phase_rad=second_rad,
        )
        return cls(
            number=number,
            laser=laser,
            phase_offset_deg=2.0 * draws[3],
            drift_deg_h=float(options["backscatter_drift_deg_h"]),
            dither_gain=1.0 + 0.01 * draws[4],
            warmth_degC=0.3 * draws[5],
            beat_V=BEAT_VOLT * (1.0 + 0.03 * draws[6]),
            current_A=0.55 + 0.5 * path_m,
        )

    def beta_deg(self, setting_deg: Any, on_s: Any) -> Any:
        """Return phase of the backscatter for a setting of the transducers, so long after switching on, degree."""
        return setting_deg + self.phase_offset_deg + self.drift_deg_h * on_s / S_PER_H

    def degC(self, on_s: Float) -> Float:
        """Return what its thermometer shows so long after switching on, without noise: it always starts cold."""
        warmed = SELF_HEATING_DEGC * -np.expm1(-on_s / SELF_HEATING_S)
        return np.asarray(LAB_DEGC + self.warmth_degC + warmed)

    def intensity_V(self, degC: Float) -> Float:
        """Amplitude of the beat while the laser runs, without noise."""
        return np.asarray(self.beat_V * (1.0 + _VOLT_PER_DEGC * (degC - LAB_DEGC)))
