"""Truth of the sensors of one simulated module: errors drawn once from (seed, serial number), and the periods in
which it had power, which warm it and give it a bias of their own. Every number and its reason stands in
docs/gnc-simulation.md.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike

from bench.model.arrays import Floats, Integers
from bench.model.clock import NS
from sim_instruments.seeds import generator
from sim_instruments.worlds.common.attitude import Tilt

REFERENCE_DEGC = 25.0
WARM_UP_DEGC = 6.0
WARM_UP_LAG_S = 80.0
MEAN_INTERVAL_S = 10.0  # of the paper's stability figure
SLOW_GYRO_DEG_S = 2.0 / 3600.0
SLOW_GYRO_S = 300.0
SLOW_ACCEL_G = 6e-6  # each of three, a decade apart
SLOW_ACCEL_S = (10.0, 100.0, 1000.0)
ARW_DEG_RT_H = 0.3
VRW_G_RTS = 0.1e-3
MAGNETIC_NOISE_GAUSS = 0.5e-3
THERMOMETER_NOISE_DEGC = 0.02
_LARGEST_DRAW = 2.5  # standard deviations


@dataclass(frozen=True)
class ImuOptions:
    """Choices for the sensors of a simulated module.

    Attributes:
        errors: off makes ideal sensors (their noise stays).
        noise: off leaves out white and slow noise and the bias that a power-on brings.
        tilt_arcmin: standard deviation of the body's tilt against the inner axis, about each axis and at each pose.
        imu_class: "coarse" has 1 % scale errors, 0.3 % cross terms and the angle random walk ``ARW_DEG_RT_H``;
            "table_2" draws the angle random walk so that the 10 s means scatter as in Table 2 of the paper;
            "table_3" has a tenth of the scale errors and cross terms, below its coupling limit of 0.001.
        lever_arm_m: place of the accelerometers from the centre of rotation of the table, body axes.
    """

    errors: bool = True
    noise: bool = True
    tilt_arcmin: float = 0.0
    imu_class: str = "coarse"
    lever_arm_m: tuple[float, float, float] = (0.0, 0.0, 0.0)


SCALE_AND_CROSS = {"coarse": (0.01, 0.003), "table_2": (0.01, 0.003), "table_3": (0.001, 0.0003)}


@dataclass(frozen=True)
class Triad:
    """One triad of sensors, N = S (w + b) at ``REFERENCE_DEGC``: indicated from true, in the unit of the triad.

    Attributes:
        sensitivity: S, (3, 3), indicated per true; row = sensor, column = body axis.
        bias: b, (3,).   scale_per_degC: relative change of each sensor's row.   bias_per_degC: change of b.
        turn_on: standard deviation of what a power-on adds to b, (3,).   white: N of each sensor, unit times sqrt(s).
    """

    sensitivity: Floats
    bias: Floats
    scale_per_degC: Floats
    bias_per_degC: Floats
    turn_on: Floats
    white: Floats

    def sensitivity_at(self, degC: Floats) -> Floats:
        """Return S at temperatures (n,), (n, 3, 3)."""
        return self.row_factor(degC)[:, :, None] * self.sensitivity

    def row_factor(self, degC: Floats) -> Floats:
        """Return what temperature multiplies each sensor's row with, (n, 3)."""
        return 1.0 + (degC - REFERENCE_DEGC)[:, None] * self.scale_per_degC

    def bias_at(self, degC: Floats) -> Floats:
        """Return b at temperatures (n,) without noise, (n, 3)."""
        return self.bias + (degC - REFERENCE_DEGC)[:, None] * self.bias_per_degC


class ImuErrors:
    """Gyroscopes (deg/s), accelerometers (standard g), thermometer and tilt of one module.

    Args: seed of the run, serial number of the module, options.
    """

    def __init__(self, seed: int, serial: str, options: ImuOptions) -> None:
        self.options = options
        rng = generator(seed, f"gnc imu errors {serial}")
        s_deg_s = 1.0 / 3600.0
        gyro = _triad(rng, options.imu_class, 0.1, 30e-6, 3.0 * s_deg_s)
        accel = _triad(rng, options.imu_class, 10e-3, 20e-6, 0.03e-3)
        turn_on = rng.uniform(1.2, 4.8, 3) * s_deg_s, rng.uniform(0.015, 0.070, 3) * 1e-3
        white = _gyro_white(seed, serial, options.imu_class), np.full(3, VRW_G_RTS)
        self.gyro = _chosen(options, gyro, turn_on[0], white[0])
        self.accel = _chosen(options, accel, turn_on[1], white[1])
        self.thermometer_degC = rng.normal(0.0, 0.5) * options.errors
        self._seed, self._serial = seed, serial

    def tilt(self, mounting: str) -> Tilt | None:
        """Return tilt of the body in one mounting, None if there is none."""
        if self.options.tilt_arcmin <= 0.0:
            return None
        rng = generator(self._seed, f"gnc tilt {self._serial} {mounting}")
        sigma_rad = np.deg2rad(self.options.tilt_arcmin / 60.0) / np.sqrt(3.0)
        turns = rng.standard_normal((5, 3)) * sigma_rad
        return Tilt(turns[0], turns[1:3], turns[3:5])


