"""A dithered ring laser without a bench: what it is and what drives its phase, as pure functions.

    dpsi/dt = K [W_in + W_D(t) - W_L (sin(psi + beta) + e sin(2 psi + beta_2))],    W_D(t) = A_k cos(w_D t)

psi is the Sagnac phase in rad, positive for a positive rotation; t = 0 is a maximum of the dither's velocity. A_k is
drawn anew at each maximum of the velocity (both senses), where the dither's angle is zero, so the angle has no step.

Source: paper 004, equation (10); K of a square ring, K = 8 pi area / (wavelength length) = pi L / (2 wavelength).
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from bench.model.arrays import Flags, Floats, Octets
from sim_instruments.worlds.lock_in.crossings import Crossings
from sim_instruments.worlds.lock_in.half_cycles import Drive

WAVELENGTH_M = 632.8e-9
DITHER_DEG_S, DITHER_HZ = 100.0, 400.0
LOCK_IN_DEG_S, LOCK_IN_PATH_M = 0.05, 0.28  # lock-in rate of that path; it falls with the square of the path
QUANTUM_DEG_RT_H, QUANTUM_PATH_M = 1.15e-4, 0.28
S_PER_H = 3600.0
AT_ONCE = 40  # half cycles integrated together: small enough for the cache, large enough for the interpreter
MOST_STEP_RAD = 1.6  # beat phase in one step at the velocity's maximum
LEAST_STEPS, SEGMENTS = 500, 10  # of a half cycle
BEAT, PICK_OFF = 0, 1  # channels


@dataclass(frozen=True)
class RingLaser:
    """One ring laser with its dither.

    Args:
        path_m: length of the optical path.   beta_rad: phase of the backscatter.
        lock_in_deg_s: lock-in rate W_L, by default 0.05 deg/s (28 cm / path)^2.
        rate_deg_h: input rate.   dither_deg_s, dither_Hz: mean amplitude of the rate and frequency; 0 deg/s = none.
        dither_noise: standard deviation of the amplitude, relative.
        quantum_deg_rt_h: random walk of the laser itself (angle), 0 for none; ``quantum_deg_rt_h(path)`` gives theory.
        beat_noise: of the comparators, standard deviation in parts of the beat's amplitude, white from edge to edge.
        second_harmonic, second_phase_rad: e and beta_2 above.
    """

    path_m: float = 0.28
    beta_rad: float = math.pi / 2
    lock_in_deg_s: float | None = None
    rate_deg_h: float = 0.0
    dither_deg_s: float = DITHER_DEG_S
    dither_Hz: float = DITHER_HZ
    dither_noise: float = 0.05
    quantum_deg_rt_h: float = 0.0
    beat_noise: float = 0.0
    second_harmonic: float = 0.0
    second_phase_rad: float = 0.0

    @property
    def scale(self) -> float:
        """K, rad of phase per rad of rotation."""
        return math.pi * self.path_m / (2.0 * WAVELENGTH_M)

    @property
    def lock_in_rad_s(self) -> float:
        """W_L, rad/s of rotation."""
        lock_in_deg_s = LOCK_IN_DEG_S * (LOCK_IN_PATH_M / self.path_m) ** 2
        return math.radians(lock_in_deg_s if self.lock_in_deg_s is None else self.lock_in_deg_s)

    @property
    def kappa_rad_s(self) -> float:
        """K W_L, rad/s of phase: the largest beat rate that lock-in swallows."""
        return self.scale * self.lock_in_rad_s

    @property
    def half_s(self) -> float:
        """Half a period of the dither, in whole picoseconds."""
        return round(0.5e12 / self.dither_Hz) * 1e-12

    @property
    def steps(self) -> int:
        """Steps of the integration in a half cycle."""
        most_rad = self.scale * math.radians(self.dither_deg_s) * (1.0 + 4.0 * self.dither_noise) * self.half_s
        return SEGMENTS * math.ceil(max(LEAST_STEPS, most_rad / MOST_STEP_RAD) / SEGMENTS)

    @property
    def quantum_rad_rt_s(self) -> float:
        """Random walk of the phase, rad per root of a second."""
        return self.scale * math.radians(self.quantum_deg_rt_h) / math.sqrt(S_PER_H)

    @property
    def lock_in_walk_deg_rt_h(self) -> float:
        """Angle random walk W_L / sqrt(K W_D) that the dithered lock-in makes, deg/rt-h. Source: paper 004, (6)."""
        walk_rad_rt_s = self.lock_in_rad_s / math.sqrt(self.scale * math.radians(self.dither_deg_s))
        return math.degrees(walk_rad_rt_s) * math.sqrt(S_PER_H)

    def drive(self, dither_deg_s: Floats, first_sense: int, noise: Floats | None, beta_rad: Floats | float) -> Drive:
        """Return what drives the phase in consecutive half cycles.

        Args: dither_deg_s: amplitudes (n,).   first_sense: +1 if the first half cycle begins at a positive rate.
            noise: standard normal draws (n, steps), None without quantum noise.   beta_rad: (n,) or one for all.
        """
        walk = None
        if noise is not None:
            walk = self.quantum_rad_rt_s * math.sqrt(self.half_s / self.steps) * noise
        sense = first_sense * (1.0 - 2.0 * (np.arange(len(dither_deg_s)) % 2))
        return Drive(
            half_s=self.half_s,
            steps=self.steps,
            amplitude_rad_s=self.scale * np.radians(dither_deg_s) * sense,
            rate_rad_s=self.scale * math.radians(self.rate_deg_h) / S_PER_H,
            kappa_rad_s=self.kappa_rad_s,
            beta_rad=np.broadcast_to(np.asarray(beta_rad, float), sense.shape),
            walk_rad=walk,
            second=self.second_harmonic,
            second_phase_rad=self.second_phase_rad,
        )


def quantum_deg_rt_h(path_m: float) -> float:
    """Return angle random walk of the quantum noise, deg/rt-h: 1.15e-4 at 28 cm, falls with the square of the path.

    Source: paper 004, equation (3): power, losses and transmission of the mirrors alike for all paths.
    """
    return QUANTUM_DEG_RT_H * (QUANTUM_PATH_M / path_m) ** 2


def levels(rises: Flags, start_rad: Floats, crossed: Crossings) -> tuple[Octets, Octets]:
    """Return levels of the own channel behind the edge and of the cosine comparator, pick-off edges first."""
    level = np.concatenate([rises, crossed.count % 2 == 0])
    even = (crossed.count + (crossed.sense < 0)) % 2 == 0  # the multiple of pi that was crossed
    return level.astype(np.uint8), np.concatenate([np.cos(start_rad) > 0.0, even]).astype(np.uint8)
