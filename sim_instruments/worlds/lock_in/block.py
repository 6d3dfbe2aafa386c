"""A mounted laser block: what was drawn for it, how it runs from one switching-on, and its housekeeping frames."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np

from bench.frame import load_frame
from bench.model.arrays import Floats, Integers
from bench.model.clock import NS
from bench.model.lab import find_shipped
from sim_instruments.seeds import generator
from sim_instruments.worlds.common.port import Port
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

PPM = 1e-6
MM = 1000.0
BEAT_VOLT = 1.2
SELF_HEATING_DEGC, SELF_HEATING_S = 8.0, 900.0
_VOLT_PER_DEGC = -2e-4  # relative, of the intensity
PERIOD_NS = NS // 10
BOOT_NS = NS // 2  # from power to the first frame
NO_BEAT = 1  # status bit
AT_ONCE = 64
_NOISE_DEGC, _NOISE_V, _NOISE_DEG_S = 0.01, 2e-4, 0.05
_STEP_DEGC, _STEP_V, _STEP_DEG_S = 0.01, 1e-4, 0.01  # of the frame's fields
_MOST = (1 << 16) - 1


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
        second_rad = generator(seed, "ring laser second harmonic", number).uniform(-math.pi, math.pi)
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

    def degC(self, on_s: Floats) -> Floats:
        """Return what its thermometer shows so long after switching on, without noise: it always starts cold."""
        warmed = SELF_HEATING_DEGC * -np.expm1(-on_s / SELF_HEATING_S)
        return LAB_DEGC + self.warmth_degC + warmed

    def intensity_V(self, degC: Floats) -> Floats:
        """Return amplitude of the beat while the laser runs, without noise."""
        return self.beat_V * (1.0 + _VOLT_PER_DEGC * (degC - LAB_DEGC))


class Housekeeping:
    """Sends the housekeeping of one switching-on.

    Args:
        port: where to.   block: of which laser.   on_ns: when it got power.   beat_ns: when it begins to beat.
        dither_deg_s: mean amplitude over the last 0.1 s at a bench time.   draw: generator of a purpose and a number.
    """

    def __init__(
        self,
        port: Port,
        block: LaserBlock,
        on_ns: int,
        beat_ns: int,
        dither_deg_s: Callable[[int], float],
        draw: Callable[..., np.random.Generator],
    ) -> None:
        self._definition = load_frame(find_shipped("frames", "rlg_housekeeping"))
        self._port, self._block, self._on_ns, self._beat_ns = port, block, on_ns, beat_ns
        self._dither_deg_s, self._draw = dither_deg_s, draw
        self._sent = 0

    def send(self, upto_ns: int) -> None:
        """Send all frames due; nobody listens = nothing is made, the counter goes on."""
        due = max(0, (upto_ns - self._on_ns - BOOT_NS) // PERIOD_NS + 1)
        if not self._port.listened:
            self._sent = max(self._sent, due)
        while self._sent < due:
            stop = min(due, (self._sent // AT_ONCE + 1) * AT_ONCE)
            self._append(np.arange(self._sent, stop, dtype=np.int64))
            self._sent = stop

    def _append(self, number: Integers) -> None:
        t_ns = self._on_ns + BOOT_NS + number * PERIOD_NS
        beats = t_ns >= self._beat_ns
        noise = self._draw("housekeeping", int(number[0]) // AT_ONCE).standard_normal((AT_ONCE, 3))[number % AT_ONCE]
        degC = self._block.degC((t_ns - self._on_ns) / NS)
        volt = self._block.intensity_V(degC) * beats + _NOISE_V * noise[:, 1]
        true = np.array([self._dither_deg_s(int(t)) for t in t_ns])
        dither = (true * self._block.dither_gain + _NOISE_DEG_S * noise[:, 2]) * (true > 0.0)
        columns = {
            "counter": (number % 2**32).astype(np.uint32),
            "temperature": np.rint((degC + _NOISE_DEGC * noise[:, 0]) / _STEP_DEGC).astype(np.int16),
            "intensity": np.clip(np.rint(volt / _STEP_V), 0, _MOST).astype(np.uint16),
            "dither_amplitude": np.clip(np.rint(dither / _STEP_DEG_S), 0, _MOST).astype(np.uint16),
            "status": np.where(beats, 0, NO_BEAT).astype(np.uint16),
        }
        self._port.append(t_ns, self._definition.encode(columns, len(number)))