def drawn(rng: np.random.Generator, sigma: ArrayLike, shape: int | tuple[int, ...]) -> Floats:
    """Return normal numbers that stay within 2.5 standard deviations."""
    return np.asarray(np.clip(rng.standard_normal(shape), -_LARGEST_DRAW, _LARGEST_DRAW) * sigma)


def signed(rng: np.random.Generator, size: float, shape: int) -> Floats:
    """Return numbers of half to one and a half times ``size``, of either sign."""
    return np.asarray(rng.choice((-1.0, 1.0), shape) * size * rng.uniform(0.5, 1.5, shape))


def _gyro_white(seed: int, serial: str, imu_class: str) -> Floats:
    """Return angle random walk of the three sensors, deg/rt_s."""
    if imu_class != "table_2":
        return np.full(3, ARW_DEG_RT_H / 60.0)
    means_deg_h = generator(seed, f"gnc table 2 {serial}").uniform(3.6, 9.1, 3)
    white_deg_s = np.sqrt(means_deg_h**2 / 3600.0**2 - SLOW_GYRO_DEG_S**2)
    return np.asarray(white_deg_s * np.sqrt(MEAN_INTERVAL_S))


def _triad(rng: np.random.Generator, name: str, bias: float, scale_degC: float, bias_degC: float) -> Triad:
    scale, cross = SCALE_AND_CROSS[name]
    sensitivity = drawn(rng, cross, (3, 3))
    np.fill_diagonal(sensitivity, 1.0 + drawn(rng, scale, 3))
    nothing = np.zeros(3)
    return Triad(
        sensitivity, drawn(rng, bias, 3), signed(rng, scale_degC, 3), signed(rng, bias_degC, 3), nothing, nothing
    )


def _chosen(options: ImuOptions, triad: Triad, turn_on: Floats, white: Floats) -> Triad:
    """Return the triad with what the options leave of it."""
    wrong, noisy = float(options.errors), float(options.noise)
    return Triad(
        np.eye(3) + wrong * (triad.sensitivity - np.eye(3)),
        wrong * triad.bias,
        wrong * triad.scale_per_degC,
        wrong * triad.bias_per_degC,
        noisy * turn_on,
        noisy * white,
    )


@dataclass(frozen=True)
class _Stretch:
    """From ``start_ns`` on the self-heating goes from ``start_degC`` to ``target_degC``; ``period`` counts from 0."""

    start_ns: int
    start_degC: float
    target_degC: float
    period: int


class PowerPeriods:
    """Times of power-on and power-off, given in order of time; before the first one the module is cold."""

    def __init__(self) -> None:
        self._stretches = [_Stretch(0, 0.0, 0.0, 0)]

    def on(self, t_ns: int) -> None:
        """Power comes on; each time but the first begins a new period."""
        self._begin(t_ns, WARM_UP_DEGC)

    def off(self, t_ns: int) -> None:
        """Power goes off: the module cools with the lag it warmed with."""
        self._begin(t_ns, 0.0)

    @property
    def first_ns(self) -> int:
        """Bench time of the first power-on, 0 before it."""
        return next((s.start_ns for s in self._stretches if s.target_degC > 0.0), 0)

    def rise_degC(self, t_ns: Integers) -> Floats:
        """Return self-heating above the surroundings at bench times (n,), degC."""
        starts = np.array([s.start_ns for s in self._stretches], np.int64)
        states = np.array([(s.start_degC, s.target_degC) for s in self._stretches])
        at = self._at(t_ns)
        first, last = states[at].T
        since_s = np.maximum(t_ns - starts[at], 0) / NS
        return np.asarray(last + (first - last) * np.exp(-since_s / WARM_UP_LAG_S))

    def period(self, t_ns: Integers) -> Integers:
        """Return number of the power-on period at bench times (n,), from 0."""
        return np.array([s.period for s in self._stretches], np.int64)[self._at(t_ns)]

    def _at(self, t_ns: Integers) -> Integers:
        starts = [s.start_ns for s in self._stretches]
        return np.maximum(np.searchsorted(starts, t_ns, side="right") - 1, 0)

    def _begin(self, t_ns: int, target_degC: float) -> None:
        last = self._stretches[-1]
        if target_degC == last.target_degC:
            return
        started = any(s.target_degC > 0.0 for s in self._stretches)
        period = last.period + 1 if started and target_degC > 0.0 else last.period
        rise_degC = float(self.rise_degC(np.array([t_ns]))[0])
        self._stretches.append(_Stretch(t_ns, rise_degC, target_degC, period))
